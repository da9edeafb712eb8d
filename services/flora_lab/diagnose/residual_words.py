"""Residuals in sentences that need no statistics to be read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import residual_statistics as statistics
from flora_lab.diagnose.replayed import PLANTS, Plant, Replayed
from flora_lab.diagnose.residual_statistics import SIDES, Comparison, Group, rms
from flora_lab.diagnose.rhythm import PERIODS_H, PLAUSIBLE_H, amplitude_of, spectrum

_SINCE_WORDS: Final = (
    "in the first hour after a switch",
    "from one to three hours after a switch",
    "from three to six hours after a switch",
    "more than six hours after a switch",
)
_MAINLY: Final = 1.35
"""A time is named if its residual is so many times the mean over all times."""
_GROWS: Final = 1.7
_FLAT: Final = 0.6
_OWN_PERIOD: Final = 50.0
"""A swing has a period of its own where it is so many times as strong as the median over all periods: in drawn runs
without one the strongest was 23 times as strong at most, in those with one 130 times and more."""
_LEAST_POWER: Final = 1e-9
"""mm^2 h: of a tip that moves by less nothing is told."""
_LINE_SHARE: Final = 0.15
"""How far from its frequency a swing's power may lie, as a share of it: its phase drifts."""
RARE: Final = 0.002
"""Chance that needs no words besides: where nothing is wrong with hundreds of sets of runs, none shows as much."""
_STORIES: Final[tuple[tuple[Group, ...], ...]] = (("sideways", "lean"), ("growth",), ("height",), ("swing",))
"""Groups of numbers that one sentence tells."""


@dataclass(frozen=True, slots=True)
class Looks:
    """What there is to put into words.

    Attributes:
        numbers: of the measured runs, by simulated plant, shape (runs, k).
        reference: of the reference runs.
        compared: both beside each other, the typical ones first.
        p_value: altogether.
        p_by_fit: by the misfit alone.
    """

    numbers: dict[Plant, Array]
    reference: dict[Plant, Array]
    compared: Comparison
    p_value: float
    p_by_fit: float

    @property
    def clearer_plant(self) -> Plant:
        """Constants of their own can absorb an effect; where they do not, they let it be seen more clearly."""
        most = np.nan_to_num(np.abs(self.compared.away)).reshape(len(PLANTS), -1).max(axis=1)
        return PLANTS[int(np.argmax(most))]


def description(looks: Looks, runs: Sequence[Replayed], is_significant: bool) -> str:
    """A few sentences: how large, what it looks like, and whether it is more than chance."""
    sentences = [_size(looks, runs)]
    sentences.extend(_pattern(looks, runs, is_significant))
    sentences.append(_verdict(looks, is_significant))
    return " ".join(sentences)


def mm(value: float) -> str:
    """Millimetres as people read them."""
    return f"{value:.0f} mm" if abs(value) >= 9.5 else f"{value:.1f} mm"


def percent_sure(confidence: float) -> str:
    """A probability; of no cause is anybody sure to 100 %."""
    return "over 99 %" if confidence > 0.99 else f"{100.0 * confidence:.0f} %"


def p_text(p_value: float) -> str:
    """A p-value as people read it."""
    return "p < 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"


def one_in(p_value: float) -> str:
    """What a p-value that is not very small means: that chance comes to as much, too."""
    return f": one set of healthy runs in {1.0 / p_value:.0f} shows as much" if p_value > RARE else ""


def _size(looks: Looks, runs: Sequence[Replayed]) -> str:
    """How far off the tip is, and how far off it is in reference runs."""
    here = {p: rms(np.concatenate([np.hypot(*run.error_mm(p)[:, -1].T) for run in runs])) for p in PLANTS}
    place = statistics.of_group("size")[0]
    logs = {p: looks.reference[p][:, place] for p in PLANTS}
    usual = {p: f" (reference runs: {mm(float(np.sqrt(np.mean(np.exp(2.0 * logs[p])))))})" for p in PLANTS}
    return (
        f"Told only the first stem and the lamps, the simulated typical plant's tip is {mm(here['typical'])} from the "
        f"measured one{usual['typical']}; with constants of each plant's own it is {mm(here['own'])}{usual['own']}."
    )


def _pattern(looks: Looks, runs: Sequence[Replayed], is_significant: bool) -> list[str]:
    """One sentence for what stands out most, and one more if another kind of thing stands out too."""
    scores = [_score(looks, story) for story in _STORIES]
    order = np.argsort(scores)[::-1]
    out = []
    for rank, k in enumerate(order[:2]):
        if scores[k] < looks.compared.remarkable:
            break
        story = _STORIES[k]
        if "sideways" in story:
            said = _sideways(looks)
        elif "growth" in story:
            said = _growth(looks)
        elif "height" in story:
            said = _height(looks)
        else:
            said = _swing(runs)
        if rank == 0:
            beside = "Beside the typical plant," if looks.clearer_plant == "typical" else "Even then,"
            said = f"{beside} {said[0].lower()}{said[1:]}"
        out.append(said)
    if is_significant and not out:
        out.append("No time, place or rhythm stands out: it is the course of the stems as a whole that differs.")
    return out


def _score(looks: Looks, story: Sequence[Group]) -> float:
    """How much stands out there, in standard errors."""
    places = np.concatenate([statistics.of_group(group) for group in story])
    both = np.concatenate([looks.compared.away[places], looks.compared.away[places + statistics.COUNT]])
    return float(np.nan_to_num(np.abs(both)).max())


def _means(numbers: Array, group: Group) -> Array:
    """Over runs; 0 where no run tells."""
    return np.nan_to_num(statistics.mean_over_runs(numbers[:, statistics.of_group(group)]))


