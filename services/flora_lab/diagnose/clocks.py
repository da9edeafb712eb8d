"""What can be compared where a clock is off: nothing that a plant did under lamps of which the record does not tell.

A record that runs behind what the lamps did ends before what the plant still saw. One change of lamps after its end,
taken for none, is hundreds of times what happens by chance, and looks like anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from flora_lab.diagnose import search
from flora_lab.diagnose.hypothesis import Cause
from flora_lab.diagnose.joint import Found, Joint
from flora_lab.diagnose.scene import Scene
from flora_lab.effects.catalogue import BY_NAME

CLOCKS: Final = ("clock_offset", "clock_skew")
MARGIN_H: Final = 0.1
"""So much longer before the record's end nothing is compared: how far a clock is off is not known to the minute."""


def cut_to_known_lamps(joint: Joint, null: Found, least_nats: float) -> list[Scene] | None:
    """The runs up to where the record tells their lamps, by the clock for which most speaks.

    Args:
        joint: the runs.
        null: fitted without a cause.
        least_nats: with less evidence a clock is taken to be right.

    Returns:
        None where nothing is to be left out.
    """
    scenes = [run.scene for run in joint.runs]
    tried = [search.best_start(joint, null, Cause(BY_NAME[name])) for name in CLOCKS]
    fits = [search.fitted(joint, null, look) for look in tried if look.evidence - null.evidence >= least_nats]
    best = max(fits, key=lambda fit: fit.evidence, default=null)
    if best.evidence - null.evidence < least_nats:
        return None
    change = best.hypothesis.change(best.coordinates)
    cut = [scene.up_to(scene.lamps_known_until_h(change) - MARGIN_H) for scene in scenes]
    return None if all(one.size == scene.size for one, scene in zip(cut, scenes, strict=True)) else cut


def left_out(whole: Sequence[Scene], compared: Sequence[Scene]) -> list[str]:
    """What was cut, in a sentence for each run of which something was."""
    ends_h = [(one, _end_h(one), _end_h(other)) for one, other in zip(whole, compared, strict=True)]
    return [
        f"{one.run.name}: the plant's last {end_h - cut_h:.0f} h are not compared: a clock seems to be off, and the "
        "record of the lamps ends before what the plant saw then"
        for one, end_h, cut_h in ends_h
        if cut_h < end_h
    ]


def _end_h(scene: Scene) -> float:
    return float(scene.time_h[scene.window[-1]]) if scene.size else 0.0
