"""The virtual rig's supervisor does what systemd does: READY, restart, start limit, darkening, polite stop."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from flora_common.errors import BadInput
from flora_common.installed import command
from flora_common.runs import RunFile
from flora_twin.box import camera_section
from flora_twin.main import main
from flora_twin.rig.experiment import parse_speed
from flora_twin.rig.layout import make_layout, remove_sockets
from flora_twin.rig.supervisor import ServiceFailed, ServiceRefused, Supervisor, wait_until
from flora_twin.rig.virtual_rig import VirtualRig

READY = """
import os, signal, socket, sys
s = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
s.sendto(b"READY=1", os.environ["NOTIFY_SOCKET"])
signal.sigwait([signal.SIGTERM])
"""


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[Supervisor]:
    with tempfile.TemporaryDirectory(prefix="flora-") as sockets:
        one = Supervisor(Path(sockets), tmp_path)
        yield one
        one.stop_all()


def python(code: str) -> list[str]:
    # The signal is blocked before READY, so that sigwait and not the default action takes it.
    return [sys.executable, "-c", "import signal; signal.pthread_sigmask(0, [signal.SIGTERM])\n" + code]


def test_ready_is_heard_and_sigterm_ends_it(supervisor: Supervisor) -> None:
    supervisor.start("a", python(READY))
    assert supervisor.children["a"].ready
    assert supervisor.stop("a") == 0


def test_a_dead_process_is_started_again_and_becomes_ready(supervisor: Supervisor) -> None:
    supervisor.start("a", python(READY))
    first = supervisor.children["a"].pid
    supervisor.kill("a", signal.SIGKILL)
    wait_until(
        lambda: supervisor.children["a"].restarts == 1 and supervisor.children["a"].ready,
        within_s=20.0,
        poll=supervisor.poll,
        what="second life",
    )
    assert supervisor.children["a"].pid != first


def test_bad_configuration_is_not_tried_again(supervisor: Supervisor) -> None:
    supervisor.launch("a", [sys.executable, "-c", "print('flora.toml: bad'); raise SystemExit(2)"])
    with pytest.raises(ServiceRefused, match=r"^flora\.toml: bad"):
        supervisor.wait_ready(["a"], within_s=20.0)


def test_a_crash_loop_ends(supervisor: Supervisor) -> None:
    supervisor.launch("a", ["false"])
    with pytest.raises(ServiceFailed, match="ended with status 1"):
        supervisor.wait_ready(["a"], within_s=60.0)


def test_one_that_ends_at_its_start_is_told_at_once_with_its_last_line(supervisor: Supervisor) -> None:
    began_s = time.monotonic()
    supervisor.launch("a", [sys.executable, "-c", "raise OverflowError('too large a seed')"])
    with pytest.raises(ServiceFailed, match="a ended with status 1 at its start: OverflowError: too large a seed"):
        supervisor.wait_ready(["a"], within_s=30.0)
    assert supervisor.children["a"].restarts == 0
    assert time.monotonic() - began_s < 10.0


def test_one_that_is_killed_at_its_start_is_started_again(supervisor: Supervisor, tmp_path: Path) -> None:
    killed = tmp_path / "killed"
    once = f"import os, pathlib\nif not pathlib.Path({str(killed)!r}).exists():\n"
    once += f"    pathlib.Path({str(killed)!r}).touch(); os.kill(os.getpid(), 9)\n"
    supervisor.start("a", python(once + READY))
    assert supervisor.children["a"].restarts == 1


@pytest.fixture
def starting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], VirtualRig]]:
    """Makes a virtual rig whose grow box is a program of ours, and is not started yet."""
    with contextlib.ExitStack() as stack:

        def make(code: str) -> VirtualRig:
            program = tmp_path / "flora-twin"
            program.write_text(f"#!{sys.executable}\n{code}\n")
            program.chmod(0o755)
            monkeypatch.setattr("flora_twin.rig.virtual_rig.command", lambda _: str(program))
            layout = make_layout(tmp_path / "rig", RunFile(camera=camera_section()))
            return stack.enter_context(VirtualRig(layout, seed=1))

        yield make


def test_a_box_that_dies_at_its_start_is_told_and_not_waited_for(starting: Callable[[str], VirtualRig]) -> None:
    began_s = time.monotonic()
    with pytest.raises(ServiceFailed, match="flora-twin ended with status 1 at its start: no such plant"):
        starting("raise SystemExit('no such plant')").start()
    assert time.monotonic() - began_s < 10.0


def test_ctrl_c_is_heard_while_the_box_starts(starting: Callable[[str], VirtualRig]) -> None:
    rig = starting("import time; time.sleep(600)")
    threading.Timer(0.3, rig.supervisor.interrupt).start()
    began_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        rig.start()
    assert time.monotonic() - began_s < 5.0


def test_after_ctrl_c_all_end_together_and_no_lamp_is_darkened(supervisor: Supervisor, tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    slow = f"import sys, time\nopen({str(calls)!r}, 'a').write(' '.join(sys.argv[1:]) + ';')\n{READY}\ntime.sleep(1)"
    names = ["flora-led", "flora-flash", "c", "d"]
    for name in names:
        supervisor.launch(name, python(slow))
    supervisor.wait_ready(names)
    began_s = time.monotonic()
    supervisor.end_all(names)
    assert time.monotonic() - began_s < 3.0
    assert calls.read_text() == ";;;;"


def test_lamps_are_darkened_after_every_death(supervisor: Supervisor, tmp_path: Path) -> None:
    log = tmp_path / "calls"
    code = f"""
