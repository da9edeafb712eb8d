"""All effects that have a name. A new one is a module with an ``EFFECT``, and its name here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from flora_lab.effects import (
    adaptation,
    camera_drift,
    camera_roll,
    camera_scale,
    circumnutation,
    clock_offset,
    clock_skew,
    diurnal_growth,
    draught,
    gravitropism,
    growth_rate,
    lamp_ageing,
    lamp_asymmetry,
    memory,
    phototropic_gain,
    phototropic_latency,
    proprioception,
    sag,
    stiffening,
    temperature_growth,
    time_scale,
)
from flora_lab.effects.effect import Effect

CATALOGUE: Final[tuple[Effect, ...]] = (
    circumnutation.EFFECT,
    phototropic_latency.EFFECT,
    adaptation.EFFECT,
    lamp_asymmetry.EFFECT,
    lamp_ageing.EFFECT,
    diurnal_growth.EFFECT,
    temperature_growth.EFFECT,
    growth_rate.EFFECT,
    stiffening.EFFECT,
    gravitropism.EFFECT,
    proprioception.EFFECT,
    phototropic_gain.EFFECT,
    sag.EFFECT,
    draught.EFFECT,
    camera_roll.EFFECT,
    camera_scale.EFFECT,
    camera_drift.EFFECT,
    clock_offset.EFFECT,
    clock_skew.EFFECT,
    time_scale.EFFECT,
    memory.EFFECT,
)

BY_NAME: Final[Mapping[str, Effect]] = {effect.name: effect for effect in CATALOGUE}
