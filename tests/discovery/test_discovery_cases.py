"""The judging from end to end with a finder that always says the same, and which cases are drawn."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from discovery.cases import read_results
from discovery.plans import MIXTURE, MOST_SEED, by_world, parse_kinds, plans
from discovery.worlds.effects import CATALOGUE
from discovery.worlds.outside import OUTSIDE
from flora_common.cli import INTERRUPTED_STATUS
from flora_common.errors import BadInput
from flora_common.files import sha256_of_bytes

ROOT = Path(__file__).resolve().parents[2]
FINDER = """\
#!{python}
import json, os, pathlib, signal, sys, time
arguments = sys.argv[1:]
output = pathlib.Path(arguments[arguments.index("-o") + 1])
case = output.parent
assert arguments[0] == "diagnose" and arguments[-1] == "--quiet"
kept = pathlib.Path({kept!r})
assert ("--no-report" in arguments) != (kept in case.parents)
reference = "".join(sorted(path.read_text() for path in case.glob("reference/*/track.csv")))
assert reference.count("time_s") == 9
if "--simulator" in arguments:
    assert "--reference" not in arguments
    did = "given"
    base = pathlib.Path(arguments[arguments.index("--simulator") + 1])
    assert base.name == "base.simulator"
    assert (base / "learned_from").read_text() == reference
else:
    assert arguments[arguments.index("--reference") + 1] == str(case / "reference")
    did = "learned"
assert all(pathlib.Path(run, "track.csv").is_file() for run in arguments[1:4])
with open({calls!r}, "a") as file:
    file.write(did + "\\n")
if case.name in {fails!r}.split():
    sys.exit("finder: cannot")
if case.name in {interrupts!r}.split():
    os.kill(os.getppid(), signal.SIGINT)
    time.sleep(1.0)
output.mkdir()
if did == "learned":
    (output / "base.simulator").mkdir()
    (output / "base.simulator" / "learned_from").write_text(reference)
cause = {{"effect": "sag", "confidence": 0.9, "nats": 9.0, "parameters": {{"amplitude": 1.0}}, "interval": {{}},
         "confusable_with": []}}
