"""flora-bus: start the proxy, and be its first customer: READY is said when our own hello has come back through it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import zmq

from flora_bus.broker import Broker, BrokerCounters
from flora_bus.guard import Guard
from flora_bus.network import LOOK_EVERY_S, Network, allow_descriptors
from flora_common.app import App
from flora_common.bus import BusAddress
from flora_common.bus_keys import (
    AUTHORIZED,
    BUS,
    CLIENT,
    check_reach,
    is_tcp,
    make_authorized,
    make_pair,
    read_authorized,
    read_pair,
)
from flora_common.config import RigSection
from flora_common.errors import BusUnreachable, ConfigError
from flora_common.files import make_folder
from flora_common.lock import AlreadyHeld, hold
from flora_common.service import Action, run_service

NetworkEndpoint = Annotated[
    str,
    msgspec.Meta(
        pattern=r"^(tcp://.+)?$(?!\n)", max_length=256, extra={"words": "an address such as tcp://*:5571, or empty"}
    ),
]


class BusSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[bus]``: where other machines find the bus; where the rig's own services do stands in ``[rig]``."""

    network_publish: NetworkEndpoint = ""
    """Where it also hears, such as ``tcp://*:5571``: other machines, with keys (``bus_keys``); empty for nowhere."""

    network_subscribe: NetworkEndpoint = ""
    """Where it also says, such as ``tcp://*:5572``; to be given together with the other."""


def hold_socket(endpoint: str) -> None:
    """Keep other buses away from an ``ipc://`` endpoint until this process ends.

    ZeroMQ takes a socket's file away from whoever listens there and makes its own: both buses would run on, the first
    one unheard. The lock beside it is never let go of by hand, because ZeroMQ still removes the file after closing.

    Raises:
        ConfigError: another bus listens there, or its folder cannot be written.
    """
    path = endpoint.removeprefix("ipc://")
    if path == endpoint or path.startswith("@"):
        return  # the kernel itself refuses a second listener
    try:
        make_folder(Path(path).parent)
        hold(Path(f"{path}.lock"))
    except AlreadyHeld as by:
        raise ConfigError(
            f"{endpoint}: already served by pid {by.pid}; stop it first, or give this rig endpoints of its own"
        ) from None
    except OSError as problem:
        raise ConfigError(f"{endpoint}: the socket's folder cannot be written ({problem.strerror})") from problem


def network_of(rig: RigSection, config: BusSection) -> BusAddress | None:
    """Where other machines find the bus; None for nowhere.

    Raises:
        ConfigError: half of it, twice the same, or open to everyone without anybody having said so.
    """
    publish, subscribe = config.network_publish, config.network_subscribe
    if not publish and not subscribe:
        return None
    if not publish or not subscribe or publish == subscribe:
        raise ConfigError("[bus] network_publish and network_subscribe: give both, with ports of their own, or neither")
    for key, endpoint in (("network_publish", publish), ("network_subscribe", subscribe)):
        check_reach(f"[bus] {key}", endpoint, bus_keys=rig.bus_keys, bus_open=rig.bus_open)
    return BusAddress(publish, subscribe)


def guard_of(rig: RigSection, network: BusAddress | None) -> Guard | None:
    """Who asks for keys; None where nobody is to, because all is within this machine or open to everyone.

    Raises:
        ConfigError: the keys cannot be used.
    """
    return Guard(Path(rig.bus_keys)) if needs_keys(rig, network) else None


def needs_keys(rig: RigSection, network: BusAddress | None) -> bool:
    """Whether whoever comes is asked for a key."""
    over_tcp = network is not None or is_tcp(rig.bus_publish) or is_tcp(rig.bus_subscribe)
    return bool(rig.bus_keys) and over_tcp


def check(rig: RigSection, config: BusSection) -> None:
    """Where other machines find the bus, and the keys that they are asked for."""
    network = network_of(rig, config)
    if needs_keys(rig, network):
        read_pair(Path(rig.bus_keys), BUS)
        read_authorized(Path(rig.bus_keys) / AUTHORIZED)


