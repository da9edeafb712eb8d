"""An unsigned controller file into a signed one."""

from __future__ import annotations

from datetime import UTC, datetime

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from flora_common.controller_file import LoadedController, parse_controller
from flora_common.errors import BadController, BadInput
from flora_common.json_strict import read_table
from flora_common.signing import public_key, signed_bytes, signer_of


def sign(
    loaded: LoadedController,
    key: Ed25519PrivateKey,
    *,
    now: datetime,
    serial: int | None = None,
    expires: datetime | None = None,
) -> LoadedController:
    """The same controller with serial, expiry and signature; a signature that it has is replaced.

    Args:
        loaded: a file that passed every check.
        key: the private key.
        now: the time, in UTC.
        serial: higher than that of all files signed before; None takes the seconds since 1970, which is.
        expires: when rigs take it no more, in UTC; None is never.

    Raises:
        BadInput: it would have expired before it is signed.
        BadController: the result is not accepted as a controller file, such as for a serial that is too large.
    """
    if expires is not None and expires <= now:
        raise BadInput(f"--expires: {time_text(expires)} is past")
    name = loaded.file.name
    table = read_table(loaded.data, where=name, what="a controller file", error=BadController)
    table["serial"] = int(now.timestamp()) if serial is None else serial
    table.pop("expires", None)
    if expires is not None:
        table["expires"] = time_text(expires)
    signed = parse_controller(signed_bytes(table, key), where=f"{name}, signed")
    own = public_key(key.public_key())
    signer_of(signed, {own.id: own})
    return signed


def time_text(when: datetime) -> str:
    """A time as controller files write it: UTC, whole seconds."""
    return f"{when.astimezone(UTC):%Y-%m-%dT%H:%M:%SZ}"


def parse_time(text: str) -> datetime:
    """A day (its first moment, UTC) or a time with its zone.

    Raises:
        BadInput: neither.
    """
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput(f"--expires: `{text[:40]}` is no time; write 2027-01-31 or 2027-01-31T12:00:00Z") from None
    if when.tzinfo is None:
        if len(text) > len("2027-01-31"):
            raise BadInput(f"--expires: {text[:40]} names no time zone; write {text[:40]}Z for UTC")
        when = when.replace(tzinfo=UTC)
    return when.astimezone(UTC)
