"""Every module of common can be the first that a program imports: none waits for one that waits for it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

COMMON = Path(__file__).parents[2] / "common"
ONE_BY_ONE = """
import importlib, sys
for name in sys.argv[1:]:
    for known in [module for module in sys.modules if module.split(".")[0] == "flora_common"]:
        del sys.modules[known]
    try:
        importlib.import_module(name)
    except ImportError as problem:
        print(f"{name}: {problem}")
"""


def test_every_module_can_be_imported_before_all_others() -> None:
    paths = [path.relative_to(COMMON).with_suffix("") for path in sorted(COMMON.rglob("*.py"))]
    names = [".".join(path.parts).removesuffix(".__init__") for path in paths if path.name != "__main__"]
    assert len(names) > 50
    done = subprocess.run([sys.executable, "-c", ONE_BY_ONE, *names], capture_output=True, text=True, check=True)
    assert done.stdout == ""