def build(app: App[BusSection]) -> None:
    rig = app.rig
    network = network_of(rig, app.config)
    hold_socket(rig.bus_publish)
    hold_socket(rig.bus_subscribe)
    guard = guard_of(rig, network)
    try:
        broker = Broker(rig.bus, guard=guard)
    except zmq.ZMQError as problem:
        raise BusUnreachable(f"cannot listen at {problem.strerror}") from problem
    if guard is not None:
        _set_up(app, guard)
    seen = BrokerCounters()
    reported = 0

    def pass_on() -> None:
        # Its own health says what went through: received is everything that came, sent what was passed on.
        broker.pass_on()
        ours, theirs = app.bus.counters, broker.counters
        ours.received += theirs.passed - seen.passed + theirs.malformed - seen.malformed
        ours.sent += theirs.passed - seen.passed
        ours.bad += theirs.malformed - seen.malformed
        seen.passed, seen.malformed = theirs.passed, theirs.malformed

    def report() -> None:
        nonlocal reported
        malformed = broker.counters.malformed
        if malformed != reported:
            app.log.warning("malformed_messages", new=malformed - reported, all=malformed)
            reported = malformed

    app.on_readable(broker.incoming, pass_on)
    app.on_readable(broker.outgoing, broker.serve_subscriptions)
    app.on_exit(broker.close)
    app.every(5.0, report)
    if network is not None:
        _open(app, Network(broker, network, guard), network, guard)


def _open(app: App[BusSection], door: Network, network: BusAddress, guard: Guard | None) -> None:
    def look() -> None:
        was_open = door.is_open
        door.look(time.monotonic())
        if door.is_open and not was_open:
            asks = guard is not None
            app.log.event("network", publish=network.publish, subscribe=network.subscribe, asks_for_keys=asks)
        app.trouble("network", door.problem)

    allow_descriptors()
    look()
    app.every(LOOK_EVERY_S, look)


def _set_up(app: App[BusSection], guard: Guard) -> None:
    def answer() -> None:
        guard.answer()
        app.trouble("authorized", guard.problem)

    def report() -> None:
        if guard.problem:  # it may be mended, and the next machine may come in days
            guard.read()
            app.trouble("authorized", guard.problem)
        refused = guard.refused
        if refused.count:
            reason = f"{refused.address} came with {refused.key}, which is not in {AUTHORIZED}/"
            # A machine that is not known yet tries every two seconds, perhaps for days: told every ten minutes.
            app.log.problem("unknown_key", f"{reason}; {refused.count} times refused so far", kind=refused.key)

    app.on_readable(guard.questions, answer)
    app.on_exit(guard.close)
    app.every(5.0, report)


def make_bus_keys(rig: RigSection, _: BusSection) -> None:
    """One shot: the bus's own pair, and the folder for the public keys of others."""
    folder = _keys_folder(rig)
    secret, public = make_pair(folder, BUS)
    authorized = make_authorized(folder)
    print(
        f"{secret} is the bus's and stays here; {public} goes to the other machines, their client.pub to {authorized}"
    )


def make_client_keys(rig: RigSection, _: BusSection) -> None:
    """One shot: the pair of a machine that takes part."""
    secret, public = make_pair(_keys_folder(rig), CLIENT)
    print(
        f"{secret} is this machine's and stays here; copy {public} to authorized/ of the bus, under this machine's name"
    )


def _keys_folder(rig: RigSection) -> Path:
    if not rig.bus_keys:
        raise ConfigError("[rig] bus_keys is not set: name there the folder that the keys are to be in")
    return Path(rig.bus_keys)


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-bus",
        BusSection,
        build,
        argv=argv,
        check=check,
        description="The message bus: XSUB/XPUB proxy with last values.",
        actions=[
            Action("--make-bus-keys", "make the keys of a bus over TCP in [rig] bus_keys, and end", make_bus_keys),
            Action("--make-client-keys", "make the keys of a machine that takes part, and end", make_client_keys),
        ],
    )
