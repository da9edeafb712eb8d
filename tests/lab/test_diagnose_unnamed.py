"""What has no name in the catalogue: found by the drive that is off and by what it follows, and said in words."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import LAW, STEP_S, base, known, levels_of, run_of, scene_of, scenes_of, stem, still, turns

from flora_common.arrays import Array
from flora_lab.diagnose import chance, search
from flora_lab.diagnose import unnamed as module
from flora_lab.diagnose.courses import CLOSER, COURSES, RHYTHMS, TRIED, Course, Push, moments_of, with_own_times
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Explanation
from flora_lab.diagnose.hypothesis import Cause
from flora_lab.diagnose.joint import Found, Joint, ready
from flora_lab.diagnose.nameless import Unnamed
from flora_lab.diagnose.scene import Answers, Lanes, Scene
from flora_lab.diagnose.summary import summary
from flora_lab.diagnose.unnamed import fitted, looked_at
from flora_lab.diagnose.unnamed_rhythms import rhythms
from flora_lab.diagnose.usual_pushes import no_pushes
from flora_lab.diagnose.verdict import left_of, left_words, named, verdict_of
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import Change
from flora_lab.threads import one_blas_thread

HOURS = 48.0
HIDDEN: Mapping[str, Mapping[str, Callable[[Array], Array]]] = {
    "by day": {"gain": lambda hour: 0.7 * np.cos(2.0 * np.pi * (hour - 7.0) / 24.0)},
    "late": {"growth": lambda hour: -0.6 * (hour > 24.0)},
    "a spell": {"growth": lambda hour: -0.8 * ((hour > 17.0) & (hour < 31.0))},
}


@functools.cache
def explained(which: str) -> Explanation:
    scenes = [scene_of(seed, hours=HOURS, besides=HIDDEN[which]) for seed in (84, 85)]
    with one_blas_thread():
        return Explainer(scenes, known()).explain()


def looked_from(scenes: list[Scene]) -> tuple[Joint, Found, list[Scene], list[Answers]]:
    """Runs as they are where nothing is taken to be wrong, and what moves them there."""
    runs = [
        ready(scene, base(), chance.covariances(scene, scene.answers(base().mean, Change())), together=2)
        for scene in scenes
    ]
    joint = Joint(runs, base())
    null = joint.fit(joint.null(), 12)
    return joint, null, scenes, [scene.answers(t, Change()) for scene, t in zip(scenes, null.traits, strict=True)]


def course_of(where: str) -> Course:
    (found,) = (course for course in COURSES if course.where.startswith(where))
    return found


def test_a_rhythm_that_is_no_cause_is_described() -> None:
    explanation = explained("by day")
    found = explanation.unnamed
    assert found is not None
    assert (found.drive, found.course) == ("gain", course_of("in a rhythm of 24 h"))
    assert np.hypot(*found.size) == pytest.approx(0.7, rel=0.4)
    assert np.arctan2(found.size[1], found.size[0]) * 24.0 / (2.0 * np.pi) == pytest.approx(7.0, abs=1.0)


@pytest.mark.slow
def test_the_hour_from_which_on_plants_grow_slower_is_told() -> None:
    found = explained("late").unnamed
    assert found is not None
    assert found.drive == "growth"
    assert found.course in [course_of(f"from {hour_h} h after the start on") for hour_h in (18, 24, 30)]
    assert found.size[0] == pytest.approx(-0.6, abs=0.3)


@pytest.mark.slow
def test_a_spell_that_comes_but_once_is_no_rhythm_of_the_day() -> None:
    """A pot that dries out and is watered: told as a rhythm, growth would seem to rest every day."""
    explanation = explained("a spell")
    found = explanation.unnamed
    assert found is not None
    assert (found.drive, found.course) == ("growth", course_of("from 18 to 30 h after the start"))
    assert found.size[0] == pytest.approx(-0.8, abs=0.3)


@pytest.mark.parametrize(
    "which", ["by day", *(pytest.param(which, marks=pytest.mark.slow) for which in ("a spell", "late"))]
)
def test_no_name_is_given_with_confidence_to_what_has_none(which: str) -> None:
    explanation = explained(which)
    left = left_of(explanation, known())
    causes = named(explanation, left)
    assert left.is_much
    assert left.unnamed is not None
    assert verdict_of(causes, left) == "unexplained"
    assert all(cause.confidence <= 0.3 for cause in causes)
    assert left.unnamed.words in left_words(left, explanation, known())
    assert left.unnamed.words in summary(causes, left)


def tied(seed: int) -> Scene:
    """A plant that a string keeps near the middle: where its tip was at each full hour pulls at it for the next."""
    pull, run = np.zeros(round(HOURS) + 1), run_of(seed, hours=HOURS)
    for hour in range(1, len(pull)):
        x_cm = float(run.points_cm[round(hour * 3600.0 / STEP_S), -1, 0])
        pull[hour] = -0.06 * np.sign(x_cm) * max(abs(x_cm) - 0.7, 0.0)
        run = run_of(seed, hours=HOURS, besides={"bias": lambda hour_h: pull[hour_h.astype(int)]})
    return Scene(run, LAW, None)


def test_a_string_that_holds_stems_is_seen() -> None:
    joint, null, scenes, answers = looked_from([tied(seed) for seed in (84, 85)])
    looks = looked_at(joint, null, scenes, answers, no_pushes())
    held = next(look for look in looks if look.course.holds)
    assert held.gain > 14.0
    assert held.words.startswith("something holds stems back")
    assert "off the middle" in held.words


@pytest.mark.slow
def test_a_string_is_told_before_any_cause() -> None:
    with one_blas_thread():
        explanation = Explainer([tied(seed) for seed in (84, 85)], known()).explain()
    assert explanation.unnamed is not None
    assert explanation.unnamed.course.holds
    left = left_of(explanation, known())
    assert verdict_of(named(explanation, left), left) == "unexplained"


def turning(period_h: float, peak_h: float, amplitude: float) -> Callable[[Array], Array]:
    return lambda hour: amplitude * np.cos(2.0 * np.pi * (hour - peak_h) / period_h)


@pytest.mark.parametrize(
    ("drive", "period_h", "amplitude", "size"),
    [("gain", 7.3, 0.7, 0.35), ("growth", 12.4, 0.6, 0.35), ("bias", 5.2, 0.04, 0.35)],
)
def test_a_rhythm_of_any_period_is_told(drive: str, period_h: float, amplitude: float, size: float) -> None:
    besides = {drive: turning(period_h, 2.0, amplitude)}
    joint, null, scenes, answers = looked_from([scene_of(seed, hours=HOURS, besides=besides) for seed in (84, 85)])
    told = module.unnamed(joint, null, scenes, answers, no_pushes())
    assert told.drive == drive
    assert told.course.period_h == pytest.approx(period_h, rel=0.05)
    assert np.hypot(*told.size) == pytest.approx(amplitude, rel=size)
    peak_h = float(np.arctan2(told.size[1], told.size[0])) * told.course.period_h / (2.0 * np.pi)
    assert peak_h == pytest.approx(2.0, abs=0.12 * period_h)
    assert f"in a rhythm of {told.course.period_h:.3g} h, most " in told.words


def test_a_rhythm_that_is_at_another_place_in_each_run_is_told_as_one() -> None:
    """As what a plant does by itself is: by the clock of the runs nothing would be there in the mean."""
    peaks_h = 0.0, 4.0
    scenes = [
        scene_of(seed, hours=HOURS, besides={"growth": turning(8.0, peak_h, 0.7)})
        for seed, peak_h in zip((84, 85), peaks_h, strict=True)
    ]
    joint, null, scenes, answers = looked_from(scenes)
    told = module.unnamed(joint, null, scenes, answers, no_pushes())
    assert (told.drive, told.has_own_times) == ("growth", True)
    assert told.course.period_h == pytest.approx(8.0, rel=0.05)
    assert told.size == pytest.approx(0.7, rel=0.35)
    assert told.times > 0.0
    assert told.words.startswith("growth is some ")
    assert told.words.endswith("higher and lower by turns in a rhythm of 8 h, in each run at times of its own")


def test_times_of_its_own_are_those_of_the_run_that_is_asked_for() -> None:
    rhythm = next(course for _, course in RHYTHMS if course.period_h == 18.0)
    at = moments_of(still(turns(36.0, 6.0, "right")), np.array([1.0, 5.5, 10.0, 19.0]))
    own = with_own_times(rhythm, {at.of: 1.0, ("another run", ""): 5.0})
    assert own.of(at)[:, 0] == pytest.approx([1.0, 0.0, -1.0, 1.0], abs=1e-9)


@pytest.mark.parametrize(
    ("drive", "hours_h", "within", "size"),
    [("gain", (9.0, 15.0), 24.0, -0.8), ("gain", (15.0, 24.0), 24.0, -0.8), ("growth", (3.0, 15.0), 24.0, -0.8)],
)
def test_what_comes_once_in_a_short_run_is_no_rhythm(
    drive: str, hours_h: tuple[float, float], within: float, size: float
) -> None:
    besides = {drive: lambda hour: size * ((hour > hours_h[0]) & (hour <= hours_h[1]))}
    joint, null, scenes, answers = looked_from([scene_of(seed, hours=within, besides=besides) for seed in (84, 85)])
    told = module.unnamed(joint, null, scenes, answers, no_pushes())
    assert told.course.period_h is None
    assert all(
        (look.course.period_h or 0.0) <= 0.5 * within for look in rhythms(joint, null, scenes, answers, no_pushes())
    )


def test_a_run_in_the_dark_tells_no_rhythm_of_the_answer_to_light() -> None:
    dark = scene_of(85, hours=HOURS, light=levels_of(["dark"] * round(HOURS * 3600.0 / STEP_S)))
    joint, null, scenes, answers = looked_from([scene_of(84, hours=HOURS), dark])
    looks = rhythms(joint, null, scenes, answers, no_pushes())
    assert all(np.isfinite(look.gain) for look in looks)
    assert {look.drive for look in looks} == {"gain", "growth", "bias"}


def test_what_hourly_means_keep_of_a_swing_is_no_rhythm() -> None:
    """One of 1.3 h shows as one of 4.3 h there."""
    joint, null, scenes, answers = looked_from([scene_of(seed, hours=HOURS) for seed in (84, 85)])

    def quickest_h(*swings_h: float) -> float:
        looks = rhythms(joint, null, scenes, answers, no_pushes(), swings_h)
        return min(look.course.period_h or 0.0 for look in looks)

    assert quickest_h() < 7.6 < quickest_h(1.3)
    assert quickest_h(2.0, 1.3) == quickest_h(1.3)


def test_rhythms_lie_as_close_as_three_days_tell_them_apart() -> None:
    periods_h = sorted({course.period_h or 0.0 for _, course in RHYTHMS})
    assert (periods_h[0], periods_h[-1]) == (pytest.approx(3.5, abs=0.1), pytest.approx(18.0))
    assert np.diff(1.0 / np.array(periods_h)) == pytest.approx(-0.5 / 72.0)
    assert len({f"{drive} {course.where}" for drive, course in RHYTHMS}) == len(RHYTHMS)


def test_nothing_holds_stems_by_pushing_them_away() -> None:
    """What pushes to the right has pushed most where the tip is farther to the right."""
    joint, null, scenes, answers = looked_from(scenes_of((86, 87), {"draught": {"drive_per_cm_h": 0.02}}))
    looks = looked_at(joint, null, scenes, answers, no_pushes())
    away = [look for look in looks if look.course.holds and look.size[0] <= 0.0]
    assert away
    assert all(look.gain == -np.inf for look in away)
    pushed = replace(away[0], gain=20.0)
    assert fitted(joint, null, pushed).gain == -np.inf


def test_something_besides_is_weighed_as_a_cause_would_be() -> None:
    """A steady push is a cause with one number: both ways to its evidence and its size."""
    joint, null, _, answers = looked_from(scenes_of((86, 87), {"draught": {"drive_per_cm_h": 0.02}}))
    cause = Cause(BY_NAME["draught"])
    (push,) = cause.parameters
    told = joint.beside(null, [own.to["bias"].sum(axis=1)[:, None] for own in answers])
    look = search.best_start(joint, null, cause)
    assert told.nats(push.spread**2 * np.eye(1)) == pytest.approx(look.evidence - null.evidence, abs=0.5)
    assert told.size(push.spread)[0] == pytest.approx(look.values()[0]["drive_per_cm_h"], rel=0.1)


def test_what_is_large_is_fitted_about_its_own_size() -> None:
    """An answer to light that falls to a fifth is far from linear about one that never does."""
    lower = {"gain": lambda hour: -0.8 * (hour > 24.0)}
    joint, null, _, _ = looked_from([scene_of(seed, hours=HOURS, besides=lower) for seed in (84, 85)])
    course = course_of("from 24 h")
    look = Unnamed("gain", course, 20.0, np.array([-0.3]))
    found = fitted(joint, null, look)
    assert (found.drive, found.course) == ("gain", course)
    assert found.size[0] == pytest.approx(-0.8, abs=0.15)
    assert found.gain > 20.0


def test_a_spell_is_told_from_when_to_when_it_was() -> None:
    """Nine hours from the fifteenth on: no spell that is looked at first begins then, or lasts so long."""
    rest = {"growth": lambda hour: -0.9 * ((hour > 15.0) & (hour <= 24.0))}
    joint, null, scenes, answers = looked_from([scene_of(seed, hours=HOURS, besides=rest) for seed in (84, 85)])
    told = module.unnamed(joint, null, scenes, answers, no_pushes())
    assert told.words.endswith("lower from 15 to 24 h after the start")
    assert told.size[0] == pytest.approx(-0.9, abs=0.2)
    assert told.tried == len(TRIED) + len(CLOSER)


def test_what_was_fitted_counts_for_no_more_than_its_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plants that stop growing for ten hours: linearly, growth by their lean to the light seemed to explain more."""
    lean, spell = (course_of(where) for where in ("for each 5 cm that the tip leans", "from 18 to 30 h"))
    looks = [Unnamed("growth", lean, 1621.0, np.array([3.5])), Unnamed("growth", spell, 1468.0, np.array([-2.0]))]
    ends = {lean.where: 1315.0, spell.where: 1467.0}
    monkeypatch.setattr(module, "looked_at", lambda *_: looks)
    monkeypatch.setattr(module, "looked_closer", lambda *_: looks[:1])
    monkeypatch.setattr(module, "fitted", lambda _joint, _before, look: replace(look, gain=ends[look.course.where]))
    joint, null, scenes, answers = looked_from([scene_of(84)])
    told = module.unnamed(joint, null, scenes, answers, no_pushes())
    assert (told.course, told.gain) == (spell, 1467.0)


