"""Who made a controller file: Ed25519 signatures that no single bit of the file can escape.

A signature covers the file's table. So that it covers every byte too, a signed file must be the one canonical text of
its table (:func:`flora_common.json_strict.canonical_bytes`): white space, the order of keys and the spelling of numbers
are then no place where a signed file could be changed. Nor is the signature itself: its base64 must be the one spelling
of its 64 bytes, and of those OpenSSL accepts no second form (RFC 8032, section 5.1.7: ``S`` below the group's order).

A public key is a PEM file, as ``openssl pkey -pubout`` writes it, perhaps with a comment in the line before it. Its
short name is the beginning of the SHA-256 of its 32 bytes.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_public_key

from flora_common.controller_file import LoadedController, bytes_to_sign
from flora_common.errors import BadController, BadInput, ConfigError
from flora_common.files import sha256_of_bytes
from flora_common.json_strict import canonical_bytes, read_table

PUBLIC_SUFFIX: Final = ".pub"
ALGORITHM: Final = "ed25519"
ID_DIGITS: Final = 16
SIGNATURE_BYTES: Final = 64
LARGEST_KEY_FILE: Final = 10_000
LONGEST_COMMENT: Final = 100
_COMMENT: Final = "# "


@dataclass(frozen=True, slots=True)
class PublicKey:
    """A key that signatures are checked with.

    Attributes:
        id: its short name, 16 hex digits.
        comment: whose it is, in the words of whoever made it; nothing vouches for them.
        key: the key.
    """

    id: str
    comment: str
    key: Ed25519PublicKey

    def __str__(self) -> str:
        return f"{self.id} ({self.comment})" if self.comment else self.id


def public_key(key: Ed25519PublicKey, comment: str = "") -> PublicKey:
    """A key with its short name."""
    return PublicKey(sha256_of_bytes(key.public_bytes_raw())[:ID_DIGITS], comment, key)


def parse_public_key(data: bytes, *, where: str) -> PublicKey:
    """A public key file's content.

    Raises:
        BadInput: not a PEM file of an Ed25519 public key.
    """
    if b"PRIVATE KEY" in data:
        raise BadInput(f"{where}: holds a private key; it belongs to whoever signs, give the {PUBLIC_SUFFIX} file here")
    try:
        key = load_pem_public_key(data)
    except (ValueError, UnsupportedAlgorithm) as problem:
        raise BadInput(f"{where}: not a public key (a PEM file as `flora-lab keygen` writes)") from problem
    if not isinstance(key, Ed25519PublicKey):
        raise BadInput(f"{where}: not an Ed25519 public key")
    first = data.split(b"\n", 1)[0].decode(errors="replace")
    comment = first.removeprefix(_COMMENT).strip() if first.startswith(_COMMENT) else ""
    return public_key(key, "".join(c for c in comment if c.isprintable())[:LONGEST_COMMENT])


def comment_line(comment: str) -> bytes:
    """What stands before the key in a public key file; nothing where there is no comment."""
    return f"{_COMMENT}{comment}\n".encode() if comment else b""


def read_trusted_keys(folder: Path) -> dict[str, PublicKey]:
    """All public keys ``*.pub`` of a folder, by their short names; none where there is no such folder.

    Raises:
        ConfigError: a file that is no public key: whoever put it there believes that it counts.
    """
    keys: dict[str, PublicKey] = {}
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix == PUBLIC_SUFFIX)
    except FileNotFoundError:
        return keys
    except OSError as problem:
        raise ConfigError(f"{folder}: the trusted keys cannot be read ({problem.strerror})") from problem
    for path in paths:
        try:
            if not path.is_file() or path.stat().st_size > LARGEST_KEY_FILE:
                raise ConfigError(f"{path}: not a public key file")
            key = parse_public_key(path.read_bytes(), where=str(path))
        except OSError as problem:
            raise ConfigError(f"{path}: cannot be read ({problem.strerror})") from problem
        except BadInput as problem:
            raise ConfigError(str(problem)) from problem
        keys[key.id] = key
    return keys


def signed_bytes(table: Mapping[str, Any], key: Ed25519PrivateKey) -> bytes:
    """The whole file, signed: a table with any old signature replaced, as its one canonical text."""
    value = base64.b64encode(key.sign(bytes_to_sign(table))).decode()
    signature = {"algorithm": ALGORITHM, "key": public_key(key.public_key()).id, "value": value}
    return canonical_bytes({**table, "signature": signature})


def signer_of(loaded: LoadedController, keys: Mapping[str, PublicKey]) -> PublicKey:
    """The key that a file was signed with, after every check of its signature.

    Args:
        loaded: the file; its bytes are what is checked.
        keys: the trusted ones, by their short names.

    Raises:
        BadController: not signed, by a key that is not among them, or not the bytes that were signed.
    """
    name, signature = loaded.file.name, loaded.file.signature
    if signature is None:
        raise BadController(f"controller `{name}` is not signed")
    key = keys.get(signature.key)
    if key is None:
        raise BadController(
            f"controller `{name}` is signed by `{signature.key[:ID_DIGITS]}`, a key that is not trusted"
        )
    table = read_table(loaded.data, where=name, what="a controller file", error=BadController)
    value = _signature_bytes(signature.value)
    if value is None or canonical_bytes(table) != loaded.data:
        raise BadController(f"controller `{name}` was changed after it was signed by {key} (not in its canonical form)")
    try:
        key.key.verify(value, bytes_to_sign(table))
    except InvalidSignature as problem:
        raise BadController(
            f"controller `{name}` was changed after it was signed by {key}, or never signed by it"
        ) from problem
    return key


def _signature_bytes(text: str) -> bytes | None:
    """The bytes of a signature where the text is the one way to write them."""
    try:
        value = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return None
    same = base64.b64encode(value).decode() == text
    return value if same and len(value) == SIGNATURE_BYTES else None
