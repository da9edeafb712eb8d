"""What a rig asks of a controller file before it may steer."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest

from flora_common.controller_file import MAX_BYTES, LoadedController, load_controller
from flora_common.errors import BadController, DiskFull, StoreError
from flora_common.files import write_bytes
from flora_common.shapes import Obstacle, Target
from flora_common.signing import signed_bytes
from flora_controller.acceptance import TASK_TOLERANCE_CM, Acceptance, Policy, TaskRule, Trust
from flora_controller.serials import SERIALS_FILE, Accepted, Serials, read_serials, write_serials
from flora_controller.source import FileSource
from signing_keys import ADA, BOB, EXPORT, TIP_ONLY, signed, trusted

TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)
NOON = datetime(2026, 12, 1, 12, tzinfo=UTC)
ADA_ID = next(iter(trusted(ADA)))


class Rig:
    """A rig's checks, its disk and its clock; ``restart`` is a new process on the same disk."""

    def __init__(self, folder: Path, **policy: Any) -> None:
        self.file = folder / SERIALS_FILE
        self.policy = Policy(**({"target": TARGET, "obstacle": OBSTACLE, "keys": trusted(ADA, BOB)} | policy))
        self.now: datetime | None = NOON
        self.disk_is_full = False
        self.restart()

    def restart(self) -> None:
        try:
            serials = read_serials(self.file)
        except StoreError:
            serials = None
        self.acceptance = Acceptance(self.policy, serials, keep=self._keep, utc=lambda: self.now)

    def _keep(self, serials: Serials) -> None:
        if self.disk_is_full:
            raise DiskFull(f"{self.file}: no room on the disk")
        write_serials(self.file, serials)

    def offer(self, loaded: LoadedController, *, offered: bool = True) -> str:
        """Why a file is refused; empty where it is accepted, and remembered."""
        try:
            self.acceptance.take(loaded, self.acceptance.check(loaded, offered=offered))
        except BadController as problem:
            return str(problem)
        return ""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


# Who signed it

UNSIGNED, TRUSTED = load_controller(TIP_ONLY), signed()


@pytest.mark.parametrize(
    ("trust", "keys", "loaded", "refused"),
    [
        ("none", [], UNSIGNED, ""),
        ("none", [], TRUSTED, ""),
        ("if-signed", [], UNSIGNED, ""),
        ("if-signed", [ADA], TRUSTED, ""),
        ("if-signed", [BOB], TRUSTED, f"signed by `{ADA_ID}`, a key that is not trusted"),
        ("required", [ADA], UNSIGNED, "is not signed"),
        ("required", [ADA], TRUSTED, ""),
        ("required", [BOB], TRUSTED, f"signed by `{ADA_ID}`, a key that is not trusted"),
    ],
)
def test_a_file_that_the_configuration_names_is_trusted_as_it_says(
    tmp_path: Path, trust: Trust, keys: list[Any], loaded: LoadedController, refused: str
) -> None:
    said = Rig(tmp_path, trust=trust, keys=trusted(*keys)).offer(loaded, offered=False)

    assert refused in said
    assert bool(said) == bool(refused)
    assert f'[controller] trust is "{trust}"' in said or not refused


@pytest.mark.parametrize("trust", ["required", "if-signed", "none"])
def test_what_is_offered_over_the_bus_needs_a_trusted_signature_whatever_the_configuration_says(
    tmp_path: Path, trust: Trust
) -> None:
    assert "is not signed; what is offered over the bus must be" in Rig(tmp_path, trust=trust).offer(UNSIGNED)
    assert "a key that is not trusted" in Rig(tmp_path, trust=trust, keys=trusted(BOB)).offer(TRUSTED)
    assert Rig(tmp_path, trust=trust).offer(TRUSTED) == ""


# How old it is


