"""The units in ``systemd/``: started by a glob, watched, boxed in, dark after death; what can be seen without booting.

The table of exposure scores is printed with ``pytest -s``.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
UNITS = ROOT / "systemd"
PAGE = ROOT / "docs" / "reference" / "units.md"
INSTALLED_BIN = "/opt/flora/current/bin"
ANCHOR = "flora-rig.target"
SAFE_MODE = "safe-mode-flora.target"
RIG = sorted(file.name for file in UNITS.glob("flora-*.service"))
HELPERS = ("on-flora-stopped.service", "on-flora-failed@.service", "on-flora-installed.service")
JUDGE = "on-flora-installed.service"
"""Of the helpers the one that does more than say a sentence to systemd."""
LAB = "lab/flora-lab.service"
LOOP = {"flora-stem.service", "flora-controller.service"}
"""Closed-loop control: what safe mode is without."""
LAMPS = {"flora-led.service", "flora-flash.service"}
NEEDS_ROOT = {"flora-led.service"}
"""PWM by /dev/mem."""
MOST_EXPOSURE = {"flora-led.service": 2.0}
MOST_EXPOSURE_OF_OTHERS = 1.2
SCORED_WITH = "252"
"""The systemd of Debian 12, whose scores the page gives; other versions weigh a little differently."""

BOX_OF_ALL = {
    "NoNewPrivileges": "yes",
    "ProtectSystem": "strict",
    "ProtectHome": "yes",
    "PrivateTmp": "yes",
    "PrivateMounts": "yes",
    "ProtectProc": "invisible",
    "ProtectHostname": "yes",
    "ProtectKernelTunables": "yes",
    "ProtectKernelModules": "yes",
    "ProtectKernelLogs": "yes",
    "ProtectControlGroups": "yes",
    "RestrictNamespaces": "yes",
    "RestrictRealtime": "yes",
    "RestrictSUIDSGID": "yes",
    "LockPersonality": "yes",
    "SystemCallArchitectures": "native",
}
HOLES = {
    "PrivateNetwork": {LAB, "flora-dashboard.service"},
    "PrivateDevices": {"flora-capture.service", "flora-flash.service", "flora-led.service"},
    "MemoryDenyWriteExecute": {LAB},
    "ProtectClock": {"flora-controller.service", "flora-flash.service"},
}
"""Settings that every unit has but these, each of which says why not in a comment of its own."""

SEES_PROC = {"flora-flash.service", "flora-led.service", "flora-capture.service", LAB}

Unit = dict[str, list[str]]


def lines_of(file: Path) -> list[tuple[str, str]]:
    """Key and value of each assignment, in order."""
    found = [line.partition("=") for line in file.read_text().splitlines() if re.match(r"[A-Za-z]+=", line)]
    return [(key, value) for key, _, value in found]


def unit(name: str) -> Unit:
    """What is in force, all values of each key in order: the unit, then its folders of additions, by name of file."""
    prefix = next((p for p in ("on-flora-", "flora-") if name.startswith(p) and name.endswith(".service")), None)
    added = [*(UNITS / f"{prefix}.service.d").glob("*.conf"), *(UNITS / f"{name}.d").glob("*.conf")]
    files = [UNITS / name, *sorted(added, key=lambda file: file.name)]
    merged: Unit = {}
    for file in files:
        for key, value in lines_of(file):
            merged.setdefault(key, []).append(value)
    return merged


def one(of: Unit, key: str) -> str:
    """The value of a key that must be stated once."""
    values = of.get(key, [])
    assert len(values) == 1, f"{key}={values}"
    return values[0]


def words(of: Unit, key: str) -> list[str]:
    return " ".join(of.get(key, [])).split()


def seconds(span: str) -> float:
    number, suffix = re.fullmatch(r"(\d+)(min|s)?", span).groups()  # type: ignore[union-attr]
    return float(number) * (60.0 if suffix == "min" else 1.0)


# the anchor


def test_the_anchor_wants_every_service_of_the_rig() -> None:
    assert sorted(words(unit(ANCHOR), "Wants")) == RIG
    assert one(unit(ANCHOR), "WantedBy") == "multi-user.target"


def test_the_anchor_comes_back_alone_when_the_glob_has_stopped_it() -> None:
    helper = one(unit(ANCHOR), "OnSuccess")
    assert not helper.startswith("flora-")
    command = one(unit(helper), "ExecStart")
    assert command == f"/usr/bin/systemctl --no-block --job-mode=ignore-dependencies start {ANCHOR}"
    assert one(unit(helper), "Type") == "oneshot"


def test_the_glob_matches_the_services_and_the_anchor_and_nothing_else() -> None:
    names = [file.name for file in UNITS.iterdir() if file.is_file()]
    assert set(HELPERS) <= set(names)
    assert sorted(name for name in names if name.startswith("flora-")) == sorted([*RIG, ANCHOR])
    assert all("flora" in name for name in names)  # the rest is found by *flora*


@pytest.mark.parametrize("name", RIG)
def test_a_service_stops_and_restarts_with_the_anchor(name: str) -> None:
    assert one(unit(name), "PartOf") == ANCHOR
    if name != "flora-bus.service":
        assert (one(unit(name), "Wants"), one(unit(name), "After")) == ("flora-bus.service", "flora-bus.service")


# alive, or started again


@pytest.mark.parametrize("name", RIG)
def test_a_service_runs_its_own_command_says_ready_and_is_watched(name: str) -> None:
    this = unit(name)
    command = name.removesuffix(".service")
    assert one(this, "ExecStart") == f"{INSTALLED_BIN}/{command} --config /etc/flora/flora.toml"
    assert (one(this, "Type"), one(this, "NotifyAccess"), one(this, "Restart")) == ("notify", "main", "always")
    assert 10 <= seconds(one(this, "WatchdogSec")) <= 60


@pytest.mark.parametrize("name", RIG)
def test_a_service_that_fails_at_every_start_reaches_its_limit(name: str) -> None:
    this = unit(name)
    interval_s, burst = seconds(one(this, "StartLimitIntervalSec")), int(one(this, "StartLimitBurst"))
    start_takes_s = 10.0
    assert burst * (seconds(one(this, "RestartSec")) + start_takes_s) < interval_s


@pytest.mark.parametrize("name", RIG)
def test_after_the_limit_comes_safe_mode_or_another_try_and_a_person_may_start_it_at_once(name: str) -> None:
    instead = SAFE_MODE if name in LOOP else "retry-flora@%n.timer"
    assert words(unit(name), "OnFailure") == [instead, "on-flora-failed@%n.service"]
    assert one(unit("on-flora-failed@.service"), "ExecStart") == "/usr/bin/systemctl reset-failed %i"


def test_the_next_try_starts_what_has_failed_and_is_called_off_with_the_rig() -> None:
    timer = unit("retry-flora@.timer")
    assert (one(timer, "Unit"), one(timer, "PartOf"), one(timer, "RemainAfterElapse")) == ("%i", ANCHOR, "no")
    assert seconds(one(timer, "OnActiveSec")) >= 300


def test_safe_mode_is_the_rig_without_its_control_loop() -> None:
    this = unit(SAFE_MODE)
    assert set(words(this, "Wants")) == set(RIG) - LOOP
    assert set(words(this, "Conflicts")) == LOOP
    assert one(this, "StopPropagatedFrom") == ANCHOR


def test_who_judges_a_new_release_is_not_among_those_that_it_restarts() -> None:
    this = unit(JUDGE)
    assert one(this, "ConditionPathExists") == "/opt/flora/trial.json"
    assert one(this, "ExecStart").startswith("/usr/bin/python3 /opt/flora/current/")  # no environment of a release
    assert one(this, "WantedBy") == "multi-user.target"  # a power cut in the middle is decided at the next boot
    assert not {"PartOf", "BindsTo", "Requires"} & set(this)


def test_each_helper_ends_by_itself() -> None:
    assert {name: seconds(one(unit(name), "TimeoutStartSec")) for name in HELPERS} == {
        "on-flora-stopped.service": 30.0,
        "on-flora-failed@.service": 30.0,
        JUDGE: 600.0,
    }


# dark


@pytest.mark.parametrize("name", RIG)
def test_lamps_are_darkened_after_any_death_and_nothing_else_runs_then(name: str) -> None:
    expected = [one(unit(name), "ExecStart") + " --dark"] if name in LAMPS else []
    assert unit(name).get("ExecStopPost", []) == expected
    assert seconds(one(unit(name), "TimeoutStopSec")) <= (120 if name == "flora-uploader.service" else 10)


# what a service may touch


@pytest.mark.parametrize("name", [*RIG, *HELPERS, LAB])
def test_a_unit_is_boxed_in(name: str) -> None:
    this = unit(name)
    assert {key: one(this, key) for key in BOX_OF_ALL} == BOX_OF_ALL
    for key, but in HOLES.items():
        assert this.get(key, []) == ([] if name in but else ["yes"]), key
    assert one(this, "DevicePolicy") == "closed"
    assert one(this, "CapabilityBoundingSet") == ("CAP_SYS_RAWIO" if name in NEEDS_ROOT else "")
    if name not in HELPERS:
        assert one(this, "User") == ("root" if name in NEEDS_ROOT else "flora")


@pytest.mark.parametrize("name", [*RIG, *HELPERS, LAB])
def test_a_forbidden_system_call_is_refused_and_does_not_kill(name: str) -> None:
    this = unit(name)
    assert one(this, "SystemCallErrorNumber") == "EPERM"
    assert this["SystemCallFilter"][0] == "@system-service"
    assert "@privileged" in this["SystemCallFilter"][1]


@pytest.mark.parametrize("name", [*RIG, LAB])
def test_each_hole_in_the_box_says_why(name: str) -> None:
    text = (UNITS / name).read_text()
    left_out = [key for key, but in HOLES.items() if name in but and key != "PrivateDevices"]
    left_out += ["ProcSubset"] * (name in SEES_PROC)
    assert [key for key in left_out if f"# No {key}=" not in text] == []
    lines = text.splitlines()
    opened = [
        i for i, line in enumerate(lines) if re.match(r"User=root|DeviceAllow=|ReadWritePaths=.*-/|RestrictA.*X ", line)
    ]
    assert bool(opened) == (name in {*HOLES["PrivateDevices"], *HOLES["PrivateNetwork"], "flora-uploader.service"})
    for i in opened:
        before = [line for line in lines[:i] if not line.startswith(("Device", "User", "Restrict"))]
        assert before[-1].startswith("# "), lines[i]


def test_what_reads_proc_beyond_processes_may() -> None:
    """flora-flash its boot id, flora-led which Pi this is, libcamera the same, torch the processor."""
    assert {name for name in [*RIG, LAB] if "ProcSubset" not in unit(name)} == SEES_PROC


def test_lamps_may_hang_on_spi() -> None:
    """Pin D10: rpi_ws281x opens /dev/spidev0.0 itself."""
    assert "char-spi rw" in unit("flora-led.service")["DeviceAllow"]


@pytest.mark.parametrize("name", [*RIG, JUDGE])
def test_libzmq_may_set_the_scheduling_of_its_threads(name: str) -> None:
    """Refused, it aborts the process: ``Operation not permitted (src/thread.cpp)``."""
    filters = unit(name)["SystemCallFilter"]
    assert "sched_setscheduler" in filters[2:]  # after the line that takes @resources away


@pytest.mark.parametrize("name", sorted(HOLES["ProtectClock"]))
def test_who_believes_the_clock_may_ask_whether_it_is_right(name: str) -> None:
    """``flora_common.clock_sync``: refused, they would believe no expiry date, and measure no power cut."""
    this = unit(name)
    assert this["SystemCallFilter"][-1].split()[:2] == ["adjtimex", "clock_adjtime"]


@pytest.mark.parametrize("name", RIG)
def test_no_service_owns_a_folder_that_others_use(name: str) -> None:
    """RuntimeDirectory= is removed, with everybody's sockets, when the first service stops."""
    assert not {"RuntimeDirectory", "StateDirectory", "DynamicUser"} & set(unit(name))


