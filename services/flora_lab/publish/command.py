"""``flora-lab publish``: its options, what it shows while a controller travels, and what it says."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, TextColumn

from flora_common.config import at_bus, checked_rig_name, load_rig
from flora_common.controller_file import SUFFIX, load_controller
from flora_common.counted import counted
from flora_common.deliver import NOBODY_AFTER_S, as_json, deliver, outcome, raise_unless_taken
from flora_common.messages.catalogue import MOST_SHADOW_TICKS
from flora_common.offering import Sending
from flora_lab.bars import Bars

SOURCE: Final = "flora-lab"


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("publish")(publish)


def publish(
    controller: Annotated[Path, typer.Argument(metavar="CONTROLLER", help=f"A signed controller file, *{SUFFIX}.")],
    *,
    rig: Annotated[str, typer.Option(metavar="NAME", help="The rig that is to take it.")],
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="A TOML file that says where the bus is.")] = None,
    publish: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Where the bus hears.")] = None,
    subscribe: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Where the bus says.")] = None,
    shadow: Annotated[
        int, typer.Option(min=0, max=MOST_SHADOW_TICKS, help="Ticks in shadow before it steers; the rig may ask more.")
    ] = 0,
    wait_steering: Annotated[
        bool, typer.Option("--wait-steering", help="Also wait for the end of the shadow.")
    ] = False,
    timeout: Annotated[
        float, typer.Option(min=0.5, max=3600.0, help="Seconds of silence after which nobody is there.")
    ] = NOBODY_AFTER_S,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the rig's answer as one JSON object.")] = False,
) -> None:
    """Bring a signed controller to a rig, which takes it, or says why not.

    Ends with 0 when the rig has taken it, with 2 when the file or the rig says no, with 1 when nobody answers.
    """
    where = at_bus(load_rig(config), publish=publish, subscribe=subscribe)
    where = where.named(checked_rig_name(rig))
    loaded = load_controller(controller)
    with _progress(silent=quiet or json) as bar:
        answer = deliver(
            loaded,
            where,
            name=controller.name,
            source=SOURCE,
            shadow_ticks=shadow,
            wait_steering=wait_steering,
            timeout_s=timeout,
            progress=bar,
        )
    if json:
        typer.echo(as_json(answer, rig=rig, name=controller.name))
    raise_unless_taken(answer, rig=rig, name=controller.name)
    if not (quiet or json):
        typer.echo(outcome(answer, rig=rig, name=controller.name))


class _Bar:
    """Chunks that have arrived, then ticks of the shadow, on one line."""

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._task = bars.add_task("asking", total=None, said="")
        self._shadow_ticks = 0

    def __call__(self, sending: Sending) -> None:
        answer, offer = sending.answer, sending.offer
        assert answer is not None
        if answer.stage == "shadowing":
            left = answer.shadow_ticks_left
            self._shadow_ticks = max(self._shadow_ticks, left)
            done, total, said = self._shadow_ticks - left, self._shadow_ticks, f"{counted(left, 'tick')} to go"
        else:
            done, total, said = sending.arrived, offer.chunks, f"{sending.arrived} of {counted(offer.chunks, 'chunk')}"
        self._bars.update(self._task, description=answer.stage, completed=done, total=total, said=said)


@contextlib.contextmanager
def _progress(*, silent: bool) -> Iterator[_Bar]:
    """A bar on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[said]}"))
    with Bars(*columns, console=console, disable=silent or not console.is_terminal, transient=True) as bars:
        yield _Bar(bars)
