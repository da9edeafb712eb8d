"""How well hidden effects were named: from truths and diagnoses to figures and tables. Pure functions.

What counts as what:

- A *claim* is a diagnosis with the verdict ``explained`` and at least one cause. Its first cause is right where it is
  the hidden effect, or where both are of one group of :data:`SAME` and the other is named as confusable: causes that
  are known to look alike may be named together. How often the first name alone was right is counted beside it.
- A *false alarm* is any verdict but ``nothing_wrong`` where nothing is hidden.
- A *confident wrong name* is a cause with a confidence of at least 0.8 that is not hidden in the case, whatever the
  verdict says.
- A case whose diagnosis failed claims nothing and is counted as such.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .units import as_finder_tells

SAME: tuple[frozenset[str], ...] = (
    frozenset({"phototropic_latency", "clock_offset"}),
    frozenset({"lamp_asymmetry", "draught", "camera_roll"}),
    frozenset({"diurnal_growth", "temperature_growth"}),
    frozenset({"phototropic_gain", "proprioception", "adaptation"}),
    frozenset({"camera_scale", "growth_rate"}),
)
"""Causes that look alike: the first two exactly so in light and track, the others in most light."""
CONFIDENT = 0.8
BINS = 10
DRAWS = 1000
DAY_H = 24.0
SIGN_FREE = frozenset({"angle_deg", "offset_h", "per_hour"})
"""Parameters whose direction is a matter of convention."""
SIMULATORS = ("base", "extended", "boosted", "still")
"""Whose errors a diagnosis tells."""

Json = Mapping[str, Any]


def named_as_a_pair(name: str, confusable: Collection[str], hidden: Collection[str]) -> str | None:
    """The hidden effect that looks like the one named and is named beside it, or None."""
    alike = [other for group in SAME if name in group for other in sorted(group - {name})]
    return next((other for other in alike if other in hidden and other in confusable), None)


@dataclass(frozen=True)
class Outcome:
    """One judged case.

    Attributes:
        truth: ``truth.json``.
        diagnosis: ``diagnosis.json``, or None where the command failed.
        seconds: that the command took.
        learned: whether it learned from the reference in these; otherwise it was given what had been learned.
    """

    truth: Json
    diagnosis: Json | None
    seconds: float
    learned: bool = True
    named_mm: Json | None = None

    @property
    def kind(self) -> str:
        return str(self.truth["kind"])

    @property
    def form(self) -> int:
        return int(self.truth["form"])

    @property
    def world(self) -> tuple[int, int]:
        """Cases of one world have the same reference runs."""
        return self.form, int(self.truth["seed"])

    @property
    def hidden(self) -> list[str]:
        return [str(effect["effect"]) for effect in self.truth["effects"]]

    @property
    def verdict(self) -> str:
        return "failed" if self.diagnosis is None else str(self.diagnosis["verdict"])

    @property
    def alarmed(self) -> bool:
        """Whether something is said to be wrong: a false alarm where nothing is hidden."""
        return self.verdict not in {"nothing_wrong", "failed"}

    @property
    def causes(self) -> list[Json]:
        return [] if self.diagnosis is None else list(self.diagnosis["causes"])

    @property
    def claimed(self) -> list[Json]:
        return self.causes if self.verdict == "explained" else []

    def names(self, cause: Json) -> str | None:
        """The hidden effect that a cause names, or None."""
        name = str(cause["effect"])
        if name in self.hidden:
            return name
        return named_as_a_pair(name, cause.get("confusable_with", ()), self.hidden)

    @property
    def first(self) -> str:
        """What the diagnosis says, in one word: the first cause of a claim, or the verdict."""
        return str(self.claimed[0]["effect"]) if self.claimed else self.verdict

    @property
    def right(self) -> bool:
        return bool(self.claimed) and self.names(self.claimed[0]) is not None

    @property
    def ranked_first(self) -> bool:
        """Whether the first claim is right, or, where nothing is claimed, a hidden effect has more evidence than all
        others of the catalogue."""
        if self.claimed:
            return self.right
        nats = (self.diagnosis or {}).get("considered") or [{}]
        return bool(nats[0]) and max(nats[0], key=nats[0].__getitem__) in self.hidden

    @property
    def right_alone(self) -> bool:
        """Whether the first name is that of a hidden effect."""
        return bool(self.claimed) and self.claimed[0]["effect"] in self.hidden

    def if_claims_took(self, least_nats: float) -> Outcome:
        """The same case, were causes with less evidence than this not named; what is ``unexplained`` stays so.

        Told from the evidence that was written down: what a finder with that bar would look for after a cause that it
        drops, or beside it, is not in it.
        """
        if self.diagnosis is None:
            return self
        kept = [cause for cause in self.causes if float(cause["nats"]) >= least_nats]
        verdict = "nothing_wrong" if self.verdict == "explained" and not kept else self.verdict
        return replace(self, diagnosis={**self.diagnosis, "causes": kept, "verdict": verdict})


@dataclass(frozen=True)
class Share:
    """So many of so many, with the 95 % interval of Wilson (1927)."""

    count: int
    total: int

    @property
    def value(self) -> float:
        return self.count / self.total if self.total else math.nan

    def interval(self) -> tuple[float, float]:
        if not self.total:
            return math.nan, math.nan
        z = 1.959964
        n, p = self.total, self.value
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
        return max(0.0, middle - half), min(1.0, middle + half)

    def __str__(self) -> str:
        if not self.total:
            return "-"
        low, high = self.interval()
        return f"{100 * self.value:.0f} % ({100 * low:.0f}-{100 * high:.0f}), {self.count} of {self.total}"


def alarmed_worlds(healthy: Sequence[Outcome]) -> Share:
    """Of the worlds of these cases, those with any false alarm; none of none where no two share a world."""
    worlds = {o.world for o in healthy}
    if len(worlds) == len(healthy):
        return Share(0, 0)
    return Share(len({o.world for o in healthy if o.alarmed}), len(worlds))


def share(items: Iterable[bool]) -> Share:
    """How many of these hold."""
    seen = list(items)
    return Share(sum(seen), len(seen))


@dataclass(frozen=True)
class ParameterError:
    """One parameter of one rightly named cause: relative error, and whether its interval holds the truth."""

    effect: str
    parameter: str
    relative: float
    held: bool | None


def parameter_errors(outcomes: Sequence[Outcome]) -> list[ParameterError]:
    """Of all causes rightly named by their own name, the parameters that truth and diagnosis share."""
    found = []
    for outcome in outcomes:
        for cause in outcome.claimed:
            for effect in outcome.truth["effects"]:
                if effect["effect"] == cause["effect"]:
                    found += _errors_of(effect, cause)
    return found


def _errors_of(effect: Json, cause: Json) -> Iterable[ParameterError]:
    for name, true in as_finder_tells(effect["effect"], effect["parameters"]).items():
        if name not in cause["parameters"]:
            continue
        told = float(cause["parameters"][name])
        low, high = (float(value) for value in cause.get("interval", {}).get(name, (math.nan, math.nan)))
        truths = [true]
        if name in SIGN_FREE:
            truths = [true, -true]
        elif name == "peak_h":
            truths = [true - DAY_H, true, true + DAY_H]
        size = DAY_H if name == "peak_h" else abs(true)
        error = min(abs(told - value) for value in truths) / size
        held = None if math.isnan(low) or math.isnan(high) else any(low <= value <= high for value in truths)
        yield ParameterError(str(effect["effect"]), name, error, held)


def calibration_error(outcomes: Sequence[Outcome]) -> float:
    """Expected calibration error of all claimed causes' confidences, in ten bins; NaN where nothing was claimed."""
    confidence, right = _claims(outcomes)
    return _calibration_error(confidence, right) if len(right) else math.nan


