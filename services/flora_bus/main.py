"""flora-bus: start the proxy, and be its first customer: READY is said when our own hello has come back through it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import zmq

from flora_bus.broker import Broker, BrokerCounters
from flora_common.app import App
from flora_common.errors import BusUnreachable, ConfigError
from flora_common.files import make_folder
from flora_common.lock import AlreadyHeld, hold
from flora_common.service import run_service


class BusSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[bus]``: nothing to set; the endpoints are in ``[rig]``, because all services need them."""


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


def build(app: App[BusSection]) -> None:
    if app.rig.bus_publish == app.rig.bus_subscribe:
        raise ConfigError(f"[rig] bus_publish and bus_subscribe are both {app.rig.bus_publish}; they must differ")
    hold_socket(app.rig.bus_publish)
    hold_socket(app.rig.bus_subscribe)
    try:
        broker = Broker(app.rig.bus)
    except zmq.ZMQError as problem:
        raise BusUnreachable(
            f"cannot listen at {app.rig.bus_publish} and {app.rig.bus_subscribe}: {problem.strerror}"
        ) from problem
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


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-bus", BusSection, build, argv=argv, description="The message bus: XSUB/XPUB proxy with last values."
    )
