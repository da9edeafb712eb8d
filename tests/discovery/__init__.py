"""Hidden effects: worlds that hide one, and the judging of who finds it."""

import sys
from pathlib import Path

# Tests import this package as `discovery`, the command as `tests.discovery`. Numba keeps compiled code by file, and
# what it keeps names the module that it was compiled as: whoever comes second must be able to import it by that name.
_TESTS = Path(__file__).resolve().parent.parent
sys.path += [folder for folder in (str(_TESTS), str(_TESTS.parent)) if folder not in sys.path]