def test_an_older_serial_is_refused_and_the_same_file_again_is_not(rig: Rig) -> None:
    assert rig.offer(signed(serial=5)) == ""
    assert rig.offer(signed(serial=7, name="newer")) == ""

    for serial in (0, 5, 6, 7):
        said = rig.offer(signed(serial=serial, name="older"))
        assert f"has serial {serial}, and one with serial 7 was accepted from {ADA_ID}; sign it again" in said
    assert rig.offer(signed(serial=7, name="newer")) == ""
    assert rig.offer(signed(serial=8, name="older")) == ""


def test_a_restarted_rig_does_not_take_an_older_one(rig: Rig) -> None:
    rig.offer(signed(serial=7))
    rig.restart()

    assert "has serial 6" in rig.offer(signed(serial=6, name="older"))
    assert rig.offer(signed(serial=7)) == ""


def test_each_key_counts_for_itself(rig: Rig) -> None:
    assert rig.offer(signed(serial=7)) == ""
    assert rig.offer(signed(serial=3, key=BOB)) == ""
    assert read_serials(rig.file).keys.keys() == trusted(ADA, BOB).keys()


def test_a_check_alone_counts_nothing(rig: Rig) -> None:
    rig.acceptance.check(signed(serial=7), offered=True)

    assert rig.offer(signed(serial=6)) == ""


def test_a_serial_that_nobody_vouches_for_counts_nothing(tmp_path: Path) -> None:
    rig = Rig(tmp_path, trust="none")
    assert rig.offer(signed(serial=2**53), offered=False) == ""

    assert rig.offer(signed(serial=1)) == ""


def test_what_cannot_be_written_down_does_not_steer(rig: Rig) -> None:
    rig.disk_is_full = True
    with pytest.raises(StoreError):
        rig.offer(signed(serial=7))
    rig.disk_is_full = False

    assert rig.offer(signed(serial=6)) == ""
    assert read_serials(rig.file).last(ADA_ID) == Accepted(6, signed(serial=6).sha256)


@pytest.mark.parametrize(
    "damage", [b"", b"{}x", b'{"keys": {"k": {"serial": -1, "sha256": ""}}}', b'{"version": 2}', b"\xff"]
)
def test_a_damaged_record_lets_nothing_signed_in_and_what_steers_goes_on(rig: Rig, damage: bytes) -> None:
    rig.offer(signed(serial=7))
    rig.file.write_bytes(damage)
    rig.restart()

    with pytest.raises(StoreError, match=f"^{rig.file}: which controllers were accepted cannot be read"):
        read_serials(rig.file)
    assert "may be an older one" in rig.offer(signed(serial=8))
    assert "may be an older one" in rig.offer(signed(serial=7))
    rig.acceptance.check_kept(signed(serial=7), offered=True)
    assert rig.offer(UNSIGNED, offered=False) == ""
    assert rig.file.read_bytes() == damage


@pytest.mark.parametrize("offered", [True, False])
def test_an_expired_one_is_refused_from_that_moment_on(rig: Rig, offered: bool) -> None:
    loaded = signed(expires="2026-12-01T12:00:00Z")

    assert "expired at 2026-12-01 12:00 UTC" in rig.offer(loaded, offered=offered)
    rig.now = NOON - timedelta(seconds=1)
    assert rig.offer(loaded, offered=offered) == ""


def test_an_expiry_is_not_believed_before_the_clock_is(rig: Rig) -> None:
    rig.now = None

    assert rig.offer(signed(expires="2020-01-01T00:00:00Z")) == ""


def test_what_steers_when_it_expires_goes_on_through_a_restart(rig: Rig) -> None:
    loaded = signed(serial=7, expires="2026-12-01T13:00:00Z")
    assert rig.offer(loaded, offered=False) == ""
    rig.now = NOON + timedelta(hours=2)
    rig.restart()

    assert rig.offer(loaded, offered=False) == ""
    assert "expired" in rig.offer(signed(serial=8, expires="2026-12-01T13:00:00Z"))


