"""``[dashboard]``."""

from __future__ import annotations

from typing import Annotated

import msgspec

from flora_common.config import DASHBOARD_PORT


class DashboardSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[dashboard]``: where the page is, and for how many."""

    host: Annotated[str, msgspec.Meta(min_length=1, max_length=255)] = "127.0.0.1"
    """Address that it listens at: ``127.0.0.1`` for this machine alone, ``0.0.0.0`` for whoever reaches it. Nobody is
    asked who they are, and nothing can be changed there."""

    port: Annotated[int, msgspec.Meta(ge=0, le=65_535)] = DASHBOARD_PORT
    """0 takes a free one; the log says which."""

    viewers: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 20
    """Pages that are kept up to date at a time; one more is asked to come back later."""
