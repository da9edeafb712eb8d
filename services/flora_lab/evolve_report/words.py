"""Numbers and reasons of an evolution in words, the same in figures, film and page."""

from __future__ import annotations

from typing import Final

from flora_lab import judging
from flora_lab.evolve.episode import Reason
from flora_lab.evolve.evolution_folder import EpisodeTrack
from flora_lab.evolve.task import Scenario, Task
from flora_lab.figure_style import drawable

NAME_SIGNS: Final = 34
"""As many signs of a scenario's name fit over a panel."""


def ended(reason: Reason, task: Task) -> str:
    """Why an episode ended."""
    if reason == "no answer":
        return "the controller had no answer"
    if reason == "time":
        return "its time was over"
    return judging.reason(reason, task.stop_height_cm)


def hours_of(episode: EpisodeTrack) -> float:
    """How long an episode went on."""
    return float(episode.time_s[-1] - episode.time_s[0]) / 3600.0


def panel_title(scenario: Scenario) -> str:
    """A scenario's name over its panel; to be drawn with ``parse_math=False``, as names may hold dollar signs."""
    return drawable(scenario.name, NAME_SIGNS) + ("" if scenario.is_possible else " (impossible)")
