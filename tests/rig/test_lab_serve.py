"""flora-lab serve as a process on a real bus: says what it finds, once, and is killed in between."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flora_common.bus import Arrival, BusClient
from flora_common.clock import SystemClock
from flora_common.messages import Departure, DiagnosisFound, Frame, Lamps, Recording, Stem
from flora_common.runs import LampsSection
from flora_lab.diagnose import chance, stored_base, usual_errors
from flora_lab.diagnose.joint import Base
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.residuals import SWING_PERIODS_H, ReferenceResiduals, Shown
from flora_lab.diagnose.rhythm import Swings
from flora_lab.diagnose.usual_errors import UsualErrors
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.store import Provenance
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

RIG = "box2"


def write_simulator(path: Path) -> None:
    """A simulator of the sources' typical bean, as if nine plants had told what happens by chance."""
    each = {plant: np.zeros((9, 3)) for plant in ("typical", "own")}
    shown = Shown(each, each, each, each, np.zeros((9, len(SWING_PERIODS_H))))
    sizes, first = chance.sizes_expected(), np.array([np.log(6.5), 0.0])
    base = Base(prior_mean(), prior_spread(), 0.1 * prior_spread(), sizes, first, np.array([0.1, 0.1]), 9)
    errors = usual_errors.expected_sizes()
    doubt = np.diag(np.repeat(errors, usual_errors.columns()) ** 2) / 9
    known = Knowledge(
        base,
        Swings(np.array([0.1, 0.6]), np.array([1.0, 0.1]), 1.0),
        UsualErrors(errors, np.zeros(len(doubt)), doubt),
        np.ones((9, 2)),
        np.zeros(9),
        ReferenceResiduals(shown, np.linspace(0.9, 1.1, 9)),
    )
    simulator = stored_base.simulator_of(base, LampsSection(), DataRange(60.0, 30.0), None)
    stored_base.write_known(path, simulator, known, Provenance(recipe="diagnose", seed=0, software="", split=""))


class Lab:
    """The service, and a rig that says what a test tells it to."""

    def __init__(self, bus: Any, tmp_path: Path) -> None:
        self.bus = bus
        write_simulator(tmp_path / "base.simulator")
        bus.sections["lab"] = {
            "simulator": str(tmp_path / "base.simulator"),
            "settled_s": 60.0,  # a slow start is no end of a run
            "settled_when_told_s": 0.5,
            "scan_every_s": 0.2,
            "rigs": {RIG: {}},
        }
        bus.start_service("flora-bus")
        self.found = tmp_path / "state" / "found"
        self.client = bus.client()
        self.rig = BusClient(bus.address, rig=RIG, source="flora-stem", clock=SystemClock())
        bus.clients.append(self.rig)
        self.rig.connect()
        bus.hear(self.rig, lambda _: self.rig.connected)

    def begin(self) -> subprocess.Popen[str]:
        process: subprocess.Popen[str] = self.bus.start("flora-lab", "serve", "--config", str(self.bus.config))
        return process

    def start(self) -> subprocess.Popen[str]:
        process = self.begin()
        self.bus.wait_ready(self.client, "flora-lab")
        return process

    def grow(self, ticks: range, lean_per_tick: float) -> None:
        """A stem that leans over more and more, whatever the lamps do."""
        for tick in ticks:
            time_s = 300.0 * (tick - 1)
            self.rig.publish(
                Frame(
                    tick=tick,
                    time_s=time_s,
                    path=f"frames/{tick:06d}.jpg",
                    run="bean-07",
                    sha256=f"{tick:064x}",
                    bytes=1,
                    width_px=640,
                    height_px=480,
                    light="left",
                    flash_confirmed=True,
                    exposure_ok=True,
                )
            )
            self.rig.publish(Lamps(tick=tick, lit="left", commanded="left"))
            lean = lean_per_tick * tick
            points = tuple((7.0 / 9.0 * i * np.sin(lean), 7.0 / 9.0 * i * np.cos(lean)) for i in range(10))
            self.rig.publish(
                Stem(
                    tick=tick,
                    time_s=time_s,
                    outcome="ok",
                    points_cm=tuple((float(x), float(y)) for x, y in points),
                    light="left",
                    frame_sha256=f"{tick:064x}",
                )
            )

    def wait_until_kept(self, run: str) -> None:
        """Until it is on the disk that the departure was said; a kill before that has it said again."""
        state = self.bus.folder / "state" / "watched" / RIG / run / "watched.json"
        end_s = time.monotonic() + 20.0
        while json.loads(state.read_bytes())["to_say"] is not None:
            assert time.monotonic() < end_s
            time.sleep(0.01)

    def hear(self, kind: type[Any], *, deadline_s: float = 120.0) -> tuple[Any, list[Arrival]]:
        """The first message of a kind, and all that was heard up to it."""
        heard = self.bus.hear(
            self.client, lambda heard: any(isinstance(a.message, kind) for a in heard), deadline_s=deadline_s
        )
        first = next(a for a in heard if isinstance(a.message, kind))
        assert first.rig == RIG
        return first.message, heard


