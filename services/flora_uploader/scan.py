"""Looking through the spool: which run folders there are, which files of record are in them, what the camera wrote."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from flora_common.errors import BadRunFolder, StoreError
from flora_common.runs import RunFolder
from flora_uploader.ledger import Found
from flora_uploader.policy import is_of_record, is_photograph, kind_of

BATCH: Final = 200
"""Files looked at before control is given back."""

MAX_DEPTH: Final = 8


class SpoolUnreadable(StoreError):
    """A folder of the spool cannot be listed."""


def is_run_folder(path: Path) -> bool:
    """Whether a folder has a ``run.toml``. One that we may not look into is not ours."""
    try:
        return (path / "run.toml").is_file()
    except PermissionError:
        return False


def run_folders(runs_dir: Path, run_dir: Path) -> tuple[dict[str, Path], list[str]]:
    """Every run folder of the spool, the rig's present one included. Links count under what they lead to.

    Returns:
        Folders by name, and those left out because another one has the name already.
    """
    candidates = [run_dir]
    try:
        with os.scandir(runs_dir) as entries:
            candidates += [Path(entry.path) for entry in entries if is_of_record(entry.name)]
    except FileNotFoundError:
        pass  # nothing has run yet
    except OSError as problem:
        raise SpoolUnreadable(f"{runs_dir}: the spool cannot be listed ({problem.strerror})") from problem
    runs: dict[str, Path] = {}
    clashes: list[str] = []
    for path in map(real_path, candidates):
        if path in runs.values() or not is_run_folder(path):
            continue
        if path.name in runs:
            clashes.append(f"{runs[path.name]} and {path}")
        else:
            runs[path.name] = path
    return runs, clashes


def real_path(path: Path) -> Path:
    """Without links. ``Path.resolve`` would end in an error where links go in a circle."""
    return Path(os.path.realpath(path))


def files_of_record(run: Path, unnameable: list[str]) -> Iterator[list[Found]]:
    """The files of a run folder in batches. Links, pipes and the like are left out: they are nobody's record.

    Args:
        run: the run folder.
        unnameable: filled with files whose names are not UTF-8 text and cannot be told to anybody.
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
                    if not _is_text(path):
                        unnameable.append(repr(path))
                    elif entry.is_dir(follow_symlinks=False):
                        if depth < MAX_DEPTH:
                            folders.append((path, depth + 1))
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
    """One file as it is now; None where there is none."""
    try:
        status = (run / path).lstat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as problem:
        raise SpoolUnreadable(f"{run / path}: cannot be looked at ({problem.strerror})") from problem
    return Found(path, kind_of(path), status.st_size, status.st_mtime_ns)


def hashes_of_photographs(run: Path) -> dict[str, str]:
    """SHA-256 by path of every photograph of the plant that a run folder's ``frames.jsonl`` tells of."""
    try:
        announced = RunFolder(run).announced_hashes()
    except BadRunFolder as problem:
        raise SpoolUnreadable(str(problem)) from problem
    return {path: sha256 for path, sha256 in announced.items() if is_photograph(path)}


def _is_text(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
