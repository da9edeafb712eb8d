"""``flora-lab submit`` and ``serve`` as processes on a real bus: jobs are taken, followed, stopped, gone on with."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from flora_common.bus import Arrival
from flora_common.installed import command
from flora_common.messages import Job, JobProgress
from flora_lab.jobs.book import BOOK_FILE, Book
from flora_lab.jobs.runner import PROGRESS_FILE

DEADLINE_S = 60.0
EVOLVE = ("evolve", "plant.simulator", "--task", "middle", "--runs", "2", "--population", "20", "--no-report")


class Lab:
    """A bus, a lab that takes jobs, and who asks."""

    def __init__(self, bus: Any, tmp_path: Path) -> None:
        self.bus = bus
        self.folder = tmp_path / "jobs"
        bus.sections["lab"] = {"jobs_dir": str(self.folder)}
        bus.start_service("flora-bus")
        self.client = bus.client()
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        self.process = self.bus.start("flora-lab", "serve", "--config", str(self.bus.config))
        self.bus.wait_ready(self.client, "flora-lab")

    def submit(self, *words: str) -> subprocess.CompletedProcess[str]:
        asking = self.bus.start("flora-lab", "submit", "--config", str(self.bus.config), *words)
        out, err = asking.communicate(timeout=DEADLINE_S)
        return subprocess.CompletedProcess(words, asking.returncode, out, err)

    def hear(self, number: str, *stages: str) -> JobProgress:
        """The first word that a job is at one of these stages."""
        found: list[JobProgress] = []

        def is_there(heard: list[Arrival]) -> bool:
            said = [one.message for one in heard]
            found[:] = [m for m in said if isinstance(m, JobProgress) and m.job == number and m.stage in stages]
            return bool(found)

        self.bus.hear(self.client, is_there, deadline_s=DEADLINE_S)
        return found[0]


def runs_in(folder: Path, count: int) -> list[str]:
    words = ["-o", str(folder), "--open-loop", "0", "--closed-loop", "0", "--random", str(count), "--hours", "12"]
    subprocess.run([command("flora-twin"), "runs", *words], check=True, capture_output=True, timeout=DEADLINE_S)
    return [f"{folder.name}/{path.name}" for path in sorted(folder.iterdir())]


@pytest.fixture
def lab(bus: Any, tmp_path: Path) -> Lab:
    return Lab(bus, tmp_path)


def test_a_job_is_done_and_its_result_is_in_the_folder_of_all_jobs(lab: Lab) -> None:
    lab.folder.mkdir()
    runs = runs_in(lab.folder / "few", 3)
    lab.start()
    done = lab.submit("--json", "dataset", *runs, "-o", "data")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["work"], told["stage"], told["share"]) == ("dataset", "done", 1.0)
    assert (lab.folder / "data").is_dir()
    again = lab.submit("--json", "--job", told["job"])
    assert json.loads(again.stdout)["stage"] == "done"
    (kept,) = json.loads((lab.folder / BOOK_FILE).read_text())["jobs"]
    assert (kept["stage"], kept["attempts"]) == ("done", 1)


def test_a_job_whose_output_has_become_a_link_is_refused_when_its_turn_comes(lab: Lab, tmp_path: Path) -> None:
    lab.folder.mkdir()
    book = Book(lab.folder)
    book.ask(Job(job=f"{1:016x}", work="dataset", arguments=("few", "-o", "out/data")), "2026-11-25T08:00:00Z")
    (tmp_path / "elsewhere").mkdir()
    (lab.folder / "out").symlink_to(tmp_path / "elsewhere")
    lab.start()
    assert "a link leads it out" in lab.hear(f"{1:016x}", "refused").text
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_job_that_fails_says_why_and_the_next_is_done(lab: Lab) -> None:
    lab.start()
    failed = lab.submit("dataset", "nothing_there", "-o", "data")
    assert failed.returncode == 1
    assert "failed: nothing_there" in failed.stderr
    assert len(failed.stderr.strip().splitlines()) == 1
    runs = runs_in(lab.folder / "few", 3)
    assert lab.submit("-q", "dataset", *runs, "-o", "data").returncode == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("evovle", "x"), "evolve"),
        (("evolve", "/etc/x", "--task", "left", "-o", "x"), "/etc/x"),
        ((), "name the work"),
        (("--stop",), "--job"),
        (("--job", "12"), "16 digits"),
        (("--job", "0" * 16, "evolve"), "not both"),
        (("--job", "0" * 16), "no such job"),
        (("--job", "0" * 16, "--stop"), "no such job"),
    ],
)
def test_what_no_lab_does_is_refused_in_a_line(lab: Lab, words: tuple[str, ...], said: str) -> None:
    lab.start()
    refused = lab.submit(*words)
    assert refused.returncode == 2
    assert said in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1


def test_the_lab_checks_what_does_not_come_from_its_own_command(lab: Lab) -> None:
    lab.start()
    for number, asked in enumerate(
        [
            Job(job=f"{1:016x}", work="publish", arguments=("x",)),
            Job(job=f"{2:016x}", work="evolve", arguments=("../../etc", "-o", "x")),
        ],
        start=1,
    ):
        lab.client.publish(asked)
        assert lab.hear(f"{number:016x}", "refused").text
    assert not (lab.folder / BOOK_FILE).exists()


def test_without_a_lab_that_takes_jobs_it_says_so(bus: Any) -> None:
    bus.start_service("flora-bus")
    client = bus.client()
    bus.start("flora-lab", "serve", "--config", str(bus.config))
    bus.wait_ready(client, "flora-lab")
    # Time enough for the bus of a busy machine: who has not reached it says that it is missing, not the lab.
    asking = bus.start("flora-lab", "submit", "--config", str(bus.config), "--timeout", "5", "report", "x")
    _, err = asking.communicate(timeout=DEADLINE_S)
    assert asking.returncode == 1
    assert "jobs_dir" in err
    assert len(err.strip().splitlines()) == 1


def test_a_long_job_is_followed_killed_gone_on_with_and_stopped(lab: Lab) -> None:
    """Told how far it is; ended with the lab, it goes on where it was; asked to stop, it keeps what it has."""
    lab.folder.mkdir()
    runs = runs_in(lab.folder / "few", 4)
    lab.start()
    assert lab.submit("-q", "train", *runs, "--recipe", "mechanistic", "-o", "plant.simulator").returncode == 0
    told = lab.submit("--json", "--no-wait", *EVOLVE, "--generations", "100000", "-o", "long")
    number = json.loads(told.stdout)["job"]
    waits = json.loads(lab.submit("--json", "--no-wait", "rhythm", runs[0], "-o", "rhythm").stdout)
    assert (waits["stage"], waits["before"]) == ("waiting", 1)
    end_s = time.monotonic() + DEADLINE_S
    while (progress := lab.hear(number, "working")).share is None:
        assert time.monotonic() < end_s
    assert progress.text
    assert lab.process is not None
    lab.process.terminate()
    assert lab.process.wait(timeout=DEADLINE_S) == 0
    kept = {one["job"]: one for one in json.loads((lab.folder / BOOK_FILE).read_text())["jobs"]}
    assert (kept[number]["stage"], kept[number]["attempts"]) == ("waiting", 1)
    lab.start()
    lab.hear(number, "working")
    end_s = time.monotonic() + DEADLINE_S
    while not (lab.folder / PROGRESS_FILE).exists():  # it has begun in earnest
        assert time.monotonic() < end_s
        time.sleep(0.05)
    stopped = lab.submit("--json", "--job", number, "--stop")
    assert stopped.returncode == 0, stopped.stderr
    assert json.loads(stopped.stdout)["stage"] == "stopped"
    assert (lab.folder / ".long.evolution").exists()  # `--resume` goes on with it
    done = lab.submit("--json", "--job", waits["job"])
    assert json.loads(done.stdout)["stage"] in ("done", "failed")  # its turn has come
