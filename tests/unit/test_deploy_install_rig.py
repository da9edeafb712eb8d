"""``deploy/install_rig.py``: what is asked of a rig, how a release is called, and what cannot be tried."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"
PI = {
    "python": "3.11",
    "machine": "aarch64",
    "glibc": "2.36",
    "root": False,
    "may": True,
    "systemd": True,
    "releases": [],
}


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(DEPLOY))
    import install_rig

    for name in ("install_rig", "rig_wheels"):
        monkeypatch.delitem(sys.modules, name)
    return install_rig


def answer(monkeypatch: pytest.MonkeyPatch, install: ModuleType, said: Any, status: int = 0) -> None:
    """Let ssh say this."""
    text = said if isinstance(said, str) else f"a greeting of the machine\n{json.dumps(said)}\n"
    done = subprocess.CompletedProcess(["ssh"], status, text, "ssh: no route\n")
    monkeypatch.setattr(install.subprocess, "run", lambda *_, **__: done)


def test_a_pi_is_recognised(monkeypatch: pytest.MonkeyPatch, install: ModuleType) -> None:
    answer(monkeypatch, install, PI | {"releases": ["0.1.0-abc"]})
    rig = install.look_at("ada@box1.local")
    assert rig.root == ["sudo", "-n"]
    assert rig.target.key == "aarch64-python3.11-glibc2.36"
    assert rig.releases == ["0.1.0-abc"]
    answer(monkeypatch, install, PI | {"root": True})
    assert install.look_at("root@box1.local").root == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"python": "3.9"}, "Bookworm or newer"),
        ({"systemd": False}, "not run by systemd"),
        ({"may": False}, "sudo asks for a password"),
        ({"glibc": ""}, "no glibc"),
    ],
)
def test_what_cannot_be_a_rig_is_told_why(
    monkeypatch: pytest.MonkeyPatch, install: ModuleType, change: dict[str, Any], said: str
) -> None:
    answer(monkeypatch, install, PI | change)
    with pytest.raises(install.Refused, match=said):
        install.look_at("ada@box1.local")


def test_no_connection_and_no_python_are_told(monkeypatch: pytest.MonkeyPatch, install: ModuleType) -> None:
    answer(monkeypatch, install, "", 255)
    with pytest.raises(install.Refused, match=r"no connection to ada@box1\.local: ssh: no route"):
        install.look_at("ada@box1.local")
    answer(monkeypatch, install, "bash: python3: command not found", 127)
    with pytest.raises(install.Refused, match="python3 does not run there"):
        install.look_at("ada@box1.local")


@pytest.mark.parametrize("address", ["", "-oProxyCommand=x", "a b", "a;b"])
def test_an_address_is_no_option_and_no_command(address: str) -> None:
    command = [sys.executable, str(DEPLOY / "install_rig.py"), "--", address]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr == f"make install-rig: RIG={address!r}: write RIG=user@host\n"


def bundle(folder: Path, text: str) -> Path:
    (folder / "systemd").mkdir(parents=True)
    (folder / "systemd/x.service").write_text(text)
    return folder


def test_the_same_content_has_the_same_name(
    monkeypatch: pytest.MonkeyPatch, install: ModuleType, tmp_path: Path
) -> None:
    target = install.Target("3.11", "aarch64", 36)
    monkeypatch.setattr(install, "_git", lambda *_: "")
    names = [
        install._name(bundle(tmp_path / n, text), [], target)[0] for n, text in (("a", "1"), ("b", "1"), ("c", "2"))
    ]
    assert names[0] == names[1] != names[2]


def test_a_clean_commit_and_the_rigs_python_are_a_name_by_themselves(
    monkeypatch: pytest.MonkeyPatch, install: ModuleType, tmp_path: Path
) -> None:
    target = install.Target("3.11", "aarch64", 36)
    folder = bundle(tmp_path / "a", "1")
    version = install.tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())["project"]["version"]
    said = {"rev-parse": "8c9693b26d", "status": ""}
    monkeypatch.setattr(install, "_git", lambda verb, *_: said[verb])
    assert install._name(folder, [], target)[0] == f"{version}-8c9693b26d-py3.11"
    upgraded = install.Target("3.13", "aarch64", 41)
    assert install._name(folder, [], upgraded)[0] == f"{version}-8c9693b26d-py3.13", "made anew for another Python"
    said["status"] = " M README.md"
    assert install._name(folder, [], target)[0].startswith(f"{version}-8c9693b26d-py3.11-")


def test_the_configuration_that_is_shipped_can_be_read_and_has_light_in_safe_mode() -> None:
    for service in ("bus", "flash", "capture", "stem", "controller", "led", "uploader", "recorder"):
        program = Path(sys.executable).parent / f"flora-{service}"
        command = [program, "--config", DEPLOY / "flora.toml", "--print-config"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        if service == "led":
            assert 'fallback = "open-loop"' in done.stdout
