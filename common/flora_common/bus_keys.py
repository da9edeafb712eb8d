"""Who may take part in a bus over TCP: CURVE key pairs in files, one of the bus and one of each machine.

A secret file ``*.key`` holds both halves of a pair and is its owner's alone; a public one ``*.pub`` is for the others.
Both are certificates as ZeroMQ's own tools write and read them, named as the keys that sign controllers are. In one
folder, ``bus_keys`` of ``[rig]``:

==================  ================================================================================
``bus.key``         the bus's pair; only where flora-bus runs
``bus.pub``         its public half; by it everyone else knows that this is the bus
``client.key``      the pair of this machine
``client.pub``      its public half, to be copied into ``authorized/`` of the bus, under any name
``authorized/``     where flora-bus runs: ``*.pub`` of the machines that may take part
==================  ================================================================================
"""

from __future__ import annotations

import os
import re
import stat
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import zmq
from zmq.utils import z85

from flora_common.errors import BadInput, ConfigError
from flora_common.files import make_folder, write_bytes

BUS: Final = "bus"
CLIENT: Final = "client"
AUTHORIZED: Final = "authorized"
SECRET_SUFFIX: Final = ".key"
PUBLIC_SUFFIX: Final = ".pub"
SECRET_MODE: Final = 0o600
LARGEST_KEY_FILE: Final = 10_000

_HALF: Final = r'^[ \t]*{}[ \t]*=[ \t]*["\']([^"\'\n]*)["\'][ \t]*$'
_PUBLIC: Final = re.compile(_HALF.format("public-key"), re.MULTILINE)
_SECRET: Final = re.compile(_HALF.format("secret-key"), re.MULTILINE)
_PORT: Final = re.compile(r":(\d+|\*)$")
_LARGEST_PORT: Final = 65_535
_LOOPBACK: Final = re.compile(r"tcp://(127(\.\d{1,3}){3}|localhost|\[::1\]):(\d+|\*)")


@dataclass(frozen=True, slots=True)
class KeyPair:
    """Both halves, 32 bytes each."""

    public: bytes
    secret: bytes

    def __repr__(self) -> str:
        return f"KeyPair(public={self.public!r})"  # the other half is for no log and no traceback


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """What a participant needs: its own pair, and the bus's public key (32 bytes)."""

    own: KeyPair
    bus: bytes


def is_tcp(endpoint: str) -> bool:
    """Whether an endpoint is one that keys are asked for at; all others stay within this machine."""
    return endpoint.startswith("tcp://")


def is_loopback(endpoint: str) -> bool:
    """Whether a ``tcp://`` endpoint is one that no other machine reaches, as it is written."""
    return _LOOPBACK.fullmatch(endpoint) is not None


def check_port(key: str, endpoint: str) -> None:
    """Whether a ``tcp://`` endpoint has a port: ZeroMQ takes one that there is not for another that there is.

    Args:
        key: where the endpoint stands, such as ``bus_publish``.
        endpoint: the endpoint.

    Raises:
        ConfigError: it has none, or one that there is not.
    """
    port = _PORT.search(endpoint)
    if is_tcp(endpoint) and port is None:
        raise ConfigError(f"{key} is {endpoint}, without a port: tcp://HOST:PORT")
    if is_tcp(endpoint) and port is not None and port[1] != "*" and int(port[1]) > _LARGEST_PORT:
        raise ConfigError(f"{key} is {endpoint}; ports go up to {_LARGEST_PORT}")


def check_reach(key: str, endpoint: str, *, bus_keys: str, bus_open: bool) -> None:
    """Whether a bus may listen, or be looked for, at an endpoint.

    Args:
        key: where the endpoint stands, such as ``bus_publish``.
        endpoint: the endpoint.
        bus_keys: the folder of keys; empty for none.
        bus_open: whoever configured it trusts everyone who reaches the port.

    Raises:
        ConfigError: see :func:`check_port`; or other machines reach it, there are no keys, and nobody
            has said that this is meant.
    """
    if bus_keys and bus_open:
        raise ConfigError("bus_keys and bus_open contradict each other: leave one of them out")
    check_port(key, endpoint)
    if is_tcp(endpoint) and not is_loopback(endpoint) and not bus_keys and not bus_open:
        raise ConfigError(
            f"{key} is {endpoint}, which other machines reach, and bus_keys names no keys; make some "
            "(`flora-bus --make-bus-keys`), or say bus_open = true where everyone may light the lamps"
        )


def client_keys(folder: Path) -> ClientKeys:
    """What this machine shows to a bus, and knows it by.

    Raises:
        ConfigError: a file is missing, is no key, or a secret that others can read.
    """
    return ClientKeys(read_pair(folder, CLIENT), read_public(folder / f"{BUS}{PUBLIC_SUFFIX}"))


def protect_client(socket: zmq.Socket[Any], keys: ClientKeys) -> None:
    """Encrypt what a socket says and hears at the endpoints that it connects to from now on."""
    socket.setsockopt(zmq.CURVE_PUBLICKEY, keys.own.public)
    socket.setsockopt(zmq.CURVE_SECRETKEY, keys.own.secret)
    socket.setsockopt(zmq.CURVE_SERVERKEY, keys.bus)


