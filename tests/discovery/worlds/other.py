"""Form 1: other physics, drawn anew for each case, with movements of about the same size.

- Stiffening: activity falls with the distance from the tip exponentially, with its third power, or as a straight ramp;
  the e-fold of the measured stiffness is 5.0 cm (3.5-6.3; Ohad et al. data, 54 plants).
- Elongation has a hump below the tip and saturates with length; it may thin out the curvature.
- Three dimensions: lamps hang behind the plant, the stem may be twisted, its noise has a part in depth, and a camera at
  70-80 cm sees it in perspective.
- The response to light saturates or is logarithmic (Weber-Fechner), light falls with the square of the distance,
  and gravity may be felt as a saturating function of the lean.
- Noise: see :mod:`individuals`.
"""

from __future__ import annotations

import numpy as np

from . import kernel
from .scene import Laws, Plant

BENDING_ZONE_CM = {kernel.EXPONENTIAL: 4.6, kernel.POWER: 4.2, kernel.RAMP: 10.0}
"""The law's own length for which the whole zone turns the tip about as far as 6 cm of even bending."""


def laws_and_plant(rng: np.random.Generator) -> tuple[Laws, Plant]:
    """Laws and typical plant of one case."""
    stiffening = int(rng.choice([kernel.EXPONENTIAL, kernel.POWER, kernel.RAMP]))
    response = int(rng.choice([kernel.SATURATING, kernel.LOGARITHM]))
    laws = Laws(
        stiffening=stiffening,
        elongation=1,
        growth=1,
        response=response,
        fall=2.0,
        half=float(rng.uniform(0.7, 2.0)) if response == kernel.SATURATING else float(rng.uniform(0.1, 0.4)),
        pull=int(rng.integers(2)),
        dilution=int(rng.integers(2)),
        twist_per_cm=float(rng.normal(0.0, 0.015)),
        lamp_x_cm=float(rng.uniform(30.0, 38.0)),
        lamp_y_cm=float(rng.uniform(27.0, 33.0)),
        lamp_z_cm=float(rng.uniform(-8.0, 0.0)),
    )
    spread = np.exp(rng.normal(0.0, 0.1, 4))
    plant = Plant(
        bending_zone_cm=BENDING_ZONE_CM[stiffening] * float(spread[0]),
        photo_per_cm_h=0.30 * float(spread[1]),
        gravity_per_cm_h=0.27 * float(spread[2]),
        proprioception_per_h=0.9 * float(spread[3]),
        latency_h=float(rng.uniform(0.2, 0.35)),
    )
    return laws, plant
