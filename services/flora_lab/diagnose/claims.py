"""How much evidence it takes to tell a cause, or something without a name, in some runs beside a reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from flora_lab.diagnose.explanation import FIRST, SECOND, THIRD
from flora_lab.diagnose.knowledge import LOOKED_FOR, Knowledge

_DOUBT: Final = 8.0
"""Nats that are needed besides, for each e-fold by which healthy runs show the law to be worse than was expected."""
_FOUND_IN_HEALTHY: Final = 1.0
"""Nats that are needed besides, for each that healthy runs show for a cause, in the median of the folds, beyond
:data:`_BY_CHANCE`; and at most."""
_BY_CHANCE: Final = 1.5
"""As much healthy runs of the law's own physics show in each other, and it tells nothing of what others will."""
_MOST_DOUBT: Final = 4.0
_FOUND_OF_ONE: Final = 1.5
"""Nats that a cause needs besides for each that healthy runs show for that very one, in the fold with most of it,
beyond :data:`_BY_CHANCE`: other plants like these have more of it than all three folds in one case of four. One odd
plant among nine is met again in every third case of three."""
_MOST_DOUBT_OF_ONE: Final = 20.0
"""The same at most."""
NAMELESS: Final = 14.0
"""Nats that it must have, which nobody has put bounds to; with more runs than three in proportion: what is wrong in the
form of the law adds up over runs."""
NAMELESS_ALONE: Final = 10.0
"""Nats that it must have where no cause has :data:`NEXT_TO_NOTHING`, and none can be hidden by it. No healthy plants
have as much and less than 14 (docs/results/discovery-history.md)."""
NEXT_TO_NOTHING: Final = 2.0
BETTER: Final = 4.0
"""Nats by which it must be better than the best cause, which then is not believed; with more runs than three by as
much more as :data:`NAMELESS` is more: causes have what is usually wrong in the law taken off, and it has not."""
_RUNS: Final = 3


@dataclass(frozen=True, slots=True)
class Claims:
    """Nats.

    Attributes:
        causes: that the first, the second and the third cause need.
        nameless: that something without a name needs.
        nameless_alone: the same where no cause has next to anything.
        better: by which it must be better than the best cause.
        besides: what causes need beyond these because healthy runs show them; none where missing.
    """

    causes: tuple[float, float, float]
    nameless: float
    nameless_alone: float
    better: float
    besides: Mapping[str, float] = field(default_factory=dict)

    @property
    def first(self) -> float:
        return self.causes[0]

    def of(self, name: str, others: int) -> float:
        """What a cause needs beside so many others."""
        return self.causes[others] + self.besides.get(name, 0.0)


def claims_of(known: Knowledge, runs: int) -> Claims:
    """What is asked where so many runs are compared."""
    more = max(1.0, runs / _RUNS)
    doubt = more * _doubt_of(known)
    return Claims(
        (FIRST + doubt, SECOND + doubt, THIRD + doubt),
        more * NAMELESS + doubt,
        more * NAMELESS_ALONE + doubt,
        BETTER + (more - 1.0) * NAMELESS,
        {name: max(0.0, more * own - doubt) for name, own in _doubts(known).items()},
    )


def _doubts(known: Knowledge) -> Mapping[str, float]:
    """Nats that each cause needs besides in three runs, because healthy ones of the same plants show it."""
    if not len(known.cross_fit):
        return {}
    beyond = known.cross_fit.max(axis=0) - _BY_CHANCE
    return dict(zip(LOOKED_FOR, np.clip(_FOUND_OF_ONE * beyond, 0.0, _MOST_DOUBT_OF_ONE).tolist(), strict=True))


def _doubt_of(known: Knowledge) -> float:
    """Nats that a cause needs besides in three runs, for the law has errors that look like causes."""
    of_errors = _DOUBT * max(0.0, known.errors.beyond_expected)
    if not len(known.cross_fit):
        return of_errors
    found = float(np.median(known.cross_fit.max(axis=1)))  # one odd plant makes one odd fold
    return max(of_errors, min(_FOUND_IN_HEALTHY * max(0.0, found - _BY_CHANCE), _MOST_DOUBT))
