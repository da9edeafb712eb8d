"""``flora-lab submit``: its options, what it shows of a job, and how it ends."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from flora_common.config import at_bus, checked_rig_name, load_rig
from flora_common.errors import BadInput, FloraError
from flora_common.messages import Job, JobProgress
from flora_common.messages.catalogue import LONGEST_ARGUMENT, MOST_ARGUMENTS
from flora_lab.jobs import rules
from flora_lab.jobs.asking import ask

NOBODY_AFTER_S: Final = 10.0
_JOB_DIGITS: Final = 16


class JobFailed(FloraError):
    """It ended without a result."""


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("submit", context_settings={"allow_interspersed_args": False, "ignore_unknown_options": True})(submit)


def submit(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="WORK [ARGUMENTS]...", help=f"One of {', '.join(rules.WORKS)}, as flora-lab takes it."),
    ] = None,
    *,
    rig: Annotated[str | None, typer.Option(metavar="NAME", help="Under whose name the lab hears.")] = None,
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="A TOML file that says where the bus is.")] = None,
    publish: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Where the bus hears.")] = None,
    subscribe: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Where the bus says.")] = None,
    job: Annotated[
        str | None, typer.Option(metavar="NUMBER", help="Of a job that was asked for before: how is it?")
    ] = None,
    stop: Annotated[bool, typer.Option("--stop", help="End the job of --job.")] = False,
    wait: Annotated[bool, typer.Option("--wait/--no-wait", help="Until it is over; else until the lab has it.")] = True,
    timeout: Annotated[
        float, typer.Option(min=0.5, max=3600.0, help="Seconds without an answer after which no lab is there.")
    ] = NOBODY_AFTER_S,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the last word about it as one JSON object.")] = False,
) -> None:
    """Ask a lab for work over the bus, and wait for it.

    Options of submit stand before WORK, those of the work behind it. Ends with 0 when the work is done, with 2 when
    the lab refuses it, with 1 when it failed, was stopped, or nobody answers. Ctrl-C leaves the job to the lab.
    """
    where = at_bus(load_rig(config), publish=publish, subscribe=subscribe)
    where = where.named(checked_rig_name(rig)) if rig is not None else where
    asked = _asked(words or [], job, stop=stop)
    with _shown(silent=quiet or as_json) as show:
        last = ask(asked, where, follows=wait, timeout_s=timeout, told=show)
    if as_json:
        told = ("job", "work", "stage", "share", "text", "before", "took_s")
        typer.echo(json.dumps({name: getattr(last, name) for name in told}))
    named = "" if last.work == rules.KNOWN else f" ({last.work})"
    text = f"job {last.job}{named}: {last.stage}" + (f": {last.text}" if last.text else "")
    if last.stage == "refused":
        raise BadInput(text)
    if last.stage == "failed" or (last.stage == "stopped" and not stop):
        raise JobFailed(text)
    if not (quiet or as_json):
        there = {"--config": config, "--publish": publish, "--subscribe": subscribe, "--rig": rig}
        options = "".join(f"{name} {shlex.quote(str(value))} " for name, value in there.items() if value is not None)
        later = f"{text}; later: flora-lab submit {options}--job {last.job}"
        typer.echo(text if last.stage in ("done", "stopped") else later)


def _asked(words: list[str], job: str | None, *, stop: bool) -> Job:
    """What is asked.

    Raises:
        BadInput: neither work nor a job, or both; or work that no lab does.
    """
    if job is not None:
        if words:
            raise BadInput("--job: name a job that was asked for before, or new work, not both")
        if len(job) != _JOB_DIGITS or set(job) - set("0123456789abcdef"):
            raise BadInput(f"--job {job[:40]}: the number of a job is {_JOB_DIGITS} digits, 0 to 9 and a to f")
        return Job(job=job, work=rules.KNOWN, stop=stop)
    if stop:
        raise BadInput("--stop: of which job? name it with --job")
    if not words:
        raise BadInput(f"name the work: {', '.join(rules.WORKS)}")
    work, *arguments = words
    rules.check(work, arguments)
    if len(arguments) > MOST_ARGUMENTS:
        raise BadInput(f"{len(arguments)} arguments; a job has {MOST_ARGUMENTS} at most: name a folder, not its files")
    long = next((one for one in arguments if len(one) > LONGEST_ARGUMENT), None)
    if long is not None:
        raise BadInput(f"argument `{long[:40]}…`: has more than {LONGEST_ARGUMENT} signs")
    return Job(job=os.urandom(_JOB_DIGITS // 2).hex(), work=work, arguments=tuple(arguments))


@contextlib.contextmanager
def _shown(*, silent: bool) -> Iterator[_Bar]:
    """A bar on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[said]}"), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=silent or not console.is_terminal, transient=True) as bars:
        yield _Bar(bars)


class _Bar:
    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task = bars.add_task("asking", total=None, said="")

    def __call__(self, progress: JobProgress) -> None:
        said = f"{progress.before} before it" if progress.stage == "waiting" else progress.text
        total = None if progress.share is None else 1.0
        self._bars.update(
            self._task, description=progress.stage, completed=progress.share or 0.0, total=total, said=said
        )
