"""Signed controller files: nothing in them can be changed, and the keys are what they seem."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from flora_common.controller_file import LoadedController, load_controller, parse_controller
from flora_common.errors import BadController, BadInput, ConfigError
from flora_common.signing import comment_line, parse_public_key, read_trusted_keys, signer_of
from signing_keys import ADA, BOB, TIP_ONLY, signed, trusted

GROUP_ORDER = 2**252 + 27742317777372353535851937790883648493
"""Of Ed25519 (RFC 8032, section 5.1)."""
PEM = ADA.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def believed(data: bytes, *keys: Ed25519PrivateKey) -> LoadedController | None:
    """The file, if it passes every check with these keys; None where it is refused."""
    try:
        loaded = parse_controller(data, where="x")
        signer_of(loaded, trusted(*keys))
    except BadController:
        return None
    return loaded


def test_the_signer_is_found_among_the_trusted_keys() -> None:
    assert signer_of(signed(key=BOB), trusted(ADA, BOB)).id == next(iter(trusted(BOB)))


def test_no_single_bit_of_file_or_signature_can_be_flipped() -> None:
    good = signed(serial=7, expires="2027-01-01T00:00:00Z").data
    assert believed(good, ADA) is not None
    flipped = bytearray(good)
    refused = 0
    for place in range(len(good)):
        for bit in range(8):
            flipped[place] ^= 1 << bit
            refused += believed(bytes(flipped), ADA) is None
            flipped[place] ^= 1 << bit
    refused += believed(good, BOB) is None

    assert refused == 8 * len(good) + 1


def test_no_byte_can_be_left_out_or_doubled() -> None:
    good = signed().data

    assert [i for i in range(len(good)) if believed(good[:i] + good[i + 1 :], ADA)] == []
    assert [i for i in range(len(good)) if believed(good[:i] + good[i : i + 1] + good[i:], ADA)] == []


@pytest.mark.parametrize(
    "spelt",
    [
        lambda data: json.dumps(json.loads(data)).encode(),
        lambda data: json.dumps(json.loads(data), sort_keys=True, indent=1).encode(),
        lambda data: json.dumps(dict(reversed(json.loads(data).items())), separators=(",", ":")).encode(),
        lambda data: data.replace(b"0.0", b"0.00"),
        lambda data: data.replace(b'"left"', b'"\\u006ceft"'),
        lambda data: data + b"\n",
        lambda data: b" " + data,
    ],
    ids=["spaces", "indented", "other order", "longer number", "escape", "line end", "space before"],
)
def test_the_same_content_written_in_another_way_is_refused(spelt: Callable[[bytes], bytes]) -> None:
    good = signed()
    other = spelt(good.data)
    assert other != good.data
    assert parse_controller(other, where="x").file == good.file

    with pytest.raises(BadController, match=r"was changed after it was signed by .* \(not in its canonical form\)"):
        signer_of(parse_controller(other, where="x"), trusted(ADA))


def with_value(text: str) -> bytes:
    """A signed file with another signature value."""
    good = signed()
    assert good.file.signature is not None
    return good.data.replace(good.file.signature.value.encode(), text.encode())


def test_a_signature_has_one_spelling() -> None:
    signature = signed().file.signature
    assert signature is not None
    text, value = signature.value, base64.b64decode(signature.value)
    # The last sign before the padding carries four bits that decoders drop.
    alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"
    loose = text[:-3] + alphabet[alphabet.index(text[-3]) + 1] + "=="
    assert base64.b64decode(loose) == value
    plus_order = value[:32] + (int.from_bytes(value[32:], "little") + GROUP_ORDER).to_bytes(32, "little")

    assert believed(with_value(text), ADA) is not None
    for other in (
        loose,
        text.rstrip("="),
        text + "====",
        text.replace("+", "-").replace("/", "_") + " ",
        base64.b64encode(plus_order).decode(),
        base64.b64encode(value[:63]).decode(),
        base64.b64encode(value + b"\0").decode(),
        base64.b64encode(bytes(64)).decode(),
        "",
    ):
        assert believed(with_value(other), ADA) is None


@pytest.mark.parametrize(
    ("loaded", "said"),
    [
        (load_controller(TIP_ONLY), "`tip-only` is not signed"),
        (signed(key=BOB), f"`tip-only` is signed by `{next(iter(trusted(BOB)))}`, a key that is not trusted"),
    ],
)
def test_what_no_trusted_key_has_signed_is_refused(loaded: LoadedController, said: str) -> None:
    with pytest.raises(BadController) as caught:
        signer_of(loaded, trusted(ADA))

    assert said in str(caught.value)


def test_a_stranger_cannot_sign_in_the_name_of_a_trusted_key() -> None:
    ada, bob = next(iter(trusted(ADA))), next(iter(trusted(BOB)))
    forged = signed(key=BOB).data.replace(bob.encode(), ada.encode())

    with pytest.raises(BadController, match="or never signed by it"):
        signer_of(parse_controller(forged, where="x"), trusted(ADA))


def test_the_trusted_keys_are_the_pub_files_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "ada.pub").write_bytes(comment_line("Ada's lab, µ") + PEM)
    (tmp_path / "readme.txt").write_text("not a key")

    keys = read_trusted_keys(tmp_path)

    assert {key.id: str(key) for key in keys.values()} == {
        next(iter(trusted(ADA))): f"{next(iter(trusted(ADA)))} (Ada's lab, µ)"
    }
    assert read_trusted_keys(tmp_path / "missing") == {}


def _private_pem(key: Ed25519PrivateKey | ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


CURVE_KEY = ec.derive_private_key(7, ec.SECP256R1())


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (_private_pem(ADA), "holds a private key"),
        (b"", "not a public key"),
        (PEM[:60], "not a public key"),
        (PEM.replace(b"A", b"\xff"), "not a public key"),
        (
            CURVE_KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo),
            "not an Ed25519 public key",
        ),
    ],
    ids=["private", "empty", "cut", "not text", "another kind"],
)
def test_what_is_no_public_key_is_told_with_its_file(tmp_path: Path, data: bytes, said: str) -> None:
    path = tmp_path / "x.pub"
    path.write_bytes(data)

    with pytest.raises(BadInput, match=f"^x: {said}"):
        parse_public_key(data, where="x")
    with pytest.raises(ConfigError, match=f"^{path}: {said}"):
        read_trusted_keys(tmp_path)


@pytest.mark.parametrize("kind", ["folder", "large", "dangling"])
def test_what_is_no_file_of_sensible_size_is_no_key(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "x.pub"
    if kind == "folder":
        path.mkdir()
    elif kind == "large":
        path.write_bytes(PEM + b" " * 10_000)
    else:
        path.symlink_to(tmp_path / "gone")

    with pytest.raises(ConfigError, match=f"^{path}: not a public key file"):
        read_trusted_keys(tmp_path)


def test_a_comment_cannot_hold_more_than_a_line_of_text() -> None:
    shown = parse_public_key(b"# \x1b[31mAda\x07" + b"x" * 300 + b"\n" + PEM, where="x").comment

    assert shown.isprintable()
    assert len(shown) == 100
