"""Learning from reference runs, and what the same search finds in them if they are held out.

Nothing is wrong with a reference run. Evidence for a cause in some of them, by what the others tell, is the law's own
error, and as much of it is to be expected in measured runs: more is asked of all causes there, and most of those that
were found. Which law is best and where each plant's fit ended is not learned anew for each fold; how plants differ,
what happens by chance and what the law is wrong in is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import learn
from flora_lab.diagnose.knowledge import LAW_ROUNDS, LOOKED_FOR, Knowledge, known_of, law_of, under
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.trials import Trials
from flora_lab.effects.law_forms import LAWS, Law

FOLDS: Final = 3
LEAST_RUNS: Final = 6
"""Fewer reference runs tell too little without a third of them."""
ROUNDS: Final = LAW_ROUNDS + 1 + FOLDS
"""How often :func:`learn_from` tells that it has come farther."""


def learn_from(
    scenes: Sequence[Scene], on_round: Callable[[int], None] = lambda _: None, laws: Sequence[Law] = LAWS
) -> Knowledge:
    """Learn from runs in which nothing is taken to be wrong, under the one of the laws that suits them best."""
    rounds = itertools.count(1)

    def told() -> None:
        on_round(next(rounds))

    law, best = law_of(scenes, told, laws)
    scenes = under(law, scenes)
    known = known_of(scenes, best, law)
    told()
    return replace(known, cross_fit=_held_out(scenes, best, known, told))


def _held_out(scenes: Sequence[Scene], best: learn.Learned, known: Knowledge, on_fold: Callable[[], None]) -> Array:
    """See :attr:`Knowledge.cross_fit`. Folds take every third run, for references often come sorted by their light."""
    found = []
    for first in range(FOLDS):
        out = range(first, len(scenes), FOLDS)
        kept = [i for i in range(len(scenes)) if i not in out]
        if len(scenes) >= LEAST_RUNS:
            less = known_of([scenes[i] for i in kept], learn.learned_by(scenes, best, kept), known.law)
            tried = Trials([scenes[i] for i in out], less).first_stage().tried
            gains = {one.effect.name: one.gain for one in tried}
            found.append([gains.get(name, 0.0) for name in LOOKED_FOR])
        on_fold()
    return np.array(found).reshape(-1, len(LOOKED_FOR))