import sys
open({str(log)!r}, 'a').write(' '.join(sys.argv[1:]) + ';')
if '--dark' in sys.argv: sys.exit()
"""
    supervisor.start("flora-led", python(code + READY))
    supervisor.kill("flora-led")
    wait_until(
        lambda: supervisor.children["flora-led"].restarts == 1 and supervisor.children["flora-led"].ready,
        within_s=20.0,
        poll=supervisor.poll,
        what="second life",
    )
    supervisor.stop("flora-led")
    assert log.read_text() == ";--dark;;--dark;"


def test_darkening_may_need_what_is_yet_to_be_started_again(supervisor: Supervisor, tmp_path: Path) -> None:
    box, lamp = tmp_path / "box", tmp_path / "flora-led"
    supervisor.start("box", python(f"open({str(box)!r}, 'a').write('.')\n" + READY))
    code = f"""
import sys, time
if '--dark' in sys.argv:
    while len(open({str(box)!r}).read()) < 2: time.sleep(0.01)
    sys.exit()
open({str(lamp)!r}, 'a').write('.')
"""
    supervisor.start("flora-led", python(code + READY))
    supervisor.kill("flora-led")
    supervisor.kill("box")
    wait_until(
        lambda: all(child.restarts == 1 and child.ready for child in supervisor.children.values()),
        within_s=10.0,
        poll=supervisor.poll,
        what="second life of both",
    )
    assert lamp.read_text() == ".."


def test_what_a_dead_service_leaves_running_goes_with_it(supervisor: Supervisor, tmp_path: Path) -> None:
    pid_file = tmp_path / "pid"
    code = (
        f"import subprocess; p = subprocess.Popen(['sleep', '600']); open({str(pid_file)!r}, 'w').write(str(p.pid))\n"
    )
    supervisor.start("a", python(code + READY))
    supervisor.kill("a")
    child = Path("/proc") / pid_file.read_text() / "cmdline"

    def has_ended() -> bool:
        try:
            return child.read_bytes() == b""
        except OSError:  # it may have gone at any moment
            return True

    wait_until(has_ended, within_s=10.0, poll=supervisor.poll, what="its end")


STRUCK = """
import os, signal, sys
from pathlib import Path
from flora_twin.rig import supervisor