def test_the_last_one_is_not_accepted_anew_when_it_is_offered_after_its_expiry(rig: Rig) -> None:
    loaded = signed(serial=7, expires="2026-12-01T13:00:00Z")
    assert rig.offer(loaded) == ""
    rig.now = NOON + timedelta(hours=2)

    assert "expired" in rig.offer(loaded)
    assert rig.acceptance.check_kept(loaded, offered=True) == trusted(ADA)[ADA_ID]


def test_a_kept_file_may_come_back_though_newer_ones_were_accepted_since(rig: Rig) -> None:
    first = signed(serial=1, expires="2026-12-01T13:00:00Z")
    rig.offer(first)
    rig.offer(signed(serial=2, name="newer"))
    rig.now = NOON + timedelta(hours=2)

    assert rig.acceptance.check_kept(first, offered=True) == trusted(ADA)[ADA_ID]


def test_a_kept_file_whose_key_is_trusted_no_more_does_not_come_back(tmp_path: Path) -> None:
    with pytest.raises(BadController, match="a key that is not trusted"):
        Rig(tmp_path, keys=trusted(BOB)).acceptance.check_kept(signed(), offered=True)


# What it was evolved for

ELSEWHERE = Target(0.0, 17.9), Obstacle(3.0, 8.8)


@pytest.mark.parametrize(
    ("rule", "target", "obstacle", "refused"),
    [
        ("same", TARGET, OBSTACLE, ""),
        ("same", Target(-5.12 + 0.9 * TASK_TOLERANCE_CM, 17.9), OBSTACLE, ""),
        ("same", Target(-5.12 + 1.1 * TASK_TOLERANCE_CM, 17.9), OBSTACLE, "whose target is at (-5.12, 17.9) cm"),
        ("same", TARGET, Obstacle(-6.3, 12.5 - 1.1 * TASK_TOLERANCE_CM), "none of whose obstacles is this run's"),
        ("same", TARGET, Obstacle(-6.3, 12.5, 9.0), "none of whose obstacles is this run's"),
        ("same", TARGET, None, ""),
        ("same", *ELSEWHERE, "evolved for another task, `left`"),
        ("target", TARGET, ELSEWHERE[1], ""),
        ("target", *ELSEWHERE, "evolved for another task, `left`"),
        ("any", *ELSEWHERE, ""),
    ],
)
def test_a_controller_for_another_task_is_refused_unless_the_rig_is_told_otherwise(
    tmp_path: Path, rule: TaskRule, target: Target, obstacle: Obstacle | None, refused: str
) -> None:
    said = Rig(tmp_path, task=rule, target=target, obstacle=obstacle).offer(signed())

    assert refused in said
    assert bool(said) == bool(refused)


def test_one_obstacle_of_the_task_is_enough(rig: Rig) -> None:
    obstacles = [{"x_cm": 3.0, "y_cm": 8.8}, {"x_cm": -6.3, "y_cm": 12.5}]
    task = {"name": "many", "obstacles": obstacles}

    assert rig.offer(signed(task=task)) == ""


@pytest.mark.parametrize("rule", ["same", "any"])
def test_a_network_that_this_run_cannot_feed_is_refused(tmp_path: Path, rule: TaskRule) -> None:
    made = Rig(tmp_path, task=rule, obstacle=None)

    assert "wants to know the obstacle" in made.offer(signed(EXPORT))


# A file in the configured place: every way in which it can be wrong (RELIABILITY: tampered controller refused)


def _with_inputs(names: list[str]) -> bytes:
    """Signed, and fed otherwise than its network wants to be."""
    table = msgspec.json.decode(TRUSTED.data) | {"inputs": [{"name": name} for name in names]}
    return signed_bytes(table, ADA)


def _with_weight(value: object) -> bytes:
    return TRUSTED.data.replace(b'"weight":-1.0', b'"weight":' + str(value).encode())


