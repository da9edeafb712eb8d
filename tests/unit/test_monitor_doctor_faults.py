"""One thing wrong on a Pi after the other: told with what to do, and for no other part."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from doctor_fakes import RUN, STRANGER, Pi, line_of

from flora_monitor.doctor import Finding, summary
from flora_monitor.doctor_case import Heard
from flora_monitor.doctor_units import TARGET
from flora_monitor.doctor_world import Done, Room


@pytest.fixture
def pi(tmp_path: Path) -> Pi:
    return Pi(tmp_path)


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


def of_root(name: str) -> Callable[[Pi], None]:
    return lambda pi: pi.write(f"{RUN}/{name}", "").chmod(0o644)


def closed_runs(pi: Pi) -> None:
    (pi.root / RUN.lstrip("/")).parent.chmod(0o700)


def used_line(by: str) -> Callable[[Pi], None]:
    said = json.dumps({"label": "pinctrl-bcm2711", "name": "GPIO17", "used": True, "by": by})
    return answer("gpiod", Done(0, said + "\n", ""))


def usb_camera(source: str) -> Callable[[Pi], None]:
    text = f'[capture]\nbackend = "opencv"\nsource = "{source}"\n'
    return lambda pi: pi.printed.update({"flora-capture": text})


def link_to_itself(pi: Pi) -> None:
    link = pi.root / RUN.lstrip("/")
    link.rename(link.with_name("bean-00"))
    link.symlink_to(link)


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
    ("run folder", link_to_itself, "no such run folder"),
    ("run folder", file(f"{RUN}/run.toml", "interval = 3"), "unknown key `interval`; did you mean `interval_s`?"),
    ("run folder", no_file(f"{RUN}/background/dark.jpg"), "flora-stem calibrate --wait"),
    ("run folder", strange_user, "may not be written by user `flora`"),
    ("run folder", closed_runs, "/var/lib/flora/runs may not be entered by user `flora`, as whom flora-capture runs"),
    ("run folder", of_root("frames.csv"), "frames.csv may not be written by user `flora`, as whom flora-capture runs"),
    ("run folder", of_root("track.csv"), "track.csv may not be written by user `flora`, as whom flora-stem runs"),
    ("run folder", unit("flora-stem.service", "ReadWritePaths", ""), "read-only for flora-stem"),
    ("bus", field("heard", Heard(False)), "systemctl start flora-rig.target"),
    ("bus", field("heard", only("degraded", "no camera")), "not well: flora-led degraded (no camera)"),
    ("bus", field("heard", only("never heard", "")), "not well: flora-led never heard"),
    ("camera", answer("picamera2", NO_MODULE), "apt install python3-picamera2"),
    ("camera", answer("picamera2", Done(0, "[]\n", "")), "seat the flat cable"),
    ("camera", print_config("flora-capture", '"0"', '"1"'), "there are 1, counted from 0: imx219"),
    ("camera", print_config("flora-capture", '"0"', '"front"'), "source front: not the number of a Pi camera"),
    ("camera", usb_camera("/dev/v4l/by-id/usb-video-index0"), "usb-video-index0 is not there: plug the camera in"),
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
    ("disk", field("room", Room(20_000_000_000, False, 1, 50)), "places for 50 more files (`df -i`), 2100 are wanted"),
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


def test_a_link_to_a_usb_camera_is_followed_to_its_device(pi: Pi) -> None:
    link = pi.root / "dev/v4l/by-id/usb-video-index0"
    link.parent.mkdir(parents=True)
    link.symlink_to("../../video0")
    usb_camera("/dev/v4l/by-id/usb-video-index0")(pi)

    assert pi.findings()["camera"] == Finding("camera", "good", "/dev/video0 is there and may be opened")


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


def test_lamps_that_do_not_go_dark_are_wrong(pi: Pi) -> None:
    pi.touch = True
    pi.answers = {"--dark": Done(1, "", "flora-led: strips: ws2811_init failed\n")} | pi.answers

    assert pi.findings()["strips"].text.endswith("flora-led --dark fails: strips: ws2811_init failed")


def test_a_line_that_flora_flash_holds_is_as_it_should_be(pi: Pi) -> None:
    used_line("flora-flash")(pi)

    assert pi.findings()["flash"].verdict == "good"