def test_every_folder_that_a_unit_must_find_is_made_by_tmpfiles_for_the_user_that_sysusers_makes() -> None:
    made = [line.split() for line in (UNITS / "tmpfiles.d/flora.conf").read_text().splitlines() if line[:1] == "d"]
    needed = {p for name in RIG for p in words(unit(name), "ReadWritePaths") if not p.startswith("-")}
    assert needed <= {row[1] for row in made}
    assert {(row[3], row[4]) for row in made} == {("flora", "flora")}
    users = (UNITS / "sysusers.d/flora.conf").read_text()
    groups = {"flora", *(g for name in RIG for g in words(unit(name), "SupplementaryGroups"))}
    assert set(re.findall(r"^[ug] (\S+)", users, re.MULTILINE)) == groups


def test_the_journal_outlives_a_power_cut_and_stays_small() -> None:
    journal = dict(lines_of(UNITS / "journald.conf.d/99-flora.conf"))
    assert journal["Storage"] == "persistent"
    assert re.fullmatch(r"\d{2,3}M", journal["SystemMaxUse"])


def test_a_machine_that_hangs_is_started_anew_within_what_a_pi_can_count() -> None:
    manager = dict(lines_of(UNITS / "system.conf.d/50-flora.conf"))
    assert manager == {"RuntimeWatchdogSec": "15s"}


