"""Key pairs: made once by whoever signs controllers; the private half never leaves that person's machine."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Final

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from flora_common.errors import BadInput
from flora_common.files import write_bytes
from flora_common.signing import LARGEST_KEY_FILE, LONGEST_COMMENT, PublicKey, comment_line, public_key

PRIVATE_NAME: Final = "flora.key"
PUBLIC_NAME: Final = "flora.pub"
PRIVATE_MODE: Final = 0o600


def write_key_pair(folder: Path, key: Ed25519PrivateKey, *, comment: str) -> PublicKey:
    """Write ``flora.key`` (PKCS8 in PEM, readable by its owner alone) and ``flora.pub`` into a folder.

    Args:
        folder: made where it is missing.
        key: the private key.
        comment: whose it is; goes into the public file, for those who are to trust it.

    Raises:
        BadInput: a key is there already, or the comment is not one line of printable text.
    """
    if not comment.isprintable() or len(comment) > LONGEST_COMMENT:
        raise BadInput(f"--comment: must be one line of at most {LONGEST_COMMENT} printable characters")
    private, public = folder / PRIVATE_NAME, folder / PUBLIC_NAME
    for path in (private, public):
        if path.exists() or path.is_symlink():
            raise BadInput(f"{path}: is there already and is not replaced; name another folder with -o")
    public_pem = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    private_pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    write_bytes(public, comment_line(comment) + public_pem)
    try:
        write_bytes(private, private_pem, mode=PRIVATE_MODE)
    except BaseException:
        public.unlink()  # half a pair is none
        raise
    return public_key(key.public_key(), comment)


def read_private_key(path: Path) -> Ed25519PrivateKey:
    """A private key that nobody but its owner can read.

    Raises:
        BadInput: missing, not a private Ed25519 key in PEM, encrypted, or open to others.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST_KEY_FILE:
            raise BadInput(f"{path}: not a private key file")
        data = path.read_bytes()
        if b"PUBLIC KEY" in data:
            raise BadInput(f"{path}: holds a public key; sign with the private one, {PRIVATE_NAME} beside it")
        if status.st_mode & 0o077:
            raise BadInput(f"{path}: others than its owner can use this key; chmod 600 {path}")
    except OSError as problem:
        raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
    try:
        key = load_pem_private_key(data, password=None)
    except TypeError as problem:
        raise BadInput(f"{path}: is encrypted, and there is nobody here to ask for its password") from problem
    except (ValueError, UnsupportedAlgorithm) as problem:
        raise BadInput(f"{path}: not a private key (`flora-lab keygen` writes one as {PRIVATE_NAME})") from problem
    if not isinstance(key, Ed25519PrivateKey):
        raise BadInput(f"{path}: not an Ed25519 private key")
    return key
