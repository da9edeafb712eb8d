"""In what the form of the mechanistic law may be another than :mod:`flora_lab.simulator.tropism` writes it."""

from __future__ import annotations

from typing import Final, NamedTuple


class Form(NamedTuple):
    """Each 0 where the law is as it is written.

    Attributes:
        brightness_more: power of its brightness, about that of one lamp at the anchor, by which the pull of light rises
            beyond the logarithm; in first order.
        lean_more: by how much gravity's pull rises beyond the sine: 1 + this times (sin^2 - 1/4), so that both are the
            same at 30 degrees.
        edge_more: logarithm of how much wider the edge of mature tissue is.
        spurt_more: by how much faster the stem grows half way between its early and late length than a straight line
            between both rates.
        side_alone: share of a pull that is the same whatever way the stem points: which side the light comes from
            counts, not how steeply it falls on the stem.
        even_light: share of the light that is everywhere as it is at the anchor, as if lamps were far away.
        apical: share of light's pull that is everywhere as it is at the apex, which alone senses it.
        by_age: power of the rate of growth, about the mean of the early and the late one, with which the zones lengthen
            in which tissue grows, is soft, and is not mature: with 1 it leaves them at an age, wherever it has come to.
        signal_h_per_cm: how long what the apex senses is under way to the tissue below it, at most six hours.
        by_hours: share in which the rate of growth follows the hours since the start, and not the stem's length.
    """

    brightness_more: float
    lean_more: float
    edge_more: float
    spurt_more: float
    side_alone: float
    even_light: float
    apical: float
    by_age: float
    by_hours: float
    signal_h_per_cm: float


AS_WRITTEN: Final = Form(*(0.0 for _ in Form._fields))
