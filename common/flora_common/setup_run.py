"""Whether a setup run goes on: it says so four times a minute, and one that is silent has ended without a word."""

from __future__ import annotations

from typing import Final

from flora_common.bus import Freshness
from flora_common.messages import Setup

SETUP_LEASE_S: Final = 60.0
"""A setup run that has said nothing for so long is over."""


def running(inbox: Freshness) -> Setup | None:
    """What the setup run asked for last; None where there is none, or where it is over."""
    setup, age_s = inbox.last(Setup), inbox.age_s(Setup)
    return setup if setup is not None and age_s is not None and setup.active and age_s <= SETUP_LEASE_S else None
