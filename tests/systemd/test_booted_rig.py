"""A rig on a machine that systemd booted: installed over ssh, started by the glob, killed, hung, upgraded, broken.

The tests go on from each other, in this order, on one machine. ``make test-systemd`` runs them and prints the table.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from booted import Machine
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from installed_rig import ROOT, RUN, SERVICES, Rig, Table

from signing_keys import ADA, TIP_ONLY, signed

pytestmark = pytest.mark.slow

DARK_WITHIN_S = 0.5
BACK_WITHIN_S = 30.0
WATCHDOG_S = {"flora-led": 20.0}
WATCHDOG_OF_OTHERS_S = 60.0
LOOP = ("flora-stem", "flora-controller")
REST = tuple(name for name in SERVICES if name not in LOOP)
UNITS = "/usr/local/lib/systemd/system"


def glob(machine: Machine, verb: str) -> None:
    """As people type it; must end with 0."""
    machine.run("systemctl", verb, "flora-*")


# installed


def test_an_empty_machine_gets_a_release_and_is_not_started_without_a_run(rig: Rig, table: Table) -> None:
    machine = rig.machine
    table.add("empty machine boots to running", f"{machine.boot_s:.1f} s")
    began_s = time.monotonic()
    done = rig.install()
    assert done.returncode == 0, done.stderr
    table.add("first installation", f"{time.monotonic() - began_s:.0f} s")
    assert "not started: " in done.stdout
    assert rig.are_stopped()
    assert 'fallback = "open-loop"' in machine.file("/etc/flora/flora.toml").read_text()
    assert machine.run("flora-led", "--version").stdout.startswith("flora-led ")
    assert machine.run("stat", "-c", "%U:%G %a", "/run/flora", "/var/lib/flora/state").stdout.splitlines() == [
        "flora:flora 750",
        "flora:flora 2770",
    ]


def test_a_person_can_leave_a_service_out(rig: Rig) -> None:
    rig.machine.run("systemctl", "mask", "flora-recorder.service")
    assert rig.machine.show("flora-recorder.service", "LoadState")["LoadState"] == "masked"
    rig.machine.run("systemctl", "unmask", "flora-recorder.service")


def test_with_a_run_it_becomes_a_rig(rig: Rig, table: Table) -> None:
    rig.prepare_run()
    config = rig.machine.file("/etc/flora/flora.toml").read_bytes()
    done = rig.install()
    assert done.returncode == 0, done.stderr
    assert re.search(rf"^well .* {len(SERVICES)} services are ready", done.stdout, re.MULTILINE)
    assert "NAS: one file written to /srv/nas, read back and removed" in done.stdout
    assert rig.are_ready()
    assert rig.machine.file("/etc/flora/flora.toml").read_bytes() == config
    assert [p.name for p in rig.machine.file("/srv/nas").iterdir() if "doctor" in p.name] == []
    table.add("with a run folder", f"{len(SERVICES)} services ready, one file to the NAS and back")


def test_its_page_can_be_reached_from_out_of_its_box(rig: Rig) -> None:
    asks = "import urllib.request; print(urllib.request.urlopen('http://127.0.0.1:8322/api/state', timeout=20).status)"
    assert rig.machine.run("/opt/flora/current/bin/python", "-c", asks).stdout.strip() == "200"


def test_the_same_again_changes_nothing(rig: Rig, table: Table) -> None:
    pids = [rig.machine.pid(service) for service in SERVICES]
    began_s = time.monotonic()
    done = rig.install()
    assert done.returncode == 0, done.stderr
    assert "changed  " not in done.stdout.replace("unchanged", "")
    assert [rig.machine.pid(service) for service in SERVICES] == pids
    table.add("the same installation again", f"nothing changed, {time.monotonic() - began_s:.0f} s")


def test_the_whole_loop_shines_in_its_boxes(rig: Rig, table: Table) -> None:
    """Empty box photographed, plant put in; then camera, vision, controller and lamps, each in its sandbox."""
    machine = rig.machine
    machine.run("runuser", "-u", "flora", "--", "flora-stem", "calibrate", within_s=300.0)
    put_in = "from flora_common.twin_link import TwinLink; TwinLink('ipc:///run/flora/twin').ask('plant', present=True)"
    machine.run("/opt/flora/current/bin/python", "-c", put_in)
    frames = machine.file(f"/srv/nas/{RUN}/frames")
    waited_s = machine.wait(
        lambda: frames.is_dir() and len(list(frames.glob("*.jpg"))) >= 3, within_s=120.0, what="photographs at the NAS"
    )
    rig.wait_lit()
    table.add("three photographs at the NAS, a lamp lit", f"{waited_s:.0f} s after the plant was put in")


# the glob, and boot


def test_start_stop_and_restart_of_the_glob(rig: Rig, table: Table) -> None:
    machine = rig.machine
    for _ in range(2):
        glob(machine, "stop")
        assert rig.are_stopped()
        assert not rig.box.are_lamps_lit
        machine.wait(lambda: machine.is_active("flora-rig.target"), within_s=10.0, what="anchor active again")
        glob(machine, "stop")
        machine.wait(lambda: machine.is_active("flora-rig.target"), within_s=10.0, what="anchor active again")
        assert rig.are_stopped()
        glob(machine, "start")
        rig.wait_ready()
        glob(machine, "start")
    before = {service: machine.pid(service) for service in SERVICES}
    glob(machine, "restart")
    rig.wait_ready()
    assert all(machine.pid(service) != pid for service, pid in before.items())
    machine.wait(lambda: machine.is_active("flora-rig.target"), within_s=10.0, what="anchor active again")
    assert machine.run("systemctl", "--failed", "--quiet", "--no-legend").stdout == ""
    table.add(
        "systemctl start, stop, restart 'flora-*'", "each ends with 0 and does it: running, stopped, twice in a row"
    )


def test_it_boots_to_running_and_powers_off(rig: Rig, table: Table) -> None:
    machine = rig.machine
    assert machine.power_off() == 0
    assert machine.boot() == "running"
    assert rig.are_ready()
    ready_us, began_us = {}, {}
    for service in SERVICES:
        times = machine.show(f"{service}.service", "ActiveEnterTimestampMonotonic", "ExecMainStartTimestampMonotonic")
        ready_us[service] = int(times["ActiveEnterTimestampMonotonic"])
        began_us[service] = int(times["ExecMainStartTimestampMonotonic"])
    assert all(began_us[service] >= ready_us["flora-bus"] for service in SERVICES if service != "flora-bus")
    table.add("boot to running, with the rig", f"{machine.boot_s:.1f} s")
    took = {service: (ready_us[service] - began_us[service]) / 1e6 for service in SERVICES}
    table.add("time to ready: the bus first", f"{took.pop('flora-bus'):.1f} s")
    table.add("time to ready: the others, at once", f"{min(took.values()):.1f} to {max(took.values()):.1f} s")
    whole_s = (max(ready_us.values()) - began_us["flora-bus"]) / 1e6
    table.add("time to ready: from first start to all", f"{whole_s:.1f} s")
    rig.wait_lit()


def test_the_journal_is_on_the_disk_and_has_fields(rig: Rig, table: Table) -> None:
    machine = rig.machine
    machine.run("journalctl", "--sync")
    ready = machine.journal(f"FLORA_RUN={RUN}", "FLORA_EVENT=ready")
    assert {entry["_SYSTEMD_UNIT"] for entry in ready} == {f"{service}.service" for service in SERVICES}
    boots = {entry["_BOOT_ID"] for entry in ready}
    assert len(boots) == 2  # this one, and the one before the power-off
    table.add(
        f"journalctl FLORA_RUN={RUN} FLORA_EVENT=ready",
        f"{len(ready)} entries of {len(SERVICES)} services, {len(boots)} boots",
    )


# death


def test_killed_services_come_back_and_lamps_are_dark_at_once(rig: Rig, table: Table) -> None:
    machine = rig.machine
    slowest_s = 0.0
    for service in SERVICES:
        rig.wait_ready()
        before = machine.pid(service)
        if service == "flora-led":
            rig.wait_lit()
            began_s = time.monotonic()
            machine.run("kill", "-9", str(before))
            dark_s = machine.wait(lambda: not rig.box.are_lamps_lit, within_s=5.0, what="dark", every_s=0.005)
            dark_s = max(dark_s, time.monotonic() - began_s)
            assert dark_s <= DARK_WITHIN_S
            table.add("lamps dark after kill -9 of flora-led", f"{dark_s:.2f} s")
        else:
            machine.run("kill", "-9", str(before))
        began_s = time.monotonic()
        machine.wait(lambda: machine.pid(service) not in (0, before), within_s=BACK_WITHIN_S, what=f"{service} back")  # noqa: B023
        rig.wait_ready(BACK_WITHIN_S)
        slowest_s = max(slowest_s, time.monotonic() - began_s)
    table.add(f"each of {len(SERVICES)} services killed with -9", f"back and ready within {slowest_s:.1f} s")
    rig.wait_lit()


def test_hung_services_are_restarted_by_their_watchdogs(rig: Rig, table: Table) -> None:
    machine = rig.machine
    rig.wait_lit()
    before = {service: machine.pid(service) for service in SERVICES}
    machine.run("kill", "-STOP", *(str(pid) for pid in before.values()))
    limit_s = WATCHDOG_S["flora-led"] + 10.0
    machine.wait(lambda: not rig.box.are_lamps_lit, within_s=limit_s, what="dark", every_s=0.005)
    dark_us = time.time() * 1e6
    machine.wait(
        lambda: all(machine.pid(service) not in (0, pid) for service, pid in before.items()),
        within_s=WATCHDOG_OF_OTHERS_S + 40.0,
        what="all hung services replaced",
    )
    rig.wait_ready(BACK_WITHIN_S)
    machine.run("journalctl", "--sync")
    found = machine.journal("--boot", "_PID=1", "--grep=Watchdog timeout")
    assert {entry["UNIT"] for entry in found} == {f"{service}.service" for service in SERVICES}
    (of_led,) = [entry for entry in found if entry["UNIT"] == "flora-led.service"]
    dark_s = (dark_us - int(of_led["__REALTIME_TIMESTAMP"])) / 1e6
    assert dark_s <= DARK_WITHIN_S
    table.add("lamps dark after flora-led's watchdog (20 s)", f"{dark_s:.2f} s")
    table.add(f"each of {len(SERVICES)} services hung (SIGSTOP)", "killed by its watchdog, replaced and ready")
    rig.wait_lit()


def test_a_crash_loop_ends_in_safe_mode_and_the_glob_ends_safe_mode(rig: Rig, table: Table) -> None:
    """At its real length: thirty starts."""
    machine = rig.machine
    drop_in = "/etc/systemd/system/flora-stem.service.d/50-broken.conf"
    broken = "[Service]\nExecStart=\nExecStart=/bin/false\n"
    machine.write(drop_in, broken)
    machine.run("systemctl", "daemon-reload")
    began_s = time.monotonic()
    machine.run("systemctl", "restart", "flora-stem.service", check=False)
    machine.wait(lambda: machine.is_active("safe-mode-flora.target"), within_s=240.0, what="safe mode", every_s=1.0)
    took_s = time.monotonic() - began_s
    assert rig.are_ready(REST)
    machine.wait(lambda: rig.are_stopped(LOOP), within_s=20.0, what="stem and controller at rest")
    lamps = "flora-monitor tail lamps --json --count 2"
    machine.wait(
        lambda: '"fallback":true' in machine.run("sh", "-c", lamps, within_s=60.0).stdout.replace(" ", ""),
        within_s=120.0,
        what="lamps on their fallback",
        every_s=2.0,
    )
    assert rig.box.are_lamps_lit
    table.add(
        "crash loop of flora-stem: 30 starts to safe mode",
        f"{took_s:.0f} s; {len(REST)} services go on, open-loop light",
    )
    glob(machine, "stop")
    assert not machine.is_active("safe-mode-flora.target")
    machine.write(drop_in, f"[Unit]\nStartLimitBurst=3\n{broken}RestartSec=0.2\n")
    machine.run("systemctl", "daemon-reload")
    glob(machine, "start")
    machine.wait(lambda: machine.is_active("safe-mode-flora.target"), within_s=60.0, what="safe mode again")
    machine.wait(
        lambda: "No jobs" in machine.run("systemctl", "list-jobs").stdout, within_s=30.0, what="systemd at rest"
    )
    machine.file(drop_in).unlink()
    machine.run("systemctl", "daemon-reload")
    glob(machine, "restart")
    rig.wait_ready()
    assert not machine.is_active("safe-mode-flora.target")
    table.add("stop, start, restart 'flora-*' in and out of safe mode", "each ends with 0; safe mode is over")
    rig.wait_lit()


# controllers


def test_a_signed_controller_is_taken_over_ssh(rig: Rig, table: Table, tmp_path: Path) -> None:
    machine = rig.machine
    pem = ADA.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    machine.write("/etc/flora/keys/ada.pub", pem.decode())
    machine.run("systemctl", "restart", "flora-controller.service")
    rig.wait_ready()
    file = tmp_path / "best.controller.json"
    file.write_bytes(signed(TIP_ONLY, ADA, serial=7).data)
    given = {"CONTROLLER": str(file), "RIG": "box1", "HOST": "root@127.0.0.1"}
    command = [str(ROOT / "deploy/publish-controller.sh"), str(Path(sys.executable).parent)]
    done = subprocess.run(command, env=machine.environment | given, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "rig `box1` took best.controller.json" in done.stdout
    again = subprocess.run(
        command, env=machine.environment | given | {"RIG": "box2"}, capture_output=True, text=True, timeout=120
    )
    assert again.returncode != 0
    table.add("make deploy of a signed controller over ssh", "taken; one for another rig is not")


# releases


def test_an_upgrade_stands_beside_the_release_before(rig: Rig, table: Table, tmp_path: Path) -> None:
    before = rig.current()
    source = rig.changed_copy(tmp_path / "next", "README.md", "# flora", "# flora, the next")
    began_s = time.monotonic()
    done = rig.install(source)
    assert done.returncode == 0, done.stderr
    assert rig.current() != before
    assert rig.machine.file(f"/opt/flora/releases/{before}/bin/flora-led").is_file()
    assert rig.are_ready()
    table.add("upgrade", f"{time.monotonic() - began_s:.0f} s, 10 of them watched")


def test_a_release_that_cannot_load_is_not_switched_to(rig: Rig, table: Table, tmp_path: Path) -> None:
    before = rig.current()
    pids = [rig.machine.pid(service) for service in SERVICES]
    old = "from __future__ import annotations\n"
    source = rig.changed_copy(tmp_path / "x", "services/flora_stem/main.py", old, f"{old}\nimport no_such_module\n")
    done = rig.install(source)
    assert done.returncode == 1
    assert "was not switched to" in done.stderr
    assert rig.current() == before
    assert [rig.machine.pid(service) for service in SERVICES] == pids
    table.add("a release that cannot load", "not switched to; no service was touched")


def test_a_broken_release_is_left_by_itself(rig: Rig, table: Table, tmp_path: Path) -> None:
    before = rig.current()
    began_s = time.monotonic()
    done = rig.install(rig.broken_copy(tmp_path / "broken", "broken release"))
    took_s = time.monotonic() - began_s
    assert done.returncode == 1
    assert re.search(rf"was not well: flora-led .*{re.escape(before)} runs again, and is well", done.stderr)
    assert rig.current() == before
    assert rig.are_ready()
    assert not rig.machine.file("/opt/flora/trial.json").exists()
    table.add(
        "a release whose flora-led dies at its start",
        f"left for the one before; all ready again, {took_s:.0f} s in all",
    )


def test_power_cut_in_the_middle_of_a_trial(rig: Rig, table: Table, tmp_path: Path) -> None:
    """Nobody is there who installs; the machine decides when it boots."""
    machine, before = rig.machine, rig.current()
    source = rig.broken_copy(tmp_path / "broken", "another broken release")
    command = [sys.executable, str(source / "deploy/install_rig.py"), "root@127.0.0.1"]
    with subprocess.Popen(command, env=machine.environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as run:
        trial = machine.file("/opt/flora/trial.json")
        machine.wait(trial.exists, within_s=240.0, what="a trial")
        machine.wait(lambda: rig.current() != before, within_s=20.0, what="a switch")
        time.sleep(2.0)
        machine.cut_power()
        _, said = run.communicate(timeout=120)
    assert run.returncode == 1, said
    machine.boot()
    assert rig.current() == before
    rig.wait_ready()
    rig.wait_lit()
    table.add("power cut while a broken release is on trial", "left for the one before at the next boot")


def test_a_person_goes_back_and_forth(rig: Rig, table: Table) -> None:
    newest = rig.current()
    done = rig.install(None, "--rollback")
    assert done.returncode == 0, done.stderr
    older = rig.current()
    assert older != newest
    assert rig.are_ready()
    assert rig.install(None, "--rollback").returncode == 0
    assert rig.current() == newest
    table.add("make rollback-rig", "back to the release before, and forth again")


def test_the_last_three_that_were_well_are_kept(rig: Rig, table: Table, tmp_path: Path) -> None:
    ran = [rig.current()]
    for n in (1, 2):
        source = rig.changed_copy(tmp_path / f"{n}", "README.md", "# flora", f"# flora {n}")
        assert rig.install(source).returncode == 0
        ran.append(rig.current())
    assert sorted(path.name for path in rig.machine.file("/opt/flora/releases").iterdir()) == sorted(ran)
    assert list(rig.machine.file("/opt/flora/incoming").iterdir()) == []
    table.add("releases on the rig after four that were well and three not", "the last three that were")


# boxes


def test_every_unit_keeps_its_score(rig: Rig, table: Table) -> None:
    machine = rig.machine
    scores = {}
    names = [f"{service}.service" for service in SERVICES]
    for name in [*names, "on-flora-stopped.service", "on-flora-failed@.service", "on-flora-installed.service"]:
        command = f"cd {UNITS} && systemd-analyze security --offline=true --no-pager ./{name}"
        said = machine.run("sh", "-c", command).stdout
        scores[name] = float(re.findall(r"Overall exposure level for \S+: ([\d.]+)", said)[-1])
    assert max(scores.values()) <= 1.2
    for name, score in sorted(scores.items(), key=lambda row: row[1]):
        table.add(f"exposure of {name}", f"{score:.1f}")
