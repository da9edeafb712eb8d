"""The rig's file: what is good, and what the user is told about each bad example in tests/golden/config/bad."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path
from typing import Annotated

import msgspec
import pytest

from flora_common.config import SECTIONS, ClockSection, RigSection, config_text, load_config
from flora_common.errors import BadRunFolder, ConfigError
from flora_common.suggest import did_you_mean
from flora_common.toml_strict import convert, read_toml, to_toml

BAD = sorted((Path(__file__).parents[1] / "golden" / "config" / "bad").glob("*.toml"))


def told(path: Path) -> tuple[str, str]:
    """(expected sentence, command) of a bad example."""
    lines = path.read_bytes().decode("utf-8", "replace").splitlines()
    assert lines[0].startswith("# expect: "), f"{path}: the first line must be `# expect: …`"
    assert lines[1].startswith("# command: "), f"{path}: the second line must be `# command: …`"
    expected = lines[0].removeprefix("# expect: ").format(file=path)
    return expected, lines[1].removeprefix("# command: ")


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_bad_examples_are_told_in_one_line_with_status_two(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    expected, command = told(path)
    main = importlib.import_module(command.replace("-", "_") + ".main").main
    status = main(["--config", str(path), "--check-config"])
    shown = capsys.readouterr()
    assert (status, shown.out) == (2, "")
    assert shown.err == f"{command}: {expected}\n"


def test_there_are_bad_examples() -> None:
    assert len(BAD) >= 15


class OwnSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    speed: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 1.0
    names: tuple[str, ...] = ("a", "b")
    clock: ClockSection = ClockSection()
    limit: float | None = None


def test_defaults_hold_where_there_is_no_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("flora_common.config.DEFAULT_CONFIG", tmp_path / "none.toml")
    assert load_config(None, "led", OwnSection) == (RigSection(), OwnSection())


def test_the_default_file_is_read_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "flora.toml"
    path.write_text('[rig]\nname = "north"\n')
    monkeypatch.setattr("flora_common.config.DEFAULT_CONFIG", path)
    assert load_config(None, "led", OwnSection)[0].name == "north"


def test_a_file_that_was_asked_for_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read \(No such file or directory\)"):
        load_config(tmp_path / "none.toml", "led", OwnSection)


def test_other_services_sections_are_left_to_them(tmp_path: Path) -> None:
    path = tmp_path / "flora.toml"
    path.write_text("[led]\nspeed = 2\n[capture]\nwhatever = true\n[rig]\nhealth_every_s = 1\n")
    rig, own = load_config(path, "led", OwnSection)
    assert (rig.health_every_s, own.speed) == (1.0, 2.0)


def test_what_is_printed_reads_back_the_same(tmp_path: Path) -> None:
    rig = RigSection(name="north", clock=ClockSection(kind="twin", twin="tcp://127.0.0.1:5555"))
    own = OwnSection(speed=0.25, names=("x", 'y "z"'), clock=ClockSection(twin="ipc://a b"))
    path = tmp_path / "flora.toml"
    path.write_text(config_text(rig, "led", own))
    assert load_config(path, "led", OwnSection) == (rig, own)


def test_print_config_of_a_service_reads_back(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from flora_recorder.core import RecorderSection
    from flora_recorder.main import main

    path = tmp_path / "flora.toml"
    path.write_text("[recorder]\nflush_s = 5.0\n")
    assert main(["--config", str(path), "--print-config"]) == 0
    printed = capsys.readouterr().out
    assert tomllib.loads(printed)["recorder"] == {"flush_s": 5.0, "rotate_h": 24.0, "rotate_mib": 16.0}
    path.write_text(printed)
    assert load_config(path, "recorder", RecorderSection) == (RigSection(), RecorderSection(flush_s=5.0))


def test_a_run_folder_is_known_by_its_own_name_where_a_link_leads_to_it(tmp_path: Path) -> None:
    (tmp_path / "bean 01").mkdir()
    (tmp_path / "bean-01").mkdir()
    link, path = tmp_path / "current", tmp_path / "flora.toml"
    path.write_text(f"[rig]\nrun_dir = '{link}'\n")
    link.symlink_to(tmp_path / "bean 01")
    with pytest.raises(ConfigError, match=r"\[rig\]: run_dir .*/current leads to `bean 01`: a run folder's name is"):
        load_config(path, "led", OwnSection)
    link.unlink()
    link.symlink_to(tmp_path / "bean-01")
    assert load_config(path, "led", OwnSection)[0].run_dir == str(link)


@pytest.mark.parametrize("key", ["run_dir", "state_dir"])
@pytest.mark.parametrize("inner", ["", "/inner/folder"])
def test_check_config_sees_what_is_in_the_way_of_a_folder(
    tmp_path: Path, key: str, inner: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from flora_bus.main import main

    (tmp_path / "file").touch()
    config, named = tmp_path / "flora.toml", f"{tmp_path}/file{inner}"
    config.write_text(f'[rig]\n{key} = "{named}"\n')
    assert main(["--config", str(config), "--check-config"]) == 2
    said = f"[rig] {key} {named}: {tmp_path}/file is no folder; move it away, or name another place\n"
    assert capsys.readouterr().err == f"flora-bus: {said}"


def test_check_config_takes_folders_that_are_made_later(tmp_path: Path) -> None:
    from flora_bus.main import main

    config = tmp_path / "flora.toml"
    (tmp_path / "current").symlink_to(tmp_path / "runs" / "of-next-week")
    config.write_text(f'[rig]\nrun_dir = "{tmp_path}/current"\nstate_dir = "{tmp_path}/not/yet"\n')
    assert main(["--config", str(config), "--check-config"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["current", "flora.toml"]


def test_check_config_says_so(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from flora_bus.main import main

    (tmp_path / "flora.toml").write_text("")
    assert main(["--config", str(tmp_path / "flora.toml"), "--check-config"]) == 0
    assert capsys.readouterr().out == "flora-bus: configuration is good\n"


def test_every_command_has_a_section() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {name.removeprefix("flora-") for name in project["scripts"]} <= set(SECTIONS)


def test_nested_tables_are_named_in_full(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("[clock]\nkin = 1\n")
    with pytest.raises(BadRunFolder, match=r"a\.toml \[clock\]: unknown key `kin`; did you mean `kind`\?"):
        convert(read_toml(tmp_path / "a.toml", BadRunFolder), OwnSection, where="a.toml", error=BadRunFolder)


def test_none_is_left_out_of_toml() -> None:
    assert "limit" not in to_toml(OwnSection())
    assert "limit = 2.5" in to_toml(OwnSection(limit=2.5))


@pytest.mark.parametrize(
    ("wrong", "clause"),
    [
        ("intervall_s", "; did you mean `interval_s`?"),
        ("zzz", "; known: interval_s, rate"),
    ],
)
def test_did_you_mean(wrong: str, clause: str) -> None:
    assert did_you_mean(wrong, ["rate", "interval_s"]) == clause
    assert did_you_mean(wrong, []) == ""


def test_a_line_without_end_is_not_told_whole(tmp_path: Path) -> None:
    assert did_you_mean("zzz", ["x" * 5000]) == f"; known: {'x' * 60}…"
    assert len(did_you_mean("zzz", [f"x{i}" for i in range(5000)])) < 300
    (tmp_path / "a.toml").write_text(f"{'x' * 5000} = 1\n")
    with pytest.raises(BadRunFolder, match=r"unknown key `x{60}…`; known: ") as told:
        convert(read_toml(tmp_path / "a.toml", BadRunFolder), OwnSection, where="a.toml", error=BadRunFolder)
    assert len(str(told.value)) < 200


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("9" * 5000, "a whole number is too large (line 2)"),
        ("9" * 400, "`rig.health_every_s` is too large, a whole number must lie within ±9223372036854775807"),
        ("-9223372036854775808", "`rig.health_every_s` is too large"),
        (f"0x{'f' * 4000}", "`rig.health_every_s` is too large"),
        (f"[1, {'9' * 20}]", "`rig.health_every_s` is too large"),
        ('"a\\u0000b"', "`rig.health_every_s` holds a NUL character"),
    ],
)
def test_values_that_can_be_nobodys_are_told_with_their_place(tmp_path: Path, value: str, said: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(f"[rig]\nhealth_every_s = {value}\n")
    with pytest.raises(ConfigError) as told:
        load_config(path, "led", OwnSection)
    assert str(told.value).startswith(f"{path}: {said}")
    assert len(str(told.value)) < len(str(path)) + 200


def test_the_largest_whole_number_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("number = 9223372036854775807\n")
    assert read_toml(tmp_path / "a.toml", ConfigError) == {"number": 2**63 - 1}


def test_keys_within_keys_without_end_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(f"{'a.' * 20_000}a = 1\n")
    with pytest.raises(ConfigError, match=r"unknown section \[a\]"):
        load_config(tmp_path / "a.toml", "led", OwnSection)


def test_a_number_beyond_every_float_is_refused_where_it_does_not_come_from_a_file() -> None:
    with pytest.raises(ConfigError, match="speed"):
        convert({"speed": 10**400}, OwnSection, where="--speed", error=ConfigError)


@pytest.mark.parametrize("key", ["run_dir", "state_dir"])
def test_a_folder_with_a_nul_in_its_name_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str
) -> None:
    from flora_bus.main import main

    path = tmp_path / "flora.toml"
    path.write_text(f'[rig]\n{key} = "a\\u0000b"\n')
    assert main(["--config", str(path), "--check-config"]) == 2
    assert capsys.readouterr().err.startswith(f"flora-bus: {path}: `rig.{key}` holds a NUL character")
