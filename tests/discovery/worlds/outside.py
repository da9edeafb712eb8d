"""Effects that are not in the catalogue: nothing there describes them, and a finder ought to say so.

Each has its parameters in its docstring; strengths are such that a person sees the difference in the tip's path.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from . import kernel
from .effects import Effect, Parameters, sign
from .scene import Scene


def _uniform(**ranges: tuple[float, float]):
    def draw(rng: np.random.Generator) -> Parameters:
        return {name: float(rng.uniform(low, high)) for name, (low, high) in ranges.items()}

    return draw


def _draw_wall(rng: np.random.Generator) -> Parameters:
    return {"x_cm": sign(rng) * float(rng.uniform(1.0, 3.0))}


def _wall(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    """An upright wall at ``x_cm`` that the stem cannot pass."""
    scene.events.wall_x_cm = p["x_cm"]


def _growth_stop(scene: Scene, p: Mapping[str, float], rng: np.random.Generator) -> None:
    """From about ``time_h`` on, a few hours earlier or later by plant, the stem neither elongates nor bends much."""
    after = scene.hour_h > p["time_h"] + rng.normal(0.0, 3.0)
    scene.scale_series(kernel.GROWTH, np.where(after, 0.0, 1.0))
    scene.scale_series(kernel.BENDING, np.where(after, 0.3, 1.0))


def _gain_rhythm(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    """The response to light follows the day: 1 + ``amplitude`` cos(2 pi (hour - ``peak_h``) / 24)."""
    turn = np.cos(2.0 * math.pi * (scene.hour_h - p["peak_h"]) / 24.0)
    scene.scale_series(kernel.GAIN, np.maximum(0.0, 1.0 + p["amplitude"] * turn))


def _slow_near_lamp(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    """The response to light falls to half where the tip is ``half_cm`` off the middle."""
    scene.events.shy_cm = p["half_cm"]


def _draw_kick(rng: np.random.Generator) -> Parameters:
    return {"time_h": float(rng.uniform(15.0, 55.0)), "bend_per_cm": sign(rng) * float(rng.uniform(0.05, 0.1))}


def _kick(scene: Scene, p: Mapping[str, float], rng: np.random.Generator) -> None:
    """A hand bends the upper 12 cm by ``bend_per_cm`` at about ``time_h``."""
    scene.events.kick_h = float(np.clip(p["time_h"] + rng.normal(0.0, 2.0), 1.0, scene.hours - 1.0))
    scene.events.kick_per_cm = p["bend_per_cm"]


def _draw_shadow(rng: np.random.Generator) -> Parameters:
    return {
        "side": sign(rng),
        "from_h": float(rng.uniform(0.0, 24.0)),
        "for_h": float(rng.uniform(5.0, 10.0)),
        "left_over": float(rng.uniform(0.0, 0.25)),
    }


def _shadow(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    """Each day for ``for_h`` hours something stands before the lamp of one ``side`` (-1 left, 1 right)."""
    inside = (scene.hour_h - p["from_h"]) % 24.0 < p["for_h"]
    column = kernel.RIGHT if p["side"] > 0.0 else kernel.LEFT
    scene.scale_series(column, np.where(inside, p["left_over"], 1.0))


def _tip_broken(scene: Scene, p: Mapping[str, float], rng: np.random.Generator) -> None:
    """From about ``time_h`` on the plant has a third to a half of its growth and of its zone."""
    after = scene.hour_h > p["time_h"] + rng.normal(0.0, 3.0)
    scene.scale_series(kernel.GROWTH, np.where(after, p["growth_left"], 1.0))
    scene.scale_series(kernel.ZONE, np.where(after, p["zone_left"], 1.0))


def _draw_light_history(rng: np.random.Generator) -> Parameters:
    return {"per_side": sign(rng) * float(rng.uniform(0.5, 0.9)), "memory_h": float(rng.uniform(3.0, 9.0))}


def _light_history(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    """Growth depends on which lamp shone in the last ``memory_h`` hours: 1 + ``per_side`` for the right, - the left."""
    scene.events.history, scene.events.history_h = p["per_side"], p["memory_h"]


def _draw_bursts(rng: np.random.Generator) -> Parameters:
    return {"period_h": float(rng.uniform(4.5, 9.0)), "share": float(rng.uniform(0.25, 0.4))}


def _growth_bursts(scene: Scene, p: Mapping[str, float], rng: np.random.Generator) -> None:
    """Growth and bending come in bursts that fill a ``share`` of each ``period_h``; phase by run."""
    on = ((scene.hour_h / p["period_h"] + rng.random()) % 1.0) < p["share"]
    scene.scale_series(kernel.GROWTH, np.where(on, 1.0 / p["share"], 0.0))
    scene.scale_series(kernel.BENDING, np.where(on, 0.7 / p["share"], 0.3))


OUTSIDE: dict[str, Effect] = {
    "wall": Effect(_draw_wall, _wall),
    "growth_stop": Effect(_uniform(time_h=(20.0, 45.0)), _growth_stop),
    "gain_rhythm": Effect(_uniform(amplitude=(0.5, 0.9), peak_h=(0.0, 24.0)), _gain_rhythm),
    "slow_near_lamp": Effect(_uniform(half_cm=(1.5, 3.5)), _slow_near_lamp),
    "kick": Effect(_draw_kick, _kick),
    "shadow": Effect(_draw_shadow, _shadow),
    "tip_broken": Effect(_uniform(time_h=(18.0, 45.0), growth_left=(0.3, 0.55), zone_left=(0.5, 0.7)), _tip_broken),
    "light_history": Effect(_draw_light_history, _light_history),
    "growth_bursts": Effect(_draw_bursts, _growth_bursts),
}


def _draw_rhythm(rng: np.random.Generator) -> Parameters:
    of = RHYTHMIC[int(rng.integers(len(RHYTHMIC)))]
    period_h = float(np.exp(rng.uniform(math.log(3.5), math.log(16.0))))
    return {
        f"{of}_amplitude": float(rng.uniform(0.02, 0.05) if of == "bias" else rng.uniform(0.4, 0.9)),
        "period_h": period_h,
        "peak_h": float(rng.uniform(0.0, period_h)),
        "in_step": float(rng.random() < 0.5),
    }


def _rhythm(scene: Scene, p: Mapping[str, float], rng: np.random.Generator) -> None:
    """Growth, alone or with all bending (``activity``), the response to light, or a push (1/(cm h)) has a rhythm.

    Highest ``peak_h`` after the start in all runs where these are ``in_step``; else each run has its own time.
    """
    peak_h = p["peak_h"] if p["in_step"] else rng.uniform(0.0, p["period_h"])
    turn = np.cos(2.0 * math.pi * (scene.hour_h - peak_h) / p["period_h"])
    if "bias_amplitude" in p:
        scene.series[:, kernel.DRIVE_X] += p["bias_amplitude"] * turn
    elif "gain_amplitude" in p:
        scene.scale_series(kernel.GAIN, 1.0 + p["gain_amplitude"] * turn)
    elif "growth_amplitude" in p:
        scene.scale_series(kernel.GROWTH, 1.0 + p["growth_amplitude"] * turn)
    else:
        for column in (kernel.GROWTH, kernel.BENDING):
            scene.scale_series(column, 1.0 + p["activity_amplitude"] * turn)


RHYTHMIC = "growth", "activity", "gain", "bias"
"""What a rhythm may be of; its amplitude is a parameter of that name."""
ON_REQUEST: dict[str, Effect] = {"rhythm": Effect(_draw_rhythm, _rhythm)}
"""Drawn only where they are named: cases that were drawn before there were these stay what they were."""
