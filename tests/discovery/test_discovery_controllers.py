"""What hidden effects are worth to controllers: with a finder that always says the same, and evolutions of seconds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from discovery import controllers
from discovery.controllers import ACTING, EXTENDED, Setting, is_judged, run_all, tables, true_extension
from discovery.judging import Finder, base_of
from discovery.plans import Plan, plans
from discovery.scoring import pooled
from discovery.worlds.effects import CATALOGUE
from flora_lab.diagnose.controller_gain import Effort
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension, Provenance, write_simulator
from lab.evolve_simulators import mechanistic

LITTLE = Effort(seeds=2, generations=2, population=6, individuals=2, judges=3)
FOUND = Extension("sag", {"amplitude": 0.8})


def stored(simulator: RodSimulator, path: Path, *extensions: Extension) -> None:
    write_simulator(
        path,
        kind=simulator.kind,
        step_s=simulator.step_s,
        weights=simulator.weights(),
        scales=simulator.scales(),
        provenance=Provenance(recipe="none", seed=0, software="test"),
        extensions=extensions,
    )


def judging(world: Sequence[Plan], cases: Path, kept: Path, _: Finder) -> Iterator[dict[str, Any]]:
    """The first case is missed, the second fails, all others are told to sag."""
    for number, plan in enumerate(world):
        folder = cases / plan.key / "diagnosis"
        if number == 0:
            stored(mechanistic(), base_of(plan, kept))
        if number > 1:
            stored(mechanistic(), folder / EXTENDED, FOUND)
        causes = [{"effect": "sag", "parameters": {"amplitude": 0.8}}] if number > 1 else []
        hidden = CATALOGUE[str(plan.effect)].draw(np.random.default_rng(number))
        yield {
            "key": plan.key,
            "truth": {"effects": [{"effect": plan.effect, "parameters": hidden}]},
            "diagnosis": {"verdict": "explained" if causes else "nothing_wrong", "causes": causes},
            "error": "status 1: cannot" if number == 1 else "",
        }


def test_what_is_missed_brings_nothing_back_and_what_is_named_is_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(controllers, "judge_world", judging)
    setting = Setting(Finder(tmp_path, 1.0), ("feedback",), LITTLE, oracle=True)
    wanted = plans(3, 1, 3, [("single", 0)], ACTING, 3)
    results = tmp_path / "results.jsonl"
    missed, failed, named = run_all(wanted, results, setting)
    told = missed["controllers"]["feedback"]
    assert told["difference"]["mean"] == 0.0
    assert told["base"] == told["extended"]
    assert failed["controllers"] is None
    told = named["controllers"]["feedback"]
    assert named["named"] == ["sag"]
    assert {"base", "extended", "oracle", "without_effect", "cost", "difference"} <= set(told)
    assert [json.loads(line) for line in results.read_text().splitlines()] == [missed, failed, named]
    summary, each = tables([missed, failed, named], ["feedback"])
    assert [row[1] for row in summary.rows] == ["2"]
    by_name = dict(zip(summary.header, summary.rows[0], strict=True))
    both = [line["controllers"]["feedback"] for line in (missed, named)]
    brought = [(one["difference"]["mean"], one["oracle"]["mean"] - one["base"]["mean"]) for one in both]
    assert by_name["of what the truth brings"] == str(pooled(brought))
    without = [{**one, "oracle": {**one["base"], "mean": one["base"]["mean"] + 0.2}} for one in both]
    half = [{**one, "difference": {**one["difference"], "mean": 0.1}} for one in without]
    lines = [{**line, "controllers": {"feedback": one}} for line, one in zip((missed, named), half, strict=True)]
    row = dict(zip(summary.header, tables(lines, ["feedback"])[0].rows[0], strict=True))
    assert row["of what the truth brings"].startswith("0.50")
    assert len(each.rows) == 2


def test_only_what_is_not_judged_yet_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def noted(world: Sequence[Plan], *arguments: Any) -> Iterator[dict[str, Any]]:
        asked.extend(plan.key for plan in world)
        return judging(world, *arguments)

    monkeypatch.setattr(controllers, "judge_world", noted)
    setting = Setting(Finder(tmp_path, 1.0), ("plan",), LITTLE, oracle=False)
    wanted = plans(3, 1, 3, [("single", 0)], ACTING, 1)
    results = tmp_path / "results.jsonl"
    first = run_all(wanted[:1], results, setting)
    assert run_all(wanted, results, setting)[0] == first[0]
    assert asked == [plan.key for plan in wanted]


def test_a_line_without_all_that_is_asked_for_is_judged_again() -> None:
    plain = Setting(Finder(Path("f"), 1.0), ("feedback", "plan"), LITTLE, oracle=False)
    with_truth = Setting(Finder(Path("f"), 1.0), ("feedback",), LITTLE, oracle=True)
    both = {"controllers": {"feedback": {"oracle": {}}, "plan": {}}}
    assert is_judged(both, plain)
    assert is_judged(both, with_truth)
    assert not is_judged({"controllers": {"feedback": {}}}, plain)
    assert not is_judged({"controllers": {"feedback": {}, "plan": {}}}, with_truth)
    assert not is_judged({"controllers": None}, plain)
    assert not is_judged(None, plain)


def test_effects_are_those_on_plants_that_a_task_can_tell() -> None:
    acting = {name for name in CATALOGUE if BY_NAME[name].where == "plant"}
    assert acting - set(ACTING) == {"temperature_growth"}
    assert set(ACTING) <= acting
    for name in ACTING:
        true = true_extension({"effect": name, "parameters": CATALOGUE[name].draw(np.random.default_rng(1))})
        mechanistic().extended([true])


def test_a_true_sag_is_put_in_the_simulator_s_unit() -> None:
    assert true_extension({"effect": "sag", "parameters": {"amplitude": 0.6}}).parameters["amplitude"] == pytest.approx(
        0.9
    )


def test_what_comes_back_is_pooled_over_cases() -> None:
    share = pooled([(0.08, 0.1), (0.2, 0.3), (0.01, 0.0), (0.0, -0.02)])
    assert share.value == pytest.approx(0.29 / 0.38)
    assert share.low < share.value < share.high
    same = pooled([(0.05, 0.1)] * 8)
    assert (same.value, same.low, same.high) == pytest.approx((0.5, 0.5, 0.5))
