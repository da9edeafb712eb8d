"""Which run to make next: the map of causes and schedules against what further runs really tell."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose_runs import LAW, STEP_S, change_of, known, run_of, scenes_of, turns

from discovery.worlds.case import draw_case
from discovery.worlds.writing import write_case
from flora_common.arrays import Array
from flora_common.light_schedule import parse_schedule
from flora_common.runs import LEVELS
from flora_controller.core import ControllerSection
from flora_controller.source import built_in
from flora_controller.steering import View
from flora_lab.diagnose import chance
from flora_lab.diagnose import next_experiment as next_experiment_module
from flora_lab.diagnose.courses import COURSES
from flora_lab.diagnose.cross_fit import learn_from
from flora_lab.diagnose.explanation import Accepted, Explanation, Stage, Tried
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.joint import Base, Found, Joint, ready
from flora_lab.diagnose.nameless import Unnamed
from flora_lab.diagnose.next_experiment import (
    CLOSE_NATS,
    MOST,
    NO_BETTER,
    NO_CAUSE_NEAR,
    NOT_IN_CATALOGUE,
    NOTHING,
    NOTHING_NEAR,
    TOLD_NATS,
    Candidate,
    candidates_of,
    lost,
    next_experiment,
    planned,
    separating,
    typical,
)
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.schedules import CHOICE, USUAL, Schedule, write_experiment
from flora_lab.diagnose.schedules import turns as turns_of
from flora_lab.diagnose.search import best_start
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import Change
from flora_lab.run_tracks import load_run
from flora_lab.simulator.measured import in_steps

STEPS_H = STEP_S / 3600.0


# Schedules


@pytest.mark.parametrize("schedule", CHOICE, ids=lambda schedule: schedule.name)
def test_the_twin_reads_a_schedule_as_it_is_meant(schedule: Schedule) -> None:
    light = parse_schedule(schedule.text_of(1296 * STEPS_H))
    levels = schedule.levels(1296, STEPS_H)
    told = [LEVELS[light((k + 0.5) * STEP_S)] for k in range(1296)]
    assert np.array_equal(levels, np.array(told))


@pytest.mark.parametrize("schedule", CHOICE, ids=lambda schedule: schedule.name)
def test_a_rig_shines_by_the_experiment_that_is_written(tmp_path: Path, schedule: Schedule) -> None:
    path = tmp_path / "experiment.lights.toml"
    write_experiment(path, schedule.text_of(72.0), hours=72.0, why="First sentence.\nSecond sentence.")
    rule = built_in(ControllerSection(use=str(path)), None, None)
    decided = [rule.decide(View((k + 0.5) * STEP_S, None, None), {}) for k in range(865)]
    assert np.array_equal(
        schedule.levels(864, STEPS_H), np.array([LEVELS[one.light or "both"] for one in decided[:-1]])
    )
    assert [bool(one.over) for one in decided] == [False] * 864 + [True]
    assert path.read_text().startswith("# First sentence.\n# Second sentence.\n# On a rig:")


def test_what_comes_after_a_run_is_not_in_its_plan() -> None:
    by_name = {schedule.name: schedule for schedule in CHOICE}
    dark = by_name["dark after each lamp"]
    assert [dark.text_of(hours) for hours in (6.0, 6.1, 24.0)] == [
        "left",
        "left 6h, dark",
        "left 6h, dark 6h, right 6h, dark",
    ]
    assert by_name["6 h"].text_of(1.0) == "6h"


def test_a_planned_run_is_like_those_that_were_made() -> None:
    scenes = [scene(30, 6.0), scene(31, 6.0)]
    made = planned(scenes, turns_of(1.5))
    assert made.steps == scenes[0].steps
    assert made.first_cm == pytest.approx(np.mean([one.first_cm for one in scenes], axis=0))
    assert np.array_equal(made.light, turns(24.0, 1.5)[: made.steps])
    assert not made.has_temperature
    warm = Scene(replace(scenes[0].run, covariates={"temperature_c": 22.0 + np.sin(np.arange(288) / 20.0)}), LAW, 22.0)
    assert planned([warm], turns_of(1.5)).warmth_c == pytest.approx(warm.warmth_c)


# The map


def scene(seed: int, turns_h: float, **effects: dict[str, float]) -> Scene:
    """A run of one of the law's own plants under equal turns."""
    return Scene(run_of(seed, light=turns(24.0, turns_h), change=change_of(effects)), LAW)


