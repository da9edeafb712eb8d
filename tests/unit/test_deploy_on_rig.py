"""``deploy/on_rig``: releases side by side, a switch in one step, a trial, and the way back; without systemd."""

from __future__ import annotations

import json
import runpy
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from subprocess import CompletedProcess
from types import ModuleType
from typing import Any

import pytest

ON_RIG = Path(__file__).parents[2] / "deploy" / "on_rig"
MODULES = ("machine", "releases", "units", "trial", "nas")


@dataclass
class OnRig:
    """The installer's modules, looking at a folder in place of a machine."""

    opt: Path
    machine: ModuleType
    releases: ModuleType
    units: ModuleType
    trial: ModuleType
    ran: list[list[str]]

    def release(self, name: str, **units: str) -> None:
        """A whole release with these unit files."""
        folder = self.releases.RELEASES / name
        files = folder / "share/flora/systemd"
        files.mkdir(parents=True)
        for file, text in units.items():
            (files / f"{file}.service").write_text(text)
        (folder / "release.json").write_text("{}")


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[OnRig]:
    monkeypatch.syspath_prepend(str(ON_RIG))
    import machine
    import releases
    import trial
    import units

    opt = tmp_path / "opt"
    opt.mkdir()
    ran: list[list[str]] = []

    def run(command: list[str], **_: Any) -> CompletedProcess[str]:
        ran.append(list(command))
        return CompletedProcess(command, 0, "", "")

    places = {"RELEASES": opt / "releases", "CURRENT": opt / "current", "PREVIOUS": opt / "previous"}
    places |= {"TRIAL": opt / "trial.json", "OUTCOME": opt / "outcome.txt", "MANIFEST": opt / "unit-files"}
    places |= {"UNIT_FOLDER": tmp_path / "units", "COMMAND_FOLDER": tmp_path / "bin"}
    for module in (machine, releases, trial, units):
        for name, path in places.items():
            if hasattr(module, name):
                monkeypatch.setattr(module, name, path)
        if module is not machine:
            monkeypatch.setattr(module, "run", run)
    yield OnRig(opt, machine, releases, units, trial, ran)
    for name in MODULES:
        sys.modules.pop(name, None)


def test_a_link_is_moved_in_one_step_and_only_where_it_must(rig: OnRig) -> None:
    link = rig.opt / "link"
    assert rig.machine.point(link, "a")
    inode = link.lstat().st_ino
    assert not rig.machine.point(link, "a")
    assert link.lstat().st_ino == inode
    (rig.opt / ".link.new").symlink_to("left by a power cut")
    assert rig.machine.point(link, "b")
    assert str(link.readlink()) == "b"


def test_a_file_is_written_only_where_it_differs(rig: OnRig) -> None:
    file = rig.opt / "below" / "file"
    assert rig.machine.write_if_other(file, b"x")
    assert not rig.machine.write_if_other(file, b"x")
    file.chmod(0o600)
    assert rig.machine.write_if_other(file, b"x")
    assert file.stat().st_mode & 0o777 == 0o644


def test_a_release_that_was_never_finished_is_none(rig: OnRig) -> None:
    (rig.releases.RELEASES / "half").mkdir(parents=True)
    rig.machine.point(rig.releases.CURRENT, "releases/half")
    assert rig.releases.name_of(rig.releases.CURRENT) is None
    assert rig.releases.installed() == []


def test_a_switch_remembers_the_release_before(rig: OnRig) -> None:
    rig.release("1")
    rig.release("2")
    rig.releases.switch("1")
    assert rig.releases.name_of(rig.releases.PREVIOUS) is None
    rig.releases.switch("2")
    rig.releases.switch("2")
    assert rig.releases.name_of(rig.releases.CURRENT) == "2"
    assert rig.releases.name_of(rig.releases.PREVIOUS) == "1"
    command = rig.releases.COMMAND_FOLDER / "flora-led"
    assert str(command.readlink()) == str(rig.releases.CURRENT / "bin/flora-led")


