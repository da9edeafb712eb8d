"""The doctor on a Pi where all is well and on a laptop with a virtual rig, what it may touch, and what it asks with."""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from doctor_fakes import PI_CONFIG, ROOT, RUN, Pi

from flora_common.config import ClockSection, RigSection
from flora_monitor import doctor_nas
from flora_monitor.doctor import CHECKS, Finding, json_of, sentence, summary
from flora_monitor.doctor_machine import journal_storage
from flora_monitor.doctor_world import Account, Done, run_child, this_machine
from flora_monitor.main import main
from signing_keys import ADA

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture
def pi(tmp_path: Path) -> Pi:
    return Pi(tmp_path)


def test_a_pi_where_all_is_well_gets_a_tick_for_each_part(pi: Pi) -> None:
    findings = pi.findings()

    assert [f"{f.part}: {f.text}" for f in findings.values() if f.verdict != "good"] == []
    assert list(findings) == [part for part, _ in CHECKS]
    assert "imx219" in findings["camera"].text
    assert "1 picture of the empty box" in findings["run folder"].text
    assert summary(list(findings.values())) == "nothing is wrong"


def test_every_page_and_target_that_is_named_is_there() -> None:
    named = "".join(file.read_text() for file in (REPOSITORY / "services/flora_monitor").glob("doctor*.py"))
    targets = (REPOSITORY / "Makefile").read_text()

    assert sorted(set(re.findall(r"`make ([a-z-]+)`", named))) == ["install-rig", "rollback-rig", "setup"]
    assert [t for t in set(re.findall(r"`make ([a-z-]+)`", named)) if f"\n{t}:" not in targets] == []
    pages = set(re.findall(r'"(docs/[^"]+)"', named))
    assert len(pages) == 2
    assert [page for page in pages if not (REPOSITORY / page).is_file()] == []


def commands_of(pi: Pi, flag: str) -> list[str]:
    return [Path(command[0]).name for command, _ in pi.asked if command[-1] == flag]


def test_nothing_is_switched_or_written_unless_asked_for(pi: Pi) -> None:
    pi.findings()
    assert commands_of(pi, "--dark") == commands_of(pi, "--touch") == []

    pi.touch = True
    pi.answers["doctor_nas"] = Done(0, '{"free_bytes": 9, "device": 2, "is_written": true}\n', "")
    findings = pi.findings()

    assert commands_of(pi, "--dark") == ["flora-led", "flora-flash"]
    assert len(commands_of(pi, "--touch")) == 1
    assert "one file written and read back" in findings["NAS"].text
    assert findings["strips"].text.endswith("switched dark")


@contextmanager
def held(lock: Path) -> Iterator[None]:
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    yield
    os.close(descriptor)


def test_lamps_that_a_running_service_holds_are_never_touched(pi: Pi) -> None:
    pi.touch = True
    lock = pi.write(f"{pi.rig.state_dir}/flora-led.lock", "")

    with held(lock):
        findings = pi.findings()

    assert commands_of(pi, "--dark") == ["flora-flash"]
    assert "flora-led runs, so it was not touched" in findings["strips"].text
    pi.asked.clear()
    pi.findings()
    assert commands_of(pi, "--dark") == ["flora-led", "flora-flash"]


def test_devices_are_asked_as_the_users_of_the_services(pi: Pi) -> None:
    pi.findings()

    asked = {
        (account.name if account else "", key)
        for command, account in pi.asked
        for key in pi.answers
        if key in " ".join(command)
    }
    assert {("flora", "picamera2"), ("root", "neopixel"), ("flora", "gpiod"), ("flora", "doctor_nas")} <= asked


def test_a_laptop_with_a_virtual_rig_needs_no_device(pi: Pi) -> None:
    pi.rig = RigSection(run_dir=RUN, clock=ClockSection(kind="twin"))
    pi.units.clear()
    pi.write("/proc/device-tree/model", "")
    (pi.root / "run/systemd/system").rmdir()
    pi.printed = {
        "flora-capture": '[capture]\nbackend = "virtual"\nsource = "0"\n',
        "flora-led": '[led]\nbackend = "virtual"\npin = "D18"\n',
        "flora-flash": '[flash]\nbackend = "virtual"\nchip = "/dev/gpiochip0"\nline = 17\n',
        "flora-uploader": '[uploader]\ntarget = ""\nmarker = ""\n',
        "flora-controller": PI_CONFIG["flora-controller"],
    }

    findings = pi.findings()

    unused = {part for part, finding in findings.items() if finding.verdict == "not used here"}
    assert unused == {"camera", "strips", "flash", "NAS", "clock", "power", "units", "journal"}
    assert {finding.verdict for finding in findings.values()} == {"good", "not used here"}


def test_photographs_of_the_run_itself_tell_how_long_the_disk_lasts(pi: Pi) -> None:
    for number in range(3):
        (pi.write(f"{RUN}/frames/{number:06d}.jpg", "")).write_bytes(bytes(1_000_000))

    # 288 photographs of 1 MB a day, and 30 MB of messages: 318 MB.
    assert "20.0 GB free for /var/lib/flora/runs/bean, 63 days at 318 MB a day" in pi.findings()["disk"].text


def test_a_trusted_key_is_named(pi: Pi) -> None:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    pem = ADA.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    pi.write("/etc/flora/keys/ada.pub", "# Ada's lab\n" + pem.decode())

    assert "(Ada's lab)" in pi.findings()["keys"].text