def calibration_error_by_chance(outcomes: Sequence[Outcome]) -> float:
    """What that would be on the mean if each claim were right with just its confidence: few in ten bins scatter."""
    confidence, _ = _claims(outcomes)
    rng = np.random.default_rng(1)
    draws = [rng.random(len(confidence)) < confidence for _ in range(DRAWS)]
    return float(np.mean([_calibration_error(confidence, right) for right in draws])) if len(confidence) else math.nan


def _claims(outcomes: Sequence[Outcome]) -> tuple[np.ndarray, np.ndarray]:
    pairs = [(float(c["confidence"]), o.names(c) is not None) for o in outcomes for c in o.claimed]
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs], dtype=bool)


def _calibration_error(confidence: np.ndarray, right: np.ndarray) -> float:
    bins = np.minimum((confidence * BINS).astype(np.int64), BINS - 1)
    gaps = [abs(confidence[bins == b].mean() - right[bins == b].mean()) * (bins == b).sum() for b in np.unique(bins)]
    return float(sum(gaps) / len(confidence))


@dataclass(frozen=True)
class GainShare:
    """What was gained as a share of what could have been, pooled over cases.

    Attributes:
        value: nan where there is nothing to gain.
        low, high: 95 % of it when cases are drawn again with replacement: plants differ by as much as weak effects do.
        cases: that took part.
    """

    value: float
    low: float
    high: float
    cases: int

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