def test_three_releases_are_kept_and_those_in_use_first(rig: OnRig) -> None:
    for name in ("1", "2", "3", "4", "5"):
        rig.release(name)
    rig.releases.switch("1")
    rig.releases.switch("2")
    (rig.releases.RELEASES / "half").mkdir()
    rig.releases.prune()
    assert sorted(path.name for path in rig.releases.RELEASES.iterdir()) == ["1", "2", "5"]


@pytest.mark.parametrize("name", ["", "../x", ".x", None, 3])
def test_a_bundle_cannot_be_called_anything(rig: OnRig, tmp_path: Path, name: Any) -> None:
    (tmp_path / "release.json").write_text(json.dumps({"release": name}))
    with pytest.raises(rig.machine.Refused, match="cannot be a release's name"):
        rig.releases.read_bundle(tmp_path)


@pytest.mark.parametrize(
    ("says", "is_there"), [("systemd 257 (257.8-1~deb13u2)\n+PAM", True), ("systemd 252 (252.39)", False), ("", False)]
)
def test_a_unit_file_for_newer_versions_is_left_out_below(
    rig: OnRig, monkeypatch: pytest.MonkeyPatch, says: str, is_there: bool
) -> None:
    rig.release("1", a="a1")
    newer = rig.releases.RELEASES / "1/share/flora/systemd/since-254/flora-.service.d/20-restart.conf"
    newer.parent.mkdir(parents=True)
    newer.write_text("[Service]\nRestartMode=direct\n")
    monkeypatch.setattr(rig.units, "run", lambda command, **_: CompletedProcess(command, 0, says, ""))
    assert rig.units.install_units("1")
    there = {
        str(path.relative_to(rig.units.UNIT_FOLDER)) for path in rig.units.UNIT_FOLDER.rglob("*.*") if path.is_file()
    }
    assert there == {"a.service", *(["flora-.service.d/20-restart.conf"] if is_there else [])}
    assert not rig.units.install_units("1")


def test_units_follow_the_release_and_nothing_of_others_is_touched(rig: OnRig) -> None:
    folder = rig.units.UNIT_FOLDER
    folder.mkdir()
    (folder / "other.service").write_text("somebody's")
    rig.release("1", a="a1", gone="x")
    rig.release("2", a="a2", new="n")
    assert rig.units.install_units("1")
    rig.ran.clear()
    assert not rig.units.install_units("1")
    assert rig.ran == []
    assert rig.units.install_units("2")
    assert rig.ran == [["systemctl", "daemon-reload"]]
    assert {p.name: p.read_text() for p in folder.iterdir()} == {
        "other.service": "somebody's",
        "a.service": "a2",
        "new.service": "n",
    }


# ready and steady


