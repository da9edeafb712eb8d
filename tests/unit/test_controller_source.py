"""Which rule steers: chosen by name, or read from a file that may be replaced at any moment."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from flora_common.errors import BadController, ConfigError
from flora_common.files import write_bytes
from flora_common.shapes import Obstacle, Target
from flora_controller.acceptance import Acceptance, Policy
from flora_controller.core import ControllerSection
from flora_controller.serials import Serials
from flora_controller.source import FileSource, built_in, check_usable, kept_file
from flora_controller.steering import WaypointSection

GOLDEN = Path(__file__).parent.parent / "golden" / "controllers"
TIP_ONLY = (GOLDEN / "good" / "tip_only.controller.json").read_bytes()
EXPORT = (GOLDEN / "good" / "neat_export.controller.json").read_bytes()
BAD = (GOLDEN / "bad" / "nan_weight.controller.json").read_bytes()
TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)


@pytest.mark.parametrize("name", ["open-loop", "dark", "tip-follower", "waypoint"])
def test_each_built_in_rule_bears_its_name(name: str) -> None:
    assert built_in(ControllerSection(use=name), TARGET, OBSTACLE).name == name


@pytest.mark.parametrize(
    ("section", "target", "obstacle", "said"),
    [
        (
            ControllerSection(use="waypiont"),
            TARGET,
            OBSTACLE,
            "no built-in controller `waypiont`; did you mean `waypoint`?",
        ),
        (ControllerSection(use="tip-follower"), None, None, r"give run.toml a section \[target\]"),
        (ControllerSection(use="waypoint"), None, OBSTACLE, r"give run.toml a section \[target\]"),
        (ControllerSection(use="waypoint"), TARGET, None, r"give run.toml a section \[obstacle\]"),
        (
            ControllerSection(use="waypoint", waypoint=WaypointSection(guard_cm=2.0, release_cm=1.0)),
            TARGET,
            OBSTACLE,
            "release_cm must not be less than guard_cm",
        ),
    ],
)
def test_what_cannot_steer_is_told(
    section: ControllerSection, target: Target | None, obstacle: Obstacle | None, said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        built_in(section, target, obstacle)


@pytest.mark.parametrize("name", ["open-loop", "dark"])
def test_what_looks_at_no_target_needs_none(name: str) -> None:
    assert built_in(ControllerSection(use=name), None, None).name == name


def accepting(target: Target | None = TARGET, obstacle: Obstacle | None = OBSTACLE) -> Acceptance:
    """A rig's checks with nothing configured."""
    policy = Policy(target=target, obstacle=obstacle)
    return Acceptance(policy, Serials(), keep=lambda _: None, utc=lambda: None)


class Rig:
    def __init__(self, folder: Path) -> None:
        self.path = folder / "steer.controller.json"
        self.state = folder / "state"

    def source(self, *, target: Target | None = TARGET, obstacle: Obstacle | None = OBSTACLE) -> FileSource:
        return FileSource(self.path, kept_file(self.state, self.path), accepting(target, obstacle))


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    made = Rig(tmp_path)
    write_bytes(made.path, TIP_ONLY)
    return made


def test_nothing_happens_while_the_file_stays(rig: Rig) -> None:
    source = rig.source()

    assert [source.poll() for _ in range(3)] == [False, False, False]
    assert (source.steering.loaded.data, source.refusal) == (TIP_ONLY, "")


def test_what_a_start_would_say_of_a_file_is_known_without_one(rig: Rig) -> None:
    kept = kept_file(rig.state, rig.path)
    check_usable(rig.path, kept, accepting())
    assert not rig.state.exists()
    write_bytes(rig.path, b"{}")
    with pytest.raises(BadController, match="not a controller file"):
        check_usable(rig.path, kept, accepting())

    write_bytes(kept, TIP_ONLY)  # accepted before: a start goes on with it, and so there is nothing to be told

    check_usable(rig.path, kept, accepting())


def test_a_new_file_takes_over(rig: Rig) -> None:
    source = rig.source()
    write_bytes(rig.path, EXPORT)

    assert source.poll()
    assert not source.poll()
    assert source.steering.loaded.data == EXPORT


