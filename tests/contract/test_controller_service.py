"""flora-controller as a process on a private bus: steered, killed, given new files."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from flora_common.bus import Arrival, BusClient
from flora_common.files import write_bytes
from flora_common.messages import ControllerState, Health, LightCommand, Stem
from flora_common.runs import CameraSection, ObstacleSection, RunFile, RunFolder, TargetSection, run_file_text
from flora_controller.main import main
from signing_keys import ADA, EXPORT, signed

if TYPE_CHECKING:
    from conftest import PrivateBus

GOLDEN = Path(__file__).parent.parent / "golden" / "controllers"
RUN_FILE = RunFile(
    camera=CameraSection(anchor_px=(160.0, 220.0), px_per_cm=10.0, width_px=320, height_px=240),
    rig="test",
    target=TargetSection(x_cm=-5.12, y_cm=17.9),
    obstacle=ObstacleSection(x_cm=-6.3, y_cm=12.5),
)


def stem(tick: int, x_cm: float, y_cm: float = 10.0) -> Stem:
    points = tuple((x_cm * i / 9, y_cm * i / 9) for i in range(10))
    return Stem(tick=tick, time_s=tick * 300.0, outcome="ok", points_cm=points, quality=1.0)


def make_run(bus: PrivateBus, run_file: RunFile = RUN_FILE) -> None:
    run = RunFolder(bus.run_dir)
    run.path.mkdir()
    run.run_toml.write_text(run_file_text(run_file))


def answer(bus: PrivateBus, client: BusClient, tick: int) -> tuple[LightCommand, ControllerState]:
    """Command and state of a tick."""
    found: dict[type, object] = {}

    def both(heard: list[Arrival]) -> bool:
        for arrival in heard:
            if isinstance(arrival.message, LightCommand | ControllerState) and arrival.message.tick == tick:
                found[type(arrival.message)] = arrival.message
        return len(found) == 2

    bus.hear(client, both)
    light, said = found[LightCommand], found[ControllerState]
    assert isinstance(light, LightCommand)
    assert isinstance(said, ControllerState)
    return light, said


def start(bus: PrivateBus) -> BusClient:
    bus.start_service("flora-bus")
    client = bus.client("flora-stem")
    bus.start_service("flora-controller")
    bus.wait_ready(client, "flora-controller")
    return client


def test_killed_in_the_middle_it_goes_on_where_it_was(bus: PrivateBus) -> None:
    make_run(bus)
    bus.sections["controller"] = {"use": "waypoint"}
    client = start(bus)
    client.publish(stem(1, 3.0, 12.0))
    client.publish(stem(2, -6.0, 12.0))  # touches the obstacle
    client.publish(stem(3, 6.0, 15.0))
    before, told_before = answer(bus, client, 3)
    assert (before.light, told_before.collided_at_s, told_before.switches) == ("left", 600.0, 1)

    bus.processes[-1].kill()
    bus.processes[-1].wait()
    bus.start_service("flora-controller")
    again, told_again = answer(bus, client, 3)  # the bus hands it the same stem once more
    client.publish(stem(4, 6.0, 15.2))
    after, told_after = answer(bus, client, 4)

    assert (again.light, again.reason) == (before.light, before.reason)
    assert again.session != before.session
    assert (told_again.decisions, told_again.switches) == (3, 1)
    assert (after.light, told_after.decisions, told_after.collided_at_s) == ("left", 4, 600.0)


def test_a_stem_that_the_bus_kept_of_another_run_says_nothing_of_this_ones_plant(bus: PrivateBus) -> None:
    make_run(bus)
    bus.sections["controller"] = {"use": "tip-follower"}
    client = start(bus)
    client.publish(msgspec.structs.replace(stem(900, -6.3, 22.0), run="bean-00"))  # over, by the stop height
    client.publish(msgspec.structs.replace(stem(901, 0.0, 5.0), run=bus.run_dir.name))
    _, said = answer(bus, client, 901)

    assert (said.decisions, said.run_over, said.collided) == (1, False, False)
    assert said.best_fitness == said.fitness


def test_a_new_controller_file_takes_over_and_a_bad_one_does_not(bus: PrivateBus, tmp_path: Path) -> None:
    make_run(bus)
    file = tmp_path / "steer.controller.json"
    shutil.copy(GOLDEN / "good" / "tip_only.controller.json", file)
    bus.sections["controller"] = {"use": str(file)}
    client = start(bus)
    client.publish(stem(1, 3.0))
    _, first = answer(bus, client, 1)

    write_bytes(file, (GOLDEN / "bad" / "nan_weight.controller.json").read_bytes())
    client.publish(stem(2, 3.0))
    _, refused = answer(bus, client, 2)
    said: list[Health] = []

    def degraded(heard: list[Arrival]) -> bool:
        said.extend(a.message for a in heard if isinstance(a.message, Health) and a.message.state == "degraded")
        return bool(said)

    bus.hear(client, degraded)
    write_bytes(file, (GOLDEN / "good" / "neat_export.controller.json").read_bytes())
    client.publish(stem(3, 3.0))
    _, second = answer(bus, client, 3)

    assert first.controller == "steer.controller.json"
    assert refused.sha256 == first.sha256
    assert refused.reason == f"refused, the one before goes on: {file}: NaN is not a finite number"
    assert "refused" in said[0].reason
    assert second.sha256 not in ("", first.sha256)
    assert (second.reason, second.decisions) == ("", 1)


def test_a_rig_that_requires_signatures_takes_newer_ones_only_also_after_a_restart(
    bus: PrivateBus, tmp_path: Path
) -> None:
    make_run(bus)
    keys = tmp_path / "keys"
    keys.mkdir()
    (keys / "ada.pub").write_bytes(ADA.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    file = tmp_path / "steer.controller.json"
    first, older = signed(serial=7), signed(EXPORT, serial=6)
    write_bytes(file, first.data)
    bus.sections["controller"] = {"use": str(file), "trust": "required", "keys_dir": str(keys)}
    client = start(bus)
    client.publish(stem(1, 3.0))
    _, steered = answer(bus, client, 1)

    write_bytes(file, older.data)
    client.publish(stem(2, 3.0))
    _, refused = answer(bus, client, 2)
    bus.processes[-1].kill()
    bus.processes[-1].wait()
    bus.start_service("flora-controller")
    client.publish(stem(3, 3.0))
    _, restarted = answer(bus, client, 3)

    assert {steered.sha256, refused.sha256, restarted.sha256} == {first.sha256}
    assert "has serial 6, and one with serial 7 was accepted" in refused.reason
    assert "has serial 6, and one with serial 7 was accepted" in restarted.reason


@pytest.mark.parametrize(
    ("section", "run_file", "said"),
    [
        ({"use": "waypiont"}, RUN_FILE, "did you mean `waypoint`?"),
        ({"use": "waypoint"}, None, "give run.toml a section [target]"),
        ({"use": "open-loop", "blind_hold_tick": 1}, RUN_FILE, "did you mean `blind_hold_ticks`?"),
        ({"trust": "required", "keys_dir": "/gone"}, RUN_FILE, "there is no key *.pub in keys_dir /gone"),
        ({"trust": "require"}, RUN_FILE, "did you mean `required`?"),
        ({"use": "/gone.controller.json"}, RUN_FILE, "/gone.controller.json: cannot be read"),
        ({"use": str(GOLDEN / "bad" / "cycle.controller.json")}, RUN_FILE, "network is not feed-forward"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    bus: PrivateBus, section: dict[str, object], run_file: RunFile | None, said: str
) -> None:
    if run_file is not None:
        make_run(bus, run_file)
    bus.sections["controller"] = section

    process = bus.start_service("flora-controller")
    _, error = process.communicate(timeout=20)

    assert process.returncode == 2
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"use": "waypiont"}, "did you mean `waypoint`?"),
        ({"trust": "required", "keys_dir": "/gone"}, "there is no key *.pub in keys_dir /gone"),
        ({"use": str(GOLDEN / "bad" / "cycle.controller.json")}, "network is not feed-forward"),
        ({"use": str(GOLDEN / "good" / "tip_only.controller.json")}, ""),
        ({"use": "waypoint"}, ""),
    ],
)
def test_the_check_of_a_configuration_says_what_a_start_would(
    bus: PrivateBus, capsys: pytest.CaptureFixture[str], section: dict[str, object], said: str
) -> None:
    make_run(bus, RUN_FILE)
    bus.sections["controller"] = section

    assert main(["--config", str(bus.config), "--check-config"]) == (2 if said else 0)

    out, error = capsys.readouterr()
    assert (out == "") == bool(said)
    assert said in error
    assert error.count("\n") == bool(said)
    assert not (bus.folder / "state").exists()


def test_a_light_plan_shines_by_the_clock_and_says_when_the_run_is_over(bus: PrivateBus) -> None:
    plan = bus.folder / "dusk.lights.toml"
    plan.write_text('schedule = "right 2h, dark 1h, both"\nhours = 4.0\n')
    bus.sections["controller"] = {"use": str(plan)}
    client = start(bus)

    shone = []
    for tick, hours in enumerate((0.0, 1.9, 2.0, 3.0, 4.0, 5.0), start=1):
        client.publish(Stem(tick=tick, time_s=hours * 3600.0, outcome="no_frame"))
        light, told = answer(bus, client, tick)
        shone.append((light.light, light.blind, told.run_over))

    assert shone == [
        ("right", False, False),
        ("right", False, False),
        ("dark", False, False),
        ("both", False, False),
        ("both", False, True),
        ("both", False, True),
    ]
    assert main(["check", str(plan)]) == 0
    assert main(["check", str(plan), "--keys", str(bus.folder)]) == 2
    assert (told.controller, "the light plan's 4 h have passed" in told.reason) == ("dusk.lights.toml", True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('schedule = "lefft 6h, right"\nhours = 4.0\n', "no light `lefft`; did you mean `left`?"),
        ('schedule = "6h"\n', "hours"),
        ('schedule = "6h"\nhours = 0.0\n', "hours"),
        ('shedule = "6h"\nhours = 4.0\n', "schedule"),
        (None, "cannot be read (No such file or directory)"),
    ],
)
def test_a_light_plan_that_cannot_be_followed_is_told_in_one_line(
    bus: PrivateBus, capsys: pytest.CaptureFixture[str], text: str | None, said: str
) -> None:
    plan = bus.folder / "bad.lights.toml"
    if text is not None:
        plan.write_text(text)
    bus.sections["controller"] = {"use": str(plan)}

    assert main(["--config", str(bus.config), "--check-config"]) == 2
    assert main(["check", str(plan)]) == 2

    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 2
    assert all(str(plan) in line and said in line for line in error.splitlines())


def test_the_open_loop_runs_without_a_run_folder(bus: PrivateBus) -> None:
    client = start(bus)

    client.publish(Stem(tick=73, time_s=6 * 3600.0, outcome="no_frame"))
    light, told = answer(bus, client, 73)

    assert (light.light, light.blind, told.controller, told.fitness) == ("right", False, "open-loop", None)


def test_its_memory_and_its_record_are_small(bus: PrivateBus) -> None:
    make_run(bus)
    client = start(bus)
    client.publish(stem(1, 3.0))
    answer(bus, client, 1)

    def healthy(heard: list[Arrival]) -> bool:
        return any(isinstance(a.message, Health) and 0 < a.message.resident_kib < 80 * 1024 for a in heard)

    bus.hear(client, healthy)
    record = bus.folder / "state" / "controller.json"
    assert json.loads(record.read_bytes())["tick"] == 1
    assert record.stat().st_size < 4096
