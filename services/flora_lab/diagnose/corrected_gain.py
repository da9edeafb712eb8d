"""How much nearer a learned simulator comes to measured runs with what it lacks beside it.

Everything else of a diagnosis is told of the mechanistic simulator. Here the one that was given runs free, as it is and
corrected, about runs that tell nothing of the correction: those held out, or each by what the others tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from flora_common.arrays import FloatArray
from flora_common.counted import counted
from flora_lab.diagnose.explanation import Explanation
from flora_lab.diagnose.gain import without_each
from flora_lab.diagnose.joint import Found
from flora_lab.diagnose.mended_simulator import BASE, STILL, error_table_mm, free_stems, still_stems
from flora_lab.simulator.corrected import CorrectedSimulator, LearnedSimulator
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension

CORRECTED: Final = "corrected"


def corrected_gain(
    learned: LearnedSimulator,
    mechanistic: RodSimulator,
    explanation: Explanation,
    runs: Sequence[MeasuredRun],
    holdout: Sequence[MeasuredRun] = (),
) -> dict[str, Any]:
    """Tip errors in mm for ``learned`` of ``diagnosis.json``: medians over runs; nothing where nothing can be judged.

    Args:
        learned: that was given.
        mechanistic: that is extended beside it.
        explanation: of the runs.
        runs: that were explained.
        holdout: further runs, to judge by.
    """
    if not _extensions(explanation.found) or not (holdout or len(runs) > 1):
        return {}
    judged = list(holdout or runs)
    stems = {BASE: free_stems(learned, judged), STILL: still_stems(judged)}
    if holdout:
        whole = CorrectedSimulator(learned, mechanistic.extended(_extensions(explanation.found)))
        stems[CORRECTED] = free_stems(whole, judged)
        judged_on = f"{counted(len(holdout), 'run')} held out"
    else:
        stems[CORRECTED] = _each_by_others(learned, mechanistic, explanation, judged)
        judged_on = f"each of {len(runs)} runs, by what the others tell"
    return {"tip_error_mm": error_table_mm(stems, judged), "judged_on": judged_on}


def _each_by_others(
    learned: LearnedSimulator, mechanistic: RodSimulator, explanation: Explanation, runs: Sequence[MeasuredRun]
) -> list[FloatArray]:
    stems = []
    for run, found in zip(runs, without_each(explanation), strict=True):
        extended = mechanistic.extended(_extensions(found))
        stems += free_stems(CorrectedSimulator(learned, extended), [run])
    return stems


def _extensions(found: Found) -> list[Extension]:
    """The causes of a fit that a simulator can be extended by."""
    causes = zip(found.hypothesis.causes, found.values(), strict=True)
    return [
        Extension(cause.effect.name, dict(values), cause.form)
        for cause, values in causes
        if not cause.effect.is_of_the_record
    ]