(output / "diagnosis.json").write_text(json.dumps({{"verdict": "explained", "causes": [cause]}}))
"""


def judged(tmp_path: Path, *arguments: str, fails: str = "", interrupts: str = "") -> subprocess.CompletedProcess[str]:
    """The judging as a program of its own; its finder fails in, or is interrupted in, the cases with these keys."""
    program = tmp_path / "finder"
    paths = {"calls": str(tmp_path / "calls"), "kept": str(tmp_path / "kept")}
    text = FINDER.format(python=sys.executable, fails=fails, interrupts=interrupts, **paths)
    program.write_text(text)
    program.chmod(0o755)
    command = [sys.executable, "-m", "tests.discovery.cases", "--program", str(program), "--jobs", "1"]
    command += ["--results", str(tmp_path / "results.jsonl"), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def calls(tmp_path: Path) -> list[str]:
    """What the finder did, call by call."""
    return (tmp_path / "calls").read_text().split()


def test_the_usual_mixture() -> None:
    drawn = plans(400, 1)
    assert len({plan.key for plan in drawn}) == 400
    kinds = Counter(plan.kind for plan in drawn)
    assert kinds == {"none": 100, "outside": 40, "pair": 50, "single": 210}
    assert sum(plan.form for plan in drawn) == 80
    assert {plan.effect for plan in drawn if plan.kind == "single"} == set(CATALOGUE)
    assert {plan.effect for plan in drawn if plan.kind == "outside"} == set(OUTSIDE)
    assert {plan.key for plan in plans(100, 1)} < {plan.key for plan in drawn}
    assert not {plan.seed for plan in plans(400, 2)} & {plan.seed for plan in drawn}


def test_cases_keep_their_keys() -> None:
    """Results that were kept are of these cases; they are worth hours."""
    keys = [plan.key for plan in plans(400, 1)]
    assert keys[:3] == ["single-0-camera_roll-400147-3", "none-0-any-600025-3", "none-0-any-600019-3"]
    assert sha256_of_bytes("\n".join(sorted(keys)).encode()).startswith("84dd0fe969c39752")
    shared = [plan.key for plan in plans(400, 1, per_world=5)]
    assert shared[:2] == ["outside-1-kick-1000000400047-3", "none-1-any-1000000400047.1-3"]


def test_shared_worlds_hold_the_usual_mixture() -> None:
    drawn = plans(400, 1, per_world=5)
    worlds = by_world(drawn)
    assert [plan for world in worlds for plan in world] == drawn
    assert len(worlds) == 80
    for world in worlds:
        assert [plan.number for plan in world] == [0, 1, 2, 3, 4]
        assert 1 <= sum(plan.kind == "none" for plan in world) <= 2
    assert len({plan.key for plan in drawn}) == 400
    assert Counter((plan.kind, plan.form) for plan in drawn) == {
        (kind, form): count * (8 if form == 0 else 2) for kind, count in MIXTURE.items() for form in (0, 1)
    }
    assert {plan.effect for plan in drawn if plan.kind == "outside"} == set(OUTSIDE)
    singles = Counter(plan.effect for plan in drawn if plan.kind == "single")
    assert set(singles) == set(CATALOGUE)
    assert max(singles.values()) - min(singles.values()) <= 2
    assert {plan.key for plan in plans(103, 1, per_world=5)} < {plan.key for plan in drawn}


def test_any_beginning_of_shared_worlds_is_a_fair_sample() -> None:
    for seed in range(5):
        kinds = Counter(plan.kind for plan in plans(400, seed, per_world=5)[:100])
        assert all(abs(kinds[kind] - 100 * weight / 40) <= 5 for kind, weight in MIXTURE.items()), kinds


def test_no_plants_are_seen_in_two_judgings() -> None:
    seeds = [
        {plan.seed for plan in plans(400, seed, per_world=per_world)}
        for seed in (0, 1, MOST_SEED)
        for per_world in (1, 5)
    ]
    assert len(set().union(*seeds)) == sum(map(len, seeds))
    assert max(max(some) for some in seeds) < 2**53  # whole in any reader of JSON


def test_parts_of_it() -> None:
    kinds = parse_kinds("single:0,none")
    assert kinds == [("single", 0), ("none", 0), ("none", 1)]
    drawn = plans(7, 1, kinds=kinds, effects=["sag", "wall"])
    assert Counter((plan.kind, plan.form) for plan in drawn) == {("single", 0): 3, ("none", 0): 2, ("none", 1): 2}
    assert {plan.effect for plan in drawn if plan.kind == "single"} == {"sag"}
    shared = by_world(plans(7, 1, kinds=kinds, effects=["sag", "wall"], per_world=2))
    assert sorted(len(world) for world in shared) == [1, 2, 2, 2]
    assert all(len({plan.form for plan in world}) == 1 for world in shared)
    assert {(plan.kind, plan.form, plan.effect) for world in shared for plan in world} == {
        ("single", 0, "sag"),
        ("none", 0, None),
        ("none", 1, None),
    }
    assert parse_kinds("none:0,none") == [("none", 0), ("none", 1)]
    with pytest.raises(BadInput, match="did you mean `single`"):
        parse_kinds("singel:0")
    with pytest.raises(BadInput, match="neither 0 nor 1"):
        parse_kinds("single:2")


def test_a_judging_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    some = ("--cases", "2", "--kinds", "single:0", "--effects", "sag,draught")
    first = judged(tmp_path, *some, "--markdown", str(tmp_path / "tables.md"))
    assert first.returncode == 0, first.stderr
    assert "right cause first" in first.stdout
    assert "1 of 2" in first.stdout
    assert "draught -> sag 0.90" in first.stdout
    assert (tmp_path / "tables.md").read_text().startswith("### Summary of 2 cases")
    with (tmp_path / "results.jsonl").open("a") as file:
        file.write('{"key": "torn')
    again = judged(tmp_path, *some)
    assert "2 of them in" in again.stdout
    assert "1 cases, 1 of them in" in judged(tmp_path, *some, "--first", "1").stdout
    assert calls(tmp_path) == ["learned", "learned"]


def test_cases_of_a_world_start_from_what_the_first_has_learned(tmp_path: Path) -> None:
    some = ("--cases", "4", "--kinds", "none:0", "--per-world", "2")
    first = judged(tmp_path, *some)
    assert first.returncode == 0, first.stderr
    assert calls(tmp_path) == ["learned", "given"] * 2
    path = tmp_path / "results.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    entries = [json.loads(line) for line in lines]
    assert [entry["learned"] for entry in entries] == [call == "learned" for call in calls(tmp_path)]
    assert all(entry["learned"] == (entry["truth"]["number"] == 0) for entry in entries)
    assert "seconds per case, base learned in it" in first.stdout
    assert first.stdout.count("longest, 2 cases") == 2
    # Interrupted after the first case: its world's base is gone, and the next case learns again.
    path.write_text(lines[0])
    again = judged(tmp_path, *some)
    assert "4 cases, 1 of them in" in again.stdout
    assert calls(tmp_path)[4:] == ["learned", "learned", "given"]
    assert len(read_results(path)) == 4


def test_who_stops_the_judging_does_not_wait_for_the_rest_of_a_world(tmp_path: Path) -> None:
    some = ("--cases", "4", "--kinds", "none:0", "--per-world", "4")
    second = plans(4, 1, kinds=[("none", 0)], per_world=4)[1]
    stopped = judged(tmp_path, *some, interrupts=second.key)
    assert stopped.returncode == INTERRUPTED_STATUS, stopped.stderr
    assert calls(tmp_path) == ["learned", "given"]
    assert len(read_results(tmp_path / "results.jsonl")) == 1
    assert "4 cases, 1 of them in" in judged(tmp_path, *some).stdout
    assert calls(tmp_path)[2:] == ["learned", "given", "given"]


def test_where_learning_fails_the_next_case_of_the_world_learns(tmp_path: Path) -> None:
    some = ("--cases", "3", "--kinds", "none:0", "--per-world", "3")
    first = plans(3, 1, kinds=[("none", 0)], per_world=3)[0]
    done = judged(tmp_path, *some, fails=first.key)
    assert done.returncode == 0, done.stderr
    assert calls(tmp_path) == ["learned", "learned", "given"]
    assert "1 of 3" in done.stdout
    judged(tmp_path, *some)
    assert calls(tmp_path)[3:] == ["learned"]


def test_what_is_kept_has_a_report_and_the_reference(tmp_path: Path) -> None:
    done = judged(tmp_path, "--cases", "2", "--kinds", "none:0", "--per-world", "2", "--keep", str(tmp_path / "kept"))
    assert done.returncode == 0, done.stderr
    assert calls(tmp_path) == ["learned", "given"]
    kept = sorted((tmp_path / "kept").iterdir())
    assert [path.name for path in kept] == sorted(plan.key for plan in plans(2, 1, kinds=[("none", 0)], per_world=2))
    assert all((path / "reference").is_dir() and (path / "diagnosis").is_dir() for path in kept)


def test_a_failed_case_is_told_and_tried_again(tmp_path: Path) -> None:
    some = ("--cases", "1", "--kinds", "none:0")
    failed = judged(tmp_path, *some, fails=plans(1, 1, kinds=[("none", 0)])[0].key)
    assert failed.returncode == 0, failed.stderr
    assert "status 1: finder: cannot" in failed.stdout
    assert "failed" in failed.stdout.splitlines()[-1]
    assert "1 of 1" in judged(tmp_path, *some).stdout
    assert [entry["diagnosis"]["verdict"] for entry in read_results(tmp_path / "results.jsonl").values()] == [
        "explained"
    ]


def test_dry_writes_cases_and_judges_nothing(tmp_path: Path) -> None:
    dry = judged(tmp_path, "--cases", "1", "--kinds", "outside:1", "--dry", "--keep", str(tmp_path / "kept"))
    assert dry.returncode == 0, dry.stderr
    (folder,) = (tmp_path / "kept").iterdir()
    assert json.loads((folder / "truth.json").read_text())["kind"] == "outside"
    assert not (tmp_path / "calls").exists()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--cases", "0"], "at least 1"),
        (["--first", "-1"], "at least 1"),
        (["--first", "0"], "at least 1"),
        (["--per-world", "0"], "at least 1"),
        (["--cases", "100001"], "has seeds for 100000"),
        (["--seed", "-1"], "must lie in [0, 999999]"),
        (["--effects", "wall", "--kinds", "single:0"], "cases of kind `outside`"),
        (["--effects", "sagg"], "did you mean `sag`"),
        (["--dry"], "--keep"),
        (["--cases", "1", "--program", "/nowhere/flora-lab"], "cannot be started"),
    ],
)
def test_what_cannot_be_done_ends_in_one_line(tmp_path: Path, arguments: list[str], word: str) -> None:
    done = judged(tmp_path, *arguments)
    assert done.returncode == 2, done.stderr
    assert word in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_file_of_something_else_is_not_taken_for_results(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text("not json\n{}\n")
    with pytest.raises(BadInput, match="line 1"):
        read_results(path)
