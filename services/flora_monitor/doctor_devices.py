"""Camera, strips and flash lamp: driver, device, permission; nothing is switched unless asked for.

Drivers are loaded in child processes, in the services' own interpreter and as their users, because a driver may hang,
and because what counts is whether the service can, not whether the caller can.
"""

from __future__ import annotations

import re
from typing import Any, Final

from flora_monitor.doctor_case import CaptureKeys, Case, FlashKeys, LedKeys
from flora_monitor.doctor_world import NotLookedAt, NotUsed, World, Wrong

MODEL: Final = "/proc/device-tree/model"
BOOT_CONFIGS: Final = ("/boot/firmware/config.txt", "/boot/config.txt")
"""Of Raspberry Pi OS since Debian 12, and before."""

LIST_CAMERAS: Final = """
import json
from picamera2 import Picamera2
print(json.dumps([str(one.get("Model", "?")) for one in Picamera2.global_camera_info()]))
"""
LOAD_STRIPS: Final = """
import json, sys
import board, neopixel
print(json.dumps(hasattr(board, sys.argv[1])))
"""
READ_LINE: Final = """
import json, sys
import gpiod
if not hasattr(gpiod, "request_lines"):
    sys.exit("gpiod is of version 1, as apt has it; version 2 is needed")
with gpiod.Chip(sys.argv[1]) as chip:
    line = chip.get_line_info(int(sys.argv[2]))
    print(json.dumps({"label": chip.get_info().label, "name": line.name, "used": line.used, "by": line.consumer}))
"""
IS_NUMBER: Final = re.compile(r"\d+", re.ASCII)
SPI_PINS: Final = frozenset({"D10", "MOSI"})
PCM_PINS: Final = frozenset({"D21"})
"""Any other pin of the strips is driven by PWM, which the analogue sound output drives too."""


def pi_model(world: World) -> str:
    """Such as ``Raspberry Pi 4 Model B Rev 1.5``; empty where this is none."""
    model = (world.read(MODEL) or "").strip("\0\n ")
    return model if "Raspberry Pi" in model else ""


def boot_config(world: World) -> tuple[str, list[str]]:
    """The firmware's configuration: where it is, and its lines without comments and blanks."""
    for path in BOOT_CONFIGS:
        text = world.read(path)
        if text is not None:
            return path, [line.replace(" ", "") for line in text.splitlines() if line.strip()[:1] not in ("", "#")]
    return BOOT_CONFIGS[0], []


def _check_device(case: Case, service: str, device: str, *, missing: str) -> None:
    account, unit = case.account(service), case.units.get(service)
    try:
        status = case.world.at(device).stat()
    except FileNotFoundError:
        raise Wrong(f"{device} is not there: {missing}") from None
    if not account.may(status, write=True):
        raise Wrong(
            f"{device} may not be opened by user `{account.name}` (mode {status.st_mode & 0o777:o}, group "
            f"{status.st_gid}): sudo usermod -aG GROUP {account.name}, with the group that `ls -l {device}` shows"
        )
    if unit is not None and unit.is_loaded and not unit.may_open(device):
        raise Wrong(f"{device} is kept from {service} by its unit: systemctl edit {service}, DeviceAllow={device} rw")


def check_camera(case: Case) -> str:
    """The camera that ``[capture]`` names is found, and its driver loads."""
    keys = case.section("capture", CaptureKeys)
    if keys.backend in ("virtual", "replay"):
        what = "the virtual grow box's" if keys.backend == "virtual" else f"photographs of {keys.source} stand for it"
        raise NotUsed(f'[capture] backend = "{keys.backend}": {what}')
    if keys.backend == "opencv":
        return _check_usb_camera(case, keys.source)
    return _check_pi_camera(case, keys.source)


def _check_usb_camera(case: Case, source: str) -> str:
    # A link, such as those in /dev/v4l/by-id, names the same camera after each start.
    device = f"/dev/video{source}" if IS_NUMBER.fullmatch(source) else str(case.world.real(source))
    if not device.startswith("/dev/"):
        if not case.world.at(source).is_file():
            raise Wrong(f"[capture] source {source}: no such film")
        raise NotUsed(f"the film {source} stands for it")
    _check_device(case, "flora-capture", device, missing="plug the camera in, or change its source")
    return f"{device} is there and may be opened"


def _check_pi_camera(case: Case, source: str) -> str:
    if source and not IS_NUMBER.fullmatch(source):
        raise Wrong(
            f"[capture] source {source}: not the number of a Pi camera, 0 for the first one; "
            'a USB camera needs backend = "opencv"'
        )
    account = case.account("flora-capture")
    try:
        models: Any = case.ask_json("flora-capture", LIST_CAMERAS)
    except Wrong as problem:
        if "No module named" in str(problem):
            advice = "sudo apt install python3-picamera2, in an environment with --system-site-packages"
            raise Wrong(f"picamera2 cannot be loaded ({problem}): {advice}") from problem
        raise Wrong(f"picamera2 fails: {problem}") from problem
    if not models:
        raise Wrong(f"no camera answers: {_why_no_camera(case.world)}")
    for device in sorted(case.world.at("/dev").glob("media[0-9]*")):
        if not account.may(device.stat(), write=True):
            raise Wrong(f"/dev/{device.name} may not be opened by user `{account.name}`: add it to the group video")
    number = int(source or "0")
    if number >= len(models):
        raise Wrong(f"[capture] source {number}: there are {len(models)}, counted from 0: {', '.join(models)}")
    return f"{models[number]} answers, picamera2 loads"


