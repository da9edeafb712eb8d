"""What one bean plant is like: the constants of its growth and motion, and how they differ between plants."""

from __future__ import annotations

from dataclasses import asdict, astuple, dataclass, fields, replace
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean


@dataclass(frozen=True, slots=True)
class PlantParameters:
    """Constants of :class:`flora_twin.plant.Plants`; each with its source.

    Rates of bending are curvature per time, 1/(cm h), of tissue at the tip; older tissue responds less (see
    ``stiffening_cm``). "Estimate" means chosen so that the whole plant does what the named source saw.
    """

    initial_length_cm: float = 6.5
    """Stem length at time 0. Wahby et al. 2018: first height of a run."""
    initial_lean_rad: float = 0.0
    """Lean of the seedling in the picture plane, positive to the right. Estimate."""
    growth_early_cm_per_day: float = 3.9
    """Elongation at ``initial_length_cm`` = 6.5. Checa et al. 2008 through Wahby et al. 2018: 3 cm/day on average."""
    growth_late_cm_per_day: float = 7.8
    """Elongation at 22 cm and above. Wahby et al. 2018: about 7 cm/day late, 21 cm after about 72 h."""
    final_length_cm: float = 60.0
    """Where elongation ends without a support to climb. Estimate."""
    growth_zone_cm: float = 6.0
    """Length of the zone below the tip that elongates. Estimate for bean stems, after Bastien et al. 2015 (L_gz)."""
    growth_rhythm: float = 0.08
    """Relative amplitude of the 24 h rhythm of elongation. Estimate; a 24 h rhythm is common."""
    growth_rhythm_phase_rad: float = 0.0
    growth_noise: float = 0.10
    """Standard deviation of the relative elongation rate, correlated over ``growth_noise_h``. Estimate."""
    growth_noise_h: float = 5.0
    stiffening_cm: float = 5.0
    """E-fold of stiffness with distance from the tip. Ohad et al. data, 54 plants: 5.0 cm (3.5-6.3)."""
    mature_cm: float = 13.0
    """Distance from the tip where tissue stops bending altogether (lignified). Estimate: the stem of Wahby et al. 2018
    keeps its curve for days."""
    photoception_per_cm_h: float = 0.31
    """nu, towards one full lamp at the anchor's distance. Estimate: lean and swing in Wahby et al. 2018."""
    graviception_per_cm_h: float = 0.26
    """beta. Estimate: between photo- and graviception neither wins, as in Bastien et al. 2015."""
    proprioception_per_h: float = 0.80
    """gamma. Estimate: beta * L_gz / gamma below 2.8, so that there is no overshoot (Bastien et al. 2018)."""
    light_half: float = 0.02
    """Light, relative to one full lamp, at which the logarithmic response to brightness sets in. Estimate."""
    photo_latency_min: float = 14.0
    """Mean delay between light and response. Arabidopsis, buckwheat: a few minutes to about 60 min."""
    nutation_period_min: float = 98.6
    """Period of circumnutation. Ohad et al. data, n = 103: 98.6 +- 12.8 min (74-155)."""
    nutation_jitter: float = 0.045
    """Relative standard deviation from cycle to cycle. The same data: 4.5 %."""
    nutation_per_cm_h: float = 0.15
    """Rotating bias at a stem length of 20 cm. Estimate: about 1 cm of tip radius there."""
    nutation_exponent: float = 2.5
    """Power of the stem's length with which the bias grows. Estimate: small in seedlings, much at 37 cm."""
    nutation_phase_rad: float = 0.0
    wander_per_cm_h: float = 0.02
    """Standard deviation of a slow random bias, correlated over ``wander_h``. Estimate."""
    wander_h: float = 3.0
    base_radius_cm: float = 0.175
    """Stem radius at the soil. Estimate: 3-4 mm thick."""
    tip_radius_cm: float = 0.10
    """Stem radius at the tip. Estimate: 2 mm thick."""
    leaf_scale: float = 1.0
    """Size of the leaves. Estimate."""
    leaf_azimuth_rad: float = 0.6
    """Direction of the first primary leaf round the stem, from +x towards the camera. Individual."""
    leaf_hue: float = 0.0
    """Colour, from yellowish (-1) to bluish green (1). Individual."""
    leaf_droop_rad: float = 0.35
    """How far grown blades hang below their petiole's end, at noon of the plant's own day. Estimate, individual."""
    leaf_sleep_rad: float = 0.25
    """Amplitude of the blades' daily rise and fall. Bean leaves sink at night; amplitude an estimate."""
    leaf_turn_rad: float = 0.35
    """Turn of the trifoliate leaf from the right angle to the primary pair. Individual."""
    leaf_gloss: float = 0.05
    """Share of light that the blades mirror. Estimate."""
    petiole_radius_cm: float = 0.085
    """Estimate: about as thick as the stem's upper end."""
    bud_scale: float = 1.0
    """Size of the folded leaflets round the tip. Estimate."""
    stem_red: float = 0.2
    """Anthocyanin at the stem's foot, from green (0) to reddish brown (1). Individual."""
    irregularity: float = 0.0
    """A whole number that fixes small differences of shape and colour between the leaves of one plant. Individual."""

    def with_values(self, **changes: float) -> PlantParameters:
        """The same plant with some constants changed.

        Raises:
            BadInput: a name that does not exist, or a value that is not a finite number.
        """
        for name, value in changes.items():
            if name not in NAMES:
                raise BadInput(f"plant parameter `{name}` does not exist{did_you_mean(name, NAMES)}")
            if not np.isfinite(value):
                raise BadInput(f"plant parameter `{name}` is {value}, not a finite number")
        return replace(self, **changes)

    def as_array(self) -> FloatArray:
        """All values in the order of :data:`NAMES`."""
        return np.array(astuple(self), dtype=np.float64)

    @staticmethod
    def from_array(values: FloatArray) -> PlantParameters:
        """Undo :meth:`as_array`."""
        return PlantParameters(**dict(zip(NAMES, (float(v) for v in values), strict=True)))


