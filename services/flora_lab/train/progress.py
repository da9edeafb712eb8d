"""What ``flora-lab train`` shows while it works: a bar on a terminal, and TensorBoard's files on request."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn, TimeRemainingColumn

from flora_common.errors import BadInput
from flora_lab.bars import Bars
from flora_lab.train.recipes import Progress


class Screen:
    """A :class:`flora_lab.train.recipes.Progress` with a rich bar and, where wanted, a TensorBoard writer.

    Args:
        bars: to draw on.
        quiet: say nothing at all.
        board: ``SummaryWriter`` of ``torch.utils.tensorboard``, or None.
    """

    def __init__(self, bars: Bars, *, quiet: bool, board: Any = None) -> None:
        self._bars = bars
        self._quiet = quiet
        self._board = board
        self._task = bars.add_task("reading", total=None, losses="")

    def note(self, text: str) -> None:
        """See :class:`Progress`; on stderr."""
        if not self._quiet:
            print(text, file=sys.stderr)

    def stage(self, name: str) -> None:
        """See :class:`Progress`."""
        self._bars.update(self._task, description=name)

    def begin(self, epochs: int, done: int = 0) -> None:
        """See :class:`Progress`."""
        self._bars.remove_task(self._task)
        self._task = self._bars.add_task("epochs", total=epochs, completed=done, losses="")

    def epoch(self, number: int, losses: Mapping[str, float], patience_left: int | None = None) -> None:
        """See :class:`Progress`."""
        text = ", ".join(f"{name} {value:.3g}" for name, value in losses.items())
        if patience_left is not None:
            text += f", patience {patience_left}"
        self._bars.update(self._task, completed=number, losses=text)
        if self._board is not None:
            for name, value in losses.items():
                self._board.add_scalar(f"loss/{name}", value, number)


@contextlib.contextmanager
def shown(*, silent: bool, quiet: bool, tensorboard: Path | None) -> Iterator[Progress]:
    """Progress on stderr if that is a terminal.

    Args:
        silent: no bar.
        quiet: no notes either.
        tensorboard: a folder for TensorBoard's event files.

    Raises:
        BadInput: TensorBoard is wanted and not installed.
    """
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[losses]}"),
        TimeRemainingColumn(),
    )
    with contextlib.ExitStack() as stack:
        board = None if tensorboard is None else stack.enter_context(_board(tensorboard))
        disable = silent or quiet or not console.is_terminal
        bars = stack.enter_context(Bars(*columns, console=console, disable=disable, transient=True))
        yield Screen(bars, quiet=quiet, board=board)


def _board(folder: Path) -> Any:
    if importlib.util.find_spec("tensorboard") is None:
        raise BadInput("--tensorboard: the package tensorboard is not installed; `pip install tensorboard`")
    return importlib.import_module("torch.utils.tensorboard").SummaryWriter(str(folder))