def _why_no_camera(world: World) -> str:
    path, lines = boot_config(world)
    asked = [line for line in lines if re.match(r"dtoverlay=(imx|ov|arducam)", line)]
    if "camera_auto_detect=1" not in lines and not asked:
        return f"{path} has neither camera_auto_detect=1 nor an overlay for the sensor; add the line and boot again"
    return "switch the Pi off, seat the flat cable anew at both ends, and boot"


def check_strips(case: Case) -> str:
    """The chain's driver loads, its device is there, and nothing else drives the pin."""
    keys = case.section("led", LedKeys)
    if keys.backend == "virtual":
        raise NotUsed('[led] backend = "virtual": the virtual grow box\'s')
    model = pi_model(case.world)
    if not model:
        raise Wrong(
            '[led] backend = "neopixel", but this is no Raspberry Pi: the driver runs and lights nothing; '
            'use backend = "virtual" for the virtual grow box'
        )
    try:
        has_pin = case.ask_json("flora-led", LOAD_STRIPS, keys.pin)
    except Wrong as problem:
        raise Wrong(f"the NeoPixel driver cannot be loaded ({problem}): {case.world.install_anew}") from problem
    if has_pin is not True:
        raise Wrong(f"[led] pin `{keys.pin}`: this board has no such pin")
    device = _check_chain_device(case, keys.pin, is_pi_5="Raspberry Pi 5" in model)
    if not case.touch:
        return f"driver loads, {device} is there; not switched (--touch sends dark)"
    return _switched_dark(case, "flora-led", f"driver loads, {device} is there")


def _check_chain_device(case: Case, pin: str, *, is_pi_5: bool) -> str:
    world, account = case.world, case.account("flora-led")
    path, lines = boot_config(world)
    if is_pi_5:
        _check_device(
            case, "flora-led", "/dev/pio0", missing="a Pi 5 needs newer firmware and kernel: sudo apt full-upgrade"
        )
        return "/dev/pio0"
    if pin in SPI_PINS:
        _check_device(case, "flora-led", "/dev/spidev0.0", missing=f"add dtparam=spi=on to {path} and boot again")
        return "/dev/spidev0.0"
    if account.uid != 0:
        raise Wrong(
            f"pin {pin} is driven through /dev/mem, which only root may: run flora-led as root, not as "
            f'`{account.name}`, or wire the chain to SPI and set [led] pin = "D10"'
        )
    _check_device(case, "flora-led", "/dev/mem", missing="the kernel gives no access to memory")
    if pin not in PCM_PINS and re.search(r"^snd_bcm2835\b", world.read("/proc/modules") or "", re.MULTILINE):
        line = " (it says dtparam=audio=on)" if "dtparam=audio=on" in lines else ""
        raise Wrong(
            f"the analogue sound output uses the PWM that pin {pin} needs: set dtparam=audio=off in {path}{line}, boot"
        )
    return "/dev/mem"


def check_flash(case: Case) -> str:
    """The line of the flash lamp is there, is the right one, and is nobody else's."""
    keys = case.section("flash", FlashKeys)
    if keys.backend != "gpio":
        what = "the virtual grow box's" if keys.backend == "virtual" else "a rig without flash lamp"
        raise NotUsed(f'[flash] backend = "{keys.backend}": {what}')
    if _is_pin_of_strips(case, f"D{keys.line}"):
        raise Wrong(f"[flash] line {keys.line} and [led] pin D{keys.line} are the same pin; move one of them")
    where = f"line {keys.line} of {keys.chip}"
    missing = "is this a Raspberry Pi? gpiodetect lists the chips, [flash] chip names one"
    _check_device(case, "flora-flash", keys.chip, missing=missing)
    try:
        line: Any = case.ask_json("flora-flash", READ_LINE, keys.chip, str(keys.line))
    except Wrong as problem:
        is_software = any(sign in str(problem) for sign in ("No module named", "of version 1"))
        advice = f": {case.world.install_anew}" if is_software else ""
        raise Wrong(f"{where} cannot be read ({problem}){advice}") from problem
    name, user = str(line.get("name") or ""), str(line.get("by") or "the kernel")
    if pi_model(case.world) and name and name != f"GPIO{keys.line}":
        raise Wrong(f"{where} is called {name}, not GPIO{keys.line}: not the header's chip; gpiodetect lists them")
    if line.get("used") and user != "flora-flash":
        raise Wrong(f"{where} is in use by {user}; choose another line, or take its overlay from config.txt")
    found = f"{where}{f' ({name})' if name else ''} is free"
    if line.get("used"):
        return f"{where}{f' ({name})' if name else ''} is held by flora-flash, as it should be"
    if not case.touch:
        return f"{found}; not switched (--touch switches it off)"
    return _switched_dark(case, "flora-flash", found)


def _is_pin_of_strips(case: Case, pin: str) -> bool:
    try:
        strips = case.section("led", LedKeys)
    except NotLookedAt:
        return False  # told where the configuration is looked at
    return strips.backend == "neopixel" and strips.pin == pin


def _switched_dark(case: Case, service: str, found: str) -> str:
    """The service's own ``--dark``: the whole way to the device, to the state that harms nothing."""
    if case.is_running(service):
        return f"{found}; {service} runs, so it was not touched"
    named = ["--config", str(case.config)] if case.config is not None else []
    done = case.ask(service, case.world.program(service), *named, "--dark")
    if not done.is_good:
        raise Wrong(f"{found}, but {service} --dark fails: {done.reason.removeprefix(f'{service}: ')}")
    return f"{found}; switched dark"
