"""A controller from the lab to a rig: over the bus and through ssh, in shadow, steering, given up, refused."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from controller_rig import LEFT_OF_IT, RIGHT_OF_IT, diverging, stem, tip_only
from flora_common.bus import Arrival, BusClient
from flora_common.messages import ControllerAnswer, ControllerState, Health, LightCommand
from flora_common.runs import CameraSection, ObstacleSection, RunFile, RunFolder, TargetSection, run_file_text
from flora_controller.shadow import MOST_SWITCHES_PER_H
from flora_lab.main import main
from signing_keys import ADA, BOB, TIP_ONLY, signed

if TYPE_CHECKING:
    from conftest import PrivateBus

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
RUN_FILE = RunFile(
    camera=CameraSection(anchor_px=(160.0, 220.0), px_per_cm=10.0, width_px=320, height_px=240),
    rig="test",
    target=TargetSection(x_cm=-5.12, y_cm=17.9),
    obstacle=ObstacleSection(x_cm=-6.3, y_cm=12.5),
)


@dataclass(frozen=True)
class Done:
    """How a command ended, and what it said."""

    status: int
    out: str
    error: str


def publish(bus: PrivateBus, file: Path, rig: str, *options: str) -> Done:
    """``flora-lab publish`` in this process."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        status = main(["publish", str(file), "--rig", rig, "--config", str(bus.config), *options])
    return Done(status, out.getvalue(), error.getvalue())


class Rig:
    """flora-bus and flora-controller as processes, with a key that they trust; the test plays flora-stem."""

    def __init__(self, bus: PrivateBus) -> None:
        self.bus = bus
        run = RunFolder(bus.run_dir)
        run.path.mkdir()
        run.run_toml.write_text(run_file_text(RUN_FILE))
        keys = bus.folder / "keys"
        keys.mkdir()
        pem = ADA.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
        (keys / "ada.pub").write_bytes(pem)
        bus.sections["controller"] = {"use": "tip-follower", "keys_dir": str(keys)}
        bus.start_service("flora-bus")
        self.client: BusClient = bus.client("flora-stem")
        self.controller = bus.start_service("flora-controller")
        bus.wait_ready(self.client, "flora-controller")
        self.tick = 0
        self.inbox: list[Any] = []

    def see(self, x_cm: float) -> tuple[LightCommand, ControllerState]:
        """One stem, and what the controller makes of it."""
        self.tick += 1
        self.client.publish(stem(self.tick, x_cm))
        light = self.heard(lambda m: isinstance(m, LightCommand) and m.tick == self.tick)
        return light, self.heard(lambda m: isinstance(m, ControllerState) and m.tick == self.tick)

    def heard(self, wanted: Callable[[Any], bool]) -> Any:
        """The first message that fits; those that do not wait for their turn."""
        taken = 0

        def look(heard: list[Arrival]) -> bool:
            nonlocal taken
            self.inbox += [arrival.message for arrival in heard[taken:]]
            taken = len(heard)
            return any(wanted(message) for message in self.inbox)

        self.bus.hear(self.client, look)
        found = next(message for message in self.inbox if wanted(message))
        self.inbox.remove(found)
        return found

    def answer(self, stage: str) -> ControllerAnswer:
        found = self.heard(lambda m: isinstance(m, ControllerAnswer) and m.stage == stage)
        assert isinstance(found, ControllerAnswer)
        return found

    def write(self, data: bytes, name: str = "new.controller.json") -> Path:
        path = self.bus.folder / name
        path.write_bytes(data)
        return path

    def publish(self, file: Path, *options: str) -> Done:
        """``flora-lab publish``, to its end."""
        return publish(self.bus, file, "test", *options)

    def begin(self, file: Path, *options: str) -> subprocess.Popen[str]:
        config = str(self.bus.config)
        return self.bus.start("flora-lab", "publish", str(file), "--rig", "test", "--config", config, *options)


@pytest.fixture
def rig(bus: PrivateBus) -> Rig:
    return Rig(bus)


def test_published_in_shadow_steering_and_a_tampered_one_refused(rig: Rig) -> None:
    new = tip_only(serial=1, name="new")
    sender = rig.begin(rig.write(new.data), "--shadow", "2", "--wait-steering")
    assert rig.answer("shadowing").shadow_ticks_left == 2
    _, first = rig.see(RIGHT_OF_IT)
    _, second = rig.see(LEFT_OF_IT)
    out, error = sender.communicate(timeout=30)
    light, third = rig.see(RIGHT_OF_IT)

    assert (sender.returncode, error) == (0, "")
    assert out == "rig `test` took new.controller.json: `new` steers\n"
    assert [(s.controller, s.shadow, s.shadow_light) for s in (first, second)] == [
        ("tip-follower", "new", "left"),
        ("tip-follower", "new", "right"),
    ]
    assert (second.shadow_ticks_left, second.shadow_agree) == (0, 1.0)
    assert (third.controller, third.sha256, third.shadow, light.light) == ("new", new.sha256, "", "left")

    newer = tip_only(serial=2, name="newer")
    refused = rig.publish(rig.write(newer.data.replace(b"-1.0", b"-2.0", 1)))
    _, goes_on = rig.see(RIGHT_OF_IT)

    assert refused.status == 2
    assert refused.error.startswith("flora-lab: rig `test` refused new.controller.json: controller `newer` was changed")
    assert refused.error.endswith("; `new` steers\n")
    assert refused.error.count("\n") == 1
    assert goes_on.controller == "new"


