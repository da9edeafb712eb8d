"""The controller that the demo steers with: evolved, signed, and shipped with the public half of its key.

How it was made stands in ``shipped/README.md``; what it was evolved in, in the file itself.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

EVOLVED: Final = "evolved"
"""What the demo calls it, beside the names of the built-in controllers."""
KEYS_DIR: Final = Path(__file__).with_name("shipped")
CONTROLLER: Final = KEYS_DIR / "round.controller.json"
