"""From evidence to words: how sure each cause is, what cannot be told from it, and whether anything is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
import scipy.special
import scipy.stats

from flora_common.arrays import Array
from flora_common.counted import listed
from flora_lab.diagnose.diagnosis import NamedCause, Verdict
from flora_lab.diagnose.explanation import FIRST, SWING, Explanation, Stage, Tried
from flora_lab.diagnose.hypothesis import Cause
from flora_lab.diagnose.joint import Found
from flora_lab.diagnose.knowledge import Knowledge, blocks
from flora_lab.diagnose.nameless import Unnamed, times_as_probable
from flora_lab.diagnose.scene import Scene
from flora_lab.effects import draught
from flora_lab.effects.effect import Effect, Parameter, is_same


@dataclass(frozen=True, slots=True)
class Belief:
    """How confidence comes from evidence.

    Attributes:
        temperature: nats are divided by it: models are never as right as their likelihoods take them to be.
        nothing: how many times more probable no cause is than any certain one, before any data.
    """

    temperature: float
    nothing: float


FIRST_BELIEF, LATER_BELIEF = Belief(1.5, 1.0), Belief(2.5, 10.0)
"""Of a first cause that has come to its claim, and of others beside it, of which those with a few nats are there in one
case of three. Read off 693 claims of drawn runs (docs/results/discovery-history.md)."""
ALIKE: Final = 4.0
"""Nats within which a cause is not told from a better one."""
RELATED: Final = 8.0
"""The same for causes that light and track hardly tell apart: no law is right enough for it."""
INSEPARABLE: Final = 12.0
"""The same for causes that they can never tell apart: what is between them is the shape of a prior; and for related
ones where the better one would have to be stronger than is plausible."""
_EXACTLY: Final = 0.6
WIDER: Final = 1.3
"""Intervals are wider than Laplace's by this, and by :data:`LAW_SHARE` of the effect: the law is not the plant."""
LAW_SHARE: Final = 0.04
_90: Final = 1.645
_LEAST_SD: Final = 0.10
"""Added to the spread of what reference runs leave, in nats: a few may be alike by chance."""
_LEFT_P: Final = 0.003
_MOSTLY: Final = 0.6
SUREST, LEAST_P = 0.999, 1e-6
"""What is told at most of a confidence, and at least of a p-value: beyond nothing was counted, in 700 claims."""
_UNSURE: Final = 0.3
"""Confidence that a cause keeps at most where much is left unexplained."""
TIPPED: Final = ("camera_roll", "camera_drift")
"""What plants look like in a pot that was tipped, once their stems are turned back."""
_ABOUT_H: Final = 6
"""What is left is averaged over so many hours to say when it is most."""
_BY_GUSTS: Final = "wind bends the stem; its gusts tell so, and these runs hardly tell from which side"
_FEATURE_WORDS: Final = (
    "where the tip is sideways",
    "how high the tip is",
    "the stem at two thirds of its height",
    "the stem at a third of its height",
    "the foot of the stem",
)
"""In the order of :data:`flora_lab.diagnose.scene.FEATURES`."""


@dataclass(frozen=True, slots=True)
class Left:
    """What is left unexplained.

    Attributes:
        share: mean square of what is left over that of reference runs by themselves.
        p_value: how often reference runs would leave as much.
        explained: share of what the simulator as it is leaves beyond what is usual, its own swing left out, that this
            and the causes take away.
        unnamed: what seems to be at work that is no cause of the catalogue.
    """

    share: float
    p_value: float
    explained: float
    unnamed: Unnamed | None = None

    @property
    def is_much(self) -> bool:
        """Whether something else must be at work.

        A little is left of every strong effect, because no term is quite what nature does.
        """
        return self.unnamed is not None or (self.p_value < _LEFT_P and self.explained < _MOSTLY)


def left_of(explanation: Explanation, known: Knowledge) -> Left:
    """How much the best explanation leaves, beside what each reference run leaves by itself.

    Runs, not rows, are counted. The worst part of a run, half a day long, counts as well as the whole: what happens for
    some hours only is lost in a mean over three days.
    """
    own = np.stack([blocks(residual) for residual in explanation.found.residuals])
    p_values, shares = [], []
    for column in range(own.shape[1]):
        mine, usual = np.log(own[:, column]), np.log(known.left[:, column])
        sd = np.sqrt(np.var(usual, ddof=1) + _LEAST_SD**2)
        t = (mine.mean() - usual.mean()) / (sd * np.sqrt(1.0 / len(mine) + 1.0 / len(usual)))
        p_values.append(float(scipy.stats.t.sf(t, len(usual) - 1)))
        shares.append(float(np.exp(mine.mean() - usual.mean())))
    healthy = float(known.left[:, 0].mean())
    at_first = explanation.stages[0].before.left if explanation.unswung is None else explanation.unswung
    before, after = (max(0.0, left - healthy) for left in (at_first, explanation.found.left))
    explained = 1.0 - after / before if before > 0.0 else 0.0
    return Left(shares[0], min(1.0, min(p_values) * len(p_values)), explained, explanation.unnamed)


