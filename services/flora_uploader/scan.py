"""Looking through the spool: which run folders there are, which files of record are in them, what the camera wrote."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from flora_common.errors import BadRunFolder, StoreError
from flora_common.runs import RunFolder
from flora_uploader.ledger_model import Found, mtime_ns
from flora_uploader.policy import is_of_record, is_photograph, kind_of

BATCH: Final = 200
"""Files looked at before control is given back."""

MAX_DEPTH: Final = 8


class SpoolUnreadable(StoreError):
    """A folder of the spool cannot be listed."""


@dataclass(frozen=True, slots=True)
class RunFolders:
    """What is in the spool.

    Attributes:
        runs: run folders by name.
        clashes: left out because another one has the name already.
        unreadable: left out because they cannot be looked at, and why; by every name that they may have.
        unnameable: left out because their names are not UTF-8 text; told as Python shows them.
    """

    runs: dict[str, Path]
    clashes: list[str]
    unreadable: dict[str, str]
    unnameable: list[str]


def is_run_folder(path: Path) -> bool:
    """Whether a folder has a ``run.toml``. One that we may not look into is not ours.

    Raises:
        SpoolUnreadable: its disk or server does not say.
    """
    try:
        return stat.S_ISREG(RunFolder(path).run_toml.stat().st_mode)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return False
    except OSError as problem:
        if problem.errno == errno.ELOOP:  # a link that leads to itself leads to no run folder
            return False
        raise SpoolUnreadable(f"{path}: the run folder cannot be looked at ({problem.strerror})") from problem


def run_folders(runs_dir: Path, run_dir: Path) -> RunFolders:
    """Every run folder of the spool, the rig's present one included. Links count under what they lead to.

    Raises:
        SpoolUnreadable: the spool itself cannot be listed.
    """
    candidates = [run_dir]
    try:
        with os.scandir(runs_dir) as entries:
            candidates += [Path(entry.path) for entry in entries if is_of_record(entry.name)]
    except FileNotFoundError:
        pass  # nothing has run yet
    except OSError as problem:
        raise SpoolUnreadable(f"{runs_dir}: the spool cannot be listed ({problem.strerror})") from problem
    found = RunFolders({}, [], {}, [])
    unnameable: set[Path] = set()
    for candidate in candidates:
        path = real_path(candidate)
        if path in found.runs.values() or path in unnameable:
            continue
        trouble = ""
        try:
            if not is_run_folder(path):
                continue
        except SpoolUnreadable as problem:
            trouble = str(problem)
        # neither a name that the ledger cannot take nor a dead mount or a bad sector holds up the others
        if not is_text(path.name):
            found.unnameable.append(repr(path.name))
            unnameable.add(path)
        elif trouble:
            found.unreadable.update(dict.fromkeys((candidate.name, path.name), trouble))
        elif path.name in found.runs:
            found.clashes.append(f"{found.runs[path.name]} and {path}")
        else:
            found.runs[path.name] = path
    return found


def real_path(path: Path) -> Path:
    """Without links. ``Path.resolve`` would end in an error where links go in a circle."""
    try:
        return Path(os.path.realpath(path))
    except OSError:  # a link that its disk does not give out: who looks through it is told why
        return path.absolute()


def files_of_record(run: Path, left_out: list[str]) -> Iterator[list[Found]]:
    """The files of a run folder in batches. Links, pipes and the like are left out: they are nobody's record.

    Args:
        run: the run folder.
        left_out: filled with files whose names are not UTF-8 text and cannot be told to anybody, and with folders that
            lie too deep, as Python shows them.
    """
    batch: list[Found] = []
    folders = [("", 0)]
    while folders:
        inner, depth = folders.pop()
        try:
            with os.scandir(run / inner) as entries:
                for entry in entries:
                    if not is_of_record(entry.name):
                        continue
                    path = f"{inner}/{entry.name}" if inner else entry.name
                    if not is_text(path):
                        left_out.append(repr(path))
                    elif entry.is_dir(follow_symlinks=False):
                        if depth < MAX_DEPTH:
                            folders.append((path, depth + 1))
                        else:
                            left_out.append(repr(path))
                    elif entry.is_file(follow_symlinks=False):
                        found = look_at(run, path)
                        if found is not None:
                            batch.append(found)
                    if len(batch) >= BATCH:
                        yield batch
                        batch = []
        except FileNotFoundError:
            continue  # taken away while we looked
        except OSError as problem:
            raise SpoolUnreadable(f"{run / inner}: the spool cannot be listed ({problem.strerror})") from problem
    yield batch


def folders_of_record(run: Path) -> list[str]:
    """Folders inside a run folder that hold files of record."""
    found = {str(Path(file.path).parent) for batch in files_of_record(run, []) for file in batch}
    return sorted(found - {"."})


def look_at(run: Path, path: str) -> Found | None:
    """One file as it is now; None where there is none, or something else of that name."""
    try:
        status = (run / path).lstat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as problem:
        raise SpoolUnreadable(f"{run / path}: cannot be looked at ({problem.strerror})") from problem
    if not stat.S_ISREG(status.st_mode):
        return None  # an announcement can name anything; it would wait for ever
    return Found(path, kind_of(path), status.st_size, mtime_ns(status))


def hashes_of_photographs(run: Path) -> dict[str, str]:
    """SHA-256 by path of every photograph of the plant that a run folder's ``frames.jsonl`` tells of."""
    try:
        announced = RunFolder(run).announced_hashes()
    except BadRunFolder as problem:
        raise SpoolUnreadable(str(problem)) from problem
    return {path: sha256 for path, sha256 in announced.items() if is_photograph(path)}


def is_text(name: str) -> bool:
    """Whether a name is UTF-8 text, so that ledger and messages can hold it."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
