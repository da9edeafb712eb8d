"""The spool as the ledger is told of it: by looking through it, and by what the camera announces."""

from __future__ import annotations

from collections.abc import Callable, Generator
from pathlib import Path

from flora_common.counted import counted
from flora_common.runs import RunFolder
from flora_uploader import scan
from flora_uploader.conditions import Conditions
from flora_uploader.ledger import Ledger
from flora_uploader.model import Event
from flora_uploader.policy import is_of_record, is_photograph

Work = Generator[None, None, None]


class Spool:
    """All run folders beside the rig's present one.

    Args:
        runs_dir: folder with run folders.
        run_dir: the rig's present run folder.
        ledger: is told what is there.
        conditions: are told what is wrong.
        say: hears of run folders that went away with files that were not stored.

    Attributes:
        runs: run folders by name, as last seen.
    """

    def __init__(
        self, runs_dir: Path, run_dir: Path, ledger: Ledger, conditions: Conditions, say: Callable[[Event], None]
    ) -> None:
        self.runs: dict[str, Path] = {}
        self._runs_dir = runs_dir
        self._run_dir = run_dir
        self._ledger = ledger
        self._conditions = conditions
        self._say = say
        self._logs_seen: dict[str, tuple[int, int]] = {}
        self._unlisted: dict[str, str] = {}

    def is_there(self, run: str) -> bool:
        """Whether a run folder, seen before, is there now; not where nobody can say. The next scan tells which."""
        try:
            return scan.is_run_folder(self.runs[run])
        except scan.SpoolUnreadable:
            return False

    def hear(self, run: str, path: str, sha256: str) -> None:
        """A photograph was announced.

        Raises:
            StoreError: the spool cannot be read or the ledger not written; the next scan finds the file.
        """
        folder = self.runs.get(run)
        if folder is None:
            folder = scan.real_path(self._run_dir)
            is_it = run in (folder.name, self._run_dir.name) and scan.is_run_folder(folder)
            if not is_it or not scan.is_text(folder.name):  # a link to it may have a name that is text
                return
            self.runs[folder.name] = folder
        if not all(is_of_record(part) for part in Path(path).parts):
            return
        found = scan.look_at(folder, path)
        if found is None:
            return
        self._ledger.see(folder.name, [found])
        if is_photograph(path):
            self._ledger.expect(folder.name, {path: sha256})

    def look_through(self, *, everything: bool) -> Generator[None, None, bool]:
        """Tell the ledger of the present run, or of all. Returns whether it came to its end."""
        left_out: list[str] = []
        try:
            found = scan.run_folders(self._runs_dir, self._run_dir)
        except scan.SpoolUnreadable as problem:
            self._conditions.set("spool", str(problem))
            return False
        self._conditions.clear("spool")
        self._take(found)
        left_out += found.unnameable
        yield
        present = scan.real_path(self._run_dir).name
        for name, folder in sorted(self.runs.items(), key=lambda item: item[0] != present):
            if everything or name == present or name in self._unlisted:
                try:
                    yield from self._look_through_run(name, folder, left_out)
                    self._unlisted.pop(name, None)
                except scan.SpoolUnreadable as problem:  # a bad sector: the others are not held up
                    self._unlisted[name] = str(problem)
        self._tell_of_unreadable(found)
        if everything:
            self._give_up_on_runs_that_are_gone(found)
            text = (
                f"{counted(len(left_out), 'path')} of files or run folders not sent, for names that are not UTF-8 "
                f"text, or more than {scan.MAX_DEPTH} folders of depth: "
            )
            self._conditions.set("left out", text + left_out[0] if left_out else "")
        return True

    def _take(self, found: scan.RunFolders) -> None:
        self.runs = found.runs
        two = f"two run folders have one name, rename one: {found.clashes[0]}" if found.clashes else ""
        self._conditions.set("clashes", two)
        self._unlisted = {name: reason for name, reason in self._unlisted.items() if name in found.runs}
        self._tell_of_unreadable(found)

    def _tell_of_unreadable(self, found: scan.RunFolders) -> None:
        reasons = list(dict.fromkeys([*found.unreadable.values(), *self._unlisted.values()]))
        more = f" (and {len(reasons) - 1} more such)" if len(reasons) > 1 else ""
        text = "check its disk or mount; other run folders are uploaded"
        self._conditions.set("unreadable", f"{reasons[0]}; {text}{more}" if reasons else "")

    def _look_through_run(self, name: str, folder: Path, left_out: list[str]) -> Work:
        has_new = False
        for batch in scan.files_of_record(folder, left_out):
            changed = self._ledger.see(name, batch)
            has_new = has_new or any(is_photograph(path) for path in changed)
            yield
        seen = scan.look_at(folder, RunFolder(folder).frames_log.name)
        stamp = (seen.size, seen.mtime_ns) if seen else (0, 0)
        if has_new or self._logs_seen.get(name) != stamp:
            self._ledger.expect(name, scan.hashes_of_photographs(folder))
            self._logs_seen[name] = stamp

    def _give_up_on_runs_that_are_gone(self, found: scan.RunFolders) -> None:
        for run in found.runs:
            self._conditions.clear(f"run {run}")  # it has come back
        for run, count in self._ledger.waiting_by_run().items():
            if run not in found.runs and run not in found.unreadable:
                reason = f"{self._runs_dir / run}: the run folder is gone, with {counted(count, 'file')} not stored"
                self._ledger.mark_run_vanished(run, reason)  # should it come back, its files wait again
                self._conditions.set(f"run {run}", reason)
                self._conditions.clear(f"owner {run}")
                self._say(Event("refused", run, reason=reason))
