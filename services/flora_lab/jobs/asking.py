"""Asks a lab for a job over the bus, and follows it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import zmq

from flora_common.bus import BusClient
from flora_common.clock import FollowerClock
from flora_common.config import RigSection
from flora_common.errors import BusUnreachable
from flora_common.messages import Job, JobProgress
from flora_lab.jobs.rules import OVER

SOURCE: Final = "flora-lab"
POLL_S: Final = 0.1
ASK_EVERY_S: Final = 1.0
"""Until the lab has answered."""
ASK_SLOWLY_EVERY_S: Final = 20.0
"""From then on: a lab that was started anew says so."""


def ask(
    job: Job,
    rig: RigSection,
    *,
    follows: bool,
    timeout_s: float,
    told: Callable[[JobProgress], None] = lambda _: None,
) -> JobProgress:
    """Ask for a job until the lab has it, or until it is over.

    Args:
        job: what is asked.
        rig: where the bus is, and under whose name the lab hears.
        follows: wait for its end.
        timeout_s: so long for the first answer.
        told: called with every word about it.

    Returns:
        The last word about it.

    Raises:
        BusUnreachable: no bus, or no lab that takes jobs.
    """
    client = BusClient(rig.bus, rig=rig.name, source=SOURCE, clock=FollowerClock(0.0))
    client.subscribe(JobProgress)
    poller = zmq.Poller()
    poller.register(client.subscriber, zmq.POLLIN)
    poller.register(client.publisher, zmq.POLLIN)
    began_s = time.monotonic()
    asked_s: float | None = None
    last: JobProgress | None = None
    try:
        client.connect()
        while last is None or (follows and last.stage not in OVER):
            poller.poll(round(POLL_S * 1000))
            client.handle_publisher()
            for _, message in client.receive():
                # What the bus had kept before anything was asked is no answer.
                if asked_s is not None and isinstance(message, JobProgress) and message.job == job.job:
                    last = message
                    told(message)
            now_s = time.monotonic()
            if last is None and now_s - began_s > timeout_s:
                raise BusUnreachable(client.hindrance or _nobody(rig, is_connected=client.connected))
            every_s = ASK_EVERY_S if last is None else ASK_SLOWLY_EVERY_S
            if client.connected and (asked_s is None or now_s - asked_s >= every_s):
                client.publish(job)
                asked_s = now_s
    finally:
        client.close()
    return last


def _nobody(rig: RigSection, *, is_connected: bool) -> str:
    if not is_connected:
        return f"no bus answers at {rig.bus_subscribe}; is flora-bus running?"
    return (
        f"no lab takes jobs for rig `{rig.name}` on this bus; is `flora-lab serve` running, with a jobs_dir in [lab]?"
    )
