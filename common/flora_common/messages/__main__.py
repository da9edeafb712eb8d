"""``python -m flora_common.messages DIR`` writes ``messages.md`` and ``messages.schema.json``."""

import sys
from pathlib import Path

from flora_common.files import write_text
from flora_common.messages.reference import page, schema_text

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/reference")
write_text(folder / "messages.md", page())
write_text(folder / "messages.schema.json", schema_text())
print(f"wrote messages.md and messages.schema.json to {folder}")
