"""Brings a controller file to a rig over the bus, and says in a sentence what became of it.

The one way for whoever does it: the lab on its own machine, or a command on the rig.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from typing import Final

import zmq

from flora_common.bus import BusClient
from flora_common.clock import FollowerClock
from flora_common.config import RigSection
from flora_common.controller_file import LoadedController
from flora_common.counted import counted
from flora_common.errors import BadController, BusUnreachable
from flora_common.messages import ControllerAnswer, Health
from flora_common.offering import ASK_SLOWLY_EVERY_S, Sending, offer_of

STEERS: Final = "flora-controller"
POLL_S: Final = 0.1
NOBODY_AFTER_S: Final = 10.0
"""Silence after which nobody is there."""
GONE_AFTER_S: Final = 3 * ASK_SLOWLY_EVERY_S
"""Silence of a rig that has taken the file and is only to be waited for."""

Progress = Callable[[Sending], None]


def deliver(
    loaded: LoadedController,
    rig: RigSection,
    *,
    name: str,
    source: str,
    shadow_ticks: int,
    wait_steering: bool,
    timeout_s: float,
    progress: Progress = lambda _: None,
) -> ControllerAnswer:
    """Offer a file until the rig has decided on it.

    Args:
        loaded: the file.
        rig: its name, and where its bus is.
        name: of the file, for people.
        source: who offers.
        shadow_ticks: in shadow before it steers.
        wait_steering: also wait for the end of the shadow.
        timeout_s: silence after which nobody is there.
        progress: told after everything that was heard.

    Returns:
        The rig's last answer, of whatever stage.

    Raises:
        BadController: the file is not signed.
        BusUnreachable: nobody answers; who is missing, and who is there.
    """
    if loaded.file.signature is None:
        raise BadController(f"{name}: is not signed, no rig takes it; first: flora-lab sign FILE --key KEY -o SIGNED")
    offer = offer_of(loaded.data, offer=os.urandom(8).hex(), name=name, shadow_ticks=shadow_ticks)
    # A visitor takes the rig's time from what it hears and brings none: a virtual rig's is not this machine's.
    client = BusClient(rig.bus, rig=rig.name, source=source, clock=FollowerClock(0.0))
    client.subscribe_prefixes(b"")
    poller = zmq.Poller()
    poller.register(client.subscriber, zmq.POLLIN)
    poller.register(client.publisher, zmq.POLLIN)
    there: set[tuple[str, str]] = set()
    sending = Sending(loaded.data, offer, wait_steering=wait_steering, now_s=time.monotonic())
    try:
        client.connect()
        while not sending.done:
            poller.poll(round(POLL_S * 1000))
            client.handle_publisher()
            now_s = time.monotonic()
            for at_rig, message in client.receive():
                if isinstance(message, Health):
                    there.add((at_rig, message.source))
                elif isinstance(message, ControllerAnswer) and at_rig == rig.name and sending.hear(message, now_s):
                    progress(sending)
            is_taken = sending.answer is not None and sending.answer.stage == "shadowing"
            if now_s - sending.heard_at_s > (max(timeout_s, GONE_AFTER_S) if is_taken else timeout_s):
                told = client.hindrance or _who_is_missing(rig, there, sending, is_connected=client.connected)
                raise BusUnreachable(told)
            if client.connected:
                for said in sending.due(now_s):
                    client.publish(said)
    finally:
        client.close()
    assert sending.answer is not None
    return sending.answer


def outcome(answer: ControllerAnswer, *, rig: str, name: str) -> str:
    """What became of an offer, in a sentence."""
    if answer.stage == "shadowing":
        ticks = counted(answer.shadow_ticks_left, "tick")
        return f"rig `{rig}` took {name}; `{answer.steers}` steers for {ticks} more, the new one in its shadow"
    if answer.stage == "steering":
        return f"rig `{rig}` took {name}: `{answer.steers}` steers"
    why = {"refused": "refused", "returned": "gave up"}.get(answer.stage, answer.stage)
    steers = f"; `{answer.steers}` steers" if answer.steers else ""
    return f"rig `{rig}` {why} {name}: {answer.reason}{steers}"


def as_json(answer: ControllerAnswer, *, rig: str, name: str) -> str:
    """The same for programs, as one JSON object."""
    told = ("stage", "reason", "sha256", "offer", "shadow_ticks_left", "steers")
    return json.dumps({"rig": rig, "file": name} | {key: getattr(answer, key) for key in told})


def raise_unless_taken(answer: ControllerAnswer, *, rig: str, name: str) -> None:
    """Turn an answer that says no into an error.

    Raises:
        BadController: refused, or given up since; the rig's sentence.
    """
    if answer.stage in ("refused", "returned"):
        raise BadController(outcome(answer, rig=rig, name=name))


def _who_is_missing(rig: RigSection, there: set[tuple[str, str]], sending: Sending, *, is_connected: bool) -> str:
    if not is_connected:
        return f"no bus answers at {rig.bus_subscribe}; is flora-bus running?"
    if sending.answer is not None:
        return f"{STEERS} of rig `{rig.name}` has stopped answering; it said `{sending.answer.stage}` last"
    if any(name == rig.name for name, _ in there):
        return f"{STEERS} of rig `{rig.name}` does not answer; is it running, and is it as new as this program?"
    others = sorted({name for name, _ in there})
    told = f"on this bus are: {', '.join(others[:10])}" if others else "nor any other on this bus"
    return f"rig `{rig.name}` is not heard, {told}"
