"""``flora-lab keygen`` and ``flora-lab sign``: their options, and what they say."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from flora_common.controller_file import LARGEST_SERIAL, SUFFIX, load_controller
from flora_common.errors import BadInput
from flora_common.files import write_bytes
from flora_common.outputs import beginning, can_be_made, check_file


def register(app: typer.Typer) -> None:
    """Add the subcommands to ``flora-lab``."""
    app.command("keygen")(keygen)
    app.command("sign")(sign)


def keygen(
    *,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder to write the pair to.")
    ] = Path(),
    comment: Annotated[str, typer.Option(help="Whose key it is; readers of the public file see it.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Make a key pair: flora.key, which signs and stays yours, and flora.pub, which rigs that trust you keep."""
    # cryptography loads a library of several MB, which the other subcommands need not wait for
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415

    from flora_lab.publish.keys import PRIVATE_NAME, PUBLIC_NAME, write_key_pair  # noqa: PLC0415

    can_be_made(output / PRIVATE_NAME)
    key = write_key_pair(output, Ed25519PrivateKey.generate(), comment=comment)
    private, public = output / PRIVATE_NAME, output / PUBLIC_NAME
    if as_json:
        typer.echo(json.dumps({"key": key.id, "private": str(private), "public": str(public)}))
    else:
        typer.echo(f"key {key}: {private} signs, keep it to yourself; {public} goes to the rigs' keys_dir")


def sign(
    controller: Annotated[Path, typer.Argument(metavar="CONTROLLER", help=f"A controller file, *{SUFFIX}.")],
    *,
    key: Annotated[Path, typer.Option(metavar="KEY", help="Your flora.key.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help=f"File to write, *{SUFFIX}.")],
    serial: Annotated[
        int | None,
        typer.Option(
            min=0, max=LARGEST_SERIAL, help="Must grow from file to file; the seconds since 1970 where not given."
        ),
    ] = None,
    expires: Annotated[
        str | None, typer.Option(metavar="DATE", help="From then on rigs do not accept it: 2027-01-31, UTC.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT where it is there.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Sign a controller, so that rigs which trust the key take it, and take no older one after it."""
    from flora_common.signing import public_key  # noqa: PLC0415 - see keygen
    from flora_lab.publish import sign as signing  # noqa: PLC0415
    from flora_lab.publish.keys import read_private_key  # noqa: PLC0415

    _check_output(output, controller, force=force)
    until = None if expires is None else signing.parse_time(expires)
    private = read_private_key(key)
    signed = signing.sign(load_controller(controller), private, now=datetime.now(UTC), serial=serial, expires=until)
    write_bytes(output, signed.data)
    signer, until_text = public_key(private.public_key()).id, None if until is None else signing.time_text(until)
    if as_json:
        said = {"file": str(output), "key": signer, "serial": signed.file.serial, "expires": until_text}
        typer.echo(json.dumps(said | {"sha256": signed.sha256}))
    else:
        until_said = "" if until_text is None else f", expires {until_text}"
        typer.echo(f"wrote {output}: `{signed.file.name}`, signed by {signer}, serial {signed.file.serial}{until_said}")


def _check_output(output: Path, controller: Path, *, force: bool) -> None:
    if not output.name.endswith(SUFFIX):
        raise BadInput(f"{output}: a controller file's name ends in {SUFFIX}")
    if output.exists() and controller.exists() and output.samefile(controller):
        raise BadInput(f"{output}: is the unsigned file itself, which stays as it is; name another one with -o")
    check_file(output, force=force, is_ours=_may_be_controller, what="a controller file")


def _may_be_controller(path: Path) -> bool:
    return beginning(path, 1) == b"{"
