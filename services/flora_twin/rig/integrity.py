"""After a run: is every photograph that was announced there, whole, and at the NAS?"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from flora_common.files import sha256_of_file
from flora_common.runs import RunFolder


@dataclass(frozen=True, slots=True)
class Integrity:
    """Counts over all announced photographs.

    Attributes:
        announced: lines of ``frames.jsonl``; each is written before its ``frame`` message is said.
        missing: their file is not in the run folder.
        torn: the file's SHA-256 is not what was announced.
        not_stored: missing or different at the NAS.
    """

    announced: int
    missing: int
    torn: int
    not_stored: int

    @property
    def whole(self) -> bool:
        return self.missing == self.torn == self.not_stored == 0


def check_run(run: RunFolder, nas_run: Path) -> Integrity:
    """Hash every announced photograph in the run folder and at the NAS.

    Args:
        run: the run folder.
        nas_run: the same run's folder at the NAS.
    """
    announced = missing = torn = not_stored = 0
    for line in run.frames_log.read_text().splitlines():
        entry = json.loads(line)
        announced += 1
        file = run.path / entry["file"]
        if not file.is_file():
            missing += 1
        elif sha256_of_file(file) != entry["sha256"]:
            torn += 1
        copy = nas_run / entry["file"]
        if not copy.is_file() or sha256_of_file(copy) != entry["sha256"]:
            not_stored += 1
    return Integrity(announced, missing, torn, not_stored)
