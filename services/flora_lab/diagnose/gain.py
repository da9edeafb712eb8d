"""What naming a cause is worth: errors of the simulator without and with it, on whole runs that no fit has seen.

The simulated plant is the typical one, started from the first stem and never told of another: whoever watches a plant
takes part of an effect for its nature. The runs that tell the cause tell of what is typical, too. Beside both
simulators stand a black box that learned their residuals, and what costs nothing: a stem that does not move.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.counted import counted
from flora_lab.diagnose import boosting
from flora_lab.diagnose.diagnosis import AROUND_H, END, HORIZONS_H, Gain
from flora_lab.diagnose.explanation import Explanation
from flora_lab.diagnose.joint import Base, Found, Joint, evidence_for_last
from flora_lab.diagnose.replayed import Replayed, replayed
from flora_lab.diagnose.rivals import last_choice, rivals
from flora_lab.diagnose.scene import Scene
from flora_lab.effects.effect import Change

SIMULATORS: Final = ("base", "extended", "boosted", "still")
POOLED: Final = "_rms"
"""Ends the key of a simulator's pooled root mean square; without it stands the median over runs."""
RIVALS: Final = 2
"""Hypotheses that each fold fits beside the chosen one, and may prefer."""
_STEPS: Final = 8
_MM: Final = 10.0


@dataclass(frozen=True, slots=True)
class Fold:
    """Runs to learn from and runs to judge by.

    Attributes:
        learned_from, judged: places in the list of all runs.
        change: what the simulator was extended by.
        typical: constants of its typical plant, shape (9,): runs to learn from tell of these, too.
    """

    learned_from: tuple[int, ...]
    judged: tuple[int, ...]
    change: Change
    typical: Array


@dataclass(frozen=True, slots=True)
class _Errors:
    """Tip errors of one simulator in one run, mm.

    Attributes:
        one_step: shape (m,).
        at: name of a time to the errors about it.
    """

    one_step: Array
    at: dict[str, Array]


def measure_gain(
    scenes: Sequence[Scene],
    base: Base,
    explanation: Explanation,
    holdout: Sequence[Scene] = (),
    on_step: Callable[[], None] = lambda: None,
) -> Gain:
    """Errors of the base and of the extended simulator, of a black box and of a stem that does not move.

    Args:
        scenes: the runs that were explained.
        base: what is known of plants.
        explanation: of them.
        holdout: further runs, to judge by; without them each run is judged by what the others tell.
        on_step: called after each run.

    Returns:
        Nothing but a sentence where no cause was found, or where there is no run to judge by.
    """
    found = explanation.found
    if not found.hypothesis.causes:
        swings = explanation.swing is not None
        why = "a swing whose phase nobody knows beforehand does not change what a typical plant does on the mean"
        return Gain(judged_on=why if swings else "")
    count = len(scenes)
    if holdout:
        runs = [*scenes, *holdout]
        change = found.hypothesis.change(found.coordinates)
        folds = [Fold(tuple(range(count)), tuple(range(count, len(runs))), change, explanation.typical)]
        judged_on = (
            f"{counted(len(holdout), 'run')} held out, which neither the choice of the causes nor the fit has seen"
        )
    elif count > 1:
        runs = list(scenes)
        folds, other = _left_out(explanation)
        judged_on = (
            f"each of {count} runs by what the others tell: parameters were fitted anew without it, and the chosen "
            f"causes had to win again over their {RIVALS} strongest rivals"
            + (f", which they did not {_times(other)}" if other else "")
            + "; that they were chosen from all causes with all runs makes the figures a little too good"
        )
    else:
        return Gain(judged_on="not judged: there is one run, and none to hold out; give more runs, or --holdout")
    as_it_is = [replayed(scene, base, base.mean, base.mean, np.zeros(2), Change()) for scene in runs]
    wrong: dict[str, list[_Errors]] = {name: [] for name in SIMULATORS}
    for fold in folds:
        box = boosting.learned([runs[i] for i in fold.learned_from], [as_it_is[i] for i in fold.learned_from])
        for i in fold.judged:
            for name, own in _judged(runs[i], as_it_is[i], base, fold, box).items():
                wrong[name].append(own)
            on_step()
    return _gain(wrong, judged_on)