WRONG: dict[str, tuple[bytes, str]] = {
    "older serial": (signed(serial=4).data, "has serial 4"),
    "expired": (signed(serial=9, expires="2026-11-30T00:00:00Z").data, "expired at 2026-11-30"),
    "wrong experiment": (
        signed(serial=9, task={"name": "middle", "target": {"x_cm": 0.0, "y_cm": 17.9}}).data,
        "`middle`",
    ),
    "input changed": (TRUSTED.data.replace(b'"x10"', b'"y10"'), "was changed after it was signed"),
    "input unknown": (_with_inputs(["x11", "target_x"]), "input 1 is `x11`"),
    "input missing": (_with_inputs(["x10"]), "lists 1 input, the network has 2"),
    "input twice": (_with_inputs(["x10", "x10"]), "input `x10` is listed twice"),
    "not finite": (_with_weight("NaN"), "NaN is not a finite number"),
    "infinite": (_with_weight("-Infinity"), "-Infinity is not a finite number"),
    "too large a number": (_with_weight("1e308"), "expected `float` <= 1000000.0"),
    "too big": (TRUSTED.data + b" " * (MAX_BYTES + 1 - len(TRUSTED.data)), f"has at most {MAX_BYTES}"),
    "not signed": (UNSIGNED.data, "is not signed"),
    "signed by a stranger": (signed(serial=9, key=BOB).data, "a key that is not trusted"),
    "no time zone": (TRUSTED.data.replace(b'"format"', b'"expires":"2027-01-01T00:00:00","format"'), "`expires`"),
    "serial below 0": (TRUSTED.data.replace(b'"signature"', b'"serial":-1,"signature"'), "`serial`"),
}


@pytest.mark.parametrize("kind", [*WRONG, "pipe", "link to a folder", "link to a pipe", "gone"])
def test_nothing_wrong_takes_the_place_of_what_steers(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "steer.controller.json"
    good = signed(serial=5)
    write_bytes(path, good.data)
    rig = Rig(tmp_path, trust="required", keys=trusted(ADA))
    source = FileSource(path, tmp_path / "kept", rig.acceptance)
    data, said = WRONG.get(
        kind, (b"", "cannot be read" if kind in ("gone", "link to a folder") else "not a regular file")
    )
    path.unlink()
    if kind in WRONG:
        write_bytes(path, data)
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind != "gone":
        elsewhere = tmp_path / "elsewhere"
        if kind.endswith("folder"):
            elsewhere.mkdir()
        else:
            os.mkfifo(elsewhere)
        path.symlink_to(elsewhere)

    assert not source.poll()
    assert said in source.refusal
    rig.restart()
    again = FileSource(path, tmp_path / "kept", rig.acceptance)

    assert "refused, the one before goes on" in again.refusal
    assert source.steering.sha256 == again.steering.sha256 == good.sha256


def test_a_full_disk_puts_a_good_file_off_until_there_is_room(tmp_path: Path) -> None:
    path = tmp_path / "steer.controller.json"
    write_bytes(path, signed(serial=5).data)
    rig = Rig(tmp_path)
    source = FileSource(path, tmp_path / "kept", rig.acceptance)
    newer = signed(EXPORT, serial=6)
    write_bytes(path, newer.data)
    rig.disk_is_full = True
    assert [source.poll(), source.poll()] == [False, False]
    assert "no room on the disk" in source.refusal
    rig.disk_is_full = False

    assert source.poll()
    assert source.steering.sha256 == newer.sha256


def test_a_full_disk_at_the_start_puts_a_good_file_off_until_there_is_room(tmp_path: Path) -> None:
    path = tmp_path / "steer.controller.json"
    older = signed(serial=5)
    write_bytes(path, older.data)
    rig = Rig(tmp_path)
    FileSource(path, tmp_path / "kept", rig.acceptance)
    newer = signed(EXPORT, serial=6)
    write_bytes(path, newer.data)
    rig.disk_is_full = True
    again = FileSource(path, tmp_path / "kept", rig.acceptance)
    assert (again.steering.sha256, again.poll()) == (older.sha256, False)
    assert "no room on the disk" in again.refusal
    rig.disk_is_full = False

    assert again.poll()
    assert (again.steering.sha256, again.refusal) == (newer.sha256, "")
