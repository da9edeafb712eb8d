"""One track judged: the swing, its cycles, and what this track cannot tell, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from flora_common.arrays import Array
from flora_lab.rhythm.cycles import Cycles, analytic, cycles
from flora_lab.rhythm.lattice import LEAST_CYCLES, LEAST_PER_CYCLE
from flora_lab.rhythm.search import LEVEL, Found, find
from flora_lab.rhythm.tip_track import TipTrack

Along = Literal["x", "y"]

LAMPS_SWING: Final = 0.35
"""Share of the lamps' own alternation in the band of the swing, as an amplitude of at most 1, that is told."""
SHORT_SAMPLES: Final = 40.0
"""Of a cycle: the shoulder of a track that was smoothed over some steps looks like swings as short as that."""
SHORTEST_STEP_S: Final = 1.0
"""Between photographs of a growing plant; what is shorter is told."""
_AGREES: Final = 0.1
_EDGE: Final = 1.1
_FEW_CYCLES: Final = 6.0


@dataclass(frozen=True, slots=True)
class Rhythm:
    """What was found in a track.

    Attributes:
        track: which.
        along: the coordinate that was searched.
        found: the best swing, a real one or not.
        cycles: in its band.
        lamps_amplitude: of the lamps' alternation in the band: 0 for none, about 1.27 for lamps that change with the
            swing; None where no lamps are told.
        other_period: of the best swing of the other coordinate, in ``track.time_unit``; None where that has none.
    """

    track: TipTrack
    along: Along
    found: Found
    cycles: Cycles
    lamps_amplitude: float | None
    other_period: float | None

    @property
    def swings(self) -> bool:
        """Whether a swing is claimed."""
        return self.found.p <= LEVEL

    @property
    def values(self) -> Array:
        """What was searched, shape (n,)."""
        return self.track.x if self.along == "x" else self.track.y

    @property
    def period(self) -> float:
        """In ``track.time_unit``."""
        return self.track.step / self.found.per_sample

    @property
    def period_interval(self) -> tuple[float, float]:
        """Of 90 %."""
        return self.track.step / self.found.high_per_sample, self.track.step / self.found.low_per_sample

    @property
    def searched(self) -> tuple[float, float]:
        """Shortest and longest period, in ``track.time_unit``."""
        return LEAST_PER_CYCLE * self.track.step, len(self.track.x) * self.track.step / LEAST_CYCLES

    @property
    def cycles_in_record(self) -> float:
        """How many of them the record holds."""
        return len(self.track.x) * self.found.per_sample


def judge(track: TipTrack, *, along: Along = "x", seed: int = 1) -> Rhythm:
    """Search one track.

    Args:
        track: which.
        along: coordinate to search; the other one is looked at only where this one swings.
        seed: of all that is drawn.
    """
    values, other = (track.x, track.y) if along == "x" else (track.y, track.x)
    found = find(values, known=track.known, seed=seed)
    lamps = None
    if track.right_share is not None:
        lamps = float(np.sqrt(np.mean(np.abs(analytic(track.right_share, found.per_sample)) ** 2)))
    other_period = None
    if found.p <= LEVEL and np.ptp(other) > 0.0:
        beside = find(other, known=track.known, seed=seed)
        other_period = track.step / beside.per_sample if beside.p <= LEVEL else None
    return Rhythm(
        track=track,
        along=along,
        found=found,
        cycles=cycles(values, track.known, found, seed=seed),
        lamps_amplitude=lamps,
        other_period=other_period,
    )


