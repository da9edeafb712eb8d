"""flora-flash, flora-capture and flora-led as processes on a private bus, before a grow box that only remembers."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from device_fakes import FakeBox, fake_box
from flora_common.bus import BusClient
from flora_common.clock import SystemClock
from flora_common.files import sha256_of_file
from flora_common.messages import Flash, Frame, FrameMissed, Health, Lamps, LightCommand, Tick
from flora_common.runs import CameraSection, RunFile, RunFolder, run_file_text


@pytest.fixture
def box(bus: Any) -> Iterator[FakeBox]:
    """The box, and a configuration whose three devices are in it, on the machine's time."""
    with fake_box() as box:
        bus.run_dir.mkdir()
        camera = CameraSection(anchor_px=(32.0, 40.0), px_per_cm=4.0, width_px=64, height_px=48)
        (bus.run_dir / "run.toml").write_text(run_file_text(RunFile(camera=camera)))
        bus.sections["rig"]["clock"] = {"kind": "system", "twin": box.address}
        for name in ("flash", "capture", "led"):
            bus.sections[name] = {"backend": "virtual"}
        yield box


@pytest.fixture
def client(bus: Any, box: FakeBox) -> BusClient:
    bus.start_service("flora-bus")
    client: BusClient = bus.client()
    return client


def hear_one(bus: Any, client: BusClient, kind: type, **fields: Any) -> Any:
    """The next message of a type with these fields."""

    def good(arrivals: list[Any]) -> list[Any]:
        messages = [a.message for a in arrivals if a.verdict == "good" and isinstance(a.message, kind)]
        return [m for m in messages if all(getattr(m, name) == value for name, value in fields.items())]

    return good(bus.hear(client, lambda arrivals: bool(good(arrivals))))[0]


def children_of(process: subprocess.Popen[str]) -> list[int]:
    return [int(p) for p in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]


def has_ended(pid: int) -> bool:
    try:
        return "Z (" in Path(f"/proc/{pid}/status").read_text()
    except OSError:  # it may go at any moment, between opening and reading too
        return True


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end_s
        os.sched_yield()


def test_flash_lights_and_every_end_is_dark(bus: Any, box: FakeBox, client: BusClient) -> None:
    flash = bus.start_service("flora-flash")
    assert hear_one(bus, client, Flash, lit=True).confirmed
    assert box.flash
    assert bus.stop(flash)[0] == 0
    assert not box.flash

    (bus.folder / "state" / "flash.json").unlink()
    flash = bus.start_service("flora-flash")
    hear_one(bus, client, Flash, lit=True)
    flash.kill()
    flash.wait()
    assert box.flash  # nobody could help it: this is what ExecStopPost is for
    dark = bus.start_service("flora-flash", "--dark")
    assert dark.wait(20.0) == 0
    assert not box.flash


def test_led_shines_as_told_and_every_end_is_dark(bus: Any, box: FakeBox, client: BusClient) -> None:
    led = bus.start_service("flora-led")
    assert hear_one(bus, client, Lamps).fallback
    client.publish(LightCommand(tick=4, light="right"))
    lamps = hear_one(bus, client, Lamps, tick=4)
    assert (lamps.lit, lamps.fallback) == ("right", False)
    assert (any(box.grb[:432]), any(box.grb[432:])) == (False, True)
    assert bus.stop(led)[0] == 0
    assert box.grb == bytes(864)

    led = bus.start_service("flora-led")
    assert hear_one(bus, client, Lamps, tick=4).lit == "right"  # the bus has kept the command
    led.kill()
    led.wait()
    assert any(box.grb)
    dark = bus.start_service("flora-led", "--dark")
    assert dark.wait(20.0) == 0
    assert box.grb == bytes(864)