@functools.cache
def early(effect: str, parameter: str, value: float) -> tuple[Scene, ...]:
    return tuple(scenes_of((50, 51), {effect: {parameter: value}}, light=turns(24.0, 6.0)))


def fitted(scenes: Sequence[Scene], base: Base, names: Sequence[str]) -> dict[str, Found]:
    """The best fit with each cause, as the finder makes it; and with none."""
    alone, runs = [], []
    single = base.of_single_runs()
    for one in scenes:
        joint = Joint([ready(one, single, parts_of(one, base.mean), together=0)], single)
        alone.append(joint.fit(joint.null(), 12))
        runs.append(ready(one, base, parts_of(one, alone[-1].traits[0]), together=len(scenes)))
    joint = Joint(runs, base)
    traits, start = (np.concatenate([getattr(fit, part) for fit in alone]) for part in ("traits", "start"))
    null = joint.fit(Found(Hypothesis(), np.zeros(0), traits, start), 12)
    out = {NOTHING: null}
    for name in names:
        forms = [Cause(BY_NAME[name], form) for form in range(len(BY_NAME[name].forms))]
        fits = [joint.fit(best_start(joint, null, cause), 12) for cause in forms]
        out[name] = max(fits, key=lambda fit: fit.evidence)
    return out


def parts_of(one: Scene, traits: Array) -> Array:
    return chance.covariances(one, one.answers(traits, Change()))


def explanation_of(scenes: Sequence[Scene], base: Base, gains: dict[str, float], extra: str = "") -> Explanation:
    """As a search might have ended: the first cause was taken."""
    found = fitted(scenes, base, list(gains))
    null = found[NOTHING]
    tried = tuple(Tried(BY_NAME[name], gain, found[name]) for name, gain in gains.items())
    stage = Stage(null, tried)
    joint = Joint([ready(one, base, parts_of(one, base.mean), together=len(scenes)) for one in scenes], base)
    assert tried[0].found is not None
    if extra == "nothing taken":
        return Explanation(null, null, None, (stage,), (), joint)
    return Explanation(null, tried[0].found, None, (stage,), (Accepted(tried[0], stage),), joint)


def test_what_a_further_run_tells_is_told_before_it_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    base, names = known().base, ["gravitropism", "proprioception"]
    factor = {"gravitropism": {"factor": 2.2}}
    before_runs = list(early("gravitropism", "factor", 2.2))
    before = fitted(before_runs, base, names)
    candidates = [Candidate(name, before[name], 0.0) for name in names]
    schedules = (turns_of(1.0), turns_of(8.0))
    monkeypatch.setattr(next_experiment_module, "CHOICE", schedules)
    row = separating(before_runs, base, candidates)["gravitropism", "proprioception"]
    told = {}
    for schedule in schedules:
        light = schedule.levels(288, STEPS_H)
        further = scenes_of((60, 61), factor, light=light)
        after = fitted([*before_runs, *further], base, names)
        gaps = [fits[names[0]].evidence - fits[names[1]].evidence for fits in (before, after)]
        told[schedule.name] = gaps[1] - gaps[0]
    assert row["8 h"] > 1.5 * row["1 h"] > 0.0
    assert told["8 h"] > told["1 h"]


def test_what_is_the_same_in_light_and_track_is_told_apart_by_no_light() -> None:
    base = known().base
    scenes = list(early("phototropic_latency", "delay_h", 0.5))
    asked = next_experiment(
        scenes, base, explanation_of(scenes, base, {"phototropic_latency": 40.0, "clock_offset": 39.0})
    )
    (row,) = asked.map.values()
    assert max(row.values()) < 1.0
    assert (asked.light_schedule, asked.hours) == ("", 0.0)
    assert asked.separates == ["phototropic_latency", "clock_offset"]
    assert asked.picture == "a picture that shows the lamps change, with its time"
    assert "No light tells phototropic_latency from clock_offset" in asked.why


