"""flora-lab while it loads its own parts, which takes seconds on a busy machine."""

from __future__ import annotations

import subprocess
import sys

INTERRUPTED_WHILE_LOADING = """
import sys

class CtrlC:
    def find_spec(self, name, path=None, target=None):
        if name == "flora_lab.rhythm.command":
            raise KeyboardInterrupt

sys.meta_path.insert(0, CtrlC())
from flora_lab.main import main
sys.exit(main(["rhythm", "tip.csv"]))
"""


def test_ctrl_c_while_the_command_still_loads_is_one_line_and_130() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_WHILE_LOADING], capture_output=True, text=True, timeout=120, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "flora-lab: interrupted\n")
