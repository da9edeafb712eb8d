"""What naming a cause is worth: errors on runs that no fit has seen, and controllers."""

from __future__ import annotations

import functools
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from diagnose_runs import known, scenes_of
from evolve_simulators import mechanistic

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.diagnose import boosting, light_plans, stored_base
from flora_lab.diagnose.controller_gain import Effort, Kind, bred, controller_gain
from flora_lab.diagnose.corrected_gain import CORRECTED, corrected_gain
from flora_lab.diagnose.diagnosis import Gain
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Accepted, Explanation
from flora_lab.diagnose.gain import POOLED, SIMULATORS, _left_out, measure_gain
from flora_lab.diagnose.hypothesis import Hypothesis
from flora_lab.diagnose.joint import Found
from flora_lab.diagnose.mended_simulator import BASE, STILL
from flora_lab.diagnose.replayed import replayed
from flora_lab.diagnose.rivals import last_choice
from flora_lab.diagnose.scene import Scene
from flora_lab.effects.effect import Change
from flora_lab.evolve.episode import HEIGHT, TIME, scored
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.scenario_batch import arrays_of, collide, fitness
from flora_lab.evolve.task import LEFT, REALITY
from flora_lab.simulator import terms
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.interface import Chance
from flora_lab.simulator.shape import can_start
from flora_lab.simulator.store import Extension
from flora_lab.simulator.tropism_traits import NAMES

DRAUGHT = {"draught": {"drive_per_cm_h": 0.12}}
MEASURED, HELD_OUT = (30, 31, 32), (40, 41)


@functools.cache
def measured() -> tuple[Scene, ...]:
    return tuple(scenes_of(MEASURED, DRAUGHT))


@functools.cache
def explained() -> Explanation:
    return Explainer(measured(), known()).explain()


def gain_of(runs: int = 3, held_out: bool = False, explanation: Explanation | None = None) -> tuple[Gain, int]:
    """And how many runs were judged."""
    judged: list[None] = []
    further = scenes_of(HELD_OUT, DRAUGHT) if held_out else []
    told = measure_gain(
        measured()[:runs],
        known().base,
        explanation or explained(),
        further,
        lambda: judged.append(None),
    )
    return told, len(judged)


# Errors on runs


def test_the_extended_simulator_is_better_on_runs_that_no_fit_has_seen() -> None:
    assert explained().found.hypothesis.names() == ("draught",)
    told, judged = gain_of()
    assert judged == 3
    assert list(told.free_running) == ["1h", "6h", "end"]  # whole hours of a run of a day are one less than a day
    assert set(told.one_step) == {*SIMULATORS, *(name + POOLED for name in SIMULATORS)}
    end = told.free_running["end"]
    assert end["extended"] < 0.8 * end["base"]
    assert end["extended" + POOLED] < 0.8 * end["base" + POOLED]
    assert end["extended"] < min(end["boosted"], end["still"])
    assert "each of 3 runs by what the others tell" in told.judged_on


def test_runs_that_were_held_out_judge_alone() -> None:
    told, judged = gain_of(held_out=True)
    assert judged == 2
    assert told.free_running["end"]["extended"] < told.free_running["end"]["base"]
    assert told.judged_on.startswith("2 runs held out")
    assert msgspec.json.decode(msgspec.json.encode(told), type=Gain) == told


def test_a_run_has_no_say_in_what_it_is_judged_by() -> None:
    explanation = explained()
    folds, other = _left_out(explanation)
    assert [(fold.learned_from, fold.judged) for fold in folds] == [((1, 2), (0,)), ((0, 2), (1,)), ((0, 1), (2,))]
    assert other == 0
    # The last run made to look as if nothing were wrong: only the folds that it is not judged in may care.
    runs = list(explanation.joint.runs)
    runs[2] = replace(runs[2], measured=runs[2].measured * 0.5)
    explanation.joint.runs, kept = runs, explanation.joint.runs
    changed, _ = _left_out(explanation)
    explanation.joint.runs = kept
    both = list(zip(folds, changed, strict=True))
    assert [np.array_equal(a.change.terms, b.change.terms) for a, b in both] == [False, False, True]
    assert [np.array_equal(a.typical, b.typical) for a, b in both] == [False, False, True]


def test_plants_that_were_measured_tell_of_the_typical_one() -> None:
    """Where the reference was of plants that bend half as readily, the measured ones mend what is typical."""
    trait = NAMES.index("photoception_per_cm_h")
    weaker = np.zeros(len(NAMES))
    weaker[trait] = np.log(0.5)
    base = known().base
    doubt = base.doubt.copy()
    doubt[trait, trait] = 0.5**2
    wrong = replace(base, mean=base.mean + weaker, doubt=doubt)
    found = explained().found
    mended = wrong.mean_with(found.traits)
    assert abs(mended - base.mean)[trait] < 0.3 * abs(weaker[trait])

    def off_mm(mean: Array) -> float:
        change = found.hypothesis.change(found.coordinates)
        runs = [replayed(scene, base, mean, mean, np.zeros(2), change) for scene in scenes_of(HELD_OUT, DRAUGHT)]
        return float(np.sqrt(np.nanmean([run.error_mm("typical")[:, -1] ** 2 for run in runs])))

    assert off_mm(mended) < 0.8 * off_mm(wrong.mean)


