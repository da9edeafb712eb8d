"""``flora-lab serve``: hears the rigs, looks at what lasts, diagnoses what has ended, and says so."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from flora_common import files
from flora_common.app import App
from flora_common.clock import NS
from flora_common.errors import BadInput, DiskFull, FloraError, StoreError
from flora_common.messages import ControllerState, Frame, Lamps, Message, Recording, Stem
from flora_common.runs import LampsSection, RunFolder
from flora_common.service import run_service
from flora_lab.jobs.runner import Runner
from flora_lab.serve import diagnosing, looking_process
from flora_lab.serve.casebook import Casebook
from flora_lab.serve.child import Child
from flora_lab.serve.diagnosing import StillBusy
from flora_lab.serve.finished import Lasting, Patience, finished
from flora_lab.serve.ledger import Entry
from flora_lab.serve.looking_process import LookingProcess
from flora_lab.serve.rig_link import RigLink
from flora_lab.serve.section import LabSection, check
from flora_lab.serve.watching import Look, Looked, Watch

NAME: Final = "flora-lab"
SWITCHED_OFF: Final = "no simulator and no reference in [lab]: no plant is watched, no run diagnosed"
WATCHED: Final = "watched"
INFO_FILE: Final = "simulator.toml"
_FORMAT: Final = "1"


class Rig:
    """One rig: what is heard of it, and where its runs end up."""

    def __init__(self, app: App[LabSection], name: str, runs_dir: str) -> None:
        self._app = app
        self.name = name
        self.watch = Watch(app.state_dir / WATCHED / name)
        self.runs_dir = Path(runs_dir) if runs_dir else self.watch.folder
        self.is_without_runs_dir = not runs_dir
        self._heard_s = time.monotonic() - self._age_s()
        self.link = RigLink(app, name, self.heard)

    def _age_s(self) -> float:
        """Since something was kept of the run that lasts, before this start."""
        heard = self.watch.heard
        rows = heard.folder / "heard.jsonl" if heard else None
        return max(0.0, time.time() - rows.stat().st_mtime) if rows is not None and rows.exists() else 0.0

    def heard(self, message: Message) -> None:
        """Whatever the rig says."""
        if isinstance(message, Frame):
            before = self.watch.heard
            if self.watch.on_frame(message):
                self._heard_s = time.monotonic()
                if before is not None and self.is_without_runs_dir:
                    before.write_track()
        elif isinstance(message, Lamps):
            self.watch.on_lamps(message)
        elif isinstance(message, ControllerState):
            self.watch.on_controller(message)
        elif isinstance(message, Recording):
            self.watch.on_recording(message)
        elif isinstance(message, Stem) and self.watch.on_stem(message):
            self._heard_s = time.monotonic()

    @property
    def lasting(self) -> Lasting:
        """The run that it is at."""
        return Lasting(self.watch.run, time.monotonic() - self._heard_s, self.watch.is_over)

    def lamps(self, run: str) -> LampsSection | None:
        """Where they hang, if the run folder is there already."""
        try:
            return RunFolder(self.runs_dir / run).read_run_file().lamps
        except BadInput:
            return None


class Service:
    """The whole of it, hung on an app."""

    def __init__(self, app: App[LabSection]) -> None:
        self._app = app
        config = app.config
        self._output = config.output_dir(app.rig)
        files.make_folder(self._output)
        diagnosing.clear_left_over(self._output)
        self._patience = Patience(config.settled_s, config.settled_when_told_s)
        self._casebook = Casebook(self._output, _utc)
        self._rigs = [Rig(app, name, folder) for name, folder in config.runs_dirs(app.rig).items()]
        self._simulator = Path(config.simulator) if config.simulator else None
        self._process = LookingProcess(app)
        self._child: tuple[Child, Entry] | None = None
        self._refused: set[str] = set()
        app.every(config.scan_every_s, self.scan)
        app.every(looking_process.EVERY_S, self.look)
        app.on_ready(self.scan)
        app.on_exit(self.finish)

    # while runs last

    def look(self) -> None:
        """Learn the simulator, then look at whatever is due; one thing at a time."""
        self._say_departures()
        if self._process.is_busy:
            return
        if self._simulator is None:
            self._process.learn(Path(self._app.config.reference), self._output, self._learned)
            return
        against = self._against(self._simulator)
        if not against:
            return
        for rig in self._rigs:
            look = rig.watch.look(against)
            if look is not None and f"{rig.name} {look.run} {look.hours} {against}" not in self._refused:
                self._look_at(rig, look, against)
                return

    def _look_at(self, rig: Rig, look: Look, against: str) -> None:
        assert self._simulator is not None

        def taken(looked: Looked | FloraError) -> None:
            if isinstance(looked, FloraError):
                self._refused.add(f"{rig.name} {look.run} {look.hours} {against}")
                self._app.trouble(f"watch {rig.name}", f"{rig.name} is not watched: {looked}")
                return
            self._app.trouble(f"watch {rig.name}", "")
            rig.watch.take(look, looked, against)
            self._app.log.debug(
                "looked", what=f"{rig.name}/{look.run}", hours=looked.hours, departed=looked.departed_at
            )
            self._say_departures()

        rate = self._app.config.false_alarms
        self._process.look(look, rig.lamps(look.run), self._simulator, rate, taken)

    def _learned(self, path: Path | FloraError) -> None:
        if isinstance(path, FloraError):
            self._app.trouble("reference", f"no simulator could be learned: {path}")
            return
        self._app.trouble("reference", "")
        self._simulator = path
        self._app.log.event("learned", simulator=str(path))

    def _say_departures(self) -> None:
        for rig in self._rigs:
            departure = rig.watch.to_say
            if departure is not None and rig.link.is_connected:
                rig.link.say(departure)
                rig.watch.said()
                self._app.log.event(
                    "departed" if departure.is_departed else "returned", rig=rig.name, run=departure.run
                )

    def _against(self, simulator: Path) -> str:
        """What a simulator and a rate are: what was found against others is no start. Empty where there is none."""
        try:
            content = files.sha256_of_file(simulator / INFO_FILE)
        except OSError:
            return ""  # told where diagnoses begin
        return f"{content[:16]} {self._app.config.false_alarms:g} {_FORMAT}"

    # when runs have ended

    def scan(self) -> None:
        """Find runs that have ended, and begin with the next diagnosis."""
        for rig in self._rigs:
            try:
                if rig.is_without_runs_dir and not self._patience.lasts(rig.lasting):
                    rig.watch.finish()
                knows = self._casebook.ledger.knows
                unreadable: list[str] = []
                found = finished(
                    rig.name,
                    rig.runs_dir,
                    rig.lasting,
                    self._patience,
                    time.time(),
                    knows,
                    is_settled=rig.is_without_runs_dir,
                    on_unreadable=unreadable.append,
                )
                self._casebook.add(found)
                more = f" (and {len(unreadable) - 1} more such)" if len(unreadable) > 1 else ""
                self._app.trouble(f"runs {rig.name}", unreadable[0] + more if unreadable else "")
            except OSError as problem:
                self._app.trouble(f"runs {rig.name}", f"{rig.runs_dir}: cannot be read ({problem.strerror})")
        self._begin()
        self._tell()

    def _begin(self) -> None:
        if self._child is not None:
            self._check_time(*self._child)
            return
        if self._simulator is None:
            return
        is_there = (self._simulator / INFO_FILE).is_file()
        self._app.trouble("simulator", "" if is_there else f"[lab] simulator {self._simulator}: no simulator is there")
        if not is_there:
            return
        entry = self._casebook.next(self._simulator, time.monotonic())
        if entry is None:
            return
        try:
            held = diagnosing.held_folder(self._output)
        except StillBusy as problem:
            self._app.trouble("busy", str(problem))
            return
        self._app.trouble("busy", "")
        try:
            self._casebook.begins(entry)
        except DiskFull:
            os.close(held)
            raise
        child = Child(self._casebook.arguments(entry, self._simulator), held)
        self._app.log.event("diagnosing", what=_name(entry), attempt=entry.attempts)
        self._child = (child, entry)
        self._app.on_readable(child.ends_fd, self._ended)

    def _check_time(self, child: Child, entry: Entry) -> None:
        if time.monotonic() - child.began_s > self._app.config.longest_s:
            self._app.log.warning("too_long", what=_name(entry))
            child.end()

    def _ended(self) -> None:
        assert self._child is not None
        child, entry = self._child
        ended = child.ended()
        if ended is None:
            return
        self._app.forget_readable(child.ends_fd)
        child.close()
        self._child = None
        self._casebook.ended(entry, ended, time.monotonic())
        self._app.log.event("diagnosed", what=_name(entry), stage=entry.stage, verdict=entry.verdict)
        self.scan()

    def _tell(self) -> None:
        links = {rig.name: rig.link for rig in self._rigs}
        for entry, message in self._casebook.unsaid():
            link = links.get(entry.rig)
            if link is not None and link.is_connected:
                link.say(message)
                self._casebook.said(entry)
        self._app.trouble("diagnosis", self._casebook.trouble())

    def finish(self) -> None:
        """The service ends: what is being done is begun anew at the next start."""
        self._process.end()
        if self._child is None:
            return
        child, entry = self._child
        self._child = None
        child.end()
        ended = child.ended()
        child.close()
        try:
            if ended is not None and ended.status == 0:
                self._casebook.ended(entry, ended, time.monotonic())
            else:
                self._casebook.given_up(entry)
        except DiskFull as problem:
            self._app.log.problem("not_kept", str(problem))


def _utc() -> str:
    # The virtual box's time is another one, but the lab's records are of this world.
    return datetime.fromtimestamp(time.time_ns() // NS, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _name(entry: Entry) -> str:
    return f"{entry.rig}/{entry.run}"


def build(app: App[LabSection]) -> None:
    """Hang the service on the app."""
    if app.config.jobs_dir:
        Runner(app, Path(app.config.jobs_dir), _utc)
    if app.config.is_off:
        app.state("ready", SWITCHED_OFF)
        return
    try:
        Service(app)
    except OSError as problem:
        where = app.config.output_dir(app.rig)
        raise StoreError(f"[lab] output {where}: cannot be written ({problem.strerror})") from problem


def main(argv: Sequence[str]) -> int:
    """The body of ``flora-lab serve``."""
    return run_service(
        NAME,
        LabSection,
        build,
        argv=argv,
        check=check,
        description="Watch plants, and diagnose runs that have ended.",
    )
