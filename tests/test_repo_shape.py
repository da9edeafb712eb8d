"""One name, three places: package, command, unit; and what a Pi process may load."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SERVICES = sorted(p.name for p in (ROOT / "services").iterdir() if p.is_dir() and p.name != "__pycache__")
COMMANDS = sorted(PROJECT["project"]["scripts"])
NO_UNIT = {"flora-monitor", "flora-twin", "flora-lab"}
"""Commands that a person types; nothing to start at boot."""
LEAN = {"flora-bus", "flora-flash", "flora-capture", "flora-led", "flora-uploader", "flora-recorder", "flora-dashboard"}
"""Services that only move messages and files: numpy alone would add a third to the memory of each."""
LEARNING = ("torch", "neat", "numba", "scipy", "sklearn", "statsmodels", "matplotlib", "ray")


def test_each_package_has_its_command_and_each_command_its_package() -> None:
    assert [name.replace("_", "-") for name in SERVICES] == COMMANDS
    for command, target in PROJECT["project"]["scripts"].items():
        assert target == f"{command.replace('-', '_')}.main:main"


def test_each_package_is_listed_for_the_wheel_and_for_the_import_contracts() -> None:
    names = {"flora_common", *SERVICES}
    assert {Path(p).name for p in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]} == names
    assert set(PROJECT["tool"]["importlinter"]["root_packages"]) == names
    independence, forbidden, learning = PROJECT["tool"]["importlinter"]["contracts"]
    assert set(independence["modules"]) == set(SERVICES)
    assert set(forbidden["forbidden_modules"]) == set(SERVICES)
    assert set(learning["source_modules"]) == names - {"flora_lab"}
    assert set(learning["forbidden_modules"]) == set(LEARNING)


def test_each_service_has_a_unit_and_each_unit_a_service() -> None:
    units = {p.stem for p in (ROOT / "systemd").glob("flora-*.service")}
    assert units == set(COMMANDS) - NO_UNIT


@pytest.mark.parametrize("service", SERVICES)
def test_each_service_has_a_readme_that_names_its_command(service: str) -> None:
    text = (ROOT / "services" / service / "README.md").read_text()
    assert service.replace("_", "-") in text


def test_no_stray_modules_on_the_import_path() -> None:
    assert list((ROOT / "services").glob("*.py")) == []
    assert list((ROOT / "common").glob("*.py")) == []


def test_test_files_have_unique_names() -> None:
    names = [p.name for p in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))


def test_no_file_at_the_top_whose_name_a_shell_glob_for_units_would_match() -> None:
    assert list(ROOT.glob("flora-*")) == []


def test_modules_stay_small() -> None:
    long = {
        str(p.relative_to(ROOT)): n
        for folder in ("common", "services")
        for p in (ROOT / folder).rglob("*.py")
        if (n := len(p.read_text().splitlines())) > 420
    }
    assert long == {}


def test_changelog_speaks_of_the_current_version() -> None:
    version = PROJECT["project"]["version"]
    assert re.search(rf"^## {re.escape(version)}\b", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c != "flora-lab"])
def test_a_pi_process_loads_nothing_of_the_learning_stack(command: str) -> None:
    package = command.replace("-", "_")
    code = f"import sys, {package}.main; print([m for m in {LEARNING!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", sorted(LEAN))
def test_a_small_service_stays_small(command: str) -> None:
    package = command.replace("-", "_")
    code = f"import sys, {package}.main; print([m for m in ('numpy', 'cv2', 'rich', 'typer') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", COMMANDS)
def test_each_installed_command_starts(command: str) -> None:
    program = Path(sys.executable).parent / command
    for flag in ("--help", "--version"):
        done = subprocess.run([program, flag], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        assert command in done.stdout


def test_no_page_holds_a_placeholder() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "services").glob("*/README.md")]
    left = [
        f"{page}: {line}"
        for page in pages
        for line in page.read_text().splitlines()
        if re.fullmatch(r"[A-Z_]{4,}", line)
    ]
    assert left == []


def test_every_link_in_the_pages_leads_somewhere() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "services").glob("*/README.md")]
    for page in pages:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.relative_to(ROOT)} links to {target}"
