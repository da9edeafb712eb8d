"""The open-loop schedule: lamps in turn, whatever the plant does (Wahby et al. 2018, the dataset experiments).

flora-controller steers by it when it cannot see, flora-led shines by it when nobody steers.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

Side = Literal["left", "right"]
OTHER: Final[dict[Side, Side]] = {"left": "right", "right": "left"}
HOUR_S: Final = 3600.0


class OpenLoopSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[controller.open_loop]`` and ``[led.open_loop]``: hours for each lamp, and which one begins."""

    hours: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 6.0
    """By the run's time, for which a lamp shines before it is the other one's turn."""

    first: Side = "left"
    """The lamp that shines from the run's beginning."""


PAPERS_TURNS: Final = OpenLoopSection()


def open_loop_side(time_s: float, section: OpenLoopSection) -> Side:
    """The lamp of the schedule at a time of the run."""
    turn = int(max(time_s, 0.0) // (section.hours * HOUR_S))
    return section.first if turn % 2 == 0 else OTHER[section.first]
