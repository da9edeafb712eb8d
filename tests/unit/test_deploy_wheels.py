"""``deploy/rig_wheels.py``: what a rig needs is judged for the rig's machine, not for this one."""

from __future__ import annotations

import re
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"


@pytest.fixture
def wheels(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(DEPLOY))
    import rig_wheels

    monkeypatch.delitem(sys.modules, "rig_wheels")
    return rig_wheels


class Index:
    """A package index on which each of ``packages`` is one wheel with these requirements."""

    def __init__(self, packages: dict[str, list[str]]) -> None:
        self.packages = packages
        self.asked: list[str] = []

    def download(self, lines: list[str], folder: Path, options: list[str]) -> bool:
        self.asked += lines
        if any(line.partition("==")[0] not in self.packages for line in lines):
            return False
        for line in lines:
            name, _, version = line.partition("==")
            if "--no-binary=:all:" in options:
                (folder / f"{name}-{version}.tar.gz").write_bytes(b"")
                continue
            stem = f"{name.replace('-', '_')}-{version}"
            requires = "".join(f"Requires-Dist: {text}\n" for text in self.packages[name])
            with zipfile.ZipFile(folder / f"{stem}-py3-none-any.whl", "w") as archive:
                archive.writestr(f"{stem}.dist-info/METADATA", f"Name: {name}\nVersion: {version}\n{requires}")
        return True


def given(
    wheels: ModuleType, monkeypatch: pytest.MonkeyPatch, first: list[str], packages: dict[str, list[str]]
) -> Index:
    """A project that requires ``first``, and an index; each package is pinned to 1.0."""
    index = Index(packages)
    names = {*packages, *(re.split(r"[^a-z0-9-]", line)[0] for line in first), "systemd-python"}
    monkeypatch.setattr(wheels, "pins", lambda: dict.fromkeys(names, "1.0"))
    monkeypatch.setattr(
        wheels,
        "_first_requirements",
        lambda target: wheels._that_hold(map(wheels.Requirement, first), target, {""}),
    )
    monkeypatch.setattr(wheels, "_download", index.download)
    return index


def test_what_a_wheel_requires_is_fetched_too(
    wheels: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    index = given(wheels, monkeypatch, ["a"], {"a": ["b>=1"], "b": ["c"], "c": ["a"]})
    parts = wheels.parts_of(wheels.TARGETS[0], tmp_path)
    assert [(part.name, part.how) for part in parts] == [(name, "py3-none-any") for name in "abc"]
    index.asked.clear()
    wheels.parts_of(wheels.TARGETS[0], tmp_path)
    assert index.asked == []  # all there


def test_requirements_are_judged_for_the_rig(
    wheels: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    of_a = ['old; python_version < "3.12"', 'arm; platform_machine == "aarch64"', 'win; sys_platform == "win32"']
    of_a += ['wanted; extra == "x"', 'unwanted; extra == "y"']
    others: dict[str, list[str]] = {name: [] for name in ("old", "arm", "win", "wanted", "unwanted")}
    given(wheels, monkeypatch, ["a[x]"], {"a": of_a, **others})
    old, new = wheels.TARGETS
    pc = wheels.Target("3.13", "x86_64", 41)
    names = [{part.name for part in wheels.parts_of(target, tmp_path / target.key)} for target in (old, new, pc)]
    assert names == [{"a", "wanted", "old", "arm"}, {"a", "wanted", "arm"}, {"a", "wanted"}]


def test_a_missing_wheel_is_named_and_the_others_are_fetched(
    wheels: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given(wheels, monkeypatch, ["a", "gone"], {"a": []})
    parts = wheels.parts_of(wheels.TARGETS[0], tmp_path)
    assert wheels.missing(parts) == ["gone 1.0"]
    assert [part.file is not None for part in parts] == [True, False]


def test_what_has_no_wheel_comes_from_apt_or_is_compiled(
    wheels: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    index = given(wheels, monkeypatch, ["systemd-python", "rpi-ws281x"], {"rpi-ws281x": []})
    parts = {part.name: part for part in wheels.parts_of(wheels.TARGETS[0], tmp_path)}
    assert parts["systemd-python"].file is None
    assert parts["systemd-python"].how == "apt: python3-systemd"
    assert parts["rpi-ws281x"].file.name == "rpi-ws281x-1.0.tar.gz"
    assert index.asked == ["rpi-ws281x==1.0"]
    assert wheels.missing(parts.values()) == []


def test_one_name_that_begins_another_is_not_taken_for_it(wheels: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "pydantic_core-1.0-py3-none-any.whl").write_bytes(b"")
    (tmp_path / "Pydantic-1.0.1-py3-none-any.whl").write_bytes(b"")
    assert wheels._file("pydantic", "1.0", tmp_path) is None
    assert wheels._file("pydantic", "1.0.1", tmp_path) == tmp_path / "Pydantic-1.0.1-py3-none-any.whl"


def test_each_package_of_a_rig_has_one_version(wheels: ModuleType) -> None:
    """Also those that constraints.txt does not have, because no laptop needs them."""
    pinned = wheels.pins()
    first = {wheels.canonicalize_name(r.name) for r in wheels._first_requirements(wheels.TARGETS[0])}
    assert first <= pinned.keys()
    assert {"simplejpeg", "rpi-ws281x", "setuptools"} <= first


def test_wheels_for_a_newer_glibc_than_the_rigs_are_not_asked_for(wheels: ModuleType) -> None:
    asked = [o.rpartition("manylinux_2_")[2] for o in wheels.TARGETS[0].pip_options if "manylinux_2_" in o]
    assert max(int(text.split("_")[0]) for text in asked) == 36
