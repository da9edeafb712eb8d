"""What a diagnosis says; ``diagnosis.json`` is this."""

from __future__ import annotations

from typing import Any, Final, Literal

import msgspec

Verdict = Literal["nothing_wrong", "explained", "unexplained"]

HORIZONS_H: Final = (1.0, 6.0, 24.0)
END: Final = "end"
"""Times after the first stem at which errors of a free run are told, and the key of its end."""
AROUND_H: Final = 0.5
"""Errors at a time are means over so much before and after it."""
SIMULATOR_NAMES: Final = {"base": "simulator as it is", "extended": "extended simulator"}
SURE_ERRORS: Final = 2.0
"""Standard errors that a mean must be away from none to be more than chance."""


class NamedCause(msgspec.Struct, frozen=True):
    """One cause.

    Attributes:
        effect: its name in the catalogue.
        parameters: by name; units stand in the names.
        interval: of 90 %, by the same names.
        confidence: probability that it is this one, or one of those that these data cannot tell from it; of what a
            learned simulator lacks as a whole see :mod:`flora_lab.diagnose.learned_simulator`.
        p_value: how often runs without any effect show as much evidence, at most.
        confusable_with: effects that these data cannot tell from it.
        evidence: a sentence.
        nats: logarithm of how much more probable the runs are with it than without.
        form: in which of its forms, see :mod:`flora_lab.effects`.
    """

    effect: str
    parameters: dict[str, float]
    interval: dict[str, tuple[float, float]]
    confidence: float
    p_value: float
    confusable_with: list[str]
    evidence: str
    nats: float
    form: int = 0


class Residuals(msgspec.Struct, frozen=True):
    """What the simulator gets wrong, before anything is explained.

    Attributes:
        where: along the stem: name of a place to figures.
        when: by time of day, since the last switch, by height and age.
        size_mm: root mean square of the tip in free running.
        significant: whether it is more than the runs' own chance and the plants' differences make of it.
        description: sentences.
        left: what is left after the causes, in sentences; empty where nothing is.
    """

    where: dict[str, Any]
    when: dict[str, Any]
    size_mm: float
    significant: bool
    description: str
    left: str = ""


class Described(msgspec.Struct, frozen=True):
    """What seems to be at work that is no cause of the catalogue.

    Attributes:
        drive: which part of the law is off: ``gain`` (the answer to light), ``growth`` or ``bias`` (of bending).
        follows: what it follows, in words.
        size: by how much, as a share, or in 1/(cm h) for ``bias``; two numbers for a rhythm, of its cosine and
            its sine, and one for a rhythm that has its own times in each run.
        nats: evidence beyond that without it.
        description: all of it as a clause.
        period_h: of a rhythm; None of anything else.
        peaks_h: of a rhythm that has its own times, by run: the first time after the start at which it is highest.
    """

    drive: str
    follows: str
    size: list[float]
    nats: float
    description: str
    period_h: float | None = None
    peaks_h: dict[str, float] = {}


class Gain(msgspec.Struct, frozen=True):
    """Errors in mm on runs that no fit has seen, by simulator: ``base``, ``extended``, ``boosted``.

    Attributes:
        one_step: simulator to tip error after one step.
        free_running: time (``1h``, ``6h``, ``24h``, ``end``) to simulator to tip error.
        controller_fitness: kind of controllers (``feedback``, ``plan``) to what
            :func:`flora_lab.diagnose.controller_gain.controller_gain` tells of them, and ``judged_on``, sentences;
            empty where it was not asked for, or nothing was found in plants.
        judged_on: how runs were held out, a sentence.
    """

    one_step: dict[str, float] = {}
    free_running: dict[str, dict[str, float]] = {}
    controller_fitness: dict[str, Any] = {}
    judged_on: str = ""


class NextExperiment(msgspec.Struct, frozen=True):
    """What would separate what these runs cannot.

    Attributes:
        light_schedule: text that ``flora-twin`` and a rig's light plan read; empty where no light would.
        separates: the causes.
        why: sentences.
        map: pair of causes to schedule to nats.
        picture: which calibration picture would help; empty where none.
        favours: the light that the map takes to tell most, which need not be ``light_schedule``.
        hours: how long the run under ``light_schedule`` is to be, as the longest of these runs is; 0 where none would.
    """

    light_schedule: str = ""
    separates: list[str] = []
    why: str = ""
    map: dict[str, dict[str, float]] = {}
    picture: str = ""
    favours: str = ""
    hours: float = 0.0


class Diagnosis(msgspec.Struct, frozen=True):
    """``diagnosis.json``."""

    verdict: Verdict
    causes: list[NamedCause]
    residuals: Residuals
    gain: Gain
    next_experiment: NextExperiment
    summary: str
    record: list[str] = []
    """What was found in the record before anything else: gaps, stems that were found wrongly."""
    corrected: list[str] = []
    """Tracks in the folder ``corrected``, of each run without what was wrong in the record of it; none where nothing
    was."""
    runs: list[str] = []
    described: Described | None = None
    """What has no name but can be described; None where nothing else seems to be at work."""
    considered: list[dict[str, float]] = []
    """Nats that each cause of the catalogue would have gained, in each round of the search."""
    needed_nats: float = 0.0
    """That one must have to be named; 1.5 fewer for what is but another constant of the plant."""
    base: dict[str, Any] = {}
    """What the simulator was learned from, and what is known of it."""
    learned: dict[str, Any] = {}
    """Of a simulator by the paper's recipe that was mended: its tip errors in mm, running free, before and after."""
    format: int = 1