def gain_share(
    outcomes: Sequence[Outcome], whose: str = "typical", *, by: str = "extended", from_one_base: bool = False
) -> GainShare:
    """Gain of the claims and of the oracle, both root mean squares of the tip's distance, in mm.

    A diagnosis takes part where it is right and ``gain.free_running.end`` gives both errors.

    Args:
        outcomes: of the cases.
        whose: plant of the oracle's.
        by: simulator that gains.
        from_one_base: the oracle begins at the error of the base that the diagnosis extends, which was learned from
            few plants, and not at that of the true typical plant without the effect.
    """
    gains = []
    for outcome in outcomes:
        end = (outcome.diagnosis or {}).get("gain", {}).get("free_running", {}).get("end")
        oracle = outcome.truth.get("oracle", {}).get(whose, {}).get("end")
        if not outcome.right or not isinstance(end, Mapping) or oracle is None:
            continue
        base, better = (end.get(f"{name}_rms") for name in ("base", by))
        if base is None or better is None:
            continue
        begin = float(base) if from_one_base else oracle["base_mm"]
        gains.append((float(base) - float(better), begin - oracle["extended_mm"]))
    return pooled(gains)


def held_out_errors(outcomes: Sequence[Outcome]) -> dict[str, dict[str, tuple[float, ...]]]:
    """Errors of the tip on runs that no fit has seen, root mean squares in mm, of each right diagnosis that tells them.

    Returns:
        Horizon (``one step``, ``1h``, ...) to simulator to the error of each case.
    """
    found: dict[str, dict[str, list[float]]] = {}
    for outcome in outcomes:
        gain = (outcome.diagnosis or {}).get("gain", {})
        told = {"one step": gain.get("one_step", {}), **gain.get("free_running", {})} if outcome.right else {}
        for horizon, errors in told.items():
            if all(f"{name}_rms" in errors for name in SIMULATORS):
                for name in SIMULATORS:
                    found.setdefault(horizon, {}).setdefault(name, []).append(float(errors[f"{name}_rms"]))
    return {horizon: {name: tuple(values) for name, values in own.items()} for horizon, own in found.items()}


def named_share(outcomes: Sequence[Outcome], when: str = "end") -> GainShare:
    """What the claims are worth about plants whose own constants are known, as a share of the whole effect.

    Single effects and pairs take part, whether anything was named or not. How plants differ, which is more than most
    effects and tells nothing of a finder, is not in it.

    Args:
        outcomes: of the cases.
        when: at the ``end``, or so long after the start (``6h``).
    """
    gains = []
    for outcome in outcomes:
        own = outcome.truth.get("oracle", {}).get("own", {}).get(when)
        told = (outcome.named_mm or {}).get(when)
        if outcome.kind in {"single", "pair"} and told is not None and own is not None:
            gains.append((own["base_mm"] - told, own["base_mm"] - own["extended_mm"]))
    return pooled(gains)


@dataclass(frozen=True)
class RhythmTold:
    """A hidden rhythm that no cause of the catalogue has, and what was said of it.

    Attributes:
        of: ``growth``, ``activity`` (growth and bending), ``gain`` or ``bias``.
        in_step: whether it is highest at the same time in all runs.
        is_unexplained: whether the verdict is that.
        is_of_that: whether what has no name is described as a rhythm of the same.
        period_off: of its period, relative; NaN where none of it is told.
    """

    of: str
    in_step: bool
    is_unexplained: bool
    is_of_that: bool
    period_off: float


def rhythms_told(outcomes: Sequence[Outcome]) -> list[RhythmTold]:
    """Of all cases that hide one of other than 24 h."""
    found = []
    for outcome in outcomes:
        for effect in outcome.truth["effects"]:
            if effect["effect"] not in {"rhythm", "growth_bursts"}:
                continue
            true = effect["parameters"]
            of = next((name.removesuffix("_amplitude") for name in true if name.endswith("_amplitude")), "activity")
            told = (outcome.diagnosis or {}).get("described") or {}
            period_h = told.get("period_h")
            is_of_that = period_h is not None and told["drive"] == ("growth" if of == "activity" else of)
            off = abs(period_h / true["period_h"] - 1.0) if is_of_that else math.nan
            in_step = bool(true.get("in_step", False))
            found.append(RhythmTold(of, in_step, outcome.verdict == "unexplained", is_of_that, off))
    return found


def pooled(gains: Sequence[tuple[float, float]]) -> GainShare:
    """Sums of what was gained and of what could have been, one by the other."""
    told = np.array(gains).reshape(-1, 2)
    gained, possible = told.sum(axis=0)
    if possible <= 0.0:
        return GainShare(math.nan, math.nan, math.nan, len(told))
    drawn = told[np.random.default_rng(1).integers(0, len(told), (DRAWS, len(told)))].sum(axis=1)
    drawn = drawn[drawn[:, 1] > 0.0]
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], (2.5, 97.5))
    return GainShare(gained / possible, float(low), float(high), len(told))


def confusion(outcomes: Sequence[Outcome]) -> Counter[tuple[str, str]]:
    """How often each hidden thing (effect, ``nothing`` or an outside effect) got each answer; no pairs."""
    return Counter(
        (outcome.hidden[0] if outcome.hidden else "nothing", outcome.first)
        for outcome in outcomes
        if outcome.kind != "pair"
    )
