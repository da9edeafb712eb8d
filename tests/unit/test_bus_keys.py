"""Keys of a bus over TCP as files: what is made, what is refused, and where a bus may listen without any."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import zmq
import zmq.auth
from zmq.utils import z85

from flora_common.bus_keys import (
    AUTHORIZED,
    BUS,
    CLIENT,
    check_reach,
    client_keys,
    is_loopback,
    make_authorized,
    make_pair,
    read_authorized,
    read_pair,
    read_public,
)
from flora_common.config import RigSection, at_bus
from flora_common.errors import BadInput, ConfigError

pytestmark = pytest.mark.skipif(not zmq.has("curve"), reason="this libzmq was built without CURVE")


def test_a_pair_reads_back_and_zeromqs_own_tools_read_it_too(tmp_path: Path) -> None:
    secret, public = make_pair(tmp_path / "new" / "keys", CLIENT)
    assert (secret.stat().st_mode & 0o777, public.stat().st_mode & 0o777) == (0o600, 0o644)
    pair = read_pair(secret.parent, CLIENT)
    assert read_public(public) == pair.public
    assert zmq.auth.load_certificate(secret) == (z85.encode(pair.public), z85.encode(pair.secret))
    assert zmq.auth.load_certificate(public) == (z85.encode(pair.public), None)
    assert repr(pair.secret) not in repr(pair)


def test_a_pair_of_zeromqs_own_tools_is_taken(tmp_path: Path) -> None:
    public, secret = zmq.auth.create_certificates(tmp_path, "client")
    Path(public).rename(tmp_path / "client.pub")
    Path(secret).rename(tmp_path / "client.key")
    (tmp_path / "client.key").chmod(0o600)
    assert read_pair(tmp_path, CLIENT).public == read_public(tmp_path / "client.pub")


@pytest.mark.parametrize("there", ["client.key", "client.pub"])
def test_nothing_is_replaced(tmp_path: Path, there: str) -> None:
    (tmp_path / there).symlink_to(tmp_path / "nowhere")
    with pytest.raises(BadInput, match="is there already and is not replaced"):
        make_pair(tmp_path, CLIENT)
    assert [path.name for path in tmp_path.iterdir()] == [there]


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BadInput, match="file/keys: cannot be written"):
        make_pair(tmp_path / "file" / "keys", BUS)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602])
def test_a_secret_that_others_reach_is_refused(tmp_path: Path, mode: int) -> None:
    secret, _ = make_pair(tmp_path, CLIENT)
    secret.chmod(mode)
    with pytest.raises(ConfigError, match=f"others than its owner can use this key; chmod 600 {secret}"):
        read_pair(tmp_path, CLIENT)


def certificate(public: str, secret: str = "") -> str:
    return f'curve\n    public-key = "{public}"\n' + (f'    secret-key = "{secret}"\n' if secret else "")


def halves() -> tuple[str, str]:
    public, secret = zmq.curve_keypair()
    return public.decode(), secret.decode()


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("", id="empty"),
        pytest.param("\0" * 100, id="zeros"),
        pytest.param("curve", id="a word"),
        pytest.param(certificate(halves()[0]), id="public half alone"),
        pytest.param(certificate(halves()[0], halves()[1]), id="halves of two pairs"),
        pytest.param(certificate(halves()[0][:-1], halves()[1]), id="too short"),
        pytest.param(certificate("~" * 40, halves()[1]), id="not Z85"),
        pytest.param(certificate("#" * 40, "#" * 40), id="five of these are more than 32 bits"),
        pytest.param(certificate(*halves()) + certificate(*halves()), id="two pairs"),
        pytest.param(certificate("é" * 40, halves()[1]), id="not ASCII"),
    ],
)
def test_what_is_no_secret_key_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bus.key"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=r"bus\.key: not a secret key \(`flora-bus --make-bus-keys` makes one\)"):
        read_pair(tmp_path, BUS)


def test_what_is_no_file_is_refused_and_nobody_waits_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "bus.key", 0o600)
    (tmp_path / "client.key").mkdir()
    for name in (BUS, CLIENT):
        with pytest.raises(ConfigError, match="not a key file"):
            read_pair(tmp_path, name)
    with pytest.raises(ConfigError, match=r"none\.pub: is not there"):
        read_public(tmp_path / "none.pub")
    (tmp_path / "large.pub").write_bytes(b"x" * 10_001)
    with pytest.raises(ConfigError, match="not a key file"):
        read_public(tmp_path / "large.pub")


def test_what_a_client_needs_is_named_where_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"client\.key: is not there; `flora-bus --make-client-keys` makes it"):
        client_keys(tmp_path)
    make_pair(tmp_path, CLIENT)
    with pytest.raises(ConfigError, match=r"bus\.pub: is not there; copy it from the machine"):
        client_keys(tmp_path)
    _, public = make_pair(tmp_path / "rig", BUS)
    (tmp_path / "bus.pub").write_bytes(public.read_bytes())
    assert client_keys(tmp_path).bus == read_pair(tmp_path / "rig", BUS).public


def test_the_authorized_are_the_public_files_of_the_folder(tmp_path: Path) -> None:
    folder = make_authorized(tmp_path)
    _, public = make_pair(tmp_path, CLIENT)
    (folder / "lab.pub").write_bytes(public.read_bytes())
    (folder / "notes.txt").write_text("the lab is in room 3")
    assert read_authorized(folder) == {read_public(public): "lab"}


def test_a_secret_among_the_authorized_is_refused(tmp_path: Path) -> None:
    secret, _ = make_pair(tmp_path, CLIENT)
    (make_authorized(tmp_path) / "lab.pub").write_bytes(secret.read_bytes())
    with pytest.raises(ConfigError, match=r"lab\.pub: holds a secret key, which stays where it was made"):
        read_authorized(tmp_path / AUTHORIZED)


def test_a_folder_where_others_put_keys_admits_nobody(tmp_path: Path) -> None:
    folder = make_authorized(tmp_path)
    folder.chmod(0o775)
    with pytest.raises(ConfigError, match="others than its owner can put keys there; chmod go-w"):
        read_authorized(folder)
    folder.chmod(0o755)
    _, public = make_pair(tmp_path, CLIENT)
    key = folder / "lab.pub"
    key.write_bytes(public.read_bytes())
    key.chmod(0o666)
    with pytest.raises(ConfigError, match=r"lab\.pub: others than its owner can change this key; chmod go-w"):
        read_authorized(folder)


def test_without_the_folder_nobody_is_guessed(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"authorized: is not there \(`flora-bus --make-bus-keys` makes it\)"):
        read_authorized(tmp_path / AUTHORIZED)


@pytest.mark.parametrize(
    ("endpoint", "expected"),
    [
        ("tcp://127.0.0.1:5571", True),
        ("tcp://127.8.9.1:*", True),
        ("tcp://localhost:5571", True),
        ("tcp://[::1]:5571", True),
        ("tcp://*:5571", False),
        ("tcp://0.0.0.0:5571", False),
        ("tcp://[::]:5571", False),
        ("tcp://lo:5571", False),
        ("tcp://localhost.example.org:5571", False),
        ("tcp://127.0.0.1.example.org:5571", False),
        ("tcp://127.0.0.1:0;10.0.0.3:5571", False),  # ZeroMQ's way to name its own address first
        ("ipc://127.0.0.1:5571", False),
    ],
)
def test_loopback_is_what_no_other_machine_reaches(endpoint: str, expected: bool) -> None:
    assert is_loopback(endpoint) is expected


def test_a_bus_that_others_reach_needs_keys_or_a_word(tmp_path: Path) -> None:
    far = "tcp://10.0.0.3:5571"
    for near in ("ipc:///run/flora/bus-publish", "inproc://bus", "tcp://127.0.0.1:5571"):
        check_reach("bus_publish", near, bus_keys="", bus_open=False)
    check_reach("bus_publish", far, bus_keys="", bus_open=True)
    check_reach("bus_publish", far, bus_keys=str(tmp_path), bus_open=False)
    with pytest.raises(ConfigError, match=r"bus_publish is tcp://10\.0\.0\.3:5571, which other machines reach"):
        check_reach("bus_publish", far, bus_keys="", bus_open=False)


def test_an_option_is_held_to_the_same() -> None:
    far = "tcp://10.0.0.3:5571"
    with pytest.raises(ConfigError, match="bus_subscribe is tcp://10"):
        at_bus(RigSection(), publish=None, subscribe=far)
    assert at_bus(RigSection(bus_keys="/keys"), publish=None, subscribe=far).bus_subscribe == far


def test_keys_are_read_only_where_they_are_asked_for(tmp_path: Path) -> None:
    assert RigSection(bus_keys=str(tmp_path)).bus.keys is None
    with pytest.raises(ConfigError, match=r"client\.key: is not there"):
        _ = RigSection(bus_keys=str(tmp_path), bus_subscribe="tcp://127.0.0.1:5572").bus


def test_a_zeromq_without_curve_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zmq, "has", lambda _: False)
    with pytest.raises(ConfigError, match="this ZeroMQ was built without CURVE"):
        client_keys(tmp_path)
    with pytest.raises(ConfigError, match="this ZeroMQ was built without CURVE"):
        make_pair(tmp_path, BUS)
