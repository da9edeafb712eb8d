"""The judging from end to end with a finder that always says the same, and which cases are drawn."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from discovery.cases import parse_kinds, plans, read_results
from discovery.worlds.effects import CATALOGUE
from discovery.worlds.outside import OUTSIDE
from flora_common.errors import BadInput

ROOT = Path(__file__).resolve().parents[2]
FINDER = """\
#!{python}
import json, pathlib, sys
arguments = sys.argv[1:]
output = pathlib.Path(arguments[arguments.index("-o") + 1])
reference = pathlib.Path(arguments[arguments.index("--reference") + 1])
assert arguments[0] == "diagnose" and arguments[-1] == "--quiet"
assert len(list(reference.glob("*/track.csv"))) == 9
assert all(pathlib.Path(run, "track.csv").is_file() for run in arguments[1:4])
with open({calls!r}, "a") as file:
    file.write("called\\n")
if {fails}:
    sys.exit("finder: cannot")
output.mkdir()
cause = {{"effect": "sag", "confidence": 0.9, "parameters": {{"amplitude": 1.0}}, "interval": {{}},
         "confusable_with": []}}
(output / "diagnosis.json").write_text(json.dumps({{"verdict": "explained", "causes": [cause]}}))
"""


def judged(tmp_path: Path, *arguments: str, fails: bool = False) -> subprocess.CompletedProcess[str]:
    program = tmp_path / "finder"
    text = FINDER.format(python=sys.executable, calls=str(tmp_path / "calls"), fails=fails)
    program.write_text(text)
    program.chmod(0o755)
    command = [sys.executable, "-m", "tests.discovery.cases", "--program", str(program), "--jobs", "1"]
    command += ["--results", str(tmp_path / "results.jsonl"), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


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


def test_parts_of_it() -> None:
    kinds = parse_kinds("single:0,none")
    assert kinds == [("single", 0), ("none", 0), ("none", 1)]
    drawn = plans(7, 1, kinds=kinds, effects=["sag", "wall"])
    assert Counter((plan.kind, plan.form) for plan in drawn) == {("single", 0): 3, ("none", 0): 2, ("none", 1): 2}
    assert {plan.effect for plan in drawn if plan.kind == "single"} == {"sag"}
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
    assert (tmp_path / "calls").read_text().count("called") == 2


def test_a_failed_case_is_told_and_tried_again(tmp_path: Path) -> None:
    some = ("--cases", "1", "--kinds", "none:0")
    failed = judged(tmp_path, *some, fails=True)
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