NAMES: Final = tuple(field.name for field in fields(PlantParameters))

SPREAD: Final = {
    "initial_length_cm": 0.05,
    "growth_early_cm_per_day": 0.10,
    "growth_late_cm_per_day": 0.10,
    "growth_zone_cm": 0.10,
    "stiffening_cm": 0.12,
    "mature_cm": 0.10,
    "photoception_per_cm_h": 0.13,
    "graviception_per_cm_h": 0.13,
    "proprioception_per_h": 0.12,
    "photo_latency_min": 0.30,
    "nutation_per_cm_h": 0.25,
    "base_radius_cm": 0.08,
    "tip_radius_cm": 0.08,
    "leaf_scale": 0.12,
}
"""Relative standard deviation between plants (log-normal). 10-15 % is an estimate; latency and nutation vary more."""

NUTATION_PERIOD_SD_MIN: Final = 12.8
NUTATION_PERIOD_RANGE_MIN: Final = (74.0, 155.0)


def draw_individual(seed: int, mean: PlantParameters | None = None) -> PlantParameters:
    """The constants of one plant: no two seeds give the same plant.

    Args:
        seed: any integer from 0.
        mean: what the plants have in common; the default is :class:`PlantParameters` as it stands.

    Returns:
        Rates log-normal about the mean (:data:`SPREAD`), the nutation period normal within its measured range, phases
        and the leaves' direction uniform; looks of stem and leaves mostly uniform within ranges of their own.
    """
    base = PlantParameters() if mean is None else mean
    rng = np.random.default_rng([seed, 1])
    values = asdict(base)
    vigour = rng.standard_normal()
    for name, spread in SPREAD.items():
        draw = rng.standard_normal()
        if name.startswith("growth_") and name.endswith("per_day"):
            draw = 0.8 * vigour + 0.6 * draw  # a plant that is fast early tends to be fast late
        values[name] *= float(np.exp(spread * np.clip(draw, -2.2, 2.2)))
    low, high = NUTATION_PERIOD_RANGE_MIN
    values["nutation_period_min"] = float(
        np.clip(base.nutation_period_min + NUTATION_PERIOD_SD_MIN * rng.standard_normal(), low, high)
    )
    values["initial_lean_rad"] = float(base.initial_lean_rad + 0.06 * rng.standard_normal())
    values["nutation_phase_rad"] = float(rng.uniform(0.0, 2 * np.pi))
    values["growth_rhythm_phase_rad"] = float(rng.uniform(0.0, 2 * np.pi))
    values["leaf_azimuth_rad"] = float(rng.uniform(0.0, 2 * np.pi))
    values["leaf_hue"] = float(rng.uniform(-1.0, 1.0))
    # Looks are drawn last, so that growth and motion of a seed stay what they were before looks were drawn.
    values["leaf_droop_rad"] = float(rng.uniform(0.10, 0.75))
    values["leaf_sleep_rad"] = float(rng.uniform(0.10, 0.40))
    values["leaf_turn_rad"] = float(rng.uniform(-0.7, 0.7))
    values["leaf_gloss"] = float(rng.uniform(0.01, 0.09))
    values["petiole_radius_cm"] = float(base.petiole_radius_cm * np.exp(0.12 * rng.standard_normal()))
    values["bud_scale"] = float(rng.uniform(0.75, 1.35))
    values["stem_red"] = float(rng.uniform(0.0, 1.0) ** 2)
    values["irregularity"] = float(rng.integers(0, 2**20))
    return PlantParameters(**values)
