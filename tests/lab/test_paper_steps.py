"""Steps that are done once: skipped when there, redone when they changed, kept through failures and stops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from flora_common.errors import BadInput
from flora_lab.paper.ledger import STEPS_FILE, check_folder, read_ledger
from flora_lab.paper.steps import Given, Made, Step, do_all, keys

RUNS = Step("runs", "the runs", "grow", ("--seed", "1"))
DATA = Step("data", "the data", "make", ("set", Made("runs", "*")), goes_on=("--resume",), anew=("--force",))
TRIED = Step("tried", "the trial", "try", (Made("data"), "--task", Given("task.toml", "hours = 3")), is_whole=False)
STEPS = (RUNS, DATA, TRIED)


class Recorder:
    """A watcher, a runner and a clock: results are folders with one file, and each command takes ten seconds."""

    def __init__(self, folder: Path, fails: Callable[[Step], BaseException | None] = lambda step: None) -> None:
        self.folder, self.fails = folder, fails
        self.done: list[str] = []
        self.skipped: list[str] = []
        self.begun: list[str] = []
        self.arguments: dict[str, list[str]] = {}
        self.now_s = 0.0

    def kept(self, number: int, step: Step, took_s: float) -> None:
        self.skipped.append(step.name)

    def begins(self, number: int, step: Step, *, is_begun: bool) -> None:
        if is_begun:
            self.begun.append(step.name)

    def ends(self, number: int, step: Step, took_s: float) -> None:
        self.done.append(step.name)

    def run(self, step: Step, arguments: Sequence[str]) -> None:
        self.arguments[step.name] = list(arguments)
        self.now_s += 10.0
        problem = self.fails(step)
        if problem is not None:
            raise problem
        place = self.folder / step.name
        place.mkdir()
        (place / "one").write_text(step.name)


def go(
    folder: Path,
    steps: Sequence[Step] = STEPS,
    *,
    software: str = "flora 1",
    force: bool = False,
    fails: Callable[[Step], BaseException | None] = lambda step: None,
) -> Recorder:
    recorder = Recorder(folder, fails)
    recorder.took_s = do_all(  # type: ignore[attr-defined]
        steps,
        folder,
        software=software,
        run=recorder.run,
        watcher=recorder,
        monotonic_s=lambda: recorder.now_s,
        force=force,
    )
    return recorder


def at(name: str, problem: BaseException) -> Callable[[Step], BaseException | None]:
    return lambda step: problem if step.name == name else None


def test_all_steps_are_done_in_order_with_the_paths_of_what_they_are_made_from(tmp_path: Path) -> None:
    done = go(tmp_path)

    assert done.done == ["runs", "data", "tried"]
    assert done.arguments["runs"] == ["--seed", "1", "-o", str(tmp_path / "runs")]
    assert done.arguments["data"] == ["set", str(tmp_path / "runs" / "one"), "-o", str(tmp_path / "data"), "--force"]
    assert done.arguments["tried"][:3] == [str(tmp_path / "data"), "--task", str(tmp_path / "task.toml")]
    assert (tmp_path / "task.toml").read_text() == "hours = 3"


def test_what_is_there_is_not_done_again_and_its_time_is_still_known(tmp_path: Path) -> None:
    go(tmp_path)

    again = go(tmp_path)

    assert (again.done, again.skipped) == ([], ["runs", "data", "tried"])
    assert again.took_s == {"runs": 10.0, "data": 10.0, "tried": 10.0}  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("steps", "redone"),
    [
        ((replace(RUNS, words=("--seed", "2")), DATA, TRIED), ["runs", "data", "tried"]),
        ((RUNS, replace(DATA, words=(*DATA.words, "--more")), TRIED), ["data", "tried"]),
        ((RUNS, DATA, replace(TRIED, words=(Made("data"), Given("task.toml", "hours = 4")))), ["tried"]),
        ((RUNS, replace(DATA, others=("--quiet",)), TRIED), []),
    ],
)
def test_a_step_that_changed_is_done_anew_with_all_that_follows_from_it(
    tmp_path: Path, steps: tuple[Step, ...], redone: list[str]
) -> None:
    go(tmp_path)

    assert go(tmp_path, steps).done == redone


def test_other_software_does_everything_anew(tmp_path: Path) -> None:
    go(tmp_path)

    assert go(tmp_path, software="flora 2").done == ["runs", "data", "tried"]


def test_a_result_that_was_removed_is_made_again_and_nothing_else(tmp_path: Path) -> None:
    go(tmp_path)
    (tmp_path / "data" / "one").unlink()
    (tmp_path / "data").rmdir()

    assert go(tmp_path).done == ["data"]


@pytest.mark.parametrize("problem", [BadInput("no"), KeyboardInterrupt(), SystemExit(143)])
def test_after_a_failure_or_a_stop_the_same_command_goes_on(tmp_path: Path, problem: BaseException) -> None:
    with pytest.raises(type(problem)):
        go(tmp_path, fails=at("data", problem))
    entry = read_ledger(tmp_path).get("data")
    assert entry is not None
    assert (entry.is_finished, entry.took_s) == (False, 10.0)

    again = go(tmp_path)

    assert (again.skipped, again.begun, again.done) == (["runs"], ["data"], ["data", "tried"])
    assert again.arguments["data"][-1] == "--resume"
    assert again.took_s["data"] == 20.0  # type: ignore[attr-defined]


def test_what_was_begun_with_other_settings_is_dropped(tmp_path: Path) -> None:
    with pytest.raises(BadInput):
        go(tmp_path, fails=at("data", BadInput("no")))

    again = go(tmp_path, (RUNS, replace(DATA, words=(*DATA.words, "--more")), TRIED))

    assert again.begun == []
    assert again.arguments["data"][-1] == "--force"


def test_what_a_killed_command_left_half_written_is_removed(tmp_path: Path) -> None:
    with pytest.raises(BadInput):
        go(tmp_path, fails=at("data", BadInput("no")))
    (tmp_path / ".data.x.part").mkdir()

    go(tmp_path)

    assert not (tmp_path / ".data.x.part").exists()


def test_a_whole_result_that_nobody_was_left_to_note_is_believed_and_a_growing_one_is_not(tmp_path: Path) -> None:
    def killed_after(name: str) -> Callable[[Step], BaseException | None]:
        def fail(step: Step) -> BaseException | None:
            if step.name == name:
                (tmp_path / name).mkdir()
                return SystemExit(137)
            return None

        return fail

    with pytest.raises(SystemExit):
        go(tmp_path, fails=killed_after("data"))
    with pytest.raises(SystemExit):
        go(tmp_path, fails=killed_after("tried"))
    (tmp_path / "tried").rmdir()

    last = go(tmp_path)

    assert (last.skipped, last.done) == (["runs", "data"], ["tried"])


def test_force_does_everything_anew(tmp_path: Path) -> None:
    go(tmp_path)

    assert go(tmp_path, force=True).done == ["runs", "data", "tried"]


def test_keys_differ_where_two_steps_differ_only_in_their_name() -> None:
    found = keys((RUNS, replace(RUNS, name="other")), "flora 1")

    assert found["runs"] != found["other"]


def test_a_folder_with_other_files_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")

    with pytest.raises(BadInput, match="holds other files"):
        check_folder(tmp_path)

    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("format = 'flora-paper-0'", "format flora-paper-0 is not known"),
        ("format = ", "steps.toml"),
        ("format = 'flora-paper-1'\n[[step]]\nname = 'a'\nkey = 'x'\nis_finished = true\ntook_s = 0.0", "key"),
    ],
)
def test_a_damaged_ledger_is_told_with_its_file(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / STEPS_FILE).write_text(text)

    with pytest.raises(BadInput, match=said):
        check_folder(tmp_path)
