"""Whether a line goes on looking like the stem that it began as.

A stem's colour changes little over a centimetre, and leaves are darker and greener than what bears them. So an end that
is both, all of it, is a young leaf that the line ran into where the stem turned aside. A leaf also begins with a foot
that is thinner than the stem, and what is thinner than a few pixels is mixed with what is behind it: there the evidence
of plant falls and rises again, as it does nowhere along a stem.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import arc_length
from flora_common.vision.path.sampler import Sampler, places_along

STEP_CM: Final = 0.05
"""The line is looked at in steps of this length."""
AT_TIP: Final = 2
"""At the tip the picture is mixed with what is behind it; so many steps tell nothing."""
LONGEST_CM: Final = 2.0
"""No young leaf at an apex is longer that lies so straight on that a line runs through it."""
SHORTEST_CM: Final = 0.3
"""A shorter end tells no colour."""
BELOW_FROM_CM, BELOW_CM = 0.2, 1.7
"""The stem below a place is what lies between these distances from it."""
LEAST_BELOW: Final = 10
"""So many steps of that are needed. Where a leaf lies over them, nothing above is darker, and nothing is said."""
DARKER, GREENER = 24.0, 8.0
"""Code units by which a leaf is darker, and greener against red, than the stem below: all of it, by both. The light of
lamps falls off along a stem by nearly as much, and does not change its colour so."""
NECK_SHARE: Final = 0.5
"""Of the evidence of plant over the centimetre below; one stem in sixty falls to that somewhere in its last two."""
NECK_FROM_CM, NECK_BELOW_CM = 0.25, 1.2
"""The very end always fades; and how far below a neck the stem is looked at."""


def leaf_from(line: FloatArray, sampler: Sampler, px_per_cm: float) -> int:
    """The first point from which on a line lies in a leaf, up to its end; as many as it has where it does not.

    Args:
        line: shape (n, 2), px, anchor first.
        sampler: of the picture.
        px_per_cm: scale.
    """
    places, from_end = _back_from_end(line, px_per_cm, LONGEST_CM + BELOW_CM)
    least, gap, reach = (round(v / STEP_CM) for v in (SHORTEST_CM, BELOW_FROM_CM, BELOW_CM))
    most = min(round(LONGEST_CM / STEP_CM), len(places) - gap - LEAST_BELOW)
    if most < least:
        return len(line)
    tone, green = sampler.tone(places), sampler.green(places)
    # the brightest and the least green of all that lies above each place
    brightest, palest = np.maximum.accumulate(tone[AT_TIP:]), np.minimum.accumulate(green[AT_TIP:])
    # most ends are as bright, or as pale, as something below: then nothing else need be looked at
    if brightest[least - 1 - AT_TIP] > tone.max() - DARKER or palest[least - 1 - AT_TIP] < green.min() + GREENER:
        return len(line)
    for k in range(most, least - 1, -1):
        below = slice(k + gap, k + reach)
        if (
            brightest[k - 1 - AT_TIP] < float(np.median(tone[below])) - DARKER
            and palest[k - 1 - AT_TIP] > float(np.median(green[below])) + GREENER
        ):
            s = arc_length(line)
            return int(np.searchsorted(s, s[-1] - from_end[k]))
    return len(line)


def has_neck(line: FloatArray, sampler: Sampler, px_per_cm: float) -> bool:
    """Whether the evidence of plant falls, and the line goes on, within its last centimetres; arguments as above."""
    places, _ = _back_from_end(line, px_per_cm, LONGEST_CM + NECK_BELOW_CM)
    plant = sampler.plant(places)
    gap, reach = round(BELOW_FROM_CM / STEP_CM), round(NECK_BELOW_CM / STEP_CM)
    first, last = round(NECK_FROM_CM / STEP_CM), min(round(LONGEST_CM / STEP_CM), len(plant) - reach)
    if last <= first or plant[first:last].min() >= NECK_SHARE * plant.max():
        return False
    return any(plant[k] < NECK_SHARE * float(np.median(plant[k + gap : k + reach])) for k in range(first, last))


def _back_from_end(line: FloatArray, px_per_cm: float, most_cm: float) -> tuple[FloatArray, FloatArray]:
    """Places along a line in even steps back from its end, shape (m, 2), and how far from it they are, px."""
    s = arc_length(line)
    from_end = px_per_cm * np.arange(0.0, min(most_cm, float(s[-1]) / px_per_cm), STEP_CM)
    return places_along(line, s, s[-1] - from_end), from_end