def test_one_that_flickers_is_given_up_and_everybody_is_told(rig: Rig) -> None:
    sent = rig.publish(rig.write(tip_only(serial=1, name="restless").data), "--json")
    told = json.loads(sent.out)
    states = [rig.see((RIGHT_OF_IT, LEFT_OF_IT)[i % 2])[1] for i in range(MOST_SWITCHES_PER_H + 2)]
    returned = rig.answer("returned")
    health = rig.heard(lambda m: isinstance(m, Health) and m.source == "flora-controller" and m.state == "degraded")
    again = rig.publish(rig.bus.folder / "new.controller.json")

    assert (sent.status, told["stage"], told["steers"], told["rig"]) == (0, "steering", "restless", "test")
    assert [s.controller for s in states] == ["restless"] * (MOST_SWITCHES_PER_H + 1) + ["tip-follower"]
    said = "while it steered: it switched 11 times within an hour, at most 10 are allowed"
    assert returned.reason == said
    assert (returned.offer, returned.steers) == (told["offer"], "tip-follower")
    assert states[-1].reason == health.reason == f"gave up `restless` {said}"
    assert again.status == 2
    assert "this rig gave it up before" in again.error


def test_one_whose_plant_leaves_its_range_is_given_up_and_everybody_is_told(rig: Rig) -> None:
    reached = {"left_cm": -8.0, "right_cm": 8.0, "lowest_tip_cm": 6.0, "highest_tip_cm": 18.0}
    lengths = {"shortest_cm": 6.5, "longest_cm": 20.0}
    sent = rig.publish(rig.write(tip_only(serial=1, name="ranged", stem_range=reached | lengths).data), "--json")
    told = json.loads(sent.out)
    states = [rig.see(x)[1] for x in (-9.0, -14.5, -9.0, -14.5, -14.5, -14.5)]
    returned = rig.answer("returned")
    health = rig.heard(lambda m: isinstance(m, Health) and m.source == "flora-controller" and m.state == "degraded")
    again = rig.publish(rig.bus.folder / "new.controller.json")

    assert (sent.status, told["stage"], told["steers"]) == (0, "steering", "ranged")
    assert [s.controller for s in states] == ["ranged"] * 5 + ["tip-follower"]
    said = (
        "while it steered: 3 stems in a row were outside its range, this one 6.5 cm farther left than any that it was "
    )
    said += "evolved with; at most 2 are allowed"
    assert returned.reason == said
    assert (returned.offer, returned.steers) == (told["offer"], "tip-follower")
    assert states[-1].reason == health.reason == f"gave up `ranged` {said}"
    assert again.status == 2
    assert "this rig gave it up before" in again.error


def test_killed_in_the_shadow_and_while_the_sender_waits_nothing_is_lost(rig: Rig) -> None:
    sender = rig.begin(rig.write(tip_only(serial=1, name="new").data), "--shadow", "3", "--wait-steering")
    rig.answer("shadowing")
    _, before = rig.see(RIGHT_OF_IT)
    rig.controller.kill()
    rig.controller.wait()
    rig.controller = rig.bus.start_service("flora-controller")
    rig.heard(lambda m: isinstance(m, ControllerState) and m.tick == 1 and m.session != before.session)
    _, after = rig.see(RIGHT_OF_IT)
    rig.see(RIGHT_OF_IT)
    sender.communicate(timeout=30)
    rig.controller.kill()
    rig.controller.wait()
    rig.controller = rig.bus.start_service("flora-controller")
    _, last = rig.see(RIGHT_OF_IT)

    assert (before.shadow_ticks_left, after.shadow_ticks_left) == (2, 1)
    assert sender.returncode == 0
    assert (last.controller, last.decisions) == ("new", 1)


def test_a_network_without_an_answer_is_given_up_within_its_first_tick(rig: Rig) -> None:
    assert rig.publish(rig.write(diverging(serial=1).data)).status == 0

    light, said = rig.see(4.0)

    assert (light.blind, said.controller) == (False, "tip-follower")
    assert "the network has no answer" in said.reason


# What is told where it cannot work


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (TIP_ONLY.read_bytes(), "is not signed, no rig takes it; first: flora-lab sign"),
        (b"{}", "not a controller file"),
    ],
)
def test_a_bad_file_does_not_travel(bus: PrivateBus, content: bytes, said: str) -> None:
    file = bus.folder / "bad.controller.json"
    file.write_bytes(content)

    done = publish(bus, file, "test")

    assert (done.status, done.out) == (2, "")
    assert said in done.error
    assert done.error.count("\n") == 1