def left_words(left: Left, explanation: Explanation, known: Knowledge) -> str:
    """What is left, in sentences; empty where it is no more than usual."""
    if not left.is_much:
        return ""
    told = []
    if left.unnamed is not None:
        told.append(f"A description that fits, but names no cause: {left.unnamed.words} ({left.unnamed.evidence}).")
    if left.p_value < _LEFT_P:
        told.append(
            f"What the best explanation leaves is {left.share:.1f} times what a reference run leaves by itself "
            f"(p = {left.p_value:.1g})."
        )
    worst, most, base = 0, 0.0, float(np.mean(known.left[:, 0]))
    for i, residual in enumerate(explanation.found.residuals):
        if float(np.mean(residual**2)) > most:
            worst, most = i, float(np.mean(residual**2))
    scene = explanation.joint.runs[worst].scene
    squares = explanation.found.residuals[worst][: scene.size] ** 2
    hours = np.array(
        [squares[scene.window == w].mean() if (scene.window == w).any() else 0.0 for w in range(scene.windows)]
    )
    smooth = np.convolve(hours, np.ones(_ABOUT_H) / _ABOUT_H, mode="same")
    at = int(np.argmax(smooth))
    told.append(
        f"It is most in {scene.run.name}, about {scene.time_h[at]:.0f} h after its start "
        f"({smooth[at] / base:.0f} times the usual), with the tip at {_height_cm(scene, at):.0f} cm."
    )
    by_feature = [float(squares[scene.feature == f].mean()) for f in range(len(_FEATURE_WORDS))]
    told.append(f"It shows most in {_FEATURE_WORDS[int(np.argmax(by_feature))]}.")
    return " ".join(told)


def _height_cm(scene: Scene, window: int) -> float:
    rows = (scene.window == window) & (scene.feature == 1)
    return float(scene.features[rows][0]) if rows.any() else float(np.nanmax(scene.run.points_cm[:, -1, 1]))


def verdict_of(causes: Sequence[NamedCause], left: Left, is_knocked: bool = False) -> Verdict:
    """In a word; runs in which somebody knocked something, and nothing else is found, are for a person to look at.

    Nothing else is what a pot that was tipped looks like, too, see :func:`beside_a_knock`.
    """
    if left.is_much:
        return "unexplained"
    if any(not (is_knocked and cause.effect in TIPPED) for cause in causes):
        return "explained"
    return "unexplained" if is_knocked else "nothing_wrong"


def beside_a_knock(causes: Sequence[NamedCause]) -> list[NamedCause]:
    """The causes of runs of which it was told that somebody knocked something, and stems were turned back.

    Where it was the pot, and not the camera, light and gravity come from elsewhere since then, and plants bend as in
    pictures that are turned the other way.
    """
    return [
        msgspec.structs.replace(
            cause,
            confidence=min(cause.confidence, _UNSURE),
            evidence=f"{cause.evidence} A pot that was tipped looks like that, too.",
        )
        if cause.effect in TIPPED
        else cause
        for cause in causes
    ]


def named(explanation: Explanation, left: Left) -> list[NamedCause]:
    """The causes, surest first."""
    found = explanation.found
    out: list[NamedCause] = []
    values = dict(zip(found.hypothesis.names(), found.values(), strict=True))
    places = _places(found)
    for place, one in enumerate(explanation.accepted):
        best, stage = one.tried, one.stage
        alike = _alike(stage)
        sure = _confidence(stage, alike, LATER_BELIEF if place else FIRST_BELIEF)
        if left.is_much:
            sure = min(sure, _UNSURE)
        if best.effect.name == SWING:
            swing = best.swing if explanation.swing is None else explanation.swing
            assert swing is not None
            parameters = {"period_h": swing.period_h, "amplitude_cm": swing.amplitude_cm}
            interval = {
                "period_h": _widened(swing.period_interval_h, swing.period_h, 0.02),
                "amplitude_cm": _widened(swing.amplitude_interval_cm, swing.amplitude_cm, 0.1),
            }
            form = 0
        else:
            cause, own = places[best.effect.name]
            interval = _intervals(cause.parameters, found.coordinates[own], found.covariance[own, own])
            parameters = {p.name: _told(p, values[best.effect.name][p.name]) for p in cause.parameters}
            form = cause.form
        if not _is_side_told(best):
            interval = {name: (-max(map(abs, ends)), max(map(abs, ends))) for name, ends in interval.items()}
        out.append(
            NamedCause(
                effect=best.effect.name,
                parameters=parameters,
                interval=interval,
                confidence=min(round(sure, 3), SUREST),
                p_value=_p_value(stage),
                confusable_with=[t.effect.name for t in alike],
                evidence=_sentence(
                    meaning(best.effect, parameters, interval), best.gain, alike, _of_two(explanation, place)
                ),
                nats=round(best.gain, 1),
                form=form,
            )
        )
    return sorted(out, key=lambda cause: -cause.confidence)