def _left_out(explanation: Explanation) -> tuple[list[Fold], int]:
    """A fold for each run, and in how many of them a rival won."""
    found, count = without_each(explanation), len(explanation.joint.runs)
    folds = []
    for out, fit in enumerate(found):
        rest = tuple(i for i in range(count) if i != out)
        typical = explanation.joint.base.mean_with(fit.traits)
        folds.append(Fold(rest, (out,), fit.hypothesis.change(fit.coordinates), typical))
    return folds, sum(fit.hypothesis.causes != explanation.found.hypothesis.causes for fit in found)


def without_each(explanation: Explanation) -> list[Found]:
    """For each run, what the others tell: the causes fitted anew, or those of a rival that wins without it."""
    runs, stage = explanation.joint.runs, last_choice(explanation)
    if stage is None:
        return []
    others = [tried.found for tried in rivals(explanation)[:RIVALS] if tried.found is not None]
    best = []
    for out in range(len(runs)):
        rest = [i for i in range(len(runs)) if i != out]
        joint = Joint([runs[i] for i in rest], explanation.joint.base)
        before, *fits = [_fitted(joint, rest, one) for one in (stage.before, explanation.found, *others)]
        chosen = fits[0]
        for fit in fits[1:]:
            if evidence_for_last(before, fit) > evidence_for_last(before, chosen):
                chosen = fit
        best.append(chosen)
    return best


def _fitted(joint: Joint, rest: Sequence[int], found: Found) -> Found:
    """The same causes for some of the runs."""
    return joint.fit(Found(found.hypothesis, found.coordinates, found.traits[rest], found.start[rest]), _STEPS)


def _judged(scene: Scene, as_it_is: Replayed, base: Base, fold: Fold, box: boosting.BlackBox) -> dict[str, _Errors]:
    extended = replayed(scene, base, fold.typical, fold.typical, np.zeros(2), fold.change)
    rows = as_it_is.step_rows
    moved = scene.run.points_cm[rows + 1] - scene.run.points_cm[rows]
    boosted = boosting.run_freely(scene, as_it_is, base.mean, box)
    still = np.repeat(scene.first_cm[None], scene.steps, axis=0)
    return {
        "base": _errors(as_it_is, as_it_is.step_error_cm, as_it_is.typical_cm),
        "extended": _errors(as_it_is, extended.step_error_cm, extended.typical_cm),
        "boosted": _errors(as_it_is, boosting.one_step_error_cm(scene, as_it_is, box), boosted),
        "still": _errors(as_it_is, moved, still),
    }


def _errors(run: Replayed, step_error_cm: Array, simulated_cm: Array) -> _Errors:
    off_mm = _MM * np.hypot(*np.moveaxis(run.measured_cm[:, -1] - simulated_cm[:, -1], -1, 0))
    at = {}
    for when, hours in (*((f"{hours:g}h", hours) for hours in HORIZONS_H), (END, run.time_h[-1])):
        about = np.abs(run.time_h - hours) <= AROUND_H + 1e-9
        own = off_mm[about & np.isfinite(off_mm)]
        if hours <= run.time_h[-1] and len(own):
            at[when] = own
    return _Errors(_MM * np.hypot(*np.moveaxis(step_error_cm[:, -1], -1, 0)), at)


def _gain(errors: dict[str, list[_Errors]], judged_on: str) -> Gain:
    one_step: dict[str, float] = {}
    free: dict[str, dict[str, float]] = {when: {} for when in (*(f"{hours:g}h" for hours in HORIZONS_H), END)}
    for name, runs in errors.items():
        _tell(one_step, name, [run.one_step for run in runs if len(run.one_step)])
        for when, told in free.items():
            _tell(told, name, [run.at[when] for run in runs if when in run.at])
    return Gain(one_step, {when: told for when, told in free.items() if told}, judged_on=judged_on)


def _tell(into: dict[str, float], name: str, runs: list[Array]) -> None:
    if runs:
        into[name] = round(float(np.median([own.mean() for own in runs])), 3)
        into[name + POOLED] = round(float(np.sqrt(np.mean(np.concatenate(runs) ** 2))), 3)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