def test_a_push_is_what_drives_besides() -> None:
    """Both ways of driving a scene come to the same stems; growth cannot be less than none."""
    scene = scene_of(88)
    course = course_of("where the tip is far off the middle")
    for drive, size in (("growth", -2.0), ("gain", 0.6)):
        change = Change(pushes=(Push(drive, course, (size,)),))
        still_there = Lanes(base().mean[None], np.zeros((1, 2)), [Change()])
        driven = np.maximum(1.0 + size * scene.course(course), 0.0)
        told = scene.points(still_there, {drive: driven})
        assert np.array_equal(scene.points(Lanes(base().mean[None], np.zeros((1, 2)), [change])), told)
        assert not np.array_equal(scene.points(still_there), told)


def test_moments_are_those_of_the_measured_run() -> None:
    at = moments_of(still(turns(12.0, 6.0, "right"), first_cm=stem(10.0, 0.3)), np.array([0.5, 5.5, 6.5, 10.5]))
    assert at.x_cm == pytest.approx(10.0 * np.sin(0.3))
    assert at.height_cm == pytest.approx(10.0 * np.cos(0.3))
    assert at.side.tolist() == [1.0, 1.0, -1.0, -1.0]
    assert at.since_h == pytest.approx([0.5, 5.5, 0.5, 4.5], abs=0.01)
    lasting = 1.0 - np.exp(-1.0)
    after_six = moments_of(still(turns(12.0, 6.0, "right")), np.array([5.99])).history
    assert after_six == pytest.approx(lasting, abs=0.01)
    assert at.history[3] < 0.0 < at.history[2] < lasting


