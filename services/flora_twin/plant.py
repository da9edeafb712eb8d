"""A bean stem as a growing rod in three dimensions.

Model, after Bastien et al. 2013 (graviception and proprioception) and 2015 ("A unified model of shoot tropism in
plants: photo-, gravi- and proprio-ception"), written for three dimensions with the curvature as a vector: with t the
unit tangent, d the distance from the tip and x_perp the part of x that is perpendicular to t,

    D(kappa)/Dt = w(d) * ( nu * S * light_perp + beta * up_perp - gamma * kappa + lambda * m(phi) + noise_perp )

- ``light`` is the direction of the light at that place, the sum over the lit lamps, each falling with the square of its
  distance; S is the logarithm of its brightness, 1 for one full lamp at the anchor; both lag behind the lamps.
- ``m(phi)`` turns round the stem once per period: circumnutation (Bastien and Meroz 2016).
- ``w(d) = exp(-d / stiffening_cm)``, ending smoothly at ``mature_cm``: tissue stiffens as the tip grows away from it
  and keeps the curvature that it had.
- Segments elongate in a zone of ``growth_zone_cm`` below the tip.

The stem is a chain of straight segments that carry their tangents. The bend of a joint turns everything above it, so
the angular velocity of a segment is the sum over the joints below: one cumulative sum, and mature joints stay as they
are to rounding. Segments that have grown long are split in two. Plants in a batch do not influence each other: a plant
alone and the same plant in a batch give the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from flora_common.arrays import FloatArray, IntArray
from flora_twin.box import BOX, Box
from flora_twin.parameters import NAMES, PlantParameters, draw_individual

State = dict[str, npt.NDArray[np.generic]]

STEP_S: Final = 100.0
"""The step that world and library use."""

NEW_SEGMENT_CM: Final = 0.2
LONG_SEGMENT_CM: Final = 0.4
LEAF_NODES_BELOW_TIP_CM: Final = (1.0, 0.12)
"""Where primary pair and first trifoliate sit at time 0; they are carried along by the elongation."""

_NOISE_BLOCK: Final = 512
_NOISE_CHANNELS: Final = 3
_H: Final = 3600.0
_GROUND: Final = np.array([0.0, 1.0, 0.0])


class Plants:
    """A batch of plants under the same box, each with its own constants, noise and light.

    Args:
        seeds: one per plant; process noise follows from the seed alone.
        parameters: one per plant; drawn from the seeds where missing.
        box: where the lamps are.
    """

    def __init__(
        self, seeds: Sequence[int], parameters: Sequence[PlantParameters] | None = None, box: Box = BOX
    ) -> None:
        chosen = [draw_individual(seed) for seed in seeds] if parameters is None else list(parameters)
        if not chosen or len(chosen) != len(seeds):
            raise ValueError(
                f"{len(seeds)} seeds and {len(chosen)} sets of parameters: one of each per plant is needed"
            )
        self.box = box
        self.seeds = np.array(seeds, dtype=np.int64)
        self.parameters = tuple(chosen)
        self._unpack()
        batch = len(chosen)
        self._length = np.zeros((batch, 0))
        self._tangent = np.zeros((3, batch, 0))
        rows = [int(np.ceil(p.initial_length_cm / NEW_SEGMENT_CM)) for p in chosen]
        self._widen(max(rows))
        for i, (p, count) in enumerate(zip(chosen, rows, strict=True)):
            self._length[i, :count] = p.initial_length_cm / count
            # The seedling leaves the soil upright and leans more and more: the lean is a gentle arc.
            angle = p.initial_lean_rad * np.minimum(1.0, (np.arange(self._length.shape[1]) + 1) / count)
            self._tangent[0, i], self._tangent[1, i] = np.sin(angle), np.cos(angle)
        self._nodes = np.array([[p.initial_length_cm - d for d in LEAF_NODES_BELOW_TIP_CM] for p in chosen])
        self._seen = np.zeros((2, 2, batch))
        self._drift = np.zeros((_NOISE_CHANNELS, batch))
        self._phase = self._p["nutation_phase_rad"].copy()
        self._cycle = np.zeros(batch, dtype=np.int64)
        self._steps = 0
        self.time_s = 0.0
        self._fill_caches()

    # What the plants look like

    @property
    def batch(self) -> int:
        return len(self.seeds)

    @property
    def length_cm(self) -> FloatArray:
        """Stem length along the stem, shape (batch,)."""
        total: FloatArray = self._length.cumsum(axis=1)[:, -1]
        return total

    @property
    def segments(self) -> IntArray:
        """Number of segments in use, shape (batch,)."""
        return np.asarray((self._length > 0).sum(axis=1), dtype=np.int64)

    @property
    def leaf_nodes_cm(self) -> FloatArray:
        """Distance along the stem from the anchor to the nodes of primary pair and trifoliate, shape (batch, 2)."""
        return self._nodes.copy()

    def centreline_cm(self) -> FloatArray:
        """Points of the stem's middle line, shape (batch, n, 3), anchor first, tip last.

        Plants with fewer segments than the longest repeat their tip.
        """
        line = np.zeros((self.batch, self._length.shape[1] + 1, 3))
        np.cumsum(np.moveaxis(self._tangent * self._length, 0, 2), axis=1, out=line[:, 1:])
        return line

    def line_cm(self, i: int) -> FloatArray:
        """Centreline of plant ``i`` without repeated points, shape (n, 3)."""
        return self.centreline_cm()[i, : self.segments[i] + 1]

    def tip_cm(self) -> FloatArray:
        """Tips, shape (batch, 3)."""
        return self.centreline_cm()[:, -1]

    # Growth and motion

    def step(self, light_left: npt.ArrayLike, light_right: npt.ArrayLike, dt_s: float = STEP_S) -> None:
        """Let ``dt_s`` seconds pass.

        Args:
            light_left: what the left lamp gives, 0 dark to 1 full; a number or shape (batch,).
            light_right: the same for the right lamp.
            dt_s: length of the step; at most 300 s keep the scheme stable.
        """
        if not 0.0 < dt_s <= 300.0:
            raise ValueError(f"a step of {dt_s} s is outside (0, 300] s")
        p, length, tangent = self._p, self._length, self._tangent
        dt_h = dt_s / _H
        noise = self._next_noise()
        self._drift *= np.exp(-dt_h / self._memory_h)
        self._drift += np.sqrt(-np.expm1(-2.0 * dt_h / self._memory_h)) * noise
        self._turn_phase(dt_s)
        seen = self._see(light_left, light_right, dt_s)

        arc = length.cumsum(axis=1)
        total = arc[:, -1]
        joint_below_tip = total[:, None] - arc + length

        # The joint's stimuli: light at its place, gravity, the turning bias, slow wander.
        stimulus = self._light(np.cumsum(tangent * length, axis=2), seen)
        bias = p["nutation_per_cm_h"] * (total / 20.0) ** p["nutation_exponent"]
        stimulus += bias[:, None] * self._turning_direction()
        stimulus[0] += (p["wander_per_cm_h"] * self._drift[0])[:, None]
        stimulus[1] += p["graviception_per_cm_h"][:, None]
        stimulus[2] += (p["wander_per_cm_h"] * self._drift[1])[:, None]

        reach = length.copy()  # the length of stem that bends in a joint: half of each neighbour
        reach[:, 1:] = 0.5 * (length[:, 1:] + length[:, :-1])
        soft = np.exp(-joint_below_tip / p["stiffening_cm"][:, None])
        soft /= 1.0 + np.exp(np.minimum((joint_below_tip - p["mature_cm"][:, None]) / 0.8, 60.0))
        bend = np.diff(tangent, axis=2, prepend=_GROUND[:, None, None] * np.ones((1, self.batch, 1)))
        bend *= -p["proprioception_per_h"][:, None]
        bend += reach * stimulus
        bend *= soft * dt_h
        # t x bend drops what lies along t by itself: only the perpendicular part turns the stem.
        self._tangent = _rotated(tangent, np.cumsum(_cross(tangent, bend), axis=2))
        self._elongate(arc, total, joint_below_tip - 0.5 * length, dt_h)
        self.time_s += dt_s
        self._steps += 1
        if self._length.max() > LONG_SEGMENT_CM:
            self._split()

    def growth_cm_per_day(self) -> FloatArray:
        """Elongation of the whole stem just now, shape (batch,)."""
        p, length = self._p, self.length_cm
        early, late = p["growth_early_cm_per_day"], p["growth_late_cm_per_day"]
        rate = early + (late - early) * np.clip((length - 6.5) / 15.5, -0.5, 1.0)
        rhythm = 1.0 + p["growth_rhythm"] * np.sin(2 * np.pi * self.time_s / 86_400.0 + p["growth_rhythm_phase_rad"])
        left = np.maximum(0.0, 1.0 - (length / p["final_length_cm"]) ** 4)
        rate = rate * rhythm * left * np.maximum(0.0, 1.0 + p["growth_noise"] * self._drift[2])
        return np.asarray(rate, dtype=np.float64)

    def _elongate(self, arc: FloatArray, total: FloatArray, below_tip: FloatArray, dt_h: float) -> None:
        zone = self._p["growth_zone_cm"][:, None]
        share = self._length / (1.0 + np.exp(np.minimum((below_tip - zone) / 0.5, 60.0)))
        added = share.cumsum(axis=1)
        new_cm = self.growth_cm_per_day() * dt_h / 24.0
        scale = new_cm / added[:, -1]
        for i in range(self.batch):
            at = np.minimum(self._nodes[i], total[i])
            self._nodes[i] = at + np.interp(at, arc[i], added[i]) * scale[i]
        self._length = self._length + share * scale[:, None]

    def _see(self, light_left: npt.ArrayLike, light_right: npt.ArrayLike, dt_s: float) -> FloatArray:
        """Two stages of delay between lamp and response; returns light that acts now, shape (2, batch).

        The delay lies behind the logarithm of brightness: before it, the first trace of light would act at once.
        """
        half = self._p["light_half"]
        full = np.log1p(1.0 / half)
        gain = -np.expm1(-dt_s / (30.0 * self._p["photo_latency_min"]))
        light = np.empty((2, self.batch))
        light[0], light[1] = light_left, light_right
        self._seen[0] += gain * (np.log1p(np.clip(light, 0.0, 4.0) / half) / full - self._seen[0])
        self._seen[1] += gain * (self._seen[0] - self._seen[1])
        return np.asarray(half * np.expm1(self._seen[1] * full), dtype=np.float64)

    def _light(self, place: FloatArray, seen: FloatArray) -> FloatArray:
        """nu * S * direction of the light at every segment, shape (3, batch, n)."""
        field = np.zeros_like(place)
        for lamp, level in zip(self.box.lamps_cm, seen, strict=True):
            if level.any():
                ray = lamp[:, None, None] - place
                r2 = np.maximum(_dot(ray, ray), 25.0)
                field += ray * ((self.box.reference_distance_cm**2 * level)[:, None] / (r2 * np.sqrt(r2)))
        size = np.sqrt(_dot(field, field))
        gain, half = self._p["photoception_per_cm_h"][:, None], self._p["light_half"][:, None]
        field *= gain / np.log1p(1.0 / half) * np.log1p(size / half) / np.maximum(size, 1e-12)
        return field

    def _turning_direction(self) -> FloatArray:
        """Unit vectors across the stem that turn with the phase, anticlockwise seen from above as beans do.

        The horizontal direction of the phase is carried onto the stem by the smallest rotation that takes the vertical
        to the tangent: no twist, and no special direction until the stem hangs straight down. Shape (3, batch, n).
        """
        tangent = self._tangent
        cos, sin = np.cos(self._phase)[:, None], -np.sin(self._phase)[:, None]
        along = (cos * tangent[0] + sin * tangent[2]) / np.maximum(1.0 + tangent[1], 1e-3)
        out: FloatArray = -along * (tangent + _GROUND[:, None, None])
        out[0] += cos
        out[2] += sin
        return out

    def _turn_phase(self, dt_s: float) -> None:
        self._phase += 2 * np.pi * dt_s / (60.0 * self._p["nutation_period_min"] * self._stretch)
        if (self._phase >= self._next_turn).any():
            for i in np.nonzero(self._phase >= self._next_turn)[0]:
                self._cycle[i] += 1
                self._start_cycle(int(i))

    # Noise: a function of seed and count alone, so that there is no generator state to keep

    def _next_noise(self) -> FloatArray:
        at = self._steps % _NOISE_BLOCK
        if at == 0:
            self._fill_noise()
        noise: FloatArray = self._noise[:, :, at]
        return noise

    def _fill_noise(self) -> None:
        block = self._steps // _NOISE_BLOCK
        draws = [
            np.random.default_rng([int(s), 2, block]).standard_normal((_NOISE_CHANNELS, _NOISE_BLOCK))
            for s in self.seeds
        ]
        self._noise = np.stack(draws, axis=1)

    def _start_cycle(self, i: int) -> None:
        draw = np.random.default_rng([int(self.seeds[i]), 3, int(self._cycle[i])]).standard_normal()
        self._stretch[i] = max(0.5, 1.0 + self.parameters[i].nutation_jitter * float(draw))
        self._next_turn[i] = self.parameters[i].nutation_phase_rad + 2 * np.pi * (self._cycle[i] + 1)

    def _fill_caches(self) -> None:
        self._fill_noise()
        self._stretch, self._next_turn = np.ones(self.batch), np.zeros(self.batch)
        for i in range(self.batch):
            self._start_cycle(i)

    def _unpack(self) -> None:
        table = np.stack([p.as_array() for p in self.parameters])
        self._p = {name: table[:, i].copy() for i, name in enumerate(NAMES)}
        self._memory_h = np.stack([self._p["wander_h"], self._p["wander_h"], self._p["growth_noise_h"]])

    # Segments

    def _widen(self, columns: int) -> None:
        """More columns, of length zero at the tip: they carry the last tangent and change nothing."""
        have = self._length.shape[1]
        if columns > have:
            extra = columns + 12 - have
            self._length = np.pad(self._length, ((0, 0), (0, extra)))
            mode = "edge" if have else "constant"
            self._tangent = np.pad(self._tangent, ((0, 0), (0, 0), (0, extra)), mode=mode)  # type: ignore[call-overload]

    def _split(self) -> None:
        """Segments that have grown long become two of half the length and the same direction."""
        used = (self._length > 0).sum(axis=1)
        self._widen(int((used + (self._length > LONG_SEGMENT_CM).sum(axis=1)).max()))
        times = np.where(self._length > LONG_SEGMENT_CM, 2, 1)
        columns = self._length.shape[1]
        for i in np.nonzero((times == 2).any(axis=1))[0]:
            index = np.repeat(np.arange(columns), times[i])[:columns]  # what falls off the end has length zero
            self._length[i] = self._length[i, index] / times[i, index]
            self._tangent[:, i] = self._tangent[:, i, index]

    # State

    def state(self) -> State:
        """Everything that :meth:`from_state` needs to go on with the very same numbers."""
        return {
            "seeds": self.seeds.copy(),
            "parameters": np.stack([p.as_array() for p in self.parameters]),
            "length": self._length.copy(),
            "tangent": self._tangent.copy(),
            "nodes": self._nodes.copy(),
            "seen": self._seen.copy(),
            "drift": self._drift.copy(),
            "phase": self._phase.copy(),
            "cycle": self._cycle.copy(),
            "steps": np.array(self._steps),
            "time_s": np.array(self.time_s),
        }

    @classmethod
    def from_state(cls, state: State, box: Box = BOX) -> Plants:
        """The plants as they were when :meth:`state` was called.

        Raises:
            KeyError, ValueError: arrays are missing or do not fit each other.
        """
        table = np.asarray(state["parameters"], dtype=np.float64)
        seeds = [int(seed) for seed in np.asarray(state["seeds"])]
        plants = cls(seeds, [PlantParameters.from_array(row) for row in table], box)
        batch, columns = np.asarray(state["length"]).shape
        shapes = {
            "length": (plants.batch, columns),
            "tangent": (3, batch, columns),
            "nodes": (batch, 2),
            "seen": (2, 2, batch),
            "drift": (_NOISE_CHANNELS, batch),
            "phase": (batch,),
            "cycle": (batch,),
        }
        for name, shape in shapes.items():
            values = np.array(state[name], dtype=np.int64 if name == "cycle" else np.float64)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"plant state `{name}` has shape {values.shape}, not {shape}, or is not finite")
            setattr(plants, f"_{name}", values)
        plants._steps = int(state["steps"])
        plants.time_s = float(state["time_s"])
        plants._fill_caches()
        return plants


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], dtype=np.float64)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    out = np.empty_like(a)
    np.subtract(a[1] * b[2], a[2] * b[1], out=out[0])
    np.subtract(a[2] * b[0], a[0] * b[2], out=out[1])
    np.subtract(a[0] * b[1], a[1] * b[0], out=out[2])
    return out


def _rotated(t: FloatArray, turn: FloatArray) -> FloatArray:
    """Unit vectors t turned by the rotation vectors ``turn`` (Rodrigues), both of shape (3, batch, n)."""
    angle = np.sqrt(np.maximum(_dot(turn, turn), 1e-24))
    axis = turn / angle
    cosine = np.cos(angle)
    out = cosine * t + np.sin(angle) * _cross(axis, t) + ((1.0 - cosine) * _dot(axis, t)) * axis
    out /= np.sqrt(_dot(out, out))
    return out