def test_who_is_not_there_is_named(bus: PrivateBus) -> None:
    file = bus.folder / "new.controller.json"
    file.write_bytes(tip_only(serial=1).data)

    def asked(rig: str, timeout_s: float = 5.0) -> tuple[int, str]:
        """With time enough for the bus of a busy machine, where there is one: who has not reached it names it alone."""
        done = publish(bus, file, rig, "--timeout", str(timeout_s))
        return done.status, done.error

    assert asked("test", 1.5) == (1, f"flora-lab: no bus answers at {bus.address.subscribe}; is flora-bus running?\n")
    bus.start_service("flora-bus")
    bus.client()
    assert asked("test") == (
        1,
        "flora-lab: flora-controller of rig `test` does not answer; is it running, and is it as new as this program?\n",
    )
    assert asked("elsewhere") == (1, "flora-lab: rig `elsewhere` is not heard, on this bus are: test\n")
    assert asked("No Rig")[0] == 2


# make deploy

FAKE_SSH = """#!/usr/bin/env bash
echo "$@" >> {log}
while [ "$1" != -- ]; do shift; done
[ "$2" = gone ] && exit 255
cd / && exec bash -c "$3"
"""


def deploy(bus: PrivateBus, **variables: str) -> subprocess.CompletedProcess[str]:
    """The script behind ``make deploy``, with an ssh that goes nowhere but here."""
    fakes = bus.folder / "fakes"
    fakes.mkdir(exist_ok=True)
    ssh = fakes / "ssh"
    ssh.write_text(FAKE_SSH.format(log=fakes / "log"))
    ssh.chmod(0o755)
    path = f"{fakes}:{BIN}:{os.environ['PATH']}"
    clean = {name: value for name, value in os.environ.items() if name not in ("CONTROLLER", "RIG", "HOST")}
    script = [ROOT / "deploy" / "publish-controller.sh", BIN]
    return subprocess.run(script, env=clean | variables | {"PATH": path}, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("host", ["", "flora@box1"])
def test_deploy_brings_a_controller_over_the_bus_or_through_ssh(rig: Rig, host: str) -> None:
    file, config = rig.write(tip_only(serial=1, name="new").data, "a b.controller.json"), str(rig.bus.config)
    done = deploy(rig.bus, CONTROLLER=str(file), RIG="test", HOST=host, CONFIG=config, SHADOW="2")
    strange = rig.write(signed(TIP_ONLY, BOB, serial=9).data)
    refused = deploy(rig.bus, CONTROLLER=str(strange), RIG="test", HOST=host, CONFIG=config)

    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == (
        "rig `test` took a b.controller.json; `tip-follower` steers for 2 ticks more, the new one in its shadow\n"
    )
    assert refused.returncode == 2
    assert "refused new.controller.json: controller `tip-only` is signed by" in refused.stderr
    log = rig.bus.folder / "fakes" / "log"
    assert log.exists() == bool(host)
    if host:
        assert "-- flora@box1 " in log.read_text()


def test_deploy_says_in_one_line_what_is_missing(bus: PrivateBus) -> None:
    file = bus.folder / "new.controller.json"
    file.write_bytes(tip_only(serial=1).data)
    config = str(bus.config)
    nothing, no_rig = deploy(bus), deploy(bus, CONTROLLER="x")
    no_file = deploy(bus, CONTROLLER="/gone.controller.json", RIG="test", HOST="flora@box1")
    no_host = deploy(bus, CONTROLLER=str(file), RIG="test", HOST="gone")
    other = deploy(bus, CONTROLLER=str(file), RIG="other", HOST="flora@box1", CONFIG=config)

    assert [d.returncode for d in (nothing, no_rig, no_file, no_host, other)] == [2, 2, 2, 1, 2]
    assert nothing.stderr.startswith("make deploy: CONTROLLER is not given; make deploy CONTROLLER=file RIG=name")
    assert no_rig.stderr.startswith("make deploy: RIG is not given")
    assert "/gone.controller.json: cannot be read" in no_file.stderr
    assert no_host.stderr == "make deploy: no connection to gone\n"
    assert other.stderr == "flora-controller: --rig other: this rig is `test`\n"
    assert all(d.stderr.count("\n") == 1 for d in (nothing, no_rig, no_file))


def test_make_hands_its_variables_to_the_script_as_they_are(tmp_path: Path) -> None:
    command = tmp_path / "flora-lab"
    command.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    command.chmod(0o755)
    given = {"CONTROLLER": "Ada's best.controller.json", "RIG": "r", "CONFIG": 'a "b"; c.toml', "SHADOW": "3"}
    done = subprocess.run(
        [
            "make",
            "--no-print-directory",  # which a make that runs these tests asks for
            "--old-file",
            "setup",
            "deploy",
            f"BIN={tmp_path}",
            *(f"{name}={text}" for name, text in given.items()),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    expected = ["publish", given["CONTROLLER"], "--rig", "r", "--shadow", "3", "--config", given["CONFIG"]]
    assert done.stdout.splitlines() == expected
