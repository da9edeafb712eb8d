"""``flora-lab dataset``: the command, its files, and what it refuses."""

from __future__ import annotations

import hashlib
import json
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from flora_common.errors import BadInput
from flora_common.runs import TRACK_HEADER, track_line
from flora_lab.dataset.recipe import STEP_NAMES, steps_named
from flora_lab.dataset.store import read_dataset
from flora_lab.main import main
from flora_twin.main import main as twin


@pytest.fixture(scope="module")
def nine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's dataset experiments with nine virtual plants."""
    folder = tmp_path_factory.mktemp("nine") / "runs"
    assert twin(["runs", "-o", str(folder), "--seed", "1"]) == 0
    return folder


@pytest.fixture(scope="module")
def made(nine: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The training set of these."""
    folder = tmp_path_factory.mktemp("made") / "data"
    assert main(["dataset", *all_runs(nine), "-o", str(folder), "--quiet"]) == 0
    return folder


def all_runs(folder: Path) -> list[str]:
    return [str(path) for path in sorted(folder.iterdir())]


def track_text(count: int = 30, *, phase: float = 0.0, step_s: float = 300.0) -> str:
    """A stem that grows and swings; lamps change half way."""
    lines = [TRACK_HEADER]
    for i in range(count):
        tip = np.array([2.0 * np.sin(0.2 * i + phase), 8.0 + 0.05 * i])
        points = np.outer(np.arange(10) / 9.0, tip)
        lines.append(track_line(step_s * i, "left" if i < count // 2 else "right", points))
    return "\n".join(lines) + "\n"


def small(tmp_path: Path, **changes: Any) -> Path:
    path = tmp_path / "plant.csv"
    path.write_text(track_text(**changes))
    return path


SMALL = ["--min-runs", "1", "--min-tips", "1", "--generic-hours", "0.5", "--generic-share", "0.2"]


# From the nine runs


def test_nine_virtual_runs_make_about_as_many_vectors_as_the_paper_has(
    nine: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["dataset", *all_runs(nine), "-o", str(tmp_path / "data")]) == 0
    said = capsys.readouterr().out
    print(said)
    rows = {line.split()[0]: line.split()[1:] for line in said.splitlines()[1:-1]}
    assert list(rows) == ["tracks", *STEP_NAMES]
    assert rows["tracks"] == ["7785", "7776", "-"]  # 9 runs of 72 h, a stem every five minutes
    final = int(rows["jumps"][1])
    assert rows["jumps"][2] == "101162"
    assert final == pytest.approx(101_162, rel=0.05)
    assert f"{final} vectors of 9 runs" in said
    data = read_dataset(made)
    assert [[str(c.stems), str(c.vectors)] for c in data.info.count] == [row[:2] for row in rows.values()]
    assert len(data.pairs) == final
    assert sorted(set(data.plants.tolist())) == [f"virtual bean, seed {i}" for i in range(1, 10)]
    assert sorted(np.unique(data.pairs.sequence).tolist()) == list(range(68))
    # back in centimetres these are stems of beans
    tips = data.pairs.inputs[:, 16:18] * data.unit_cm
    assert np.abs(tips[:, 0]).max() < 15.0
    assert 5.0 < tips[:, 1].min() < tips[:, 1].max() < 30.0


def test_the_same_tracks_and_seed_give_the_same_bytes_and_another_seed_does_not(
    nine: Path, made: Path, tmp_path: Path
) -> None:
    for name, more, same in (("again", [], True), ("other", ["--seed", "2"], False)):
        folder = tmp_path / name
        assert main(["dataset", *all_runs(nine), "-o", str(folder), "--quiet", *more]) == 0
        for file in ("data.npz", "dataset.toml"):
            assert ((folder / file).read_bytes() == (made / file).read_bytes()) is same


def test_what_is_written_says_where_it_came_from(nine: Path, made: Path) -> None:
    info = tomllib.loads((made / "dataset.toml").read_text())
    assert sorted(path.name for path in made.iterdir()) == ["data.npz", "dataset.toml"]
    assert info["data_sha256"] == hashlib.sha256((made / "data.npz").read_bytes()).hexdigest()
    assert [run["name"] for run in info["run"]] == [path.name for path in sorted(nine.iterdir())]
    for run in info["run"]:
        assert run["sha256"] == hashlib.sha256(Path(run["file"]).read_bytes()).hexdigest()
    assert info["recipe"]["noise"] == {"sequences": 3, "theta_3": 100, "omega": 0.1, "mean": "offset"}
    assert info["recipe"]["seed"] == 1


def test_measured_vectors_are_the_tracks_own_rows(nine: Path, made: Path) -> None:
    data = read_dataset(made)
    pairs = data.pairs
    tables = [np.genfromtxt(path / "track.csv", delimiter=",", skip_header=1) for path in sorted(nine.iterdir())]
    lights = [
        [line.split(",")[1] for line in (p / "track.csv").read_text().splitlines()[1:]] for p in sorted(nine.iterdir())
    ]
    chosen = np.nonzero((pairs.sequence == 0) & ~pairs.mirrored)[0]
    assert len(chosen) > 7000
    for i in chosen[::97]:
        run, row = int(pairs.run[i]), int(pairs.row[i])
        assert pairs.inputs[i, :18] * data.unit_cm == pytest.approx(tables[run][row, 4:], abs=1e-4)
        assert pairs.outputs[i] * data.unit_cm == pytest.approx(tables[run][row + 1, 4:], abs=1e-4)
        assert pairs.inputs[i, 18] == (lights[run][row + 1] == "right")


# Steps by name


def test_steps_are_listed_and_their_names_are_what_without_takes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dataset", "--list-steps"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["tracks", *STEP_NAMES]
    assert main(["dataset", "--list-steps", "--json"]) == 0
    assert [step["step"] for step in json.loads(capsys.readouterr().out)] == list(STEP_NAMES)
    assert steps_named(["jumps", "noise"]) == ("noise-eq8-16", "jumps")


@pytest.mark.parametrize("step", [name for name in STEP_NAMES if name != "pairs"])
def test_each_step_can_be_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str], step: str) -> None:
    track, out = small(tmp_path), tmp_path / "data"
    assert main(["dataset", str(track), "-o", str(out), "--without", step, "--json", *SMALL]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [c["step"] for c in told["counts"]] == ["tracks", *(name for name in STEP_NAMES if name != step)]
    assert told["recipe"]["without"] == [step]
    assert read_dataset(out).info.vectors == told["vectors"]


def test_counts_of_a_small_track_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    track = small(tmp_path)
    assert main(["dataset", str(track), "-o", str(tmp_path / "data"), "--json", *SMALL]) == 0
    counts = {c["step"]: (c["stems"], c["vectors"]) for c in json.loads(capsys.readouterr().out)["counts"]}
    # 30 stems, 29 steps; four times as many with noise. Movements of half an hour are 6 stems, and a fifth of 30 stems
    # is one of them: 6 stems and 5 steps, 64 times. All of it twice.
    assert counts["sparse-areas"] == (30, 29)
    assert counts["noise-eq8-16"] == (120, 116)
    assert counts["generic-eq17"] == (120 + 64 * 6, 116 + 64 * 5)
    assert counts["mirror"] == counts["pairs"] == (1008, 872)


def test_a_track_whose_name_is_no_utf_8_makes_a_training_set(tmp_path: Path) -> None:
    track = small(tmp_path).rename(tmp_path / os.fsdecode(b"pl\xe4nt.csv"))
    folder = tmp_path / os.fsdecode(b"r\xfcn")
    folder.mkdir()
    (folder / "track.csv").write_text(track_text(phase=1.0))
    out = tmp_path / "data"
    assert main(["dataset", str(track), str(folder), "-o", str(out), "--json", *SMALL]) == 0
    runs = read_dataset(out).info.run
    assert [run.name for run in runs] == [run.plant for run in runs] == ["pl\ufffdnt", "r\ufffdn"]
    assert runs[0].file == f"{tmp_path}/pl\ufffdnt.csv"


# What is refused


def refused(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """The one line with which a command ends that has bad input."""
    assert main(["dataset", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    return err


def test_no_runs_no_output_and_a_missing_file_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "data"
    assert "no RUNS given" in refused(capsys, ["-o", str(out)])
    assert "-o is missing" in refused(capsys, [str(small(tmp_path))])
    assert "absent.csv: no such run or track" in refused(capsys, [str(tmp_path / "absent.csv"), "-o", str(out)])
    os.mkfifo(tmp_path / "pipe.csv")
    for path in ("/dev/zero", str(tmp_path / "pipe.csv")):
        assert f"{path}: not a regular file; write what it gives into one" in refused(capsys, [path, "-o", str(out)])
    (tmp_path / "empty").mkdir()
    assert "holds no track.csv; make it with `flora-lab track" in refused(
        capsys, [str(tmp_path / "empty"), "-o", str(out)]
    )
    (tmp_path / "odd" / "track.csv").mkdir(parents=True)
    said = refused(capsys, [str(tmp_path / "odd"), "-o", str(out)])
    assert f"{tmp_path / 'odd' / 'track.csv'}: is a folder, where the run's track must be" in said
    (tmp_path / "many" / "a").mkdir(parents=True)
    (tmp_path / "many" / "a" / "track.csv").write_text(track_text())
    assert "name the runs in it" in refused(capsys, [str(tmp_path / "many"), "-o", str(out)])
    assert not out.exists()


def line_changed(number: int, change: Callable[[list[str]], list[str]]) -> str:
    lines = track_text().splitlines()
    lines[number] = ",".join(change(lines[number].split(",")))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (line_changed(7, lambda v: [*v[:5], "nan", *v[6:]]), "line 8: y2 is `nan`, not a finite number"),
        (line_changed(7, lambda v: [*v[:5], "inf", *v[6:]]), "line 8: y2 is `inf`, not a finite number"),
        (line_changed(7, lambda v: [v[0], "green", *v[2:]]), "line 8: light is `green`"),
        (line_changed(7, lambda v: [v[0], "dark", *v[2:]]), "row 7 (time_s 1800): light is `dark`"),
        (line_changed(7, lambda v: [v[0], "both", *v[2:]]), "row 7 (time_s 1800): light is `both`"),
        (line_changed(7, lambda v: ["1600.0", *v[1:]]), "row 7 (time_s 1600): 100 s after the row before"),
        (line_changed(7, lambda v: [*v[:2], "0.5", *v[3:]]), "row 7 (time_s 1800): point 1 is the anchor"),
        (line_changed(7, lambda v: [*v[:-1], "1790.0"]), "line 8: y10 is 1790, beyond 500; y10 is in cm"),
        (
            line_changed(7, lambda v: [*v[:-1], "179.0"]),
            "row 7 (time_s 1800): a point is more than 60 cm from the anchor",
        ),
        (line_changed(7, lambda v: ["1e300", *v[1:]]), "line 8: time_s is 1e+300, beyond 1e+12; time_s is in seconds"),
        (line_changed(7, lambda v: ["1e9", *v[1:]]), "line 8: time_s 1e+09 is more than a year after the first, 0"),
        (track_text(step_s=600.0), "row 2 (time_s 600): 600 s after the row before; steps of 300 s are wanted"),
        (track_text(step_s=60.0), "row 2 (time_s 60): 60 s after the row before"),
        (track_text(count=1), "no two stems one step apart"),
        (TRACK_HEADER + "\n", "holds no rows"),
    ],
)
def test_a_track_that_cannot_be_used_is_told_with_its_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    good, bad, out = tmp_path / "good.csv", tmp_path / "bad.csv", tmp_path / "data"
    good.write_text(track_text(phase=1.0))
    bad.write_text(text)
    runs = [str(bad)] if "no two stems" in said else [str(good), str(bad)]
    told = refused(capsys, [*runs, "-o", str(out), *SMALL])
    assert said in told
    assert "bad.csv" in told
    assert not out.exists()


def test_a_dark_first_row_is_fine_and_other_dark_rows_can_be_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    track = tmp_path / "plant.csv"
    plain = ["--json", *SMALL, *(f"--without={name}" for name in ("noise", "generic", "mirror", "dupl", "jumps"))]
    track.write_text(line_changed(1, lambda v: [v[0], "dark", *v[2:]]))
    assert main(["dataset", str(track), "-o", str(tmp_path / "a"), *plain]) == 0
    assert json.loads(capsys.readouterr().out)["vectors"] == 29
    track.write_text(line_changed(9, lambda v: [v[0], "dark", *v[2:]]))
    assert "--skip-other-lights" in refused(capsys, [str(track), "-o", str(tmp_path / "b"), *plain])
    assert main(["dataset", str(track), "-o", str(tmp_path / "b"), "--skip-other-lights", *plain]) == 0
    # row 9 was dark in the interval before it: the pair of rows 8 and 9 (7 and 8 from 0) is not there
    assert json.loads(capsys.readouterr().out)["vectors"] == 28
    rows = read_dataset(tmp_path / "b").pairs.row.tolist()
    assert rows == [row for row in range(29) if row != 7]


def test_a_row_that_is_missing_is_a_gap_and_a_late_beat_is_none(tmp_path: Path) -> None:
    lines = track_text().splitlines()
    late = lines[20].split(",")
    lines[20] = ",".join([f"{float(late[0]) + 12.0}", *late[1:]])
    del lines[10]
    track = tmp_path / "plant.csv"
    track.write_text("\n".join(lines) + "\n")
    plain = ["--quiet", *SMALL, *(f"--without={name}" for name in ("noise", "generic", "mirror", "dupl", "jumps"))]
    assert main(["dataset", str(track), "-o", str(tmp_path / "data"), *plain]) == 0
    assert read_dataset(tmp_path / "data").pairs.row.tolist() == [row for row in range(28) if row != 8]


def test_what_shone_over_a_gap_does_not_matter(tmp_path: Path) -> None:
    lines = line_changed(11, lambda v: [v[0], "dark", *v[2:]]).splitlines()
    del lines[10]
    track = tmp_path / "plant.csv"
    track.write_text("\n".join(lines) + "\n")
    plain = ["--quiet", *SMALL, *(f"--without={name}" for name in ("noise", "generic", "mirror", "dupl", "jumps"))]
    assert main(["dataset", str(track), "-o", str(tmp_path / "data"), *plain]) == 0
    pairs = read_dataset(tmp_path / "data").pairs
    assert pairs.row.tolist() == [row for row in range(28) if row != 8]
    assert pairs.inputs[:, 18].tolist() == [float(row >= 13) for row in pairs.row.tolist()]


def test_wrong_numbers_and_names_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    track, out = str(small(tmp_path)), tmp_path / "data"
    assert "did you mean `mirror`" in refused(capsys, [track, "-o", str(out), "--without", "miror"])
    assert "made of pairs" in refused(capsys, [track, "-o", str(out), "--without", "pairs"])
    for option, number, said in (
        ("--theta-3", "0", ">= 1"),
        ("--cell-cm", "1e-300", ">= 0.001"),
        ("--unit-cm", "inf", "<= 1000000.0"),
        ("--interval-s", "nan", "> 0.0"),
        ("--generic-hours", "1e300", "<= 1000.0"),
        ("--noise-sequences", "101", "<= 100"),
    ):
        told = refused(capsys, [track, "-o", str(out), option, number])
        assert f"{option}: expected a number {said}, it is {float(number):g}\n" in told
    assert "no area is dense enough" in refused(capsys, [track, "-o", str(out), "--min-tips", "1000"])
    copy = tmp_path / "copy.csv"
    copy.write_text(track_text())
    assert "is the same track as" in refused(capsys, [track, str(copy), "-o", str(out)])
    assert not out.exists()


def test_a_stem_that_never_moves_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = np.outer(np.arange(10) / 9.0, (1.0, 8.0))
    track = tmp_path / "still.csv"
    track.write_text("\n".join([TRACK_HEADER, *(track_line(300.0 * i, "left", points) for i in range(30))]) + "\n")
    still = [str(track), "-o", str(tmp_path / "data"), *SMALL, "--without", "noise"]
    assert "no stem ever moves" in refused(capsys, still)


# The folder


def test_an_existing_output_is_kept_unless_it_is_a_training_set_and_force_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    track, out = str(small(tmp_path)), tmp_path / "data"
    assert main(["dataset", track, "-o", str(out), "--quiet", *SMALL]) == 0
    before = (out / "data.npz").read_bytes()
    assert "is there already" in refused(capsys, [track, "-o", str(out), "--seed", "5", *SMALL])
    assert (out / "data.npz").read_bytes() == before
    assert main(["dataset", track, "-o", str(out), "--seed", "5", "--force", "--quiet", *SMALL]) == 0
    assert (out / "data.npz").read_bytes() != before
    assert read_dataset(out).info.recipe.seed == 5
    (out / "notes.txt").write_text("mine")
    assert "is not a training set" in refused(capsys, [track, "-o", str(out), "--force", *SMALL])
    assert (out / "notes.txt").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "plant.csv"]


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    out = tmp_path / "data"
    assert main(["dataset", str(small(tmp_path)), "-o", str(out), "--quiet", *SMALL]) == 0
    return out


def test_reading_tells_what_is_damaged(stored: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such training set"):
        read_dataset(tmp_path / "absent")
    with pytest.raises(BadInput, match="not a training set"):
        read_dataset(tmp_path)
    data = stored / "data.npz"
    whole = data.read_bytes()
    data.write_bytes(whole[:5000] + bytes([whole[5000] ^ 1]) + whole[5001:])
    with pytest.raises(BadInput, match="is damaged"):
        read_dataset(stored)
    data.unlink()
    with pytest.raises(BadInput, match="cannot be read"):
        read_dataset(stored)


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("inputs", lambda a: np.where(a == a.max(), np.nan, a).astype(np.float32), "not finite"),
        ("inputs", lambda a: np.concatenate([a[:, :18], a[:, 18:] + 1], axis=1), "neither 0"),
        ("inputs", lambda a: a.astype(np.float64), "`inputs` is float64"),
        ("outputs", lambda a: a[:-1], "`outputs` is float32"),
        ("run", lambda a: a + 1, "does not list"),
        ("row", None, "expected inputs, outputs, run, row"),
    ],
)
def test_reading_checks_every_array(stored: Path, name: str, change: Callable[[Any], Any] | None, said: str) -> None:
    """Arrays that were exchanged together with their hash: by hand, or by another program."""
    with np.load(stored / "data.npz") as archive:
        arrays = {key: archive[key] for key in archive.files}
    if change is None:
        del arrays[name]
    else:
        arrays[name] = change(arrays[name])
    np.savez(stored / "data.npz", **arrays)
    info = tomllib.loads((stored / "dataset.toml").read_text())
    info["data_sha256"] = hashlib.sha256((stored / "data.npz").read_bytes()).hexdigest()
    (stored / "dataset.toml").write_text(tomli_w.dumps(info))
    with pytest.raises(BadInput, match=said):
        read_dataset(stored)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("format", 2, "format 2 is not known"),
        ("vectors", "many", "expected `int`"),
        ("colour", 1, "unknown key `colour`"),
    ],
)
def test_reading_checks_the_table(stored: Path, key: str, value: object, said: str) -> None:
    info = tomllib.loads((stored / "dataset.toml").read_text())
    (stored / "dataset.toml").write_text(tomli_w.dumps({**info, key: value}))
    with pytest.raises(BadInput, match=said):
        read_dataset(stored)