class Course:
    """What systemd would say, second by second; time passes with each look."""

    def __init__(self, rig: OnRig, monkeypatch: pytest.MonkeyPatch, at: Callable[[float], Any]) -> None:
        self.now_s = 0.0
        monkeypatch.setattr(rig.units, "states", lambda: at(self.now_s))
        monkeypatch.setattr(rig.units.time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(rig.units.time, "sleep", self._pass)

    def _pass(self, seconds: float) -> None:
        self.now_s += seconds


def wait(rig: OnRig, expected: list[str]) -> str:
    said: str = rig.units.wait_steady(expected, within_s=120.0, steady_s=10.0, most_restarts=3)
    return said


def test_ready_must_last(rig: OnRig, monkeypatch: pytest.MonkeyPatch) -> None:
    state = rig.units.State

    def at(s: float) -> Any:
        # Up, dead once after 8 s, then up for good: a watch that began at the first READY would be over too soon.
        return {"x": state(False, s < 8 or s >= 12, int(s >= 12), "1" if s < 8 else "2")}

    course = Course(rig, monkeypatch, at)
    assert wait(rig, ["x"]) == ""
    assert course.now_s == pytest.approx(22.0, abs=1.1)


def test_who_dies_again_and_again_is_told_at_once(rig: OnRig, monkeypatch: pytest.MonkeyPatch) -> None:
    state = rig.units.State
    at = lambda s: {"x": state(False, False, int(s / 3), "0"), "y": state(False, False, 99, "0")}  # noqa: E731
    course = Course(rig, monkeypatch, at)
    assert wait(rig, ["x"]) == "x ends again and again (journalctl -u x)"
    assert course.now_s < 20.0


def test_who_hangs_at_the_start_is_told_in_the_end(rig: OnRig, monkeypatch: pytest.MonkeyPatch) -> None:
    state = rig.units.State
    at = lambda s: {"x": state(False, False, 0, "7"), "y": state(False, True, 0, "8")}  # noqa: E731
    course = Course(rig, monkeypatch, at)
    assert wait(rig, ["x", "y"]).startswith("x not ready after 120 s")
    assert course.now_s < 125.0


# the trial


@pytest.fixture
def judged(rig: OnRig, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Releases 1 to 3, of which 1 ran before 2; 3 is put on trial."""
    for name in ("1", "2", "3"):
        rig.release(name, a=f"of {name}")
    rig.releases.switch("1")
    rig.releases.switch("2")
    rig.units.install_units("2")
    monkeypatch.setattr(rig.trial, "states", lambda: {"flora-led": rig.units.State(False, True, 0, "5")})
    monkeypatch.setattr(rig.trial, "restart", lambda: None)

    def judge(*problems: str) -> None:
        told = iter(problems)
        monkeypatch.setattr(rig.trial, "_problem", lambda expected: next(told))
        rig.trial.begin("3")
        assert rig.releases.name_of(rig.releases.CURRENT) == "3"
        rig.trial.decide()

    return judge


def unit_text(rig: OnRig) -> str:
    text: str = (rig.units.UNIT_FOLDER / "a.service").read_text()
    return text


def test_a_release_that_is_well_stays(rig: OnRig, judged: Callable[..., None]) -> None:
    judged("")
    assert rig.releases.name_of(rig.releases.CURRENT) == "3"
    assert rig.releases.name_of(rig.releases.PREVIOUS) == "2"
    assert not rig.trial.TRIAL.exists()
    assert unit_text(rig) == "of 3"


def test_a_release_that_is_not_well_is_left_and_forgotten(rig: OnRig, judged: Callable[..., None]) -> None:
    with pytest.raises(rig.machine.Failed, match=r"3 was not well: it hangs\. 2 runs again, and is well"):
        judged("it hangs", "")
    assert rig.releases.name_of(rig.releases.CURRENT) == "2"
    assert rig.releases.name_of(rig.releases.PREVIOUS) == "1"
    assert not rig.trial.TRIAL.exists()
    assert unit_text(rig) == "of 2"
    assert sorted(rig.releases.installed()) == ["1", "2"]


def test_a_trial_that_was_interrupted_is_decided_later(rig: OnRig, judged: Callable[..., None]) -> None:
    rig.trial.restart = _interrupt
    with pytest.raises(KeyboardInterrupt):
        judged("")
    rig.trial.restart = lambda: None
    rig.trial._problem = lambda expected: "" if rig.releases.name_of(rig.releases.CURRENT) == "2" else "broken"
    with pytest.raises(rig.machine.Failed, match="2 runs again"):
        rig.trial.decide()
    assert rig.releases.name_of(rig.releases.CURRENT) == "2"


@pytest.mark.parametrize("second", ["3", "4"])
def test_an_install_before_the_last_one_was_decided_still_returns_to_what_was_well(
    rig: OnRig, judged: Callable[..., None], monkeypatch: pytest.MonkeyPatch, second: str
) -> None:
    rig.release("4", a="of 4")
    rig.trial.restart = _interrupt
    with pytest.raises(KeyboardInterrupt):
        judged("")
    rig.trial.restart = lambda: None
    monkeypatch.setattr(rig.trial, "states", lambda: {"flora-led": rig.units.State(False, False, 9, "0"),
                                                      "flora-stem": rig.units.State(False, True, 0, "6")})  # fmt: skip
    rig.trial.begin(second)
    assert json.loads(rig.trial.TRIAL.read_text()) == {
        "release": second, "before": "2", "earlier": "1", "expected": ["flora-led"],
    }  # fmt: skip
    told = iter(("it hangs", ""))
    monkeypatch.setattr(rig.trial, "_problem", lambda expected: next(told))
    with pytest.raises(rig.machine.Failed, match=r"2 runs again, and is well"):
        rig.trial.decide()
    assert rig.releases.name_of(rig.releases.CURRENT) == "2"
    assert rig.releases.name_of(rig.releases.PREVIOUS) == "1"
    assert unit_text(rig) == "of 2"


@pytest.mark.parametrize("cut", ["switch", "install_units"])
def test_a_switch_that_a_power_cut_ended_halfway_is_ended_before_it_is_judged(
    rig: OnRig, judged: Callable[..., None], monkeypatch: pytest.MonkeyPatch, cut: str
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(rig.trial, cut, lambda _: _interrupt())
        with pytest.raises(KeyboardInterrupt):
            judged("")
    rig.trial.decide()
    assert rig.releases.name_of(rig.releases.CURRENT) == "3"
    assert rig.releases.name_of(rig.releases.PREVIOUS) == "2"
    assert unit_text(rig) == "of 3"


def test_a_release_that_ran_before_is_not_removed_where_going_back_to_it_fails(
    rig: OnRig, judged: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = iter(("its configuration is too new", ""))
    monkeypatch.setattr(rig.trial, "_problem", lambda expected: next(told))
    rig.trial.begin("1")
    with pytest.raises(rig.machine.Failed, match="2 runs again"):
        rig.trial.decide()
    assert rig.releases.name_of(rig.releases.CURRENT) == "2"
    assert rig.releases.name_of(rig.releases.PREVIOUS) == "1"


def _interrupt() -> None:
    raise KeyboardInterrupt


def test_only_who_was_well_before_must_be_well_again(
    rig: OnRig, judged: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    state = rig.units.State
    before = {
        "flora-led": state(False, True, 0, "5"),
        "flora-capture": state(False, False, 9, "0"),
        "flora-stem": state(True, False, 0, "0"),
    }
    monkeypatch.setattr(rig.trial, "states", lambda: before)
    rig.trial.begin("3")
    assert json.loads(rig.trial.TRIAL.read_text())["expected"] == ["flora-led"]


def test_without_a_trial_there_is_nothing_to_decide(rig: OnRig) -> None:
    rig.trial.decide()
    assert rig.ran == []


def test_an_installation_that_fails_leaves_no_bundle_on_the_card(rig: OnRig, monkeypatch: pytest.MonkeyPatch) -> None:
    bundle = rig.opt / "incoming/0.1.0-x"
    bundle.mkdir(parents=True)
    (bundle / "release.json").write_text('{"release": "0.1.0-x"}')
    other = rig.opt / "incoming/no-bundle"
    other.mkdir()

    def no_room(bundle: Path, name: str) -> None:
        raise rig.machine.Failed("No space left on device")

    monkeypatch.setattr(rig.releases, "build", no_room)
    install = runpy.run_path(str(ON_RIG / "__main__.py"), run_name="installer")["install"]
    install.__globals__["install_packages"] = lambda names: None
    with pytest.raises(rig.machine.Failed, match="No space left"):
        install(bundle)
    with pytest.raises(rig.machine.Refused, match="not a bundle"):
        install(other)
    assert list((rig.opt / "incoming").iterdir()) == [other]


def test_the_run_folder_is_found_in_a_configuration_that_the_services_read(rig: OnRig, tmp_path: Path) -> None:
    config = tmp_path / "flora.toml"
    config.write_bytes('\ufeff[rig]\r\nrun_dir = "/data/bean-01"\r\n'.encode())
    find = runpy.run_path(str(ON_RIG / "__main__.py"), run_name="installer")["_run_dir"]
    find.__globals__["CONFIG"] = config
    assert find() == Path("/data/bean-01")
