"""Plants of a run, advanced in steps that are short enough whatever lies between its photographs.

A law that is advanced by half an hour at once answers the light of half an hour late: to a diagnosis that is a clock
which is off, or a plant that answers late.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.simulator.law import Stems
from flora_lab.simulator.terms import Driven, ExtendedLaw, Seen

Array = npt.NDArray[Any]

LONGEST_H: Final = 0.1
"""Six minutes: what is learned from photographs every five is advanced by five."""


def advance(
    law: ExtendedLaw,
    stems: Stems,
    traits: Array,
    terms: Array,
    driven: Driven,
    seen: Seen,
    step_h: float,
    every: int,
    out: Array,
) -> None:
    """As :meth:`flora_lab.simulator.terms.ExtendedLaw.advance_with`, with several steps for one that is long.

    Args:
        law, stems, traits, terms, driven, seen, step_h, every, out: see there.
    """
    parts = max(1, math.ceil(step_h / LONGEST_H - 1e-9))
    if parts > 1:
        driven = Driven(*(np.repeat(course, parts, axis=0) for course in driven))
    law.advance_with(stems, traits, terms, driven, seen, step_h / parts, every * parts, out)