def test_a_link_that_is_turned_takes_over(rig: Rig, tmp_path: Path) -> None:
    other = tmp_path / "other.controller.json"
    other.write_bytes(EXPORT)
    current = tmp_path / "current.controller.json"
    current.symlink_to(rig.path)
    source = FileSource(current, tmp_path / "kept", accepting())
    new = tmp_path / "new"
    new.symlink_to(other)
    new.replace(current)

    assert source.poll()
    assert source.steering.loaded.data == EXPORT


@pytest.mark.parametrize("how", ["bad", "gone", "pipe", "cut"])
def test_what_is_refused_leaves_the_old_one_at_work_and_says_why(rig: Rig, how: str) -> None:
    source = rig.source()
    if how == "bad":
        write_bytes(rig.path, BAD)
    elif how == "cut":
        rig.path.write_bytes(EXPORT[:300])
    else:
        rig.path.unlink()
        if how == "pipe":
            os.mkfifo(rig.path)

    assert not source.poll()
    assert source.steering.loaded.data == TIP_ONLY
    assert source.refusal.startswith(f"refused, the one before goes on: {rig.path}: ")
    write_bytes(rig.path, EXPORT)
    assert source.poll()
    assert source.refusal == ""


def test_a_file_written_in_pieces_takes_over_once_it_is_whole(rig: Rig) -> None:
    source = rig.source()
    with rig.path.open("wb") as file:
        for piece in (EXPORT[:100], EXPORT[100:2000], EXPORT[2000:]):
            file.write(piece)
            file.flush()
            changed = source.poll()

    assert changed
    assert source.steering.loaded.data == EXPORT


def test_the_same_content_anew_is_no_other_controller(rig: Rig) -> None:
    source = rig.source()
    write_bytes(rig.path, TIP_ONLY)

    assert not source.poll()
    assert source.refusal == ""


def test_a_copy_that_cannot_be_kept_is_told_until_it_is(rig: Rig) -> None:
    rig.state.write_bytes(b"a file where the folder must be")
    source = rig.source()
    told = "in force, but a copy cannot be kept"
    assert (source.poll(), told in source.refusal) == (False, True)
    os.utime(rig.path)
    assert (source.poll(), told in source.refusal) == (False, True)
    write_bytes(rig.path, BAD)
    assert not source.poll()
    assert source.refusal.startswith("refused, the one before goes on: ")
    assert told in source.refusal
    write_bytes(rig.path, TIP_ONLY)
    rig.state.unlink()

    assert not source.poll()
    assert source.refusal == ""
    assert kept_file(rig.state, rig.path).read_bytes() == TIP_ONLY


def test_a_network_that_this_run_cannot_feed_is_refused(rig: Rig) -> None:
    source = rig.source(obstacle=None)
    write_bytes(rig.path, EXPORT)

    assert not source.poll()
    assert "wants to know the obstacle" in source.refusal


def test_a_bad_file_at_the_first_start_is_told(rig: Rig) -> None:
    write_bytes(rig.path, BAD)

    with pytest.raises(BadController, match="NaN is not a finite number"):
        rig.source()


def test_a_bad_file_at_a_later_start_leaves_the_accepted_one_at_work(rig: Rig) -> None:
    rig.source()
    write_bytes(rig.path, BAD)

    again = rig.source()

    assert again.steering.loaded.data == TIP_ONLY
    assert "refused, the one before goes on" in again.refusal
    assert not again.poll()


def test_what_was_accepted_under_another_path_does_not_count(rig: Rig, tmp_path: Path) -> None:
    rig.source()
    other = tmp_path / "other.controller.json"
    write_bytes(other, BAD)

    with pytest.raises(BadController):
        FileSource(other, kept_file(rig.state, other), accepting())


def test_many_switches_never_show_half_a_controller(rig: Rig) -> None:
    """Both names belong to their own network at every moment."""
    files = {json.loads(data)["name"]: data for data in (TIP_ONLY, EXPORT)}
    source = rig.source()
    for turn in range(200):
        write_bytes(rig.path, [EXPORT, TIP_ONLY][turn % 2])
        assert source.poll()
        loaded = source.steering.loaded
        assert files[loaded.file.name] == loaded.data
