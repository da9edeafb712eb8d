"""The doctor on a Pi where all is well, with one thing wrong after the other, and on a laptop with a virtual rig."""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from flora_common.config import ClockSection, RigSection
from flora_common.health import Line, services_of_catalogue
from flora_monitor import doctor_nas
from flora_monitor.doctor import CHECKS, Finding, examine, json_of, sentence, summary, take_case
from flora_monitor.doctor_case import Heard
from flora_monitor.doctor_machine import journal_storage
from flora_monitor.doctor_units import TARGET
from flora_monitor.doctor_world import Account, Done, Room, World, run_child, this_machine
from flora_monitor.main import main
from signing_keys import ADA

REPOSITORY = Path(__file__).parents[2]
SERVICES = services_of_catalogue()
FLORA = Account("flora", 4141, os.getgid(), frozenset({os.getgid()}))
"""Opens what the group of whoever runs the tests may open."""
STRANGER = Account("flora", 4242, 4242, frozenset({4242}))
ROOT = Account("root", 0, 0, frozenset({0}))
RUN = "/var/lib/flora/runs/bean"
GOOD = Done(0, "", "")
RUN_TOML = """
plant = "Saxa"
interval_s = 300.0
[camera]
anchor_px = [820.0, 984.0]
px_per_cm = 18.4
width_px = 1640
height_px = 1232
"""
PI_CONFIG = {
    "flora-capture": '[capture]\nbackend = "picamera2"\nsource = "0"\n',
    "flora-led": '[led]\nbackend = "neopixel"\npin = "D18"\n',
    "flora-flash": '[flash]\nbackend = "gpio"\nchip = "/dev/gpiochip0"\nline = 17\n',
    "flora-uploader": '[uploader]\ntarget = "/mnt/nas"\nmarker = ".flora-nas"\n',
    "flora-controller": '[controller]\nuse = "waypoint"\ntrust = "if-signed"\nkeys_dir = "/etc/flora/keys"\n',
}


def line_of(service: str, state: str = "ready", reason: str = "") -> Line:
    return Line(service, state, reason, 1.0, 100.0, 50_000, 0, 0, ok=state == "ready")