def test_the_schedule_is_one_that_a_rig_can_run_and_parts_the_causes_most() -> None:
    base = known().base
    scenes = list(early("gravitropism", "factor", 2.2))
    asked = next_experiment(
        scenes, base, explanation_of(scenes, base, {"gravitropism": 12.0, "proprioception": 8.0, "camera_roll": 5.0})
    )
    row = asked.map["gravitropism / proprioception"]
    by_text = {schedule.text_of(24.0): schedule for schedule in CHOICE}
    favoured, chosen = by_text[asked.favours], by_text[asked.light_schedule]
    assert row[favoured.name] == max(row.values())
    assert row[USUAL.name] >= TOLD_NATS
    assert chosen is USUAL  # which tell enough
    assert asked.separates == ["gravitropism", "proprioception"]  # camera_roll lies farther behind than is close
    assert f"A run of 24 h with {chosen.words} is expected" in asked.why  # as long as these are
    assert asked.hours == 24.0
    assert asked.picture == ""


@pytest.mark.parametrize(("usual", "schedule"), [(0.2, "left 6h, dark 6h, right 6h, dark"), (3.0, "6h")])
def test_other_light_is_asked_for_where_the_usual_turns_would_tell_nothing(
    monkeypatch: pytest.MonkeyPatch, usual: float, schedule: str
) -> None:
    base = known().base
    scenes = list(early("gravitropism", "factor", 2.2))

    def told(*_: object, **__: object) -> dict[tuple[str, str], dict[str, float]]:
        return {("gravitropism", "proprioception"): {one.name: usual for one in CHOICE} | {"dark after each lamp": 5.0}}

    monkeypatch.setattr(next_experiment_module, "separating", told)
    asked = next_experiment(scenes, base, explanation_of(scenes, base, {"gravitropism": 12.0, "proprioception": 8.0}))
    assert (asked.light_schedule, asked.favours) == (schedule, "left 6h, dark 6h, right 6h, dark")
    assert (f"By the map dark after each lamp tell 5.0 nats or more; {NO_BETTER}" in asked.why) == (usual > 1.0)
    assert ("with dark after each lamp is expected to tell" in asked.why) == (usual < 1.0)


def test_a_rival_of_the_record_is_settled_by_a_picture() -> None:
    base = known().base
    scenes = list(early("gravitropism", "factor", 2.2))
    asked = next_experiment(scenes, base, explanation_of(scenes, base, {"gravitropism": 12.0, "camera_roll": 8.0}))
    assert asked.picture == "a plumb line in the picture"
    assert "camera_roll" in asked.why


def test_who_comes_into_question() -> None:
    base, scenes = known().base, list(early("gravitropism", "factor", 2.2))
    gains = {"gravitropism": 20.0, "proprioception": 20.5 - CLOSE_NATS, "sag": 19.5 - CLOSE_NATS, "clock_offset": 1.0}
    explanation = explanation_of(scenes, base, gains)
    assert [(one.name, one.behind) for one in candidates_of(explanation)] == [
        ("gravitropism", 0.0),
        ("proprioception", CLOSE_NATS - 0.5),
    ]
    alone = explanation_of(scenes, base, {"gravitropism": 20.0})
    asked = next_experiment(scenes, base, alone)
    assert (asked.map, asked.why) == ({}, NOTHING_NEAR)
    nameless = Unnamed("growth", COURSES[0], 12.0, np.zeros(1))
    assert next_experiment(scenes, base, replace(alone, unnamed=nameless)).why == NOT_IN_CATALOGUE
    many = dict.fromkeys(("gravitropism", "proprioception", "sag", "draught", "camera_roll"), 10.0)
    assert len(candidates_of(explanation_of(scenes, base, many))) == MOST


def test_the_pair_that_is_the_same_comes_into_question_however_far_behind() -> None:
    base, scenes = known().base, list(early("phototropic_latency", "delay_h", 0.5))
    explanation = explanation_of(scenes, base, {"phototropic_latency": 40.0, "clock_offset": 20.0})
    assert [one.name for one in candidates_of(explanation)] == ["phototropic_latency", "clock_offset"]


def test_what_may_be_in_place_of_an_earlier_cause_is_asked_for_where_the_last_has_no_rival() -> None:
    base, scenes = known().base, list(early("phototropic_latency", "delay_h", 0.5))
    first = explanation_of(scenes, base, {"phototropic_latency": 40.0, "clock_offset": 39.0})
    second = explanation_of(scenes, base, {"gravitropism": 20.0, "sag": 1.0})
    both = replace(second, accepted=(*first.accepted, *second.accepted))
    assert [one.name for one in candidates_of(both)] == ["phototropic_latency", "clock_offset"]
    asked = next_experiment(scenes, base, both)
    assert asked.picture == "a picture that shows the lamps change, with its time"
    rival_last = explanation_of(scenes, base, {"gravitropism": 20.0, "proprioception": 18.0})
    both = replace(rival_last, accepted=(*first.accepted, *rival_last.accepted))
    assert [one.name for one in candidates_of(both)] == ["gravitropism", "proprioception"]


