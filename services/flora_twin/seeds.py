"""Which seeds there are: one range for every command, the configuration and whoever starts the box."""

from __future__ import annotations

from typing import Annotated, Final

import typer

LARGEST_SEED: Final = 2**32 - 1

Seed = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="The individual plant and all chance.")]