class Pi:
    """A machine in a folder: files as a Pi has them, child processes that answer as one's would."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.rig = RigSection(run_dir=RUN)
        self.heard = Heard(True, tuple(map(line_of, SERVICES)))
        self.is_synchronised = True
        self.room = Room(20_000_000_000, False, 1)
        self.accounts = {"flora": FLORA, "root": ROOT}
        self.me = ROOT
        self.touch = False
        self.asked: list[tuple[list[str], Account | None]] = []
        self.printed = dict(PI_CONFIG)
        self.units = {f"{name}.service": self.unit(name) for name in SERVICES} | {
            TARGET: {"LoadState": "loaded", "UnitFileState": "enabled", "ActiveState": "active"}
            | {"Wants": " ".join(f"{name}.service" for name in SERVICES)}
        }
        self.answers: dict[str, Done] = {
            "picamera2": Done(0, '["imx219"]\n', ""),
            "neopixel": Done(0, "true\n", ""),
            "gpiod": Done(0, '{"label": "pinctrl-bcm2711", "name": "GPIO17", "used": false, "by": ""}\n', ""),
            "import_module": Done(0, '{"python": "3.11.2", "learning": [], "journal": true}\n', ""),
            "doctor_nas": Done(0, '{"free_bytes": 900000000000, "device": 2}\n', ""),
            "vcgencmd": Done(0, "throttled=0x0\n", ""),
        }
        self.write("/proc/device-tree/model", "Raspberry Pi 4 Model B Rev 1.5\0")
        self.write("/proc/meminfo", "MemTotal:        3884000 kB\nMemAvailable:    2900000 kB\n")
        self.write("/proc/modules", "v4l2 1 0 - Live\n")
        self.write("/proc/self/mountinfo", "30 1 179:2 / / rw,noatime shared:1 - ext4 /dev/mmcblk0p2 rw\n")
        self.write("/boot/firmware/config.txt", "camera_auto_detect=1\n")
        self.write("/sys/fs/ext4/mmcblk0p2/errors_count", "0\n")
        self.write(f"{RUN}/run.toml", RUN_TOML)
        self.write(f"{RUN}/background/dark.jpg", "")
        self.write("/etc/flora/flora.toml", "")
        self.write("/etc/systemd/journald.conf.d/99-flora.conf", "[Journal]\nStorage=persistent\n")
        for device in ("/dev/gpiochip0", "/dev/mem", "/dev/media0", "/dev/video0"):
            self.write(device, "").chmod(0o660)
        (root / RUN.lstrip("/")).chmod(0o770)
        (root / "run/systemd/system").mkdir(parents=True)

    @staticmethod
    def unit(name: str) -> dict[str, str]:
        user = "root" if name == "flora-led" else "flora"
        return {"LoadState": "loaded", "UnitFileState": "enabled", "ActiveState": "active", "User": user} | {
            "ProtectSystem": "strict", "ProtectHome": "yes", "ReadWritePaths": "/var/lib/flora -/mnt",
        }  # fmt: skip

    def write(self, path: str, text: str) -> Path:
        file = self.root / path.lstrip("/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    def run(self, command: Sequence[str], *, account: Account | None = None) -> Done:
        self.asked.append((list(command), account))
        program = Path(command[0]).name
        if command[-1] == "--print-config":
            printed = self.printed.get(program, "")
            return Done(2, "", printed) if printed.startswith(f"{program}: ") else Done(0, printed, "")
        if program == "systemctl":
            blocks = [{"Id": name} | unit for name, unit in self.units.items()]
            return Done(0, "\n\n".join("\n".join(f"{k}={v}" for k, v in block.items()) for block in blocks), "")
        said = " ".join(command)
        return next((answer for key, answer in self.answers.items() if key in said), GOOD)

    def findings(self, python: str = "/opt/flora/releases/1/bin/python") -> dict[str, Finding]:
        world = World(
            root=self.root,
            me=self.me,
            run=self.run,
            lookup=lambda name, groups: self.accounts.get(name),
            room=lambda path: self.room,
            is_synchronised=lambda: self.is_synchronised,
            python=Path(python),
        )
        case = take_case(world, self.rig, None, SERVICES, self.heard, touch=self.touch)
        return {finding.part: finding for finding in examine(case)}


@pytest.fixture
def pi(tmp_path: Path) -> Pi:
    return Pi(tmp_path)


def test_a_pi_where_all_is_well_gets_a_tick_for_each_part(pi: Pi) -> None:
    findings = pi.findings()

    assert [f"{f.part}: {f.text}" for f in findings.values() if f.verdict != "good"] == []
    assert list(findings) == [part for part, _ in CHECKS]
    assert "imx219" in findings["camera"].text
    assert "1 pictures of the empty box" in findings["run folder"].text
    assert summary(list(findings.values())) == "nothing is wrong"


def print_config(service: str, old: str, new: str) -> Callable[[Pi], None]:
    def change(pi: Pi) -> None:
        assert old in pi.printed[service]
        pi.printed[service] = pi.printed[service].replace(old, new)

    return change


def answer(key: str, done: Done) -> Callable[[Pi], None]:
    return lambda pi: pi.answers.update({key: done})


def file(path: str, text: str) -> Callable[[Pi], None]:
    def change(pi: Pi) -> None:
        pi.write(path, text)

    return change


def no_file(path: str) -> Callable[[Pi], None]:
    return lambda pi: (pi.root / path.lstrip("/")).unlink()


def field(name: str, value: Any) -> Callable[[Pi], None]:
    return lambda pi: setattr(pi, name, value)


def unit(name: str, key: str, value: str) -> Callable[[Pi], None]:
    return lambda pi: pi.units[name].update({key: value})


def no_unit(name: str) -> Callable[[Pi], None]:
    return lambda pi: pi.units[name].update({"LoadState": "not-found", "UnitFileState": ""})


def strange_user(pi: Pi) -> None:
    pi.accounts["flora"] = STRANGER


def used_line(by: str) -> Callable[[Pi], None]:
    said = json.dumps({"label": "pinctrl-bcm2711", "name": "GPIO17", "used": True, "by": by})
    return answer("gpiod", Done(0, said + "\n", ""))


def unreadable_key(pi: Pi) -> None:
    pi.write("/etc/flora/keys/ada.pub", "not a key")


def only(state: str, reason: str) -> Heard:
    return Heard(True, (line_of("flora-bus"), line_of("flora-led", state, reason)))


def loaded(**changed: Any) -> Callable[[Pi], None]:
    said = json.dumps({"python": "3.11.2", "learning": [], "journal": True} | changed)
    return answer("import_module", Done(0, said, ""))


MOUNTS = (
    "29 1 179:2 / / rw - ext4 /dev/mmcblk0p2 rw\n30 1 0:20 / /var\\040x rw - a b\n31 1 0:21 / /var rw - tmpfs t rw\n"
)
NO_MODULE = Done(1, "", "Traceback\nModuleNotFoundError: No module named 'x'\n")
WRONG: list[tuple[str, Callable[[Pi], None], str]] = [
    ("config", no_file("/etc/flora/flora.toml"), "every service takes its defaults; write one"),
    ("config", lambda pi: pi.printed.update({"flora-stem": "flora-stem: [stem]: unknown key `x`"}), "unknown key `x`"),
    ("programs", answer("import_module", NO_MODULE), "No module named 'x'"),
    ("programs", loaded(learning=["torch"]), "torch, which belong in the lab"),
    ("programs", loaded(journal=False), "sudo apt install python3-systemd"),
    ("run folder", no_file(f"{RUN}/run.toml"), "has no run.toml"),
    ("run folder", file(f"{RUN}/run.toml", "interval = 3"), "unknown key `interval`; did you mean `interval_s`?"),
    ("run folder", no_file(f"{RUN}/background/dark.jpg"), "flora-stem calibrate --wait"),
    ("run folder", strange_user, "may not be written by user `flora`"),
    ("run folder", unit("flora-stem.service", "ReadWritePaths", ""), "read-only for flora-stem"),
    ("bus", field("heard", Heard(False)), "systemctl start flora-rig.target"),
    ("bus", field("heard", only("degraded", "no camera")), "not well: flora-led degraded (no camera)"),
    ("bus", field("heard", only("never heard", "")), "not well: flora-led never heard"),
    ("camera", answer("picamera2", NO_MODULE), "apt install python3-picamera2"),
    ("camera", answer("picamera2", Done(0, "[]\n", "")), "seat the flat cable"),
    ("camera", print_config("flora-capture", '"0"', '"1"'), "there are 1, counted from 0: imx219"),
    ("camera", answer("picamera2", Done(None, "", "")), "no answer in time"),
    ("camera", strange_user, "/dev/media0 may not be opened by user `flora`"),
    ("strips", file("/proc/device-tree/model", "A laptop"), "no Raspberry Pi"),
    ("strips", answer("neopixel", NO_MODULE), "make rollback-rig"),
    ("strips", answer("neopixel", Done(0, "false\n", "")), "no such pin"),
    ("strips", unit("flora-led.service", "User", "flora"), "which only root may"),
    ("strips", no_file("/dev/mem"), "/dev/mem is not there"),
    ("strips", file("/proc/modules", "snd_bcm2835 28672 0 - Live\n"), "dtparam=audio=off"),
    ("strips", print_config("flora-led", "D18", "D10"), "dtparam=spi=on"),
    ("strips", file("/proc/device-tree/model", "Raspberry Pi 5 Model B"), "/dev/pio0 is not there"),
    ("strips", unit("flora-led.service", "DevicePolicy", "closed"), "DeviceAllow=/dev/mem rw"),
    ("flash", no_file("/dev/gpiochip0"), "/dev/gpiochip0 is not there"),
    ("flash", strange_user, "may not be opened by user `flora`"),
    ("flash", answer("gpiod", NO_MODULE), "make rollback-rig"),
    ("flash", answer("gpiod", Done(1, "", "gpiod is of version 1, as apt has it\n")), "make rollback-rig"),
    ("flash", used_line("spi0 CS0"), "in use by spi0 CS0"),
    ("flash", answer("gpiod", Done(0, '{"name": "PWM0_MISO", "used": false, "by": ""}', "")), "not the header's chip"),
    ("flash", print_config("flora-flash", "17", "18"), "are the same pin"),
    ("controller", print_config("flora-controller", "waypoint", "/x.controller.json"), "no such file"),
    ("keys", unreadable_key, "not a public key"),
    ("keys", print_config("flora-controller", "if-signed", "required"), "has no key"),
    ("keys", file("/etc/flora/flora.key", "-----BEGIN PRIVATE KEY-----"), "everybody on this machine can read it"),
    ("clock", field("is_synchronised", False), "timedatectl set-ntp true"),
    ("disk", field("room", Room(1_000_000_000, False, 1)), "7 are wanted: free some space"),
    ("disk", field("room", Room(20_000_000_000, True, 1)), "is read-only"),
    ("disk", file("/proc/self/mountinfo", MOUNTS), "lies in memory (tmpfs)"),
    ("disk", file("/sys/fs/ext4/mmcblk0p2/errors_count", "3\n"), "counts 3 errors"),
    ("disk", file("/sys/block/mmcblk0/device/life_time", "0x0b 0x02\n"), "end of its life"),
    ("NAS", answer("doctor_nas", Done(0, '{"problem": "/mnt/nas has no .flora-nas"}', "")), "has no .flora-nas"),
    ("NAS", answer("doctor_nas", Done(None, "", "")), "does not answer: is the server on?"),
    ("NAS", answer("doctor_nas", Done(0, '{"free_bytes": 9, "device": 1}', "")), "the same disk as the runs"),
    ("NAS", print_config("flora-uploader", "/mnt/nas", "/nas"), "read-only for flora-uploader"),
    ("memory", file("/proc/meminfo", "MemTotal: 900000 kB\nMemAvailable: 30000 kB\n"), "64 MiB are wanted beside"),
    ("power", answer("vcgencmd", Done(0, "throttled=0x50005\n", "")), "undervoltage now"),
    ("power", answer("vcgencmd", Done(0, "throttled=0x10000\n", "")), "undervoltage since the last boot"),
    ("power", answer("vcgencmd", Done(0, "throttled=0x40000\n", "")), "too warm"),
    ("units", no_unit("flora-led.service"), "not installed: flora-led; `make install-rig` brings the units"),
    ("units", unit(TARGET, "UnitFileState", "disabled"), f"sudo systemctl enable {TARGET}"),
    ("units", unit("flora-stem.service", "ActiveState", "failed"), "journalctl -u flora-stem"),
    ("units", unit("flora-stem.service", "LoadState", "masked"), "flora-stem.service is masked"),
    ("units", unit("flora-stem.service", "User", "nobody-here"), "whom this machine does not have"),
    ("units", unit(TARGET, "Wants", "flora-bus.service"), "does not start flora-flash"),
    ("journal", no_file("/etc/systemd/journald.conf.d/99-flora.conf"), "there is no /var/log/journal"),
    ("journal", file("/etc/systemd/journald.conf.d/99-zz.conf", "Storage=volatile\n"), "Storage=volatile in /etc"),
]  # fmt: skip


@pytest.mark.parametrize(("part", "spoil", "told"), WRONG, ids=lambda v: v if isinstance(v, str) else "")
def test_what_is_wrong_is_told_with_what_to_do(pi: Pi, part: str, spoil: Callable[[Pi], None], told: str) -> None:
    pi.answers["controller check"] = Done(2, "", "flora-controller: /x.controller.json: no such file\n")
    spoil(pi)

    finding = pi.findings()[part]

    assert (finding.verdict, told in finding.text) == ("wrong", True), finding


PARTS_OF_ITS_OWN = [("programs", "import_module"), ("strips", "neopixel"), ("flash", "gpiod")]


@pytest.mark.parametrize(("part", "key"), PARTS_OF_ITS_OWN)
def test_what_to_do_about_a_damaged_installation_can_be_done_there(pi: Pi, part: str, key: str) -> None:
    pi.answers[key] = NO_MODULE

    on_rig = pi.findings()[part].text
    assert "sudo rm -r /opt/flora/releases/1`" in on_rig
    assert "make setup" not in on_rig

    in_checkout = pi.findings("/home/ada/flora/.venv/bin/python")[part].text
    assert in_checkout.endswith("install flora anew: `make setup` in its checkout")


def test_every_page_and_target_that_is_named_is_there() -> None:
    named = "".join(file.read_text() for file in (REPOSITORY / "services/flora_monitor").glob("doctor*.py"))
    targets = (REPOSITORY / "Makefile").read_text()

    assert sorted(set(re.findall(r"`make ([a-z-]+)`", named))) == ["install-rig", "rollback-rig", "setup"]
    assert [t for t in set(re.findall(r"`make ([a-z-]+)`", named)) if f"\n{t}:" not in targets] == []
    pages = set(re.findall(r'"(docs/[^"]+)"', named))
    assert len(pages) == 2
    assert [page for page in pages if not (REPOSITORY / page).is_file()] == []


def test_one_fault_is_not_told_for_other_parts_too(pi: Pi) -> None:
    pi.answers["picamera2"] = NO_MODULE

    findings = pi.findings()

    assert [part for part, finding in findings.items() if finding.verdict == "wrong"] == ["camera"]
    assert summary(list(findings.values())) == "1 of 16 wrong: camera"


def test_a_camera_that_nothing_asks_for_is_explained_by_the_boot_configuration(pi: Pi) -> None:
    pi.answers["picamera2"] = Done(0, "[]\n", "")
    pi.write("/boot/firmware/config.txt", "# camera_auto_detect=1\n")

    assert "has neither camera_auto_detect=1" in pi.findings()["camera"].text


def test_where_a_section_cannot_be_read_its_parts_are_not_looked_at(pi: Pi) -> None:
    pi.printed["flora-led"] = "flora-led: [led]: unknown key `pim`"

    findings = pi.findings()

    assert findings["config"].verdict == "wrong"
    assert findings["strips"] == Finding("strips", "not looked at", "[led] cannot be read")
    assert findings["flash"].verdict == "good"


def test_whoever_may_not_open_a_device_that_the_service_may_is_sent_to_sudo(pi: Pi) -> None:
    pi.me = STRANGER
    pi.answers["gpiod"] = Done(1, "", "PermissionError: [Errno 13] Permission denied\n")

    finding = pi.findings()["flash"]

    assert finding.verdict == "not looked at"
    assert finding.text.endswith("run this command with sudo")


def test_an_answer_that_is_no_answer_is_not_believed(pi: Pi) -> None:
    pi.answers["doctor_nas"] = Done(0, '{"free_bytes": "much"}\n', "")
    pi.answers["neopixel"] = Done(0, "\x1b[31m", "")
    pi.printed["flora-capture"] = "[capture]\nbackend = 3\n"

    findings = pi.findings()

    assert [findings[part].verdict for part in ("NAS", "strips", "camera")] == ["not looked at"] * 3


def test_a_folder_that_the_caller_may_not_see_is_not_called_wrong(pi: Pi, monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(looks: Callable[[Path], bool], name: str) -> Callable[[Path], bool]:
        def look(path: Path) -> bool:
            if path.name == name:
                raise PermissionError(13, "Permission denied", str(path))
            return looks(path)

        return look

    pi.heard = Heard(False)
    monkeypatch.setattr(Path, "is_dir", refusing(Path.is_dir, "bean"))
    monkeypatch.setattr(Path, "exists", refusing(Path.exists, "bus-subscribe"))

    findings = pi.findings()

    assert [findings[part].verdict for part in ("run folder", "bus")] == ["not looked at"] * 2
    assert findings["bus"].text.endswith("Permission denied; run this command with sudo")


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


def test_lamps_that_do_not_go_dark_are_wrong(pi: Pi) -> None:
    pi.touch = True
    pi.answers = {"--dark": Done(1, "", "flora-led: strips: ws2811_init failed\n")} | pi.answers

    assert pi.findings()["strips"].text.endswith("flora-led --dark fails: strips: ws2811_init failed")


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


def test_a_line_that_flora_flash_holds_is_as_it_should_be(pi: Pi) -> None:
    used_line("flora-flash")(pi)

    assert pi.findings()["flash"].verdict == "good"


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