def _places(found: Found) -> dict[str, tuple[Cause, slice]]:
    """Where the coordinates of each cause stand."""
    out, at = {}, 0
    for cause in found.hypothesis.causes:
        out[cause.effect.name] = (cause, slice(at, at + len(cause.parameters)))
        at += len(cause.parameters)
    return out


def _alike(stage: Stage) -> list[Tried]:
    """What these runs cannot tell from the best."""
    best = stage.tried[0]
    related = related_nats(best)
    out = []
    for other in stage.tried[1:]:
        behind = best.gain - other.gain
        near = other.gain > 0.0 and behind < (related if is_same(best.effect, other.effect) else ALIKE)
        if near or (other.effect.name in best.effect.exactly and _is_as_good(best, other)):
            out.append(other)
    return out


def related_nats(best: Tried) -> float:
    """Nats within which a related cause is not told from the best one."""
    return RELATED if _is_plausible(best) else INSEPARABLE


def _is_plausible(tried: Tried) -> bool:
    """Whether a cause is no stronger than is plausible; beyond it a related one is the likelier."""
    if tried.found is None:
        return True
    values = tried.found.values()[-1]
    return all(p.is_plausible(values[p.name]) for p in tried.effect.parameters)


def _is_as_good(best: Tried, other: Tried) -> bool:
    """Whether what is the same as the best one could be it, too; a delay cannot be less than none.

    By the fits themselves: what healthy runs show of either is not told exactly enough where there are many nats.
    """
    if other.gain > _EXACTLY * best.gain:
        return True
    if best.found is None or other.found is None:
        return False
    return other.found.evidence > best.found.evidence - INSEPARABLE


def _confidence(stage: Stage, alike: Sequence[Tried], belief: Belief) -> float:
    """Probability of the best cause, or of one that cannot be told from it."""
    gains = np.array([tried.gain for tried in stage.tried])
    logs = np.append(gains / belief.temperature, np.log(belief.nothing))
    weights = scipy.special.softmax(logs)
    names = {stage.tried[0].effect.name, *(t.effect.name for t in alike)}
    return float(sum(w for w, t in zip(weights, stage.tried, strict=False) if t.effect.name in names))


def _p_value(stage: Stage) -> float:
    """How often runs without a cause would show this evidence for any of so many, at most (Markov's inequality)."""
    return float(np.clip(len(stage.tried) * np.exp(-stage.tried[0].gain), LEAST_P, 1.0))


def _told(p: Parameter, value: float) -> float:
    return value % 24.0 if p.is_cyclic else value


def _intervals(
    parameters: Sequence[Parameter], coordinates: Array, covariance: Array
) -> dict[str, tuple[float, float]]:
    out = {}
    for i, p in enumerate(parameters):
        away = abs(float(coordinates[i]) - p.centre) if p.none is not None else 0.0
        half = _90 * float(np.hypot(WIDER * np.sqrt(max(covariance[i, i], 0.0)), LAW_SHARE * away))
        # On a clock, about the hour that is told: before 0 or after 24 where it must be.
        middle = _told(p, float(coordinates[i]))
        out[p.name] = (p.value(middle - half), p.value(middle + half))
    return out


def _widened(interval: tuple[float, float], value: float, share: float) -> tuple[float, float]:
    low, high = value - interval[0], interval[1] - value
    return value - float(np.hypot(WIDER * low, share * value)), value + float(np.hypot(WIDER * high, share * value))


def meaning(effect: Effect, parameters: dict[str, float], interval: dict[str, tuple[float, float]]) -> str:
    """What a cause means, given its values and their intervals of 90 %; a draught whose side is not told has none."""
    may_be_either = effect is draught.EFFECT and all(low == -high for low, high in interval.values())
    return _BY_GUSTS if may_be_either else effect.sentence(parameters)


def _is_side_told(tried: Tried) -> bool:
    """Whether more than its gusts, which are the same from either side, speaks for a wind."""
    return tried.gusts.evidence == 0.0 or tried.gain - tried.gusts.evidence >= FIRST


def _sentence(text: str, nats: float, alike: Sequence[Tried], of_two: str) -> str:
    text = text[0].upper() + text[1:]
    told = f"{text}: with it the runs are {times_as_probable(nats)}{of_two}."
    if alike:
        told += f" These runs do not tell it from {listed([t.effect.title.lower() for t in alike], 'or')}."
    return told


def _of_two(explanation: Explanation, place: int) -> str:
    """What is to be said of causes of which one by itself is too little."""
    if not explanation.is_of_two or place > 1:
        return ""
    other = explanation.accepted[1 - place].tried.effect.title.lower()
    return f", beside {other}; neither of the two is enough by itself, and both together are"
