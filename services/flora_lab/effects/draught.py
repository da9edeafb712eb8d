"""Something pushes the stem to one side all the time."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms

LATE_CM: Final = 12.0
"""Distance from the tip within which the softness of a stem that stiffens late falls e-fold."""


def turning(change: Change, v: Values) -> None:
    """A steady stimulus beside the others, whichever way the stem points."""
    change.terms[terms.PUSH] += v["drive_per_cm_h"]


def pushing(change: Change, v: Values) -> None:
    """A push from one side: what of it is across the stem acts."""
    change.terms[terms.SIDEWAYS] += v["drive_per_cm_h"]


def blowing(change: Change, v: Values) -> None:
    """Wind bends the stem elastically, the more of it there is; what it stands in then is no growth."""
    change.terms[terms.WIND] += 0.03 * v["drive_per_cm_h"]


def bowing(change: Change, v: Values) -> None:
    """The same wind on a stem that stiffens late: it bows as a whole, where a soft tip alone grows against its bend."""
    change.terms[terms.WIND] += 0.006 * v["drive_per_cm_h"]
    if change.terms[terms.SAG] == 0.0:  # how soft a stem is that sags is told by that
        change.terms[terms.SOFTNESS_CM] = LATE_CM


def sentence(v: Values) -> str:
    """What it means."""
    side, size = "right" if v["drive_per_cm_h"] > 0 else "left", abs(v["drive_per_cm_h"])
    return f"something pushes the stem to the {side} all the time (strength {size:.3f} per cm and hour)"


FORMS: Final = (turning, pushing, blowing, bowing)
WINDS: Final = (FORMS.index(blowing), FORMS.index(bowing))
"""Those that bend stems elastically."""
EFFECT: Final = Effect(
    name="draught",
    title="Steady push to a side",
    where="plant",
    parameters=(
        Parameter(
            name="drive_per_cm_h",
            none=0.0,
            low=-0.3,
            high=0.3,
            scale="linear",
            meaning="curvature per hour of a steady push to the right; of wind that bends the stem elastically, "
            "0.03 per cm^3 of softness at the tip (0.006 where it stiffens late)",
            source="a fan, a window, a leaning pot",
            starts=(-0.1, 0.1),
            least=0.003,
        ),
    ),
    forms=FORMS,
    sentence=sentence,
    first_needs=2.5,
    same_as={
        "lamp_asymmetry": "a day in the dark or under both lamps, or the pot turned round",
        "camera_roll": "a plumb line in the picture",
    },
)