def test_journal_settings_are_merged_as_systemd_merges_them(pi: Pi) -> None:
    pi.write("/usr/lib/systemd/journald.conf.d/40-rpi-volatile-storage.conf", "[Journal]\nStorage=volatile\n")
    pi.write("/etc/systemd/journald.conf", "[Journal]\n#Storage=auto\nStorage=none\n")
    world = replace(this_machine(), root=pi.root)
    assert journal_storage(world) == ("persistent", "/etc/systemd/journald.conf.d/99-flora.conf")

    (pi.root / "etc/systemd/journald.conf.d/99-flora.conf").unlink()
    assert journal_storage(world)[0] == "volatile"

    pi.write("/etc/systemd/journald.conf.d/40-rpi-volatile-storage.conf", "[Journal]\n")  # in place of the vendor's
    assert journal_storage(world)[0] == "none"


def test_a_sentence_says_the_verdict_where_its_mark_would_not() -> None:
    assert sentence(Finding("NAS", "not used here", "no target")) == "not used here: no target"
    assert json.loads(json_of(Finding("NAS", "wrong", "gone"))) == {"part": "NAS", "verdict": "wrong", "text": "gone"}


def test_a_file_whose_name_is_no_text_is_told_to_programs_too() -> None:
    finding = Finding("configuration", "good", os.fsdecode(b"/etc/b\xff/flora.toml: read"))
    assert json.loads(json_of(finding))["text"] == "/etc/b\N{REPLACEMENT CHARACTER}/flora.toml: read"


def test_one_file_goes_to_the_nas_and_back_and_is_gone_again(tmp_path: Path) -> None:
    (tmp_path / ".flora-nas").touch()

    looked = doctor_nas.look(tmp_path, ".flora-nas", touch=True)

    assert (looked.problem, looked.is_written, looked.device) == ("", True, tmp_path.stat().st_dev)
    assert [path.name for path in tmp_path.iterdir()] == [".flora-nas"]


def test_nothing_is_written_beside_a_missing_marker(tmp_path: Path) -> None:
    looked = doctor_nas.look(tmp_path, ".flora-nas", touch=True)

    assert "has no .flora-nas, as an empty mount point" in looked.problem
    assert list(tmp_path.iterdir()) == []
    assert "is no folder" in doctor_nas.look(tmp_path / "gone", "", touch=True).problem


def test_a_nas_that_gives_back_other_bytes_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "posix_fadvise", lambda number, *_: os.truncate(f"/proc/self/fd/{number}", 100))

    looked = doctor_nas.look(tmp_path, "", touch=True)

    assert "other bytes came back" in looked.problem
    assert list(tmp_path.iterdir()) == []


def test_a_child_that_does_not_end_is_killed_at_its_deadline() -> None:
    assert run_child(["sleep", "60"], deadline_s=0.05) == Done(None, "", "")


def test_a_command_that_is_not_there_is_told() -> None:
    done = run_child(["/no/such/command"])

    assert not done.is_good
    assert done.reason == "/no/such/command: No such file or directory"


@pytest.mark.parametrize(
    ("mode", "account", "write", "may"),
    [
        (0o600, Account("owner", 7, 7, frozenset({7})), True, True),
        (0o460, Account("owner", 7, 8, frozenset({8})), True, False),  # the owner's own bits count, not the group's
        (0o660, Account("member", 9, 9, frozenset({9, 8})), True, True),
        (0o640, Account("member", 9, 9, frozenset({9, 8})), True, False),
        (0o640, Account("member", 9, 9, frozenset({9, 8})), False, True),
        (0o660, Account("other", 9, 9, frozenset({9})), False, False),
        (0o000, ROOT, True, True),
    ],
)  # fmt: skip
def test_who_may_open_a_file(mode: int, account: Account, write: bool, may: bool) -> None:
    status = os.stat_result((mode, 0, 0, 1, 7, 8, 0, 0, 0, 0))

    assert account.may(status, write=write) is may


def test_the_command_hears_the_bus_of_this_machine_and_looks_at_the_rest(
    bus: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    bus.sections["led"] = {"backend": "virtual"}
    bus.start_service("flora-bus")
    bus.wait_ready(bus.client(), "flora-bus")

    status = main(["doctor", "--config", str(bus.config), "--json"])

    said = capsys.readouterr()
    findings = {line["part"]: line for line in map(json.loads, said.out.splitlines())}
    assert status == 1
    assert list(findings) == [part for part, _ in CHECKS]
    assert findings["config"]["verdict"] == findings["programs"]["verdict"] == "good"
    assert findings["strips"]["verdict"] == "not used here"
    assert "answers; not well: flora-flash never heard" in findings["bus"]["text"]
    assert said.err.startswith("flora-monitor: ")
    assert said.err.count("\n") == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may run a child as somebody else")
def test_a_child_runs_as_the_user_of_the_service() -> None:
    nobody = Account("nobody", 65534, 65534, frozenset({65534, 4243}))

    assert run_child(["id", "-u"], account=nobody).out == "65534\n"
    assert set(run_child(["id", "-G"], account=nobody).out.split()) == {"65534", "4243"}


def test_a_config_that_cannot_be_read_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--config", str(tmp_path / "none.toml")]) == 2
    assert "none.toml: cannot be read" in capsys.readouterr().err
