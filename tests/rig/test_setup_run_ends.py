"""However a setup run ends, nobody takes it for running afterwards; while it lasts, there is no second one."""

from __future__ import annotations

import signal
from typing import Any

import pytest

from flora_common.messages import Health, Setup
from flora_common.runs import CameraSection, RunFile, run_file_text


def asked(heard: list[Any]) -> list[bool]:
    return [a.message.active for a in heard if isinstance(a.message, Setup)]


@pytest.fixture
def bus_of_a_run(bus: Any) -> Any:
    camera = CameraSection(anchor_px=(320.0, 440.0), px_per_cm=18.0, width_px=640, height_px=480)
    bus.run_dir.mkdir()
    (bus.run_dir / "run.toml").write_text(run_file_text(RunFile(camera=camera)))
    bus.start_service("flora-bus")
    return bus


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL])
def test_a_setup_run_that_is_struck_is_over(bus_of_a_run: Any, number: signal.Signals) -> None:
    """SIGHUP is what a lost ssh line sends."""
    bus = bus_of_a_run
    listener = bus.client()
    process = bus.start("flora-stem", "calibrate", "--config", str(bus.config))
    bus.hear(listener, lambda heard: True in asked(heard))

    process.send_signal(number)
    if number != signal.SIGKILL:
        bus.hear(listener, lambda heard: False in asked(heard))
    process.communicate(timeout=20)

    later = bus.client("flora-led")
    heard = bus.hear(later, lambda heard: any(isinstance(a.message, Health) for a in heard))
    assert asked(heard) == [], "who starts later must not light what nobody asks for any more"


def test_two_setup_runs_at_once_do_not_photograph_each_others_lamps(bus_of_a_run: Any) -> None:
    bus = bus_of_a_run
    listener = bus.client()
    first = bus.start("flora-stem", "calibrate", "--config", str(bus.config))
    bus.hear(listener, lambda heard: True in asked(heard))

    second = bus.start("flora-stem", "calibrate", "--again", "--config", str(bus.config))
    _, err = second.communicate(timeout=20)
    assert (second.returncode, err) == (
        2,
        "flora-stem calibrate: another setup run of rig `test` is under way; wait for its end\n",
    )

    first.kill()
    first.communicate(timeout=20)
    third = bus.start("flora-stem", "calibrate", "--config", str(bus.config))
    bus.hear(listener, lambda heard: True in asked(heard))
    third.kill()
    third.communicate(timeout=20)