class Late:
    def prctl(self, *arguments):
        os.kill(os.getppid(), signal.SIGKILL)
        while os.getppid() == parent:
            pass
        libc.prctl(*arguments)

parent, libc, supervisor._LIBC = os.getpid(), supervisor._LIBC, Late()
supervisor.Supervisor(Path(sys.argv[1]), Path(sys.argv[1])).launch("a", ["sh", "-c", sys.argv[2]])
"""


def test_what_is_being_started_while_the_supervisor_is_killed_is_not_begun(tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    with tempfile.TemporaryDirectory(prefix="flora-") as sockets:
        program = [sys.executable, "-c", STRUCK, sockets, f"echo $$ > {begun}; exec sleep 600"]
        struck = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        struck.communicate(timeout=20.0)
        assert struck.returncode == -signal.SIGKILL
        end_s = time.monotonic() + 1.0
        while not begun.exists() and time.monotonic() < end_s:
            time.sleep(0.01)
    if begun.exists():
        os.kill(int(begun.read_text()), signal.SIGKILL)
        pytest.fail("it would have run for ever")


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path) -> None:
    keep = tmp_path / "thesis.tex"
    keep.write_text("years of work")
    with pytest.raises(BadInput, match="holds other files"):
        make_layout(tmp_path, RunFile(camera=camera_section()))
    assert keep.read_text() == "years of work"


def test_a_layout_is_made_anew_in_its_own_folder(tmp_path: Path) -> None:
    first = make_layout(tmp_path / "rig", RunFile(camera=camera_section()))
    (first.run.path / "old").touch()
    remove_sockets(first)
    second = make_layout(tmp_path / "rig", RunFile(camera=camera_section()))
    assert not (second.run.path / "old").exists()
    assert second.run.read_run_file().camera == camera_section()
    remove_sockets(second)
    assert not second.sockets.exists()


@pytest.mark.parametrize(("text", "rate"), [("lockstep", 0.0), ("realtime", 1.0), ("300", 300.0)])
def test_speeds(text: str, rate: float) -> None:
    assert parse_speed(text) == rate


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--speed", "warp"], "write lockstep, realtime, or a number"),
        (["--speed", "-3"], "write lockstep, realtime, or a number"),
        (["--fault", "nas_gon@3h"], "did you mean `nas_gone`?"),
        (["--hours", "0"], "0"),
    ],
)
def test_bad_demo_arguments_end_with_one_line_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    began_s = time.monotonic()
    assert main(["demo", "--out", str(tmp_path / "out"), *arguments]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.strip().count("\n") == 0
    assert not (tmp_path / "out").exists()
    assert time.monotonic() - began_s < 30.0


@pytest.mark.parametrize(
    ("number", "is_in_setup_run"),
    [(signal.SIGTERM, False), (signal.SIGHUP, False), (signal.SIGKILL, False), (signal.SIGKILL, True)],
)
def test_a_demo_that_is_ended_leaves_no_process_behind(
    tmp_path: Path, number: signal.Signals, *, is_in_setup_run: bool
) -> None:
    demo = subprocess.Popen(
        [command("flora-twin"), "demo", "--out", str(tmp_path / "out"), "--quiet", "--no-dashboard"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )

    def mine() -> list[Path]:
        """Command lines that name this test's folder, the demo itself left out."""
        found = []
        for file in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                if str(tmp_path).encode() in file.read_bytes() and file.parent.name != str(demo.pid):
                    found.append(file)
        return found

    def is_begun() -> bool:
        return any(tmp_path.glob("**/background/*.jpg")) if is_in_setup_run else len(mine()) >= 9

    try:
        wait_until(is_begun, within_s=60.0, poll=lambda: None, what="the rig")
        demo.send_signal(number)
        demo.wait(30.0)
        wait_until(lambda: not mine(), within_s=30.0, poll=lambda: None, what="the end of all")
    finally:
        demo.kill()
        demo.wait()
