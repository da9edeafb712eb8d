"""flora-controller: find the task and the rule, then answer every stem with a lamp."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from flora_common import files, setup_run
from flora_common.app import App
from flora_common.config import RigSection
from flora_common.controller_file import SUFFIX
from flora_common.errors import ConfigError, StoreError
from flora_common.messages import ControllerAnswer, ControllerChunk, ControllerOffer, Setup, Stem
from flora_common.runs import RunFile, RunFolder
from flora_common.service import run_service
from flora_common.shapes import Obstacle, Target
from flora_controller.acceptance import Acceptance
from flora_controller.acceptance_setup import look_only, open_acceptance, policy_of
from flora_controller.check import check_file
from flora_controller.core import ControllerCore, ControllerSection
from flora_controller.offer_command import offer_file
from flora_controller.record import RECORD_FILE, read_record, write_record
from flora_controller.shelf import FOLDER as SHELF_FOLDER
from flora_controller.shelf import Shelf
from flora_controller.source import FileSource, FixedSource, built_in, check_name, check_usable, kept_file
from flora_controller.succession import Succession

LOOK_EVERY_S: Final = 5.0
LEAST_TARGET_CM: Final = 1.0
"""Nearer to the anchor than this, the fitness of the paper divides by almost nothing."""


def check(rig: RigSection, section: ControllerSection) -> None:
    """What a start would refuse; of a run that is not made yet, what does not depend on it."""
    run, is_file = RunFolder(Path(rig.run_dir)), section.use.endswith(SUFFIX)
    if not is_file:
        check_name(section.use)
    if not files.is_file(run.run_toml):
        return  # who reads a folder that is closed to us is told
    policy = policy_of(section, *task_of(run.read_run_file(), run))
    if is_file:
        path, state_dir = Path(section.use), Path(rig.state_dir)
        check_usable(path, kept_file(state_dir, path), look_only(policy, state_dir))
    else:
        built_in(section, policy.target, policy.obstacle)


def build(app: App[ControllerSection]) -> None:
    run_file = app.run.read_run_file() if _is_there(app.run) else None
    target, obstacle = task_of(run_file, app.run)
    acceptance = open_acceptance(app, target, obstacle)
    source = open_source(app.config, app.state_dir, acceptance)
    record_file = app.state_dir / RECORD_FILE
    record, dropped = read_record(record_file, run=run_identity(app.run, run_file))
    if dropped:
        app.log.event("record_dropped", reason=dropped)
    succession = Succession(
        source,
        Shelf(app.state_dir / SHELF_FOLDER),
        acceptance,
        shadow_ticks=app.config.shadow_ticks,
        say=lambda answer: told(app, answer),
    )
    core = ControllerCore(succession.lineup, app.config, target=target, obstacle=obstacle, record=record)
    app.log.event("steering", controller=core.steering.name, sha256=core.steering.sha256[:12], after_tick=record.tick)

    def tell_troubles() -> None:
        app.trouble("file", source.refusal)
        app.trouble("shelf", succession.trouble)
        app.trouble("returned", succession.note)

    def follow() -> None:
        core.use(succession.lineup)
        app.log.event("controller_replaced", controller=core.steering.name, sha256=core.steering.sha256[:12])

    if succession.after_tick(core.shadow_ticks):
        follow()  # the last start ended between the last tick of a shadow and what follows from it
    tell_troubles()

    own = {"", *app.run.names}

    def on_stem(stem: Stem) -> None:
        # The bus keeps the last one of the run before; its plant says nothing of this run's.
        if stem.run not in own:
            app.log.event("stem_of_another_run", run=stem.run, tick=stem.tick)
            return
        if succession.poll():
            follow()
        answer = core.on_stem(stem, note="; ".join(part for part in (source.refusal, succession.note) if part))
        if answer is None:
            app.log.debug("stem_of_an_earlier_tick", tick=stem.tick, last=core.record.tick)
            return
        command, said = answer
        # On the shelf first: after a kill the one that failed must not steer again.
        if succession.after_tick(core.shadow_ticks, core.failures):
            follow()
        try:
            # Before it is said: after a kill the same tick must be answered with the same words.
            write_record(record_file, core.record)
            app.trouble("record", "")
        except (StoreError, OSError) as problem:
            app.trouble("record", f"the state cannot be kept: {problem}")
        app.publish(command)
        app.publish(said)
        tell_troubles()
        app.trouble("blind", command.reason if command.blind else "")
        app.trouble("silence", "")

    def on_offer(offer: ControllerOffer) -> None:
        succession.on_offer(offer, time.monotonic())
        tell_troubles()

    def on_chunk(chunk: ControllerChunk) -> None:
        if succession.on_chunk(chunk, time.monotonic()):
            follow()
        tell_troubles()

    def look() -> None:
        succession.on_time(time.monotonic())
        rests = setup_run.running(app.inbox) is not None
        if app.inbox.last(Stem) is not None and not rests and not app.inbox.fresh(Stem):
            # The same words as long as it lasts: each change of a reason is a line of the log and a message.
            app.trouble("silence", "no stem for more than two ticks; the last command stands")

    app.on(Stem, on_stem)
    app.on(Setup, lambda _: None)
    app.on(ControllerOffer, on_offer)
    app.on(ControllerChunk, on_chunk)
    app.every(LOOK_EVERY_S, look)


def _is_there(run: RunFolder) -> bool:
    """Whether there is a run folder, as far as this user may look."""
    try:
        return run.path.is_dir()
    except PermissionError:
        return True  # who reads it is told


def told(app: App[ControllerSection], answer: ControllerAnswer) -> None:
    """Say what has become of an offer, on the bus and in the log."""
    app.publish(answer)
    if answer.stage != "received":
        app.log.event("offer", stage=answer.stage, sha256=answer.sha256[:12], reason=answer.reason)


def task_of(run_file: RunFile | None, run: RunFolder) -> tuple[Target | None, Obstacle | None]:
    """Target and obstacle of a run, where it has them.

    Raises:
        ConfigError: a target on the anchor.
    """
    if run_file is None:
        return None, None
    target = run_file.target_or_none()
    if target is not None and abs(target.x_cm) + abs(target.y_cm) < LEAST_TARGET_CM:
        raise ConfigError(f"{run.run_toml}: the target lies on the anchor (0, 0); give it a place to grow to")
    return target, run_file.obstacle_or_none()


def run_identity(run: RunFolder, run_file: RunFile | None) -> str:
    """Names the run that a stored state belongs to: another folder, start or task is another run."""
    parts: list[object] = [str(run.place)]
    if run_file is not None:
        parts += [str(run_file.start), msgspec.to_builtins(run_file.target), msgspec.to_builtins(run_file.obstacle)]
    return files.sha256_of_bytes(msgspec.json.encode(parts))[:16]


def open_source(section: ControllerSection, state_dir: Path, acceptance: Acceptance) -> FileSource | FixedSource:
    """The rule's source that the configuration names.

    Raises:
        BadInput: no such built-in rule, a light plan that cannot be read, a file that must not steer,
            or a task that lacks what it needs.
        StoreError: that a file is accepted cannot be written down.
    """
    if not section.use.endswith(SUFFIX):
        return FixedSource(built_in(section, acceptance.policy.target, acceptance.policy.obstacle))
    path = Path(section.use)
    return FileSource(path, kept_file(state_dir, path), acceptance)


def main(argv: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["check"]:
        return check_file(arguments[1:])
    if arguments[:1] == ["offer"]:
        return offer_file(arguments[1:])
    return run_service(
        "flora-controller",
        ControllerSection,
        build,
        argv=arguments,
        check=check,
        description="Decides left or right from each stem. `flora-controller check FILE` checks a controller file or a "
        "light plan, `flora-controller offer FILE` hands one to the flora-controller that runs.",
    )