def said(rhythm: Rhythm) -> list[str]:
    """What was found, a sentence each."""
    track, unit = rhythm.track, rhythm.track.time_unit
    low, high = rhythm.searched
    if not rhythm.swings:
        return [
            f"no swing of {low:.3g} to {high:.3g} {unit} that noise of this kind would not also show "
            f"(p = {rhythm.found.p:.3g}); smaller or less regular ones may be there"
        ]
    first, last = rhythm.period_interval
    band = rhythm.cycles
    lines = [
        f"the tip swings along {rhythm.along} every {rhythm.period:.3g} {unit} ({first:.3g} to {last:.3g}), "
        f"p = {rhythm.found.p:.3g}",
        f"{band.amplitude:.2g} {track.unit} to each side ({band.amplitude_interval[0]:.2g} to "
        f"{band.amplitude_interval[1]:.2g}), as the root mean square over the record",
    ]
    clear = band.clear_periods * track.step
    if len(clear):
        listed = ", ".join(f"{value:.3g}" for value in clear[:12]) + (", …" if len(clear) > 12 else "")
        scatter = f"; scatter {band.scatter * track.step:.2g}" if len(clear) > 1 else ""
        lines.append(f"clear cycles, {unit}: {listed}{scatter}")
    if band.growth_interval[0] > 1.0:
        lines.append(f"it grows: {_factor(band.growth_per_cycle)} times as far from one cycle to the next")
    elif band.growth_interval[1] < 1.0:
        lines.append(f"it dies away: {_factor(band.growth_per_cycle)} times as far from one cycle to the next")
    if rhythm.other_period is not None:
        lines.append(_beside(rhythm, rhythm.other_period))
    return lines


def _factor(value: float) -> str:
    """With as many digits as tell it from 1: over a hundred short cycles a little more each time is much."""
    return next((text for digits in range(2, 7) if (text := f"{value:.{digits}g}") != "1"), "1.00000")


def _beside(rhythm: Rhythm, period: float) -> str:
    other = "y" if rhythm.along == "x" else "x"
    text = f"along {other} it swings every {period:.3g} {rhythm.track.time_unit}"
    if abs(np.log(2.0 * period / rhythm.period)) < _AGREES:
        return f"{text}: half as long, as of a stem that bends to one side and the other"
    if abs(np.log(period / rhythm.period)) < _AGREES:
        return f"{text}: the same, as of a tip that goes round or along a slope"
    return f"{text}: another rhythm, or another cause"


def cannot_tell(rhythm: Rhythm) -> list[str]:
    """What this track leaves open, a sentence each, the gravest first."""
    track = rhythm.track
    lines = []
    if rhythm.lamps_amplitude is not None and rhythm.lamps_amplitude > LAMPS_SWING and rhythm.swings:
        lines.append("whether the plant swings by itself: the lamps alternate with this period too")
    elif track.right_share is None:
        lines.append("whether lamps, air or warmth make it swing: nothing is known of them")
    lines.append("a swing of the camera or the pot from one of the plant: nothing that stands still is in the track")
    lines.append("growth, stiffening, and answers to light or weight: they need the whole stem and the light")
    step_s = round(track.step * 3600.0, 6) if track.time_unit == "h" else SHORTEST_STEP_S
    if step_s < SHORTEST_STEP_S:
        lines.append(f"whether its times are seconds: they are {step_s:.3g} s apart, as hours that nobody converted")
    if track.time_unit == "frames":
        lines.append("hours: the time between two frames is not known; give it with --step-s")
    if track.unit == "px":
        lines.append("how far in cm: the scale is not known; give it with --px-per-cm")
    elif track.is_scale_doubtful:
        lines.append("how far in cm to better than the ruler in the film: the scale is the file's own")
    lines.append("the way round: one camera sees two of three directions")
    if rhythm.swings and rhythm.cycles_in_record < _FEW_CYCLES:
        lines.append(f"whether it lasts: the record holds {rhythm.cycles_in_record:.1f} cycles")
    if rhythm.swings and _is_at_edge(rhythm):
        lines.append("the period: it is at the end of what this record can show")
    if rhythm.swings and rhythm.found.per_sample > 1.0 / SHORT_SAMPLES:
        lines.append("a swing from what smoothing leaves: if the track was smoothed, give it as measured")
    return lines


def _is_at_edge(rhythm: Rhythm) -> bool:
    low, high = rhythm.searched
    return rhythm.period < _EDGE * low or rhythm.period > high / _EDGE
