"""flora-dashboard: hear everything of the rig, and show it to whoever opens the page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from flora_common.app import App
from flora_common.bus import Arrival
from flora_common.errors import BadRunFolder
from flora_common.messages import Frame, Stem
from flora_common.runs import RunFile
from flora_common.service import run_service
from flora_dashboard.board import Board, as_json
from flora_dashboard.history import History
from flora_dashboard.photographs import Photographs
from flora_dashboard.section import DashboardSection
from flora_dashboard.server import PageServer, listen, url_of
from flora_dashboard.web import make_app

SHOWN_WITHIN_S: Final = 0.3
"""What is heard together is shown together."""
SHOWN_EVERY_S: Final = 5.0
"""Ages grow when nothing is heard, too."""


def build(app: App[DashboardSection]) -> None:
    listener = listen(app.config.host, app.config.port)
    run_file, without = _run_file(app)
    history = History(run_file.target_or_none() if run_file else None)
    try:
        history.read(app.run)
    except BadRunFolder as problem:
        app.log.warning("track_not_read", reason=str(problem))
    board = Board(
        app.rig.name,
        app.run.name,
        run_file,
        without,
        clock=app.clock,
        history=history,
        health_every_s=app.rig.health_every_s,
        ages_are_known=app.rig.has_own_clock,
    )
    photographs = Photographs(app.run.path)
    server = PageServer(
        listener,
        lambda latest: make_app(
            latest,
            photographs,
            lambda number: as_json(history.since(number)),
            most_viewers=app.config.viewers,
        ),
    )
    own = {"", *app.run.names}
    is_live = False
    is_due = False

    def show() -> None:
        nonlocal is_due
        is_due = False
        server.tell(as_json(board.view(real_s=time.monotonic(), is_connected=app.bus.connected)))

    def hear(arrival: Arrival) -> None:
        nonlocal is_due
        message = arrival.message
        if message is None or arrival.verdict != "good" or arrival.rig != app.rig.name:
            return
        # The bus keeps the last ones of the run before: neither picture nor stem is of this run's plant.
        if isinstance(message, Frame | Stem) and message.run not in own:
            return
        board.hear(message, real_s=time.monotonic(), is_live=is_live)
        if isinstance(message, Frame):
            photographs.announce(message)
        if not is_due:
            is_due = True
            app.after(SHOWN_WITHIN_S, show)

    def all_kept_are_heard() -> None:
        nonlocal is_live
        is_live = True
        app.log.event("shown", url=url_of(listener))

    server.start()
    show()
    app.on_raw(hear)
    app.on_ready(all_kept_are_heard)
    app.every(SHOWN_EVERY_S, show)
    app.every(SHOWN_EVERY_S, lambda: app.trouble("page", server.check()))
    app.on_exit(server.stop)


def _run_file(app: App[DashboardSection]) -> tuple[RunFile | None, str]:
    """The run's own file; or why there is none: the page then shows what the bus tells."""
    try:
        return app.run.read_run_file(), ""
    except BadRunFolder as problem:
        app.log.warning("no_run_file", reason=str(problem))
        return None, f"Without run.toml there is no scale, target or obstacle: {problem}"


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-dashboard",
        DashboardSection,
        build,
        argv=argv,
        description="Show the rig in a browser: photograph, stem, lamps, charts, health.",
    )