@pytest.fixture
def lab(bus: Any, tmp_path: Path) -> Lab:
    return Lab(bus, tmp_path)


def test_says_once_that_a_plant_departs_and_what_became_of_its_run(lab: Lab) -> None:
    process = lab.start()
    lab.grow(range(1, 31), 0.02)
    departure, _ = lab.hear(Departure)
    assert (departure.run, departure.is_departed, departure.compared_with) == ("bean-07", True, "typical")
    assert departure.right_mm > departure.expected_mm > 0.0
    assert departure.sentence.startswith("The plant departs from its simulator since hour")
    lab.wait_until_kept("bean-07")
    process.send_signal(signal.SIGKILL)
    process.wait()

    process = lab.start()
    lab.grow(range(25, 40), 0.02)  # what the bus had kept comes again
    lab.rig.publish(Recording(path="bus/1.mcap", closed=True))
    said, heard = lab.hear(DiagnosisFound)
    assert [a for a in heard if isinstance(a.message, Departure)] == []
    assert (said.run, said.verdict) == ("bean-07", "failed")
    assert "is 3.2 h long; at least 6 h are needed" in said.sentence

    def says_so(heard: list[Arrival]) -> bool:
        return any("could not be diagnosed" in getattr(a.message, "reason", "") for a in heard)

    before = lab.bus.hear(lab.client, says_so)[-1].message
    status, _, err = lab.bus.stop(process)
    assert status == 0, err
    (line,) = (json.loads(line) for line in (lab.found / "found.jsonl").read_text().splitlines())
    assert (line["rig"], line["run"], line["stage"]) == (RIG, "bean-07", "failed")

    # Not waited for until it is ready: what it finds at its start may be a trouble before the bus has answered.
    process = lab.begin()
    anew = lambda heard: says_so([a for a in heard if getattr(a.message, "session", "") != before.session])  # noqa: E731
    heard = lab.bus.hear(lab.client, anew)
    assert not [a for a in heard if isinstance(a.message, (DiagnosisFound, Departure)) and a.message.seq == 1]
    assert lab.bus.stop(process)[0] == 0


def test_is_ready_and_says_why_it_does_nothing_without_a_simulator(bus: Any) -> None:
    bus.start_service("flora-bus")
    client = bus.client()
    process = bus.start("flora-lab", "serve", "--config", str(bus.config))
    told = "no simulator and no reference in [lab]: no plant is watched, no run diagnosed"
    heard = bus.hear(client, lambda heard: any(getattr(a.message, "reason", "") == told for a in heard))
    assert getattr(heard[-1].message, "state", "") == "ready"
    assert bus.stop(process)[0] == 0


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"simulater": "x"}, "unknown key `simulater`; did you mean `simulator`?"),
        ({"simulator": "a", "reference": "b"}, "give either `simulator` or `reference`"),
        ({"false_alarms": 0.9}, "false_alarms"),
        ({"jobs_dir": __file__}, f"[lab] jobs_dir {__file__}: {__file__} is a file; name a folder"),
        ({"output": f"{__file__}/found"}, f"{__file__} is a file; name a folder"),
    ],
)
@pytest.mark.parametrize("flags", [[], ["--check-config"]])
def test_a_wrong_configuration_is_one_line(
    bus: Any, section: dict[str, object], message: str, flags: list[str]
) -> None:
    bus.sections["lab"] = section
    process = bus.start("flora-lab", "serve", "--config", str(bus.config), *flags)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_prints_what_is_in_force(bus: Any) -> None:
    bus.sections["lab"] = {"simulator": "/srv/base.simulator", "rigs": {"box2": {"runs_dir": "/mnt/nas/box2"}}}
    process = bus.start("flora-lab", "serve", "--config", str(bus.config), "--print-config")
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert 'simulator = "/srv/base.simulator"' in out
    assert "[lab.rigs.box2]" in out
