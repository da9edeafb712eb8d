"""What a rig may be called: in the configuration, on the bus, and in the runs that it made."""

from __future__ import annotations

from typing import Annotated

import msgspec

RigName = Annotated[
    str,
    msgspec.Meta(
        # `$` alone lets a line feed through at the end in Python, which `(?!\n)` does not; it is JSON Schema, too.
        pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$(?!\n)",
        extra={"words": "1 to 32 small letters, digits, - and _, the first one a letter or digit"},
    ),
]
