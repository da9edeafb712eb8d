"""flora-monitor: look at the bus, record it, play it again."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.console import Console
from rich.live import Live

from flora_common.bus import LATE_FACTOR
from flora_common.cli import run_typer, version_line
from flora_common.clock import SystemClock
from flora_common.counted import counted
from flora_common.errors import BadInput, BusUnreachable, DiskFull, StoreError
from flora_common.health import HealthBoard
from flora_common.outputs import can_be_made
from flora_common.recording import RecordingWriter
from flora_common.recording_reader import RecordingReader
from flora_monitor import show, tape
from flora_monitor.doctor_command import doctor
from flora_monitor.listen import IS_IT_RUNNING, PROGRAM, Batch, Listener, hear_health, hear_life
from flora_monitor.options import (
    Common,
    Config,
    Count,
    Interval,
    Json,
    Pattern,
    Publish,
    Rig,
    Seconds,
    Subscribe,
    common_options,
)
from flora_monitor.stats import Board, checked_pattern, matches, topic_lines

RECORD_FLUSH_S: Final = 5.0

app = typer.Typer(
    name=PROGRAM,
    help="Look at the bus of a rig, record it, play it again.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _until(listener: Listener, seconds: float | None, began_s: float, *, every_s: float = 0.25) -> Iterator[Batch]:
    for batch in listener.batches(every_s=every_s):
        yield batch
        # Whether there is a bus is known first: the seconds of a busy machine are soon over.
        is_known = listener.connected or listener.misses_bus
        if is_known and seconds is not None and batch.real_s - began_s >= seconds:
            listener.explain_silence()
            return


@contextmanager
def _summed_up(summary: Callable[[], str], listener: Listener | None = None) -> Iterator[None]:
    """Ctrl-C, SIGTERM and a reader who has had enough (``| head``) end the work; one line says what was done.

    Work that comes to its own end though the bus of ``listener`` has not answered ends with status 1.
    """
    has_failed = False
    try:
        yield
        has_failed = listener is not None and not listener.has_answered
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    except BrokenPipeError:
        # What is left in the buffer would fail once more when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    print(f"{PROGRAM}: {summary()}", file=sys.stderr, flush=True)
    if has_failed:
        raise typer.Exit(1)


def _said(board: Board, began_s: float) -> str:
    took_s = time.monotonic() - began_s
    counts = f"{counted(board.messages, 'message')}, {board.lost} lost, {board.bad} bad, {board.repeated} repeated"
    return f"{counts} in {took_s:.1f} s"


@app.command()
def tail(
    pattern: Pattern = "*",
    rig: Rig = None,
    config: Config = None,
    publish: Publish = None,
    subscribe: Subscribe = None,
    as_json: Json = False,
    count: Count = None,
    seconds: Seconds = None,
) -> None:
    """Every message as it comes: one line each, with the time since the one before on its topic."""
    common = common_options(config, rig, publish, subscribe, as_json=as_json)
    board, listener, began_s = common.board(), common.listener(pattern, waits=seconds is None), time.monotonic()
    console = Console(highlight=False, soft_wrap=False)
    shown = 0
    with _summed_up(lambda: _said(board, began_s), listener):
        for batch in _until(listener, seconds, began_s):
            for arrival in batch.arrivals:
                since_s = board.hear(arrival, batch.real_s)
                if arrival.verdict == "repeated":
                    continue
                if common.as_json:
                    print(show.line_for_programs(arrival), flush=True)
                else:
                    console.print(show.line_for_terminal(arrival, since_s), no_wrap=True, overflow="ellipsis")
                shown += 1
                if shown == count:
                    return


@app.command()
def rates(
    pattern: Pattern = "*",
    rig: Rig = None,
    config: Config = None,
    publish: Publish = None,
    subscribe: Subscribe = None,
    as_json: Json = False,
    count: Count = None,
    seconds: Seconds = None,
    interval: Interval = None,
) -> None:
    """How often each topic comes, how evenly, what is missing; red when late."""
    common = common_options(config, rig, publish, subscribe, as_json=as_json)
    board, listener, began_s = common.board(interval), common.listener(pattern, waits=seconds is None), time.monotonic()

    def heard() -> Iterator[Batch]:
        for batch in _until(listener, seconds, began_s):
            for arrival in batch.arrivals:
                board.hear(arrival, batch.real_s)
            yield batch
            if count is not None and board.messages >= count:
                return

    with _summed_up(lambda: _said(board, began_s), listener):
        if common.as_json:
            told_s = began_s
            for batch in heard():
                if batch.real_s - told_s >= 1.0 and seconds is None and count is None:
                    told_s = batch.real_s
                    _print_lines(board.rows(batch.real_s))
            _print_lines(board.rows(time.monotonic()))
        else:
            with Live(console=Console(), refresh_per_second=4) as live:
                for batch in heard():
                    live.update(show.rates_table(board.rows(batch.real_s)))


def _print_lines(items: Sequence[Any]) -> None:
    if items:
        print(show.json_lines(items), flush=True)


@app.command()
def topics(
    pattern: Pattern = "*",
    rig: Rig = None,
    config: Config = None,
    publish: Publish = None,
    subscribe: Subscribe = None,
    as_json: Json = False,
    seconds: Seconds = None,
) -> None:
    """The catalogue, and what of it has been heard: the bus tells what it keeps at once."""
    common = common_options(config, rig, publish, subscribe, as_json=as_json)
    board, listener, began_s = common.board(), common.listener(pattern, waits=False), time.monotonic()
    with _summed_up(lambda: _said(board, began_s)):
        for batch in _until(listener, seconds, began_s, every_s=0.05):
            for arrival in batch.arrivals:
                board.hear(arrival, batch.real_s)
            if seconds is None and (batch.is_live or listener.misses_bus):
                listener.explain_silence()
                break
    lines = topic_lines(board.rows(time.monotonic()), pattern, common.only_rig)
    if common.as_json:
        _print_lines(lines)
    else:
        Console().print(show.topics_table(lines))


@app.command()
def health(
    pattern: Annotated[
        str, typer.Argument(help="Glob on the services' names.", metavar="PATTERN", callback=checked_pattern)
    ] = "*",
    rig: Rig = None,
    config: Config = None,
    publish: Publish = None,
    subscribe: Subscribe = None,
    as_json: Json = False,
    seconds: Seconds = None,
) -> None:
    """How each service is; status 1 when one is not ready, silent or was never heard."""
    common = common_options(config, rig, publish, subscribe, as_json=as_json)
    expected = common.services(pattern)
    period_s = common.rig.health_every_s
    listener = Listener(common.rig, only_rig=rig or common.rig.name, pattern="health", without_bus=IS_IT_RUNNING)
    clock = SystemClock()
    board = HealthBoard(expected, period_s=period_s, ages_are_known=common.rig.has_own_clock)
    answered = hear_health(
        listener,
        board,
        pattern=pattern,
        limit_s=LATE_FACTOR * period_s if seconds is None else seconds,
        ends_early=seconds is None,
    )
    if not answered:
        raise typer.Exit(1)
    listener.explain_silence()
    lines = board.lines(real_s=time.monotonic(), mono_ns=clock.mono_ns())
    listener.close()
    if common.as_json:
        _print_lines(lines)
    else:
        Console().print(show.health_table(lines))
    if not all(line.ok for line in lines):
        raise typer.Exit(1)


app.command()(doctor)


@app.command()
def record(
    file: Annotated[Path, typer.Argument(help="A new .mcap file.", metavar="FILE")],
    pattern: Pattern = "*",
    rig: Rig = None,
    config: Config = None,
    publish: Publish = None,
    subscribe: Subscribe = None,
    count: Count = None,
    seconds: Seconds = None,
) -> None:
    """Record what comes to FILE; it is called FILE.open until the end."""
    if file.suffix != ".mcap":
        raise BadInput(f"{file}: a recording's name ends in .mcap")
    can_be_made(file, "FILE")
    common = common_options(config, rig, publish, subscribe, as_json=False)
    board, listener, began_s = common.board(), common.listener(pattern, waits=seconds is None), time.monotonic()
    clock = SystemClock()
    writer = _new_recording(file, rig)

    def summary() -> str:
        done = f"{writer.messages} recorded, {writer.bytes} bytes" if listener.has_answered else "not written"
        return f"{file}: {done}; " + _said(board, began_s)

    def take() -> None:
        flushed_s, is_told = began_s, False
        for batch in _until(listener, seconds, began_s):
            if listener.connected and not is_told:
                is_told = True
                listener.warn(f"recording to {writer.open_path}")
            for arrival in batch.arrivals:
                board.hear(arrival, batch.real_s)
                writer.add(arrival, utc_ns=clock.utc_ns(), rig=rig or "")
                if writer.messages == count:
                    return
            if batch.real_s - flushed_s >= RECORD_FLUSH_S or writer.wants_flush:
                flushed_s = batch.real_s
                writer.flush()

    with _summed_up(summary, listener):
        try:
            take()
        finally:
            writer.close()
            if not listener.has_answered:
                file.unlink()


def _new_recording(file: Path, rig: str | None) -> RecordingWriter:
    """An empty recording; where none can be made, a full disk apart, the person has named a wrong place."""
    try:
        return RecordingWriter(file, metadata={"rig": rig or "all"})
    except DiskFull:
        raise
    except StoreError as problem:
        raise BadInput(f"{problem}; name another place with FILE") from problem


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(help="A recording.", metavar="FILE")],
    only: Annotated[
        str, typer.Option("--only", help="Glob on <rig>/<kind> or kind, as recorded.", callback=checked_pattern)
    ] = "*",
    rate: Annotated[
        float | None, typer.Option("--rate", min=0.001, help="Recorded seconds per second; 1 where not given.")
    ] = None,
    as_fast: Annotated[bool, typer.Option("--as-fast", help="Without waiting.")] = False,
    rig: Annotated[str | None, typer.Option("--rig", help="Say it as this rig.", metavar="NEW")] = None,
    force: Annotated[bool, typer.Option("--force", help="Even where services of that rig are alive.")] = False,
    config: Config = None,
    publish: Publish = None,
    subscribe: Subscribe = None,
) -> None:
    """Say recorded messages again, with the bytes, sequence numbers and times that were recorded."""
    if as_fast and rate is not None:
        raise BadInput("give either --as-fast or --rate")
    common = common_options(config, rig, publish, subscribe, as_json=False)
    reader = RecordingReader(file)
    player = tape.Player(common.rig.bus, rig=rig, only=only)
    played = tape.Played()
    try:
        if not force:
            _refuse_live_rig(common, {rig} if rig else _rigs_in(file, only))
        with _summed_up(lambda: _played(file, played)):
            player.play(reader, played, rate=None if as_fast else rate or 1.0)
    finally:
        player.close()
    if played.problem:
        raise typer.Exit(1)


def _played(file: Path, played: tape.Played) -> str:
    text = f"{file}: {counted(played.sent, 'message')} said again"
    if played.left_out:
        text += f", {played.left_out} left out"
    if played.unreadable:
        text += f", {played.unreadable} that were unreadable when recorded are not said again"
    return text + (f"; {played.problem}" if played.problem else "")


def _rigs_in(file: Path, only: str) -> set[str]:
    return {r.topic.partition("/")[0] for r in RecordingReader(file) if matches(only, r.topic)}


def _refuse_live_rig(common: Common, rigs: set[str]) -> None:
    """A recorded `light` would drive the lamps of a rig that runs."""
    listener = Listener(common.rig, pattern="health", without_bus=None)
    try:
        period_s, is_here = common.rig.health_every_s, common.rig.has_own_clock
        alive = hear_life(listener, rigs, within_s=LATE_FACTOR * period_s, ages_are_known=is_here)
    except BusUnreachable as problem:
        # The player has found one that hears: what it plays would be taken by whoever lives there.
        which = ", ".join(f"`{name}`" for name in sorted(rigs))
        raise BusUnreachable(
            f"{problem}, and nobody else says whether rig {which} is alive; try again, use --rig NEW, or --force"
        ) from problem
    finally:
        listener.close()
    if alive is not None:
        raise BadInput(
            f"{alive.source} of rig `{alive.rig}` is on this bus and would take the recording for real; "
            "use --rig NEW, or --force"
        )


@app.command()
def check(
    files: Annotated[list[Path], typer.Argument(help="Recordings.", metavar="FILE...")], as_json: Json = False
) -> None:
    """Read recordings back from end to end; status 1 when one is cut or damaged, 2 when one cannot be read at all."""
    status = 0
    for file in files:
        try:
            checked = tape.check(file)
        except BadInput as problem:
            print(f"{PROGRAM}: {problem}", file=sys.stderr, flush=True)
            status = max(status, problem.exit_status)
            continue
        if as_json or not sys.stdout.isatty():
            print(tape.to_json(file, checked), flush=True)
        else:
            for line in tape.check_lines(checked):
                print(line)
            whole = checked.problem or "whole"
            print(f"{file}: {counted(checked.messages, 'message')} over {checked.span_s:.1f} s; {whole}")
        status = max(status, 1 if checked.problem else 0)
    raise typer.Exit(status)


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
) -> None:
    if version:
        print(version_line(PROGRAM))
        raise typer.Exit


def main(argv: Sequence[str] | None = None) -> int:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    return run_typer(PROGRAM, lambda: app, argv)
