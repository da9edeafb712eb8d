"""flora-controller: find the task and the rule, then answer every stem with a lamp."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from flora_common.app import App
from flora_common.cli import run_cli
from flora_common.controller_file import SUFFIX, load_controller
from flora_common.errors import ConfigError, StoreError
from flora_common.files import sha256_of_bytes
from flora_common.messages import Setup, Stem
from flora_common.runs import RunFile, RunFolder
from flora_common.service import run_service
from flora_common.shapes import Obstacle, Target
from flora_controller.core import ControllerCore, ControllerSection
from flora_controller.record import RECORD_FILE, read_record, write_record
from flora_controller.source import FileSource, FixedSource, built_in, kept_file

LOOK_EVERY_S: Final = 5.0
LEAST_TARGET_CM: Final = 1.0
"""Nearer to the anchor than this, the fitness of the paper divides by almost nothing."""


def build(app: App[ControllerSection]) -> None:
    run_file = app.run.read_run_file() if app.run.path.is_dir() else None
    target, obstacle = task_of(run_file, app.run)
    source = open_source(app.config, app.state_dir, target, obstacle)
    record_file = app.state_dir / RECORD_FILE
    record, dropped = read_record(record_file, run=run_identity(app.run, run_file))
    if dropped:
        app.log.event("record_dropped", reason=dropped)
    core = ControllerCore(source.steering, app.config, target=target, obstacle=obstacle, record=record)
    app.log.event("steering", controller=core.steering.name, sha256=core.steering.sha256[:12], after_tick=record.tick)
    app.trouble("file", source.refusal)

    def on_stem(stem: Stem) -> None:
        if source.poll():
            core.use(source.steering)
            app.log.event("controller_replaced", controller=core.steering.name, sha256=core.steering.sha256[:12])
        answer = core.on_stem(stem, note=source.refusal)
        if answer is None:
            app.log.debug("stem_of_an_earlier_tick", tick=stem.tick, last=core.record.tick)
            return
        command, said = answer
        try:
            # Before it is said: after a kill the same tick must be answered with the same words.
            write_record(record_file, core.record)
            app.trouble("record", "")
        except (StoreError, OSError) as problem:
            app.trouble("record", f"the state cannot be kept: {problem}")
        app.publish(command)
        app.publish(said)
        app.trouble("file", source.refusal)
        app.trouble("blind", command.reason if command.blind else "")
        app.trouble("silence", "")

    def look() -> None:
        setup = app.inbox.last(Setup)
        rests = setup is not None and setup.active
        if app.inbox.last(Stem) is not None and not rests and not app.inbox.fresh(Stem):
            # The same words as long as it lasts: each change of a reason is a line of the log and a message.
            app.trouble("silence", "no stem for more than two ticks; the last command stands")

    app.on(Stem, on_stem)
    app.on(Setup, lambda _: None)
    app.every(LOOK_EVERY_S, look)


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
    parts: list[object] = [str(run.path.resolve())]
    if run_file is not None:
        parts += [str(run_file.start), msgspec.to_builtins(run_file.target), msgspec.to_builtins(run_file.obstacle)]
    return sha256_of_bytes(msgspec.json.encode(parts))[:16]


def open_source(
    section: ControllerSection, state_dir: Path, target: Target | None, obstacle: Obstacle | None
) -> FileSource | FixedSource:
    """The rule's source that the configuration names.

    Raises:
        BadInput: no such built-in rule, a file that cannot steer, or a task that lacks what it needs.
    """
    if not section.use.endswith(SUFFIX):
        return FixedSource(built_in(section, target, obstacle))
    path = Path(section.use)
    return FileSource(path, kept_file(state_dir, path), target=target, obstacle=obstacle)


def check_file(argv: Sequence[str]) -> int:
    """``flora-controller check FILE``: whether a controller file could steer, and what it is."""
    parser = argparse.ArgumentParser("flora-controller check", description="Check a controller file and end.")
    parser.add_argument("file", type=Path, metavar="FILE", help=f"a controller file, *{SUFFIX}")
    options = parser.parse_args(argv)

    def work() -> None:
        loaded = load_controller(options.file)
        network, file = loaded.network, loaded.file
        links = sum(len(node.links) for node in network.nodes)
        print(
            f"{options.file}: good; `{file.name}`, task `{file.task.name}`, {len(network.inputs)} inputs, "
            f"{len(network.nodes)} nodes, {links} links, sha256 {loaded.sha256[:12]}"
        )

    return run_cli("flora-controller", work)


def main(argv: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["check"]:
        return check_file(arguments[1:])
    return run_service(
        "flora-controller",
        ControllerSection,
        build,
        argv=arguments,
        description="Decides left or right from each stem. `flora-controller check FILE` checks a controller file.",
    )
