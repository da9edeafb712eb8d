"""Where a run lies, and where it goes: run folder, disk, NAS, keys, controller file."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

import msgspec

from flora_common.config import DEFAULT_CONFIG
from flora_common.controller_file import SUFFIX
from flora_common.counted import counted
from flora_common.errors import BadInput, BadRunFolder, NotPermitted
from flora_common.runs import RunFile
from flora_common.signing import LARGEST_KEY_FILE, PUBLIC_SUFFIX, read_trusted_keys
from flora_monitor.doctor_case import Case, ControllerKeys, UploaderKeys
from flora_monitor.doctor_nas import Looked
from flora_monitor.doctor_world import Account, NotLookedAt, NotUsed, World, Wrong

DAY_S: Final = 86_400.0
ENOUGH_DAYS: Final = 7.0
"""A plant takes three days; a week leaves room for one that is slow, and a NAS that is away meanwhile."""
JPEG_BYTES_PER_PX: Final = 0.5
"""Of a photograph, before the first one is there: on the large side."""
RECORDED_BYTES_PER_DAY: Final = 30e6
"""Messages and tables, most of it the health of eight services every ten seconds."""
FILES_PER_DAY: Final = 300
"""A photograph every five minutes, recordings, tables."""
USUAL_PICTURE_PX: Final = 1640 * 1232
USUAL_INTERVAL_S: Final = 300.0
PICTURES_WEIGHED: Final = 50
MOST_FILES_READ: Final = 200
CARD_WORN: Final = 0x0B
"""``life_time`` of an eMMC in tenths of its life from 1; above ten tenths (JEDEC 84-B51)."""

WRITES: Final = {
    "flora-capture": ("frames", "frames.jsonl", "frames.csv"),
    "flora-recorder": ("bus",),
    "flora-stem": ("track.csv",),
}
"""What services add to in a run folder. A service that somebody tried with sudo leaves them to root."""


def check_run(case: Case) -> str:
    """The run folder is there, whole, and may be written by the services; the empty setup was photographed."""
    name, run = case.rig.run_dir, case.run
    try:
        about = run.read_run_file()
    except NotPermitted as problem:
        raise NotLookedAt(f"{name}: Permission denied; run this command with sudo") from problem
    except BadRunFolder as problem:
        raise Wrong(f"{problem}; docs/reference/run-folder.md says what it needs") from problem
    unwritable = _unwritable(case)
    if unwritable:
        raise Wrong(unwritable)
    pictures = len(run.background_pictures())
    if not pictures:
        raise Wrong(
            f"{name}/background has no pictures of the empty box: flora-stem calibrate --wait, before the plant"
        )
    plant = f"plant `{about.plant}`" if about.plant else "no plant named"
    return f"{name}: {plant}, every {about.interval_s:g} s, {counted(pictures, 'picture')} of the empty box"


def _unwritable(case: Case) -> str:
    folder = Path(case.rig.run_dir)
    for service, names in WRITES.items():
        account = case.account(service)
        for outer in reversed(folder.parents[:-1]):
            if not account.may_enter(case.world.at(outer).stat()):
                return (
                    f"{outer} may not be entered by user `{account.name}`, as whom {service} runs: "
                    f"sudo chgrp {account.name} {outer} && sudo chmod g+rx {outer}"
                )
        for path in (folder, *(folder / name for name in names)):
            if _is_kept_from(account, case.world.at(path)):
                return (
                    f"{path} may not be written by user `{account.name}`, as whom {service} runs: "
                    f"sudo chown -R {account.name} {folder}"
                )
        unit = case.units.get(service)
        if unit is not None and unit.is_loaded and not unit.may_write(case.world.real(folder)):
            return (
                f"{folder} is read-only for {service}: move it below /var/lib/flora, or add ReadWritePaths= to its unit"
            )
    return ""


def _is_kept_from(account: Account, path: Path) -> bool:
    try:
        return not account.may(path.stat(), write=True)
    except FileNotFoundError:
        return False  # it will make it


def bytes_per_day(case: Case) -> float:
    """What a run adds to the disk in a day: its own photographs as far as there are some, else an estimate."""
    about: RunFile | None
    try:
        about = case.run.read_run_file()
    except BadRunFolder:
        about = None
    interval_s = about.interval_s if about else USUAL_INTERVAL_S
    pixels = about.camera.width_px * about.camera.height_px if about else USUAL_PICTURE_PX
    latest = sorted(case.run.frames.glob("*.jpg"))[-PICTURES_WEIGHED:] if case.run.frames.is_dir() else []
    sizes = [path.stat().st_size for path in latest]
    picture = sum(sizes) / len(sizes) if sizes else pixels * JPEG_BYTES_PER_PX
    return DAY_S / interval_s * picture + RECORDED_BYTES_PER_DAY


def check_disk(case: Case) -> str:
    """Room for a week, a file system that takes writes, and a card that has not begun to fail."""
    folder = _nearest(case.world, case.rig.run_dir)
    room = case.world.room(case.world.at(folder))
    if room.is_read_only:
        raise Wrong(f"the file system of {folder} is read-only: after a fault Linux makes it so; see `sudo dmesg`")
    kind, source = _file_system(case.world, folder)
    if kind == "tmpfs" and not case.is_virtual:
        raise Wrong(f"{folder} lies in memory ({kind}) and is gone after a power cut; choose another [rig] run_dir")
    worn = _worn(case.world, Path(source).name)
    if worn:
        raise Wrong(worn)
    a_day = bytes_per_day(case)
    days = room.free_bytes / a_day
    figures = f"{room.free_bytes / 1e9:.1f} GB free for {folder}, {days:.0f} days at {a_day / 1e6:.0f} MB a day"
    if days < ENOUGH_DAYS:
        raise Wrong(f"{figures}; {ENOUGH_DAYS:g} are wanted: free some space, or take a larger disk")
    files = ENOUGH_DAYS * FILES_PER_DAY
    if room.free_files is not None and room.free_files < files:
        raise Wrong(
            f"{folder} has places for {counted(room.free_files, 'more file')} (`df -i`), {files:g} are wanted: "
            "something has filled its disk with small files; remove them"
        )
    return figures


def _nearest(world: World, path: str) -> Path:
    """A folder, or of its parents the first that is there: what is yet to be made will lie on its disk."""
    real = world.real(path)
    return next((folder for folder in (real, *real.parents) if world.at(folder).is_dir()), Path("/"))


def _file_system(world: World, folder: Path) -> tuple[str, str]:
    """Type and source of what is mounted there (proc(5), mountinfo); empty where it is not told."""
    best, found = -1, ("", "")
    for line in (world.read("/proc/self/mountinfo") or "").splitlines():
        fields, _, rest = line.partition(" - ")
        parts, of_disk = fields.split(), rest.split()
        if len(parts) < 5 or len(of_disk) < 2:
            continue
        point = Path(re.sub(r"\\([0-7]{3})", lambda octal: chr(int(octal[1], 8)), parts[4]))
        if folder.is_relative_to(point) and len(point.parts) >= best:
            best, found = len(point.parts), (of_disk[0], of_disk[1])
    return found


def _worn(world: World, device: str) -> str:
    """Signs of a failing card, as far as the kernel tells without root; a sentence, or nothing."""
    if not device:
        return ""
    errors = (world.read(f"/sys/fs/ext4/{device}/errors_count") or "").strip()
    if errors.isdigit() and int(errors) > 0:
        return f"ext4 on {device} counts {errors} errors: save the runs, run fsck, replace the card if they come again"
    whole = re.sub(r"p\d+$", "", device)
    lives = (world.read(f"/sys/block/{whole}/device/life_time") or "").split()
    if any(int(life, 16) >= CARD_WORN for life in lives if re.fullmatch(r"0x[0-9a-fA-F]{1,2}", life)):
        return f"{whole} says that it has reached the end of its life: replace it"
    return ""


def check_nas(case: Case) -> str:
    """The target is there, the right one, and not the disk of the runs; with ``--touch`` one file there and back."""
    keys = case.section("uploader", UploaderKeys)
    if not keys.target:
        raise NotUsed("[uploader] target is empty: photographs stay on this machine alone")
    flags = ["--touch"] if case.touch else []
    folder = str(case.world.at(keys.target))
    command = [str(case.world.python), "-P", "-m", "flora_monitor.doctor_nas", folder, keys.marker, *flags]
    done = case.ask("flora-uploader", *command)
    if done.status is None:
        raise Wrong(f"{keys.target} does not answer: is the server on? mount it `soft`, so that nothing waits for ever")
    try:
        found = msgspec.convert(case.read_json("flora-uploader", done), Looked)
    except msgspec.ValidationError as problem:
        raise NotLookedAt(f"the answer cannot be read ({problem})") from problem
    if found.problem:
        raise Wrong(found.problem)
    unit = case.units.get("flora-uploader")
    if unit is not None and unit.is_loaded and not unit.may_write(case.world.real(keys.target)):
        raise Wrong(
            f"{keys.target} is read-only for flora-uploader: mount it below /mnt, or add ReadWritePaths= to its unit"
        )
    runs = case.world.room(case.world.at(_nearest(case.world, case.rig.run_dir)))
    if found.device == runs.device and not case.is_virtual:
        raise Wrong(f"{keys.target} lies on the same disk as the runs, which a copy is to survive: is it mounted?")
    written = "one file written and read back" if found.is_written else "nothing written (--touch writes one file)"
    marker = f"{keys.marker} is there, " if keys.marker else ""
    return f"{keys.target}: {marker}{found.free_bytes / 1e9:.0f} GB free, {written}"


def check_keys(case: Case) -> str:
    """Trusted keys can be read by who checks with them, and no private key lies on the rig."""
    keys = case.section("controller", ControllerKeys)
    folder = case.world.at(keys.keys_dir)
    found = private_key_in(case, (folder, (case.config or DEFAULT_CONFIG).parent, Path(case.rig.state_dir)))
    if found:
        raise Wrong(found)
    try:
        trusted = read_trusted_keys(folder)
    except BadInput as problem:
        raise Wrong(str(problem)) from problem
    account = case.account("flora-controller")
    for path in sorted(folder.glob(f"*{PUBLIC_SUFFIX}")):
        if not account.may(path.stat(), write=False):
            raise Wrong(f"{path} may not be read by user `{account.name}`: sudo chmod 644 {path}")
    names = ", ".join(str(key) for key in trusted.values())
    if trusted:
        return f'trust = "{keys.trust}", {keys.keys_dir} trusts {names}'
    if keys.trust == "required":
        raise Wrong(
            f'trust = "required", but {keys.keys_dir} has no key: put the *{PUBLIC_SUFFIX} of whoever signs there'
        )
    return f'trust = "{keys.trust}", no key in {keys.keys_dir}: nobody can publish a controller to this rig'


def private_key_in(case: Case, folders: tuple[Path, ...]) -> str:
    """A private key has no place on a rig: who reads it can steer every rig that trusts it. A sentence, or nothing."""
    for folder in dict.fromkeys(case.world.at(folder) for folder in folders):
        for path in sorted(folder.iterdir())[:MOST_FILES_READ] if folder.is_dir() else []:
            if not path.is_file() or path.stat().st_size > LARGEST_KEY_FILE or not os.access(path, os.R_OK):
                continue
            if b"PRIVATE KEY" in path.read_bytes():
                known = (
                    " everybody on this machine can read it, so make another one;"
                    if path.stat().st_mode & 0o004
                    else ""
                )
                return f"{path} is a private key;{known} take it to the machine of whoever signs, and delete it here"
    return ""


def check_controller(case: Case) -> str:
    """What is to steer: a built-in rule, or a file that could."""
    keys = case.section("controller", ControllerKeys)
    if not keys.use.endswith(SUFFIX):
        return f"`{keys.use}`, built in"
    trusted = ["--keys", keys.keys_dir] if keys.trust == "required" else []
    done = case.ask("flora-controller", case.world.program("flora-controller"), "check", keys.use, *trusted)
    if not done.is_good:
        raise Wrong(done.reason.removeprefix("flora-controller: "))
    return done.out.strip()