def read_pair(folder: Path, name: str) -> KeyPair:
    """``<name>.key`` of a folder, which nobody but its owner can read.

    Raises:
        ConfigError: missing, open to others, not a certificate with a secret key, or its halves do not belong together.
    """
    path = folder / f"{name}{SECRET_SUFFIX}"
    text = _read(path, made_by=f"`flora-bus --make-{name}-keys` makes it", forbidden=0o077)
    public, secret = _half(_PUBLIC, text), _half(_SECRET, text)
    if public is None or secret is None or zmq.curve_public(z85.encode(secret)) != z85.encode(public):
        raise ConfigError(f"{path}: not a secret key (`flora-bus --make-{name}-keys` makes one)")
    return KeyPair(public, secret)


def read_public(path: Path) -> bytes:
    """The 32 bytes of a public key file.

    Raises:
        ConfigError: missing, not a certificate, or one that gives a secret away.
    """
    return _public(path, _read(path, made_by="copy it from the machine that it was made on", forbidden=0))


def read_authorized(folder: Path) -> dict[bytes, str]:
    """The machines that may take part: public keys and the names of their files, ``*.pub`` of a folder.

    Raises:
        ConfigError: no such folder; a file that is no public key; others than the owner can put keys there.
    """
    _need_curve()
    try:
        if folder.stat().st_mode & 0o022:
            raise ConfigError(f"{folder}: others than its owner can put keys there; chmod go-w {folder}")
        paths = sorted(path for path in folder.iterdir() if path.suffix == PUBLIC_SUFFIX)
    except FileNotFoundError as problem:
        raise ConfigError(f"{folder}: is not there (`flora-bus --make-bus-keys` makes it)") from problem
    except OSError as problem:
        raise ConfigError(f"{folder}: cannot be read ({problem.strerror})") from problem
    return {_public(path, _read(path, made_by="is it a broken link?", forbidden=0o022)): path.stem for path in paths}


def make_pair(folder: Path, name: str) -> tuple[Path, Path]:
    """Make a new pair in a folder, which is made where it is missing.

    Args:
        folder: ``bus_keys`` of ``[rig]``.
        name: :data:`BUS` or :data:`CLIENT`.

    Returns:
        The secret file, readable by its owner alone, and the public one.

    Raises:
        BadInput: there is one already, or the folder cannot be written.
    """
    _need_curve()
    secret_path, public_path = folder / f"{name}{SECRET_SUFFIX}", folder / f"{name}{PUBLIC_SUFFIX}"
    for path in (secret_path, public_path):
        if path.exists() or path.is_symlink():
            raise BadInput(f"{path}: is there already and is not replaced; move it away to make a new pair")
    public, secret = (half.decode("ascii") for half in zmq.curve_keypair())
    whose = "the bus" if name == BUS else "one machine on the bus"
    try:
        make_folder(folder)
        write_bytes(public_path, _certificate(f"Public key of {whose}, for the others.", public).encode())
        try:
            text = _certificate(f"SECRET key of {whose}: it stays where it was made.", public, secret)
            write_bytes(secret_path, text.encode(), mode=SECRET_MODE)
        except BaseException:
            public_path.unlink()  # half a pair is none
            raise
    except OSError as problem:
        raise BadInput(f"{folder}: cannot be written ({problem.strerror})") from problem
    return secret_path, public_path


def make_authorized(folder: Path) -> Path:
    """The folder for the public keys of those who may take part, which its owner alone can add to.

    Raises:
        BadInput: it cannot be made.
    """
    path = folder / AUTHORIZED
    try:
        if not path.is_dir():
            make_folder(path)
            path.chmod(0o755)
    except OSError as problem:
        raise BadInput(f"{path}: cannot be made ({problem.strerror})") from problem
    return path


def _certificate(comment: str, public: str, secret: str = "") -> str:
    more = f'    secret-key = "{secret}"\n' if secret else ""
    return f'# {comment}\nmetadata\ncurve\n    public-key = "{public}"\n{more}'


def _need_curve() -> None:
    if not zmq.has("curve"):
        raise ConfigError("this ZeroMQ was built without CURVE; install pyzmq from a wheel (`pip install pyzmq`)")


def _read(path: Path, *, made_by: str, forbidden: int) -> str:
    """A key file's text; ``forbidden`` are the rights that nobody but its owner may have."""
    _need_curve()
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            # Asked of the open file: between a look at a name and its opening another file may take the name.
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST_KEY_FILE:
                raise ConfigError(f"{path}: not a key file")
            if status.st_mode & forbidden:
                verb, chmod = ("use", "600") if forbidden & 0o044 else ("change", "go-w")
                raise ConfigError(f"{path}: others than its owner can {verb} this key; chmod {chmod} {path}")
            return os.read(descriptor, LARGEST_KEY_FILE).decode("utf-8", "replace")
        finally:
            os.close(descriptor)
    except FileNotFoundError as problem:
        raise ConfigError(f"{path}: is not there; {made_by}") from problem
    except OSError as problem:
        raise ConfigError(f"{path}: cannot be read ({problem.strerror})") from problem


def _public(path: Path, text: str) -> bytes:
    if _SECRET.search(text):
        raise ConfigError(f"{path}: holds a secret key, which stays where it was made; put its *{PUBLIC_SUFFIX} here")
    public = _half(_PUBLIC, text)
    if public is None:
        raise ConfigError(f"{path}: not a public key (a file *{PUBLIC_SUFFIX} as flora-bus makes them)")
    return public


def _half(pattern: re.Pattern[str], text: str) -> bytes | None:
    """The one key of its kind in a certificate; None where there is not exactly one, or it is no key."""
    found = pattern.findall(text)
    if len(found) != 1 or len(found[0]) != 40:
        return None
    try:
        return bytes(z85.decode(found[0]))
    except (KeyError, ValueError, struct.error):
        return None
