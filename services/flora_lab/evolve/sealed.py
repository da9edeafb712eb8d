"""Data of an evolution as a file's content that says what it is, and shows when it is not whole any more."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from flora_common import files
from flora_common.errors import BadInput

T = TypeVar("T", bound=msgspec.Struct)


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    format: str
    sha256: str
    content: msgspec.Raw


def sealed(value: msgspec.Struct, form: str) -> bytes:
    """One JSON object with the value and its SHA-256; the same value gives the same bytes.

    Args:
        value: any.
        form: name and version of its form.
    """
    body = msgspec.json.encode(value)
    return msgspec.json.encode(_File(form, files.sha256_of_bytes(body), msgspec.Raw(body)))


def opened(data: bytes, form: str, kind: type[T], what: str) -> T:
    """Undo :func:`sealed`.

    Args:
        data: a file's content.
        form: that this program reads.
        kind: of the value.
        what: names the value in messages.

    Raises:
        BadInput: not such a file, of another form, or damaged; a clause that begins with its verb.
    """
    try:
        file = msgspec.json.decode(data, type=_File)
    except (ValueError, RecursionError) as problem:
        raise BadInput(f"is damaged or no {what} ({str(problem)[:100]})") from problem
    if file.format != form:
        raise BadInput(f"has the format `{file.format[:30]}`; this program reads `{form}`")
    if files.sha256_of_bytes(bytes(file.content)) != file.sha256:
        raise BadInput("is damaged: its content does not fit its SHA-256")
    try:
        return msgspec.json.decode(file.content, type=kind)
    except (ValueError, RecursionError) as problem:
        raise BadInput(f"is no {what} ({str(problem)[:100]})") from problem