# systemd's own opinion

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def exposure(name: str) -> float:
    file = UNITS / name
    limit = MOST_EXPOSURE.get(name, MOST_EXPOSURE_OF_OTHERS)
    command = ["systemd-analyze", "security", "--offline=true", f"--threshold={10 * limit:.0f}", f"./{file.name}"]
    done = subprocess.run(command, cwd=file.parent, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, f"{name}: {done.stdout[-300:]}{done.stderr}"
    return float(re.findall(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)[-1])


@needs_systemd
def test_every_unit_is_as_safe_as_the_page_says() -> None:
    scores = {name: exposure(name) for name in [*RIG, *HELPERS, LAB]}
    print("\n" + "\n".join(f"{score:4.1f}  {name}" for name, score in sorted(scores.items(), key=lambda row: row[1])))
    told = dict(re.findall(r"^\| `([^`]+)` \|.*\| ([\d.]+) \|$", PAGE.read_text(), re.MULTILINE))
    assert told.keys() == {name.removeprefix("lab/") for name in scores}
    version = subprocess.run(["systemd-analyze", "--version"], capture_output=True, text=True, timeout=60).stdout
    if version.split()[1] == SCORED_WITH:
        assert told == {name.removeprefix("lab/"): f"{score:.1f}" for name, score in scores.items()}


@needs_systemd
def test_systemd_finds_no_fault_and_every_command_is_there(tmp_path: Path) -> None:
    shutil.copytree(UNITS, tmp_path / "units")
    shutil.copy(UNITS / LAB, tmp_path / "units")
    files = [file for file in (tmp_path / "units").iterdir() if file.is_file()]
    for file in files:
        file.write_text(file.read_text().replace(INSTALLED_BIN, str(Path(sys.executable).parent)))
    named = [str(file).replace("@.", "@flora-bus.service.") for file in files]
    for file, name in zip(files, named, strict=True):
        if str(file) != name:
            shutil.copy(file, name)
    command = ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", *named]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), json.dumps(named)
