"""Where matplotlib cannot write in the user's home it makes do, and need not say so before every answer.

It then takes a temporary folder for its list of fonts, which goes with the process, and names it in two lines of
warning. Who has set a folder for it is still told when that one is of no use.
"""

from __future__ import annotations

import logging
import os
from typing import Final

VARIABLE: Final = "MPLCONFIGDIR"
_ABOUT_ITS_FOLDER: Final = (
    "mkdir -p failed for path",
    "%s is not a writable directory",
    "Matplotlib created a temporary cache directory",
)
"""How the lines begin that are left out, as they are before anything is put into them."""


def say_nothing_of_its_folder() -> None:
    """From now on; to be called before matplotlib is imported, for it looks for its folder then."""
    if not os.environ.get(VARIABLE):
        # a filter holds for this logger alone: what matplotlib's modules say goes on to be told
        logging.getLogger("matplotlib").addFilter(_is_told)


def _is_told(record: logging.LogRecord) -> bool:
    return not str(record.msg).startswith(_ABOUT_ITS_FOLDER)