def test_what_is_named_is_no_rival_of_an_earlier_cause() -> None:
    base, scenes = known().base, list(early("gravitropism", "factor", 2.2))
    first = explanation_of(scenes, base, {"gravitropism": 12.0, "proprioception": 11.0})
    second = explanation_of(scenes, base, {"proprioception": 20.0})
    both = replace(second, accepted=(*first.accepted, *second.accepted))
    assert next_experiment(scenes, base, both).why == NOTHING_NEAR


def test_a_cause_that_was_nearly_named_is_set_against_nothing() -> None:
    base, scenes = known().base, list(early("gravitropism", "factor", 2.2))
    near = explanation_of(scenes, base, {"gravitropism": 4.0, "sag": 1.0}, "nothing taken")
    assert [one.name for one in candidates_of(near)] == [NOTHING, "gravitropism"]
    assert list(next_experiment(scenes, base, near).map) == ["nothing / gravitropism"]
    far = explanation_of(scenes, base, {"gravitropism": 1.5}, "nothing taken")
    assert candidates_of(far) == []
    assert next_experiment(scenes, base, far).why == NO_CAUSE_NEAR
    nameless = Unnamed("growth", COURSES[0], 12.0, np.zeros(1))
    assert next_experiment(scenes, base, replace(near, unnamed=nameless)).why == NOT_IN_CATALOGUE


# Cases whose plants are not the finder's own


def drawn(folder: Path, effect: str, seed: int) -> tuple[Base, dict[str, list[Scene]]]:
    """The base of a drawn case, and its measured runs by schedule, four of each."""
    case = draw_case(seed, 0, "single", runs=12, effect=effect)
    write_case(case, folder)

    def scenes(part: str, usual_c: float) -> list[Scene]:
        runs = [in_steps(load_run(path)) for path in sorted((folder / part).iterdir())]
        return [Scene(run, LAW.__class__(run.lamps or LAW.lamps), usual_c) for run in runs]

    base = learn_from(scenes("reference", 22.0)).base
    measured = scenes("measured", 22.0)
    by_schedule: dict[str, list[Scene]] = {}
    for run, one in zip(case.measured, measured, strict=True):
        by_schedule.setdefault(run.schedule, []).append(one)
    return base, by_schedule


def as_shone(run: Scene) -> Schedule:
    """The schedule of a run that was made."""
    names = {levels: name for name, levels in LEVELS.items()}
    return Schedule("as shone", tuple((names[tuple(levels)], run.step_h) for levels in run.light.tolist()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "rival", "better", "worse"),
    [
        ("adaptation", "proprioception", "six_hour", "long_dwell"),
        ("camera_roll", "lamp_asymmetry", "random_dwell", "long_dwell"),
    ],
)
def test_the_map_is_right_about_which_schedule_tells_more(
    tmp_path: Path, effect: str, rival: str, better: str, worse: str
) -> None:
    """Two runs were made in six-hour turns, two more follow; over four cases the better one tells more, as said."""
    said, came = {better: 0.0, worse: 0.0}, {better: 0.0, worse: 0.0}
    for seed in range(1, 5):
        base, runs = drawn(tmp_path / f"{seed}", effect, seed)
        made = runs["six_hour"][:2]
        before = fitted(made, base, [effect, rival])
        one, other = (Candidate(name, before[name], 0.0) for name in (effect, rival))
        for schedule in (better, worse):
            further = runs[schedule][-2:]
            for run in further:
                plan = planned(made, as_shone(run))
                own = ready(plan, base, parts_of(plan, base.mean), together=1)
                pair = lost(own, base, typical(own, base, one), other) + lost(own, base, typical(own, base, other), one)
                said[schedule] += 0.5 * pair
            after = fitted([*made, *further], base, [effect, rival])
            came[schedule] += sum(
                sign * (fits[effect].evidence - fits[rival].evidence) for sign, fits in ((1, after), (-1, before))
            )
    print(f"{effect} / {rival}: said {said}, came {came}")
    assert said[better] > said[worse]
    assert came[better] > came[worse] > 0.0
