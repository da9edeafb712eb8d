"""Commands as child processes: their last line, their status, and how they are stopped."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

import pytest

from flora_common.lock import hold
from flora_lab.paper.children import ChildFailed, run_child


@pytest.fixture
def held(tmp_path: Path):  # type: ignore[no-untyped-def]
    descriptor = hold(tmp_path / ".lock")
    yield descriptor
    os.close(descriptor)


def python(code: str, held: int, *, is_silent: bool = True) -> None:
    run_child(sys.executable, ["-c", code], held=held, is_silent=is_silent)


def test_a_failing_command_is_told_by_its_last_line_and_its_status(held: int) -> None:
    with pytest.raises(ChildFailed, match=r"^flora-lab: no such run \(status 2\)$") as told:
        python("import sys; print('flora-lab: no such run', file=sys.stderr); sys.exit(2)", held)

    assert told.value.exit_status == 2


def test_a_traceback_is_shown_over_its_last_line(held: int, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ChildFailed, match=r"^ZeroDivisionError: division by zero \(status 1\)$"):
        python("1 / 0", held)

    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("is_silent", [True, False])
def test_a_command_that_a_signal_ended_is_told_so(held: int, is_silent: bool) -> None:
    with pytest.raises(ChildFailed, match="signal 9") as told:
        python("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", held, is_silent=is_silent)

    assert told.value.exit_status == 1


def test_what_a_command_prints_as_its_result_is_not_shown(held: int, capfd: pytest.CaptureFixture[str]) -> None:
    python("print('a table'); import sys; print('a bar', file=sys.stderr)", held, is_silent=False)

    told = capfd.readouterr()
    assert (told.out, told.err) == ("", "a bar\n")


def test_a_command_that_is_stopped_names_what_a_person_has_typed(held: int, capfd: pytest.CaptureFixture[str]) -> None:
    python(
        "import sys; from flora_lab.stopped_work import going_on; print(going_on(), file=sys.stderr)",
        held,
        is_silent=False,
    )
    assert capfd.readouterr().err == "the same `flora-lab paper` goes on\n"


def test_after_ctrl_c_the_command_is_ended_and_its_end_is_waited_for(held: int, tmp_path: Path) -> None:
    started, ended = tmp_path / "started", tmp_path / "ended"
    code = (
        "import pathlib, signal, sys, time\n"
        "signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(143))\n"
        "try:\n"
        f"    pathlib.Path({str(started)!r}).write_text('')\n"
        "    while True:\n"
        "        time.sleep(0.01)\n"  # signal.pause() would miss a signal that comes just before it
        "finally:\n"
        f"    pathlib.Path({str(ended)!r}).write_text('kept')\n"
    )

    is_over = threading.Event()

    def interrupt() -> None:
        while not started.exists() and not is_over.wait(0.01):
            continue
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            python(code, held)
    finally:
        is_over.set()
        thread.join()

    assert ended.read_text() == "kept"


def test_a_command_holds_the_lock_as_long_as_it_runs(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    descriptor = hold(path)
    code = (
        "import fcntl, os\n"
        f"assert os.path.samestat(os.fstat({descriptor}), os.stat({str(path)!r}))\n"
        f"other = os.open({str(path)!r}, os.O_RDWR)\n"
        "try:\n"
        "    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)\n"
        "except BlockingIOError:\n"
        "    raise SystemExit(7)\n"
    )

    with pytest.raises(ChildFailed, match="status 7"):
        python(code, descriptor)

    os.close(descriptor)
