"""What is told beside a result, of input that was read with something left out."""

from __future__ import annotations

import sys


def aside(text: str) -> None:
    """A sentence on stderr."""
    print(f"note: {text}", file=sys.stderr)
