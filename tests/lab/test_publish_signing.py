"""``flora-lab keygen`` and ``sign``, and ``flora-controller check``: from a key pair to a file that a rig believes."""

from __future__ import annotations

import json
import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, NoEncryption, PrivateFormat

from flora_common.controller_file import load_controller
from flora_common.errors import BadInput
from flora_common.files import DiskFull
from flora_common.signing import read_trusted_keys, signer_of
from flora_controller.main import main as controller
from flora_lab.main import main
from flora_lab.publish import keys
from flora_lab.publish.sign import parse_time, sign
from signing_keys import ADA, EXPORT, TIP_ONLY, signed, trusted

NOON = datetime(2026, 12, 1, 12, tzinfo=UTC)


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A folder with a key pair."""
    assert main(["keygen", "-o", str(tmp_path / "keys"), "--comment", "Ada's lab"]) == 0
    return tmp_path / "keys"


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """The one line of a command that ends with status 2."""
    capsys.readouterr()
    assert main([str(argument) for argument in arguments]) == 2
    heard = capsys.readouterr()
    assert heard.out == ""
    assert heard.err.count("\n") == 1
    return heard.err


def test_what_a_new_key_signs_a_rig_that_has_its_public_half_believes(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "signed.controller.json"
    before = EXPORT.read_bytes()

    assert main(["sign", str(EXPORT), "--key", str(pair / "flora.key"), "-o", str(out), "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert controller(["check", str(out), "--keys", str(pair)]) == 0

    told = json.loads(lines[-1])
    assert told["sha256"] == load_controller(out).sha256
    said = f"signed by {told['key']} (Ada's lab), serial {told['serial']}\n"
    assert capsys.readouterr().out.endswith(said)
    assert EXPORT.read_bytes() == before
    assert load_controller(out).network.nodes == load_controller(EXPORT).network.nodes


def test_the_private_key_is_its_owners_alone_and_neither_half_is_ever_replaced(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    private = pair / "flora.key"
    before = private.read_bytes()

    assert stat.S_IMODE(private.stat().st_mode) == 0o600
    assert "flora.key: is there already and is not replaced" in refused(capsys, "keygen", "-o", pair)
    private.unlink()
    assert "flora.pub: is there already and is not replaced" in refused(capsys, "keygen", "-o", pair)
    assert not private.exists()
    assert b"BEGIN PRIVATE KEY" in before


def test_a_folder_in_which_no_key_can_be_made_is_told_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    assert main(["keygen", "-o", str(tmp_path / "keys")]) == 2
    said = f"nothing may be made in {tmp_path}; name another place with -o\n"
    assert capsys.readouterr().err.endswith(said)


def test_two_key_pairs_are_two_keys(pair: Path, tmp_path: Path) -> None:
    main(["keygen", "-o", str(tmp_path / "other")])

    assert not read_trusted_keys(pair).keys() & read_trusted_keys(tmp_path / "other").keys()


def test_half_a_pair_is_not_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = keys.write_bytes

    def full_at_the_second(path: Path, data: bytes, *, mode: int = 0o644) -> None:
        if path.name == keys.PRIVATE_NAME:
            raise DiskFull(f"{path}: no room on the disk")
        write(path, data, mode=mode)

    monkeypatch.setattr(keys, "write_bytes", full_at_the_second)
    with pytest.raises(DiskFull):
        keys.write_key_pair(tmp_path, ADA, comment="")

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("comment", ["two\nlines", "x" * 101, "bell\a"])
def test_a_comment_is_one_line_of_text(comment: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--comment: must be one line" in refused(capsys, "keygen", "-o", tmp_path / "k", "--comment", comment)
    assert not (tmp_path / "k").exists()


def _key_file(folder: Path, kind: str) -> Path:
    path = folder / "x.key"
    curve = ec.derive_private_key(7, ec.SECP256R1())
    contents = {
        "missing": None,
        "open to others": ADA.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
        "encrypted": ADA.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret")),
        "of another kind": curve.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
        "public": (folder / "keys" / "flora.pub").read_bytes(),
        "public and open to others": (folder / "keys" / "flora.pub").read_bytes(),
        "no key": b"a text",
        "large": b" " * 20_000,
    }
    data = contents[kind]
    if data is not None:
        path.write_bytes(data)
        path.chmod(0o640 if kind.endswith("open to others") else 0o600)
    return path


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("missing", "cannot be read (No such file or directory)"),
        ("open to others", "others than its owner can use this key; chmod 600"),
        ("encrypted", "is encrypted"),
        ("of another kind", "not an Ed25519 private key"),
        ("public", "holds a public key; sign with the private one, flora.key"),
        ("public and open to others", "holds a public key"),
        ("no key", "not a private key (`flora-lab keygen` writes one"),
        ("large", "not a private key file"),
    ],
)
def test_what_is_no_key_to_sign_with_is_told(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, said: str
) -> None:
    path, out = _key_file(pair.parent, kind), tmp_path / "out.controller.json"

    assert f"{path}: {said}" in refused(capsys, "sign", TIP_ONLY, "--key", path, "-o", out)
    assert not out.exists()


def test_an_output_that_is_there_is_kept_unless_told_otherwise_and_the_input_always(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "in.controller.json", tmp_path / "out.controller.json"
    source.write_bytes(TIP_ONLY.read_bytes())
    out.write_text("mine")
    key = ["--key", pair / "flora.key"]

    assert "is not a controller file and is not replaced" in refused(capsys, "sign", source, *key, "-o", out, "--force")
    assert out.read_text() == "mine"
    out.write_text("{}")
    assert "is there already; name another" in refused(capsys, "sign", source, *key, "-o", out)
    assert "is the unsigned file itself" in refused(capsys, "sign", source, *key, "-o", source, "--force")
    assert "name ends in .controller.json" in refused(capsys, "sign", source, *key, "-o", tmp_path / "out.json")
    assert (out.read_text(), source.read_bytes()) == ("{}", TIP_ONLY.read_bytes())
    assert main(["sign", str(source), *map(str, key), "-o", str(out), "--force", "--serial", "3"]) == 0
    assert load_controller(out).file.serial == 3


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--expires", "tomorrow", "`tomorrow` is no time; write 2027-01-31"),
        ("--expires", "2027-01-31T12:00:00", "names no time zone"),
        ("--expires", "2020-01-01", "2020-01-01T00:00:00Z is past"),
        ("--serial", "-1", "Invalid value for '--serial'"),
        ("--serial", str(2**53 + 1), "9007199254740992"),
        ("--serial", str(2**63), "9007199254740992"),
    ],
)
def test_what_cannot_be_signed_is_told(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, said: str
) -> None:
    out = tmp_path / "out.controller.json"
    key = pair / "flora.key"

    told = refused(capsys, "sign", TIP_ONLY, "--key", key, "-o", out, option, value)
    assert said in told
    assert option == "--expires" or f"'{option}'" in told  # the rest is Typer's, by its version
    assert not out.exists()


def test_a_bad_controller_is_not_signed(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = TIP_ONLY.parent.parent / "bad" / "nan_weight.controller.json"
    out = tmp_path / "out.controller.json"

    assert "NaN is not a finite number" in refused(capsys, "sign", bad, "--key", pair / "flora.key", "-o", out)
    assert not out.exists()


def test_serial_and_expiry_are_what_was_asked_for() -> None:
    loaded = load_controller(TIP_ONLY)

    plain = sign(loaded, ADA, now=NOON)
    given = sign(loaded, ADA, now=NOON, serial=0, expires=NOON + timedelta(days=1))

    assert (plain.file.serial, plain.file.expires) == (int(NOON.timestamp()), None)
    assert (given.file.serial, given.file.expires) == (0, NOON + timedelta(days=1))
    assert sign(loaded, ADA, now=NOON).data == plain.data


def test_signing_again_replaces_signature_serial_and_expiry() -> None:
    first = sign(load_controller(TIP_ONLY), ADA, now=NOON, expires=NOON + timedelta(days=1))

    again = sign(first, ADA, now=NOON + timedelta(hours=1))

    assert (again.file.serial, again.file.expires) == (first.file.serial + 3600, None)
    assert signer_of(again, trusted(ADA)).id == next(iter(trusted(ADA)))


@pytest.mark.parametrize(
    ("text", "when"),
    [
        ("2027-01-31", datetime(2027, 1, 31, tzinfo=UTC)),
        ("2027-01-31T12:00:00Z", datetime(2027, 1, 31, 12, tzinfo=UTC)),
        ("2027-01-31T12:00+02:00", datetime(2027, 1, 31, 10, tzinfo=UTC)),
    ],
)
def test_times_are_read_as_utc(text: str, when: datetime) -> None:
    assert parse_time(text) == when


@pytest.mark.parametrize("text", ["", "now", "2027-13-01", "2027-01-31 12:00", "1e9"])
def test_what_is_no_time_is_told(text: str) -> None:
    with pytest.raises(BadInput, match="--expires"):
        parse_time(text)


def test_check_tells_a_signature_that_nobody_was_asked_to_verify(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.controller.json"
    path.write_bytes(signed(serial=7, expires="2027-01-01T00:00:00Z").data)

    assert controller(["check", str(path)]) == 0
    assert controller(["check", str(TIP_ONLY)]) == 0

    first, second = capsys.readouterr().out.splitlines()
    assert first.endswith("not verified without --keys, serial 7, expires 2027-01-01 00:00 UTC")
    assert second.endswith("; not signed")


def test_check_refuses_what_none_of_the_keys_has_signed(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.controller.json"
    path.write_bytes(signed().data)
    capsys.readouterr()

    assert [controller(["check", str(file), "--keys", str(pair)]) for file in (path, TIP_ONLY)] == [2, 2]

    first, second = capsys.readouterr().err.splitlines()
    assert first.endswith(f"a key that is not trusted; the keys asked are those in {pair}")
    assert second.endswith(f"is not signed; the keys asked are those in {pair}")


def test_check_tells_where_no_keys_are(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.controller.json"
    path.write_bytes(signed().data)
    capsys.readouterr()

    assert controller(["check", str(path), "--keys", str(tmp_path / "nope")]) == 2

    assert capsys.readouterr().err == f"flora-controller: --keys {tmp_path / 'nope'}: no such folder\n"


def test_help_does_not_wait_for_cryptography() -> None:
    program = "import sys, flora_lab.main as m; m.build_app(); sys.exit('cryptography' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
