"""What ``flora-lab track`` says: progress on stderr while it works, a summary on stdout when it is done."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from flora_common.counted import counted
from flora_common.vision.reading import OK
from flora_lab.bars import Bars
from flora_lab.track.learning import Learnt, Sorted
from flora_lab.track.pictures import Wanted
from flora_lab.track.readings import Summary

BAD_PICTURES_NAMED: Final = 3

Stage = Callable[..., Callable[[], None]]
"""From a stage's name, length (None: not known) and what is done of it, to a function that counts one more."""

_LIGHTS_FROM: Final = {
    "frames.csv": "",
    "told": "",
    "picture": ", as each picture shows",
    "alternation": ", as the pictures show",
    "nothing": ", for the pictures show no lamps that alternate; say it with --light-from if you know",
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """All that the summary tells."""

    input: str
    method: str
    output: Path
    wanted: Wanted
    summary: Summary
    learnt: Learnt
    frames: Sorted
    jobs: int
    resumed: int

    def as_json(self) -> str:
        """One object."""
        s = self.summary
        fields: dict[str, Any] = {
            "input": self.input,
            "method": self.method,
            "setup": self.learnt.made_by,
            "setup_pictures": self.learnt.pictures,
            "setup_states": self.learnt.states,
            "frames": s.frames,
            "readings": s.readings,
            "outcomes": dict(s.outcomes),
            "folded": s.folded,
            "lights": dict(s.lights),
            "lights_from": self.frames.lights_from,
            "mean_quality": round(s.mean_quality, 4),
            "bad_pictures": s.bad,
            "jobs": self.jobs,
            "resumed_after": self.resumed,
            "track": str(self.output),
            "overlays": _text(self.wanted.overlays),
            "contact": _text(self.wanted.contact),
            "film": _text(self.wanted.film),
        }
        return json.dumps(fields)

    @property
    def advice(self) -> str:
        """What to try where most frames gave no stem, or none to be relied upon; empty where most did."""
        if 2 * self.summary.outcomes[OK] >= self.summary.frames:
            return ""
        tries = [] if self.wanted.overlays else ["look at them with --overlays"]
        if self.learnt.made_by != "background":
            tries.append("take background pictures of the setup without a plant")
        if self.method == "path":
            tries.append("give --hidden-base-cm where a rim hides the foot of the stem")
        tries.append("see whether anchor and scale are right")
        gave = "no stem" if 2 * self.summary.readings < self.summary.frames else "no stem that is ok"
        return f"most frames gave {gave}: {', '.join(tries)}"

    def lines(self) -> list[str]:
        """For people."""
        s = self.summary
        lights = ", ".join(f"{name} {count}" for name, count in s.lights.items())
        pictures, states = self.learnt.pictures, self.learnt.states
        told_apart = counted(states, "lamp state")
        if self.learnt.made_by == "background":
            setup = f"from {counted(pictures, 'background picture')}"
            setup += f", {told_apart}" if self.method == "path" else ""
        else:
            setup = f"learnt from {pictures} of the frames, {told_apart}, for there are no background pictures"
        return [
            f"{counted(s.frames, 'frame')}, {counted(s.readings, 'reading')}: {s.outcome_words()}",
            f"mean quality {s.mean_quality:.2f}" + (f"; {s.folded} folded" if s.folded else ""),
            f"light {lights}{_LIGHTS_FROM[self.frames.lights_from]}",
            f"empty setup: {setup}",
            "wrote " + ", ".join(map(str, [self.output, *self.wanted.paths])),
        ]


def tell(outcome: Outcome, *, quiet: bool, as_json: bool) -> None:
    """Print the summary."""
    if as_json:
        print(outcome.as_json())
        return
    if quiet:
        return
    bad = outcome.summary.bad
    for reason in bad[:BAD_PICTURES_NAMED]:
        print(f"left out: {reason}", file=sys.stderr)
    if len(bad) > BAD_PICTURES_NAMED:
        print(f"left out: {len(bad) - BAD_PICTURES_NAMED} more bad pictures", file=sys.stderr)
    for line in outcome.lines():
        print(line)
    if outcome.advice:
        print(outcome.advice, file=sys.stderr)


@contextlib.contextmanager
def progress(silent: bool) -> Iterator[Stage]:
    """A bar for the stage that the work is at, on a terminal; nothing elsewhere."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Speed(), TimeRemainingColumn())
    with Bars(*columns, console=console, disable=silent or not console.is_terminal, transient=True) as bars:

        def stage(name: str, total: int | None, done: int = 0) -> Callable[[], None]:
            for before in bars.task_ids:
                bars.update(before, visible=False)
            task = bars.add_task(name, total=total, completed=done)
            return lambda: bars.advance(task)

        yield stage


class _Speed(ProgressColumn):
    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{speed:.1f} frames/s" if speed else "", style="progress.data.speed")


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)