def test_capture_photographs_survives_its_camera_and_leaves_no_process(
    bus: Any, box: FakeBox, client: BusClient
) -> None:
    capture = bus.start_service("flora-capture")
    bus.wait_ready(client, "flora-capture")
    client.publish(Flash(tick=1, lit=True, confirmed=True))
    frame = hear_one(bus, client, Frame, tick=1)
    run = RunFolder(bus.run_dir)
    assert sha256_of_file(run.path / frame.path) == frame.sha256
    assert frame.exposure_ok

    (camera,) = children_of(capture)
    os.kill(camera, signal.SIGKILL)
    hear_one(bus, client, Health, source="flora-capture", state="degraded")
    client.publish(Flash(tick=2, lit=True, confirmed=True, time_s=300.0))
    hear_one(bus, client, Frame, tick=2)

    box.silent.add("shutter")
    client.publish(Flash(tick=3, lit=True, confirmed=True, time_s=600.0))
    until(lambda: [request["op"] for request in box.requests].count("shutter") == 3)
    (camera,) = children_of(capture)
    os.kill(camera, signal.SIGKILL)
    assert hear_one(bus, client, FrameMissed, tick=3).because == "camera_gone"

    box.silent.clear()
    client.publish(Flash(tick=4, lit=True, confirmed=True, time_s=900.0))
    hear_one(bus, client, Frame, tick=4)
    (camera,) = children_of(capture)
    assert bus.stop(capture)[0] == 0
    assert not Path(f"/proc/{camera}").exists()
    assert [row.time_s for row in run.read_frames()] == [0.0, 300.0, 900.0]


def test_a_camera_process_does_not_outlive_a_killed_service(bus: Any, box: FakeBox, client: BusClient) -> None:
    capture = bus.start_service("flora-capture")
    bus.wait_ready(client, "flora-capture")
    client.publish(Flash(tick=1, lit=True, confirmed=True))
    frame = hear_one(bus, client, Frame, tick=1)
    (camera,) = children_of(capture)
    capture.kill()
    capture.wait()
    until(lambda: has_ended(camera))
    bus.start_service("flora-capture")
    bus.wait_ready(client, "flora-capture")
    client.publish(Flash(tick=2, lit=True, confirmed=True, time_s=300.0))
    assert hear_one(bus, client, Frame, tick=2).sha256 == frame.sha256


def test_the_three_together_in_lock_step(bus: Any, box: FakeBox, client: BusClient) -> None:
    bus.sections["rig"]["clock"]["kind"] = "twin"
    for name in ("flora-capture", "flora-led", "flora-flash"):
        bus.start_service(name)
    for tick in range(1, 6):
        assert hear_one(bus, client, Tick, tick=tick).time_s == 300.0 * (tick - 1)
        frame = hear_one(bus, client, Frame, tick=tick)
        assert frame.flash_confirmed
        client.publish(LightCommand(tick=tick, light="left" if tick % 2 else "right", t_mono_ns=1))
        hear_one(bus, client, Lamps, tick=tick)
    assert [row.light for row in RunFolder(bus.run_dir).read_frames()][:5] == [
        "dark", "left", "right", "left", "right",
    ]  # fmt: skip


@pytest.mark.parametrize("command", ["flora-flash", "flora-capture", "flora-led"])
def test_a_misspelt_key_is_one_line_and_status_2(bus: Any, box: FakeBox, command: str) -> None:
    bus.sections[command.removeprefix("flora-")] = {"backent": "virtual"}
    process = bus.start_service(command, "--check-config")
    out, err = process.communicate(timeout=20.0)
    assert (process.returncode, out) == (2, "")
    assert err.count("\n") == 1
    assert "did you mean `backend`" in err


@pytest.mark.parametrize("command", ["flora-flash", "flora-capture"])
def test_no_run_folder_is_one_line_and_status_2(bus: Any, box: FakeBox, command: str) -> None:
    (bus.run_dir / "run.toml").unlink()
    process = bus.start_service(command)
    _, err = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert err.splitlines()[-1].endswith("not a run folder, it has no run.toml")


def test_two_rigs_do_not_photograph_into_one_run_folder(bus: Any, box: FakeBox, client: BusClient) -> None:
    first = bus.start_service("flora-capture")
    bus.wait_ready(client, "flora-capture")
    bus.sections["rig"] |= {"name": "other", "state_dir": str(bus.folder / "other-state")}
    second = bus.start_service("flora-capture")
    _, err = second.communicate(timeout=20.0)
    assert second.returncode == 2
    assert err.splitlines()[-1].endswith(
        f"[rig] run_dir {bus.run_dir}: the flora-capture of another rig writes there; give each rig a run folder"
    )
    first.kill()
    first.wait()
    bus.start_service("flora-capture")
    other = BusClient(bus.address, rig="other", source="flora-test", clock=SystemClock())
    bus.clients.append(other)
    other.subscribe_prefixes(b"other/")
    other.connect()
    bus.wait_ready(other, "flora-capture")