def test_a_rival_that_wins_without_a_run_is_what_the_run_is_judged_by() -> None:
    explanation = explained()
    stage = last_choice(explanation)
    assert stage is not None
    worse = next(tried for tried in reversed(stage.tried) if tried.found is not None)
    assert worse.found is not None
    # As if the search had taken one of the worst causes.
    mistaken = replace(explanation, found=worse.found, accepted=(Accepted(worse, stage),))
    folds, other = _left_out(mistaken)
    assert other == 3
    assert all(fold.change.terms[terms.PUSH] == pytest.approx(0.12, abs=0.03) for fold in folds)
    told = measure_gain(measured(), known().base, mistaken)
    assert "which they did not 3 times" in told.judged_on


def test_one_run_cannot_judge() -> None:
    told, judged = gain_of(runs=1)
    assert judged == 0
    assert (told.one_step, told.free_running) == ({}, {})
    assert "--holdout" in told.judged_on


def test_without_a_cause_there_is_no_gain() -> None:
    found = explained().found
    null = Found(Hypothesis(), np.zeros(0), found.traits, found.start)
    assert gain_of(explanation=replace(explained(), found=null, accepted=())) == (Gain(), 0)


# The black box


def test_the_black_box_learns_a_step_and_runs_away_no_farther_than_a_stem_is_long() -> None:
    scene, base = measured()[0], known().base
    run = replayed(scene, base, base.mean, base.mean, np.zeros(2), Change())
    box = boosting.learned([scene], [run])
    left = boosting.one_step_error_cm(scene, run, box)
    assert np.mean(left[:, -1] ** 2) < 0.9 * np.mean(run.step_error_cm[:, -1] ** 2)
    stems = boosting.run_freely(scene, run, base.mean, box)
    assert stems.shape == (scene.steps, 10, 2)
    assert np.isfinite(stems).all()
    assert not stems[:, 0].any()


def test_what_the_black_box_learned_nothing_of_lies_between_what_it_did() -> None:
    class Model:
        def __init__(self, value: float) -> None:
            self.value = value

        def predict(self, seen: Array) -> Array:
            return np.full(len(seen), self.value)

    tip_x, tip_y, upper, lower = 0.9, 0.18, 0.6, -0.3
    box = boosting.BlackBox(tuple(Model(value) for value in (tip_x, tip_y, upper, lower)))
    added = box.residual_cm(np.zeros((2, 23)))
    assert added.shape == (2, 10, 2)
    assert added[1, :, 0] == pytest.approx([0.0, -0.1, -0.2, -0.3, 0.0, 0.3, 0.6, 0.7, 0.8, 0.9])
    assert added[1, :, 1] == pytest.approx(0.02 * np.arange(10))


def test_a_box_that_corrects_the_stem_away_leaves_the_simulators() -> None:
    class Vanishing(boosting.BlackBox):
        """Takes away all of the stem that it is shown; a step adds less than a millimetre."""

        def residual_cm(self, seen: Array) -> Array:
            stems = np.zeros((len(seen), 10, 2))
            stems[:, 1:] = seen[:, :18].reshape(-1, 9, 2)
            return -stems

    scene, base = measured()[0], known().base
    run = replayed(scene, base, base.mean, base.mean, np.zeros(2), Change())
    stems = boosting.run_freely(scene, run, base.mean, Vanishing(()))
    assert np.isfinite(stems).all()
    assert np.abs(stems[0, -1]).max() < 0.1  # what it told
    assert not can_start(stems[:1])[0]


def test_stems_that_lie_on_the_soil_are_no_start_of_a_step() -> None:
    scene, base = measured()[0], known().base
    points = scene.run.points_cm.copy()
    points[100:130] *= 1e-3
    flat = Scene(replace(scene.run, points_cm=points), scene.law)
    run = replayed(flat, base, base.mean, base.mean, np.zeros(2), Change())
    assert len(run.step_rows) > 0
    assert not set(range(100, 130)) & set(run.step_rows.tolist())


# Controllers


LITTLE = Effort(seeds=2, generations=2, population=6, individuals=1, judges=3)
SHORT = replace(REALITY, name="short", hours=12.0)


