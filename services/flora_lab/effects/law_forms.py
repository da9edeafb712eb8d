"""In what the form of the law may be another than the plants': no causes, since nothing in a box changes them.

How steeply the pull of light rises with brightness, or that of gravity with the lean, is the same in healthy plants and
in those that something is wrong with. Reference runs tell it, once for all plants; in another light it then foretells
what else would look like an effect. Small differences are taken for errors of the law (:data:`FORMS`); which of two
laws it is where they differ much (:data:`LAWS`) is chosen as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def _form(name: str, title: str, term: int, most: float, source: str, unit: float = 1.0) -> Effect:
    amount = Parameter("amount", 0.0, -most, most, "linear", f"see {name.upper()} of flora_lab.simulator.terms", source)
    return Effect(name, title, "simulator", (amount,), (_adding(term, unit),), lambda _: title)


def _adding(term: int, unit: float) -> Callable[[Change, Values], None]:
    def add(change: Change, values: Values) -> None:
        change.terms[term] += unit * values["amount"]

    return add


NEARER: Final = _form(
    "nearer", "Long stems lean towards the camera", terms.NEARER, 0.12, "8 cm in depth seen from 70 cm"
)
SIDE_ALONE: Final = _form(
    "side_alone",
    "Which side the light comes from counts, not how steeply it falls on the stem",
    terms.SIDE_ALONE,
    1.0,
    "0: the sine of the angle between light and stem (Bastien et al. 2015); 1: a stimulus to one side",
)
EVEN_LIGHT: Final = _form(
    "even_light",
    "Light is everywhere as it is at the foot of the stem",
    terms.EVEN_LIGHT,
    1.0,
    "0: lamps where they hang; 1: lamps far away, or a plant that turns all of it up or down",
)
APICAL: Final = _form(
    "apical",
    "The apex alone senses light",
    terms.APICAL,
    1.0,
    "0: each place for itself (Bastien et al. 2015); 1: the apex for all below it, as of coleoptiles (Darwin 1880)",
)
SIGNAL: Final = _form(
    "signal",
    "What the apex senses reaches the tissue below it at 2.5 cm/h",
    terms.SIGNAL_H_PER_CM,
    2.0,
    "0: at once; 1: 2.5 cm/h, as auxin is transported (1 to 2 cm/h, Went and Thimann 1937; faster fronts since)",
    unit=0.4,
)
BY_AGE: Final = _form(
    "by_age",
    "Tissue grows, stiffens and matures by its age, not by its distance from the tip",
    terms.BY_AGE,
    1.0,
    "0: zones of a length that stays; 1: zones that a faster stem draws out (Silk and Erickson 1979)",
)
SPURT: Final = _form(
    "spurt",
    "Stems grow twice as fast half way as a straight line between their early and their late rate",
    terms.SPURT_MORE,
    1.0,
    "0: ever faster, then evenly; 1: an S-shaped course, as of organs whose growth ends (Richards 1959)",
)
BY_HOURS: Final = _form(
    "by_hours",
    "Growth follows the hours since the start, not the length of the stem",
    terms.BY_HOURS,
    1.0,
    "0: a stem's length tells how fast it grows; 1: its age does (growth curves over time, Richards 1959)",
)
Law: TypeAlias = tuple[tuple[Effect, ...], ...]
"""Forms in each of the three aspects of :data:`LAWS`."""
LAWS: Final[tuple[Law, ...]] = (
    ((), (SPURT,), (BY_HOURS,), (BY_HOURS, SPURT)),
    ((), (SIDE_ALONE,), (EVEN_LIGHT,), (APICAL,), (APICAL, SIGNAL), (SIDE_ALONE, EVEN_LIGHT)),
    ((), (BY_AGE,)),
)
"""What a law may be, simpler ones first and as it is written before all: when stems grow, how light is sensed, and how
tissue matures."""
AS_WRITTEN: Final[tuple[Law, ...]] = (((),),) * len(LAWS)
"""For who need not choose."""
FORMS: Final = (
    _form(
        "brightness_more",
        "Light pulls the more, the brighter it is",
        terms.BRIGHTNESS_MORE,
        0.8,
        "0: Weber-Fechner (Bastien et al. 2015); 1: in proportion to the light",
    ),
    _form(
        "lean_more",
        "Gravity pulls the more, the farther the stem leans",
        terms.LEAN_MORE,
        1.0,
        "0: the sine law (Sachs 1887; Bastien et al. 2013); below: a pull that saturates",
    ),
    _form(
        "edge_more",
        "Tissue matures gradually",
        terms.EDGE_MORE,
        1.6,
        "0: within 0.8 cm; stems stiffen e-fold in 3.5 to 6.3 cm (Ohad et al., 54 plants)",
    ),
    _form(
        "spurt_more",
        "Stems of middle length grow fastest",
        terms.SPURT_MORE,
        0.3,
        "0: straight between the early and the late rate",
    ),
    _form(
        "signal_more",
        "The signal of the apex is slower",
        terms.SIGNAL_H_PER_CM,
        0.3,
        "0: as the law says; stems in which each place senses light for itself send none",
    ),
    NEARER,
)
"""Each with one parameter, whose plausible range says how wide it is looked for."""
BY_NAME: Final[Mapping[str, Effect]] = {
    form.name: form for form in (*FORMS, SIDE_ALONE, EVEN_LIGHT, APICAL, SIGNAL, BY_AGE, SPURT, BY_HOURS)
}