def _clearest(looks: Looks, group: Group) -> int:
    """Which number of a group stands out most."""
    away = looks.compared.away.reshape(len(PLANTS), -1)[PLANTS.index(looks.clearer_plant)]
    return int(np.argmax(np.nan_to_num(np.abs(away[statistics.of_group(group)]))))


def _differ(looks: Looks, group: Group) -> str:
    """How far plants differ in these numbers anyway."""
    known = looks.reference[looks.clearer_plant][:, statistics.of_group(group)]
    spread = rms(known)
    unit = "mm/h" if group == "growth" else "mm"
    return f"; reference plants differ by {_number(spread)} {unit}"


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 9.5 else f"{value:.1f}" if abs(value) >= 0.95 else f"{value:.2f}"


def _to(value_mm: float) -> str:
    return f"{mm(abs(value_mm))} farther to the {'right' if value_mm > 0 else 'left'}"


def _sideways(looks: Looks) -> str:
    """Left or right, under which lamp, how long after a switch, and whether it grows with the plant."""
    by = _means(looks.numbers[looks.clearer_plant], "sideways").reshape(len(SIDES), -1)
    sideways = looks.numbers[looks.clearer_plant][:, statistics.of_group("sideways")]
    seen = np.isfinite(sideways).any(axis=0).reshape(by.shape)
    count = np.maximum(seen.sum(axis=1), 1)
    left, right = by.sum(axis=1) / count
    larger = 0 if abs(left) > abs(right) else 1
    alike = min(abs(left), abs(right)) > _FLAT * max(abs(left), abs(right))
    if alike and left * right > 0:
        by_time = by.mean(axis=0)
        text = f"The tip lies {_to(0.5 * (left + right))} than simulated, whichever lamp shines"
    elif alike:
        by_time = 0.5 * (by[1] - by[0])
        way = "farther towards" if right > 0 else "less far towards"
        text = f"The tip lies {mm(0.5 * abs(right - left))} {way} the lamp that shines than simulated"
    else:
        by_time = by[larger]
        text = f"The tip lies {_to(float((left, right)[larger]))} than simulated while the {SIDES[larger]} lamp shines"
    text += _mainly(by_time, np.asarray(seen.any(axis=0))) + _by_day(_means(looks.numbers[looks.clearer_plant], "lean"))
    return f"{text}{_differ(looks, 'sideways')}."


def _mainly(by_time: Array, seen: Array) -> str:
    size = np.abs(by_time) * seen
    if seen.sum() < 2 or size.max() < _MAINLY * size[seen].mean():
        return ""
    return f", mainly {_SINCE_WORDS[int(np.argmax(size))]}"


def _by_day(by_day: Array) -> str:
    first, last = abs(by_day[0]), abs(by_day[-1])
    if by_day[0] * by_day[-1] > 0 and last > _GROWS * first and last > 2.0:
        return f", growing from {mm(first)} on the first day to {mm(last)} on the third"
    return ""


def _growth(looks: Looks) -> str:
    rates = _means(looks.numbers[looks.clearer_plant], "growth")
    middle, swing = float(rates.mean()), 0.5 * float(np.ptp(rates))
    differ = _differ(looks, "growth")
    if abs(middle) > swing:
        return f"The stem grows {_number(abs(middle))} mm/h {_faster(middle)} than simulated, day and night{differ}."
    said = (
        f"{_number(abs(rates[k]))} mm/h {_faster(rates[k])} than simulated in hours "
        f"{statistics.clock_label(k).removesuffix(' h')}"
        for k in (int(np.argmax(rates)), int(np.argmin(rates)))
    )
    return f"Counted from the start of each day, the stem grows {' and '.join(said)}{differ}."


def _faster(value: float) -> str:
    return "faster" if value > 0 else "more slowly"


def _height(looks: Looks) -> str:
    by_day = _means(looks.numbers[looks.clearer_plant], "height")
    day = _clearest(looks, "height")
    way = "higher" if by_day[day] > 0 else "lower"
    return f"The tip is {mm(abs(by_day[day]))} {way} than simulated on day {day + 1}{_differ(looks, 'height')}."


def _swing(runs: Sequence[Replayed]) -> str:
    """A swing at a period of its own, with its size, or a tip that is restless at all periods."""
    spectra = [spectrum(run.error_mm("own")[:, -1, 0], run.step_h) for run in runs]
    grid = np.linspace(1.0 / PERIODS_H[1], 1.0 / PERIODS_H[0], 80)
    power = np.array([np.interp(grid, own.per_hour, own.power) for own in spectra])
    usual = np.maximum(np.median(power, axis=1, keepdims=True), _LEAST_POWER)
    stands_out = (power / usual).mean(axis=0)
    at = int(np.argmax(stands_out))
    period_h = 1.0 / float(grid[at])
    if stands_out[at] < _OWN_PERIOD or not PLAUSIBLE_H[0] <= period_h <= PLAUSIBLE_H[1]:
        return (
            "Within hours the tip goes to and fro more than simulated plants and reference runs do, at no period of "
            "its own."
        )
    line = np.abs(grid - grid[at]) <= _LINE_SHARE * grid[at]
    amplitude_mm = float(amplitude_of(np.trapezoid(power.mean(axis=0)[line], grid[line])))
    return (
        f"The tip swings by {mm(amplitude_mm)} to either side every {period_h:.1f} h or so, which simulated plants and "
        "reference runs do not."
    )


def _verdict(looks: Looks, is_significant: bool) -> str:
    p = p_text(looks.p_value)
    if not is_significant:
        return f"Taken as a whole, that is no more than plants and chance make of it ({p})."
    return f"That is more than plants and chance make of it ({p}{one_in(looks.p_value)})."