@pytest.mark.parametrize("kind", ["feedback", "plan"])
def test_controllers_of_both_simulators_meet_the_same_plants(kind: Kind) -> None:
    base = mechanistic()
    evolved: list[None] = []
    plant = base.extended([Extension("sag", {"amplitude": 0.7})])
    twice = [bred(SHORT, base, kind, LITTLE, on_evolved=lambda: evolved.append(None)) for _ in range(2)]
    assert len(evolved) == 4
    told = controller_gain(*twice, plant)
    assert told["base"] == told["extended"]  # evolved alike, judged alike
    assert told["difference"] == {"mean": 0.0, "standard_error": 0.0}
    assert told["base"]["worst_plant"] <= told["base"]["mean"] <= 1.0
    assert 0.0 <= told["base"]["collisions"] <= 1.0
    assert told["cost"]["mean"] == pytest.approx(told["without_effect"]["mean"] - told["base"]["mean"], abs=2e-4)
    assert "oracle" not in told
    msgspec.json.encode(told)


def test_a_plant_that_has_no_effect_costs_nothing() -> None:
    base = mechanistic()
    in_base = bred(SHORT, base, "plan", LITTLE)
    told = controller_gain(in_base, in_base, base, oracle=in_base)
    assert told["cost"]["mean"] == 0.0
    assert told["recovered"] is None
    assert told["oracle"] == told["base"]


def test_a_plan_is_run_as_a_simulator_runs_lamps() -> None:
    simulator = mechanistic().extended([Extension("sag", {"amplitude": 0.7})])
    task = replace(LEFT, name="short", hours=20.0)
    genes = np.random.default_rng(2).uniform(-0.6, 2.4, (3, light_plans.TURNS + 1))
    genes[:, -1] = [-1.0, 1.0, 1.0]
    lamps = light_plans.lamps(genes, task.most_steps)
    seeds = Individuals(2).seeds()
    assert seeds is not None
    told, hit = light_plans.run_plans(simulator, task, seeds, lamps)
    for plant, seed in enumerate(seeds):
        state = simulator.start(np.repeat(task.start_stem_cm[None], 3, axis=0), Chance(np.full(3, seed)))
        stems = [simulator.stems_cm(state)]
        for is_right in lamps:
            state, points = simulator.step(state, np.stack([~is_right, is_right], axis=1).astype(float), 300.0)
            stems.append(points)
        for plan in range(3):
            course = np.stack(stems)[:, plan]
            for s in range(len(task.scenarios)):
                edges = np.repeat(arrays_of(task).edges[s][None], len(course), axis=0)
                touches, high = collide(course, edges), course[:, -1, 1] >= task.stop_height_cm
                over = np.flatnonzero(touches | high)
                end = over[0] if len(over) else len(course) - 1
                reason = 0 if touches[end] else HEIGHT if high[end] else TIME
                wanted = fitness(course[end, -1], arrays_of(task).targets[s])
                assert told[plan, s, plant] == pytest.approx(float(scored(task, wanted, np.array(reason))), abs=1e-9)
                assert hit[plan, s, plant] == (reason == 0)
    assert hit.any()
    assert not hit.all()


def test_genes_are_turns() -> None:
    genes = np.full((2, light_plans.TURNS + 1), np.log(2.0))
    genes[:, -1] = [-1.0, 1.0]
    lamps = light_plans.lamps(genes, 60)
    assert lamps[:24, 0].tolist() == [False] * 24
    assert lamps[24:48, 0].all()
    assert not lamps[48:, 0].any()
    assert np.array_equal(lamps[:, 0], ~lamps[:, 1])


def test_plans_get_better() -> None:
    wanted = np.log(3.0)

    def judge(genes: Array) -> Array:
        return np.asarray(-np.abs(genes[:, : light_plans.TURNS] - wanted).mean(axis=1))

    ends = [judge(light_plans.evolved(judge, generations, 20, seed=1))[0] for generations in (1, 30)]
    assert ends[1] > 0.5 * ends[0]
    assert judge(light_plans.evolved(judge, 30, 20, seed=1))[0] == ends[1]


@pytest.mark.parametrize("held_out", [False, True])
def test_a_learned_simulator_is_judged_as_it_is_and_corrected(held_out: bool) -> None:
    """Of one that knows what the base knows, what is added is all that it lacked."""
    learned = stored_base.simulator_of(known().base, LampsSection(), DataRange(30.0, 20.0), None)
    further = [scene.run for scene in scenes_of(HELD_OUT, DRAUGHT)] if held_out else []
    runs = [scene.run for scene in measured()]
    told = corrected_gain(learned, learned, explained(), runs, further)  # type: ignore[arg-type]
    for row in told["tip_error_mm"].values():
        assert set(row) == {BASE, CORRECTED, STILL}
    for when in ("24h", "end", "mean"):
        row = told["tip_error_mm"][when]
        assert row[CORRECTED] < 0.7 * row[BASE]
    assert told["judged_on"] == ("2 runs held out" if held_out else "each of 3 runs, by what the others tell")
    assert corrected_gain(learned, learned, explained(), runs[:1]) == {}  # type: ignore[arg-type]