@pytest.mark.parametrize("course", COURSES, ids=[course.where for course in COURSES])
def test_courses_are_of_the_order_of_one_and_none_is_another(course: Course) -> None:
    moments = moments_of(scene_of(5, light=turns(72.0, 1.7)), np.arange(0.5, 72.0, 1.0))
    own = course.of(moments)
    assert own.shape[0] == 72
    assert 0.1 < np.abs(own).max() < 3.0
    for other in COURSES:
        its = other.of(moments)
        if other is not course and its.shape == own.shape:
            assert np.abs(own - its).max() > 0.05, other.where


@pytest.mark.parametrize(
    ("drive", "where", "size", "words"),
    [
        (
            "gain",
            "where the tip is far off",
            [-0.4],
            "the answer to light is some 40 % lower where the tip is far off the middle",
        ),
        ("growth", "from 30 h", [0.25], "growth is some 25 % higher from 30 h after the start on"),
        ("growth", "from 30 h", [-1.4], "growth is much lower from 30 h after the start on"),
        ("bias", "from 30 h", [-0.01], "something bends stems to the left from 30 h after the start on"),
        ("bias", "where the tip is farther left than 0.7 cm", [0.05], "something holds stems back where the tip is"),
        ("gain", "in a rhythm", [0.0, 0.5], "the answer to light is some 50 % higher in a rhythm of 24 h, most 6 h"),
    ],
)
def test_it_is_said_in_words(drive: str, where: str, size: list[float], words: str) -> None:
    found = Unnamed(drive, course_of(where), 30.0, np.array(size))
    assert found.words.startswith(words)
    assert found.evidence == "with it the runs are e^30 times as probable as without"
