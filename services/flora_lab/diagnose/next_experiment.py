"""Which run to make next, and how well each light schedule would part the causes that are still possible.

For each cause that may still be, and each schedule that a rig can run, it is worked out what a further run would be
like: a typical plant, the cause as strong as it was found. What another cause would lose on that run, with the plant
and the parameters that suit it best, is what the run would tell. Nothing is simulated by chance. In drawn cases most
pairs of schedules came out in the order that was told, with nats between half of what was told and a little more than
all of it; six-hour turns told less of a rolled camera than they were said to.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg

from flora_common.arrays import Array
from flora_lab.diagnose import chance
from flora_lab.diagnose.diagnosis import NextExperiment
from flora_lab.diagnose.explanation import FIRST, Explanation, Stage
from flora_lab.diagnose.joint import Base, Found, Joint, Ready, ready
from flora_lab.diagnose.rhythm import Swing
from flora_lab.diagnose.rivals import choices
from flora_lab.diagnose.scene import START_SD, TEMPERATURE, Scene
from flora_lab.diagnose.schedules import CHOICE, USUAL, Schedule
from flora_lab.diagnose.usual_errors import UsualErrors
from flora_lab.diagnose.verdict import related_nats
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import Change, is_same
from flora_lab.simulator.measured import STEP_S, MeasuredRun
from flora_lab.simulator.terms import ExtendedLaw

CLOSE_NATS: Final = 6.0
"""A cause whose evidence lies so near to that of the best one may still be the true one."""
MOST: Final = 4
"""Causes that are compared, at most: maps of more are not read."""
TOLD_NATS: Final = 1.0
"""A run that is expected to tell less than this does not tell two causes apart."""
NOTHING: Final = "nothing"
NOTHING_TOLD: Final = "nothing at all"
"""How that is called where a person reads it."""
NOTHING_NEAR: Final = "Nothing else comes near: no further run is needed to tell causes apart."
NO_CAUSE_NEAR: Final = "No cause comes near enough to be told by a further run."
NOT_IN_CATALOGUE: Final = (
    "Something that is not in the catalogue is at work, and no light tells what: look at the runs, and at the box."
)
NO_BETTER: Final = "in drawn cases what it favours told no more than the usual turns again."
"""Of the map, see docs/results/discovery.md: it is offered, and no promise."""
_STEPS: Final = 8
_STEPS_TO_SUIT: Final = 4
_PICTURES: Final[Mapping[str, str]] = {
    "camera_roll": "a plumb line in the picture",
    "camera_drift": "a plumb line in the first picture and in the last one",
    "camera_scale": "a scale bar beside the stem",
    "clock_offset": "a picture that shows the lamps change, with its time",
    "clock_skew": "pictures that show the lamps change, with their times, at the start and at the end",
}
"""What settles an effect of the record without any light."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A cause that may be the true one.

    Attributes:
        name: of the effect.
        found: all causes together, this one the last.
        behind: nats by which its evidence lies behind that of the best one.
    """

    name: str
    found: Found
    behind: float


Separating = dict[tuple[str, str], dict[str, float]]
"""Pair of causes to name of a schedule to nats a run."""


def next_experiment(
    scenes: Sequence[Scene],
    base: Base,
    explanation: Explanation,
    errors: UsualErrors | None = None,
    swing: Swing | None = None,
) -> NextExperiment:
    """What would separate the causes that may still be.

    Args:
        scenes: the runs that were explained.
        base: what is known of plants.
        explanation: of them.
        errors: what the law is wrong in; in nothing where None.
        swing: that plants have by themselves.
    """
    candidates = candidates_of(explanation)
    if explanation.unnamed is not None and (len(candidates) < 2 or not explanation.accepted):
        return NextExperiment(why=NOT_IN_CATALOGUE)
    if len(candidates) < 2:
        return NextExperiment(why=NOTHING_NEAR if explanation.accepted else NO_CAUSE_NEAR)
    told = separating(scenes, base, candidates, explanation.swing or swing, errors=errors)
    best, others = candidates[0], candidates[1:]
    asked = {other.name: told[best.name, other.name] for other in others}
    by_light = [other for other in others if max(asked[other.name].values()) >= TOLD_NATS]
    favoured = _favoured(by_light, asked)
    chosen = _chosen(by_light, asked, favoured)
    pictures = _pictures(best.name, [other.name for other in others])
    without = [other.name for other in others if other not in by_light]
    hours = float(round(_longest(scenes).run.hours))
    said = _why_light(best.name, by_light, asked, chosen, hours) if chosen is not None else []
    if favoured is not None and chosen is not favoured:
        most = min(asked[other.name][favoured.name] for other in by_light)
        said.append(f"By the map {favoured.words} tell {most:.1f} nats or more; {NO_BETTER}")
    said += [_why_none(best.name, name, pictures.get(name)) for name in without]
    said += [
        f"Without any light: {text} tells {name} from {_called(best.name)}."
        for name, text in pictures.items()
        if name not in without
    ]
    first = without + [other.name for other in by_light]
    return NextExperiment(
        light_schedule="" if chosen is None else chosen.text_of(hours),
        hours=0.0 if chosen is None else hours,
        separates=[best.name, *(other.name for other in (by_light or others))],
        why=" ".join(said),
        map={f"{a} / {b}": {name: round(nats, 1) for name, nats in row.items()} for (a, b), row in told.items()},
        favours="" if favoured is None else favoured.text_of(hours),
        picture=next((_PICTURES.get(name, "") or pictures[name] for name in first if name in pictures), ""),
    )


def _called(name: str) -> str:
    """A candidate in a sentence."""
    return NOTHING_TOLD if name == NOTHING else name


def candidates_of(explanation: Explanation) -> list[Candidate]:
    """The causes that may still be, the best one first; one or none where nothing is in question.

    They are those that may be in the place of the cause that was chosen last, or else of the one before.
    """
    stages = choices(explanation)
    if not stages:
        near = (
            Candidate(tried.effect.name, _to_the_end(explanation.joint, tried.found), 0.0)
            for tried in explanation.stages[-1].tried
            if tried.found is not None and tried.gain > 0.5 * FIRST
        )
        best = next(near, None)
        return [] if best is None else [Candidate(NOTHING, explanation.found, 0.0), best]
    fits = [explanation.found, *(stage.tried[0].found for stage in stages[1:])]
    in_question = [
        _in_place_of(stage, fit, explanation.joint) for stage, fit in zip(stages, fits, strict=True) if fit is not None
    ]
    return next((one for one in in_question if len(one) > 1), in_question[0])


def _in_place_of(stage: Stage, found: Found, joint: Joint) -> list[Candidate]:
    """The cause that was chosen at a stage, as it was found, and those that may be in its place."""
    best = stage.tried[0]
    out = [Candidate(best.effect.name, found, 0.0)]
    for tried in stage.tried[1:]:
        behind = best.gain - tried.gain
        is_near = behind <= (related_nats(best) if is_same(best.effect, tried.effect) else CLOSE_NATS)
        if tried.found is not None and (is_near or tried.effect.name in best.effect.exactly) and len(out) < MOST:
            out.append(Candidate(tried.effect.name, _to_the_end(joint, tried.found), max(behind, 0.0)))
    return out


def _to_the_end(joint: Joint, found: Found) -> Found:
    """A fit of which only the beginning was made, because it promised little, carried on."""
    return found if found.jacobians else joint.fit(found, _STEPS)


def separating(
    scenes: Sequence[Scene],
    base: Base,
    candidates: Sequence[Candidate],
    swing: Swing | None = None,
    errors: UsualErrors | None = None,
) -> Separating:
    """How many nats a further run under each of :data:`CHOICE` would bring, on the mean, between two causes of which
    either is true.

    Args:
        scenes: runs that were made: a further one is as long, as warm, and of plants as long at the start.
        base: what is known of plants.
        candidates: the causes.
        swing: of the tip, that is there besides.
        errors: what the law is wrong in.
    """
    pairs = list(itertools.combinations(candidates, 2))
    told: Separating = {(a.name, b.name): {} for a, b in pairs}
    for schedule in CHOICE:
        scene = planned(scenes, schedule)
        answers = scene.answers(base.mean, Change())
        besides = np.zeros((scene.size, scene.size))
        if swing is not None:
            besides += chance.of_swing(scene, answers, swing)
        if errors is not None:  # on the mean it is known, and does not tell one cause from another
            besides += errors.of_run(scene, base.mean, Change())[1]
        run = ready(scene, base, chance.covariances(scene, answers), together=1, besides=besides)
        shown = {candidate.name: typical(run, base, candidate) for candidate in candidates}
        for a, b in pairs:
            nats = lost(run, base, shown[a.name], b) + lost(run, base, shown[b.name], a)
            told[a.name, b.name][schedule.name] = 0.5 * nats
    return told


def planned(scenes: Sequence[Scene], schedule: Schedule) -> Scene:
    """A run that was not made yet: as long and as warm as the longest one, of a plant that starts as they did."""
    like = _longest(scenes)
    steps = round((len(like.run) - 1) * like.run.step_s / STEP_S)
    step_h = STEP_S / 3600.0
    first_cm = np.mean([scene.first_cm for scene in scenes], axis=0)
    points = np.repeat(first_cm[None], steps + 1, axis=0).astype(np.float64)
    time_s = np.arange(steps + 1, dtype=np.float64) * STEP_S
    at_h = (np.arange(steps) + 0.5) * step_h
    # Warmth is told as what it is above the usual, so the usual is none.
    warmth = np.asarray(np.interp(at_h, (np.arange(like.steps) + 0.5) * like.step_h, like.warmth_c), dtype=np.float64)
    light = schedule.levels(steps, step_h)
    run = MeasuredRun(schedule.name, "", "", points, light, time_s, STEP_S, {TEMPERATURE: warmth})
    law: ExtendedLaw = like.law
    return Scene(run, law, 0.0)


def _longest(scenes: Sequence[Scene]) -> Scene:
    return max(scenes, key=lambda scene: scene.steps)


def typical(run: Ready, base: Base, candidate: Candidate) -> Array:
    """What a typical plant would show in a run under a cause, shape (m + 2,)."""
    found = candidate.found
    at = Found(found.hypothesis, found.coordinates, base.mean[None], np.zeros((1, 2)))
    return Joint([run], base).features_of(at, 0, with_slopes=False)[0]


def lost(run: Ready, base: Base, told: Array, other: Candidate) -> float:
    """Nats that a cause loses on a run that another one made, with a plant and with parameters that suit it best.

    Args:
        run: that is planned.
        base: what is known of plants.
        told: what the true cause shows, shape (m + 2,).
        other: the cause that is not true. Its parameters are known from the runs that were made, the plant is not.
    """
    joint, found = Joint([run], base), other.found
    centre = np.concatenate([base.mean, np.zeros(len(START_SD)), found.coordinates])
    doubt = scipy.linalg.block_diag(base.spread + base.doubt, np.diag(START_SD**2), found.covariance)
    precision = np.linalg.inv(doubt)
    at, least = centre, np.inf
    for _ in range(_STEPS_TO_SUIT):
        plant, own = at[: len(base.mean) + len(START_SD)], at[len(base.mean) + len(START_SD) :]
        traits, start = plant[None, : len(base.mean)], plant[None, len(base.mean) :]
        shown, slopes = joint.features_of(Found(found.hypothesis, own, traits, start), 0)
        rest, white, away = run.white(told - shown), run.white(slopes), at - centre
        least = min(least, 0.5 * float(rest @ rest + away @ precision @ away))
        at = at + np.linalg.solve(white.T @ white + precision, white.T @ rest - precision @ away)
    return least


def _chosen(
    by_light: Sequence[Candidate], asked: Mapping[str, Mapping[str, float]], favoured: Schedule | None
) -> Schedule | None:
    """The usual turns where these tell anything of each cause, and else what is favoured.

    Another plant is what helps: in drawn cases a run under what the map favours has told no more than the usual turns
    again (docs/results/discovery.md), so that nobody is asked for other light without need.
    """
    tells = all(asked[other.name][USUAL.name] >= TOLD_NATS for other in by_light)
    return USUAL if tells and by_light else favoured


def _favoured(by_light: Sequence[Candidate], asked: Mapping[str, Mapping[str, float]]) -> Schedule | None:
    """The schedule after which the least is expected to be left of the other causes' probability."""
    if not by_light:
        return None

    def left(schedule: Schedule) -> float:
        return float(sum(np.exp(-other.behind - asked[other.name][schedule.name]) for other in by_light))

    return min(CHOICE, key=left)


def _why_light(
    best: str, by_light: Sequence[Candidate], asked: Mapping[str, Mapping[str, float]], chosen: Schedule, hours: float
) -> list[str]:
    said = []
    for other in by_light:
        row = asked[other.name]
        usual = "" if chosen.name == USUAL.name else f"; turns of {USUAL.name} would tell {row[USUAL.name]:.1f}"
        said.append(
            f"A run of {hours:g} h with {chosen.words} is expected to tell {_called(best)} from "
            f"{_called(other.name)} by {row[chosen.name]:.1f} nats{usual}."
        )
    return said


def _why_none(best: str, other: str, what: str | None) -> str:
    return f"No light tells {_called(best)} from {other}" + (f"; {what} would." if what else ".")


def _pictures(best: str, others: Sequence[str]) -> dict[str, str]:
    """By the name of another cause: what tells it from the best one without light."""
    found = {}
    for other in others:
        same = BY_NAME[best].same_as.get(other) if best in BY_NAME else None
        text = same or _PICTURES.get(other) or _PICTURES.get(best)
        if text:
            found[other] = text
    return found
