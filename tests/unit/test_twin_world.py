"""The world and its server: each operation, malformed requests, and faults."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from served_world import RIGHT, START_NS, Rig, make

from flora_common import files
from flora_twin.faults import MENU, OPERATIONS
from flora_twin.server import TRUTH
from flora_twin.strips import STRIP_BYTES

SHUTTER = {"op": "shutter", "exposure_us": 20_000, "analogue_gain": 1.0, "colour_gains": [1.9, 1.6]}


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return make(tmp_path / "state")


@pytest.fixture(scope="module")
def eye(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """One world for the tests that take pictures: building a studio takes a second."""
    return make(tmp_path_factory.mktemp("eye"))


def test_time_passes_only_by_waiting_in_lock_step_and_never_back(rig: Rig) -> None:
    rig.clock.now_s += 500.0
    assert rig.ask("now") == {"ok": True, "time_s": 0.0, "t_utc_ns": START_NS, "rate": 0.0, "planted": True}
    assert rig.ask("wait", until_s=300.0)["time_s"] == 300.0
    assert rig.ask("wait", until_s=10)["time_s"] == 300.0
    assert rig.ask("now")["t_utc_ns"] == START_NS + 300 * 10**9


def test_time_follows_the_clock_at_the_rate_and_waiting_answers_at_once(tmp_path: Path) -> None:
    rig = make(tmp_path, rate=60.0)
    rig.clock.now_s += 10.0
    assert rig.ask("wait", until_s=1e6)["time_s"] == pytest.approx(600.0)
    rig.clock.now_s += 1.5
    assert rig.ask("now")["time_s"] == pytest.approx(690.0)
    again = make(tmp_path, rate=60.0)
    assert again.ask("now")["time_s"] == pytest.approx(600.0)  # the last checkpoint


def test_the_plant_bends_to_the_bytes_on_the_strips_and_the_course_does_not_depend_on_who_asks(tmp_path: Path) -> None:
    seldom, often = make(tmp_path / "a"), make(tmp_path / "b")
    for rig in (seldom, often):
        assert rig.ask("strips", grb=RIGHT) == {"ok": True}
    seldom.ask("wait", until_s=4 * 3600.0)
    for minute in range(0, 241, 7):
        often.ask("wait", until_s=minute * 60.0)
    often.ask("wait", until_s=4 * 3600.0)
    a, b = seldom.server.world.truth(), often.server.world.truth()
    assert a is not None
    assert b is not None
    assert a.tip_cm[0] > 0.5
    assert np.allclose(a.points_cm, b.points_cm, atol=1e-9)


def test_a_plant_that_is_out_of_the_box_does_not_age(rig: Rig) -> None:
    rig.ask("plant", present=False)
    rig.ask("wait", until_s=6 * 3600.0)
    assert rig.ask("now")["planted"] is False
    assert rig.server.world.plants.time_s == 0.0
    rig.ask("plant", present=True)
    rig.ask("wait", until_s=7 * 3600.0)
    assert rig.server.world.plants.time_s == 3600.0


def test_a_photograph_comes_with_its_truth_beside_it(eye: Rig) -> None:
    eye.ask("flash", on=True)
    reply = eye.ask(**SHUTTER, name="0001")
    picture = cv2.imdecode(np.frombuffer(reply["jpeg"], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (1232, 1640, 3)
    assert {"ExposureTime", "AnalogueGain", "DigitalGain", "ColourGains", "SensorTimestamp"} <= set(reply["metadata"])
    line = json.loads((eye.folder / TRUTH).read_text().splitlines()[-1])
    assert line["sha256"] == files.sha256_of_bytes(reply["jpeg"])
    assert line["name"] == "0001"
    assert line["seed"] == 3
    assert line["flash"] is True
    assert len(line["points_cm"]) == 10
    assert line["tip_cm"] == line["points_cm"][-1] == line["centreline_cm"][-1]
    assert len(line["centreline_px"]) == len(line["centreline_cm"])


def test_without_a_plant_the_truth_has_no_stem(eye: Rig) -> None:
    eye.ask("plant", present=False)
    eye.ask(**SHUTTER)
    eye.ask("plant", present=True)
    line = json.loads((eye.folder / TRUTH).read_text().splitlines()[-1])
    assert line["planted"] is False
    assert "points_cm" not in line


def test_a_hanging_camera_never_answers_and_everything_else_does(eye: Rig) -> None:
    eye.ask("fault", name="camera_hangs", on=True)
    assert eye.server.handle(msgpack.packb(SHUTTER)) is None
    assert eye.ask("now")["ok"] is True
    eye.ask("fault", name="camera_hangs", on=False)
    assert eye.ask(**SHUTTER)["ok"] is True
    eye.ask("fault", name="camera_hangs", on=True, times=1)
    assert eye.server.handle(msgpack.packb(SHUTTER)) is None
    assert eye.ask(**SHUTTER)["ok"] is True


def test_a_torn_picture_ends_too_early_once(eye: Rig) -> None:
    eye.ask("fault", name="torn_jpeg", on=True, times=1)
    torn = eye.ask(**SHUTTER)["jpeg"]
    assert not torn.endswith(b"\xff\xd9")
    assert eye.ask(**SHUTTER)["jpeg"].endswith(b"\xff\xd9")


def test_a_dead_flash_says_so(rig: Rig) -> None:
    assert rig.ask("flash", on=True)["on"] is True
    rig.ask("fault", name="flash_dead", on=True)
    assert rig.server.world.flash is False
    assert rig.ask("flash", on=True) == {"ok": True, "on": False}
    rig.ask("fault", name="flash_dead", on=False)
    assert rig.ask("flash", on=True)["on"] is True
    assert rig.ask("flash", on=False)["on"] is False


def test_a_dead_flash_is_not_used_up_by_switching_off(rig: Rig) -> None:
    rig.ask("fault", name="flash_dead", on=True, times=1)
    rig.ask("flash", on=False)
    assert rig.ask("flash", on=True)["on"] is False
    assert rig.ask("flash", on=True)["on"] is True


def test_a_lost_lamp_command_is_acknowledged_and_ignored(rig: Rig) -> None:
    rig.ask("fault", name="lamp_command_lost", on=True, times=1)
    assert rig.ask("strips", grb=RIGHT) == {"ok": True}
    assert rig.server.world.light == "dark"
    rig.ask("strips", grb=RIGHT)
    assert rig.server.world.light == "right"


def test_a_jumping_clock_moves_utc_and_nothing_else(rig: Rig) -> None:
    rig.ask("wait", until_s=60.0)
    rig.ask("fault", name="clock_jumps", on=True, seconds=-86_400.0)
    jumped = rig.ask("now")
    assert jumped["t_utc_ns"] == START_NS + (60 - 86_400) * 10**9
    assert jumped["time_s"] == 60.0
    rig.ask("fault", name="clock_jumps", on=False)
    assert rig.ask("now")["t_utc_ns"] == START_NS + 60 * 10**9
    rig.ask("fault", name="clock_jumps", on=True, seconds=5.0, times=1)
    assert rig.ask("now")["t_utc_ns"] == START_NS + 65 * 10**9
    assert rig.ask("now")["t_utc_ns"] == START_NS + 60 * 10**9


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"name": "camera_hang", "on": True}, "did you mean `camera_hangs`"),
        ({"name": "service_killed", "on": True}, "played by the rig"),
        ({"name": "clock_jumps", "on": True}, "needs `seconds`"),
        ({"name": "flash_dead", "on": True, "seconds": 3.0}, "takes no `seconds`"),
        ({"name": "flash_dead", "on": True, "times": 0}, ">= 1"),
    ],
)
def test_faults_that_make_no_sense_are_told(rig: Rig, arguments: dict[str, Any], says: str) -> None:
    reply = rig.ask("fault", **arguments)
    assert reply["ok"] is False
    assert says in reply["error"]


@pytest.mark.parametrize(
    "request_",
    [
        {},
        {"op": "dance"},
        {"op": "wait"},
        {"op": "wait", "until_s": "soon"},
        {"op": "wait", "until_s": float("nan")},
        {"op": "wait", "until_s": float("inf")},
        {"op": "wait", "until_s": 1e9},
        {"op": "now", "extra": 1},
        {"op": "strips", "grb": b"x" * (STRIP_BYTES - 1)},
        {"op": "strips", "grb": [1, 2, 3]},
        {"op": "flash", "on": "yes"},
        {**SHUTTER, "exposure_us": float("nan")},
        {**SHUTTER, "exposure_us": -5.0},
        {**SHUTTER, "colour_gains": [1.0]},
        {**SHUTTER, "colour_gains": [0.0, 1.0]},
        [1, 2],
        None,
    ],
)
def test_malformed_requests_get_one_line_and_change_nothing(rig: Rig, request_: Any) -> None:
    before = rig.server.world.snapshot()
    reply = rig.server.handle(msgpack.packb(request_))
    assert reply is not None
    answer = msgpack.unpackb(reply)
    assert answer["ok"] is False
    assert answer["error"]
    assert "\n" not in answer["error"]
    assert rig.server.world.snapshot() == before


@settings(max_examples=300, deadline=None)
@given(payload=st.one_of(st.binary(max_size=200), st.binary(max_size=40).map(lambda b: b"\x82\xa2op\xa3now" + b)))
def test_noise_gets_an_answer(eye: Rig, payload: bytes) -> None:
    reply = eye.server.handle(payload)
    assert reply is not None
    assert msgpack.unpackb(reply)["ok"] in (True, False)


def test_deep_nesting_and_length_bombs_get_an_answer(eye: Rig) -> None:
    for payload in (b"\x91" * 5000, b"\xdd\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", bytes(1 << 17)):
        reply = eye.server.handle(payload)
        assert reply is not None
        assert msgpack.unpackb(reply)["ok"] is False


def test_every_operation_is_understood(eye: Rig) -> None:
    for op in OPERATIONS:
        reply = eye.server.handle(msgpack.packb({"op": op, "wrong": 1}))
        assert reply is not None
        assert "wrong" in msgpack.unpackb(reply)["error"]
    assert {fault.layer for fault in MENU.values()} == {"world", "rig"}
