"""One rig on the bus: the service's own by its own connection, any other by one of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from flora_common.app import App
from flora_common.bus import BusClient
from flora_common.errors import FloraError
from flora_common.messages import ControllerState, Frame, Lamps, Message, Recording, Stem
from flora_common.messages.envelope import as_sentence
from flora_common.service import default_clock
from flora_lab.serve.section import LabSection

HEARD: tuple[type[Message], ...] = (Frame, Lamps, ControllerState, Recording, Stem)
M = TypeVar("M", bound=Message)


class RigLink:
    """Hears and says for one rig.

    Args:
        app: the service.
        rig: the rig's name.
        heard: called with each message of :data:`HEARD`.
    """

    def __init__(self, app: App[LabSection], rig: str, heard: Callable[[Message], None]) -> None:
        self._app = app
        self._heard = heard
        self._client: BusClient | None = None
        if rig == app.rig.name:
            for kind in HEARD:
                app.on(kind, heard)
            return
        named = app.rig.named(rig)
        client = BusClient(named.bus, rig=rig, source=app.name, clock=default_clock(named))
        client.subscribe(*HEARD)
        client.connect()
        app.attend(client, client.handle_publisher)
        app.on_readable(client.subscriber, self._receive)
        app.on_exit(client.close)
        self._client = client

    @property
    def is_connected(self) -> bool:
        """Whether what is said now goes out."""
        return (self._client or self._app.bus).connected

    def say(self, message: Message) -> None:
        """Under the rig's own name."""
        (self._client or self._app.bus).publish(message)

    def _receive(self) -> None:
        assert self._client is not None
        for _, message in self._client.receive():
            try:
                self._heard(message)
            except FloraError as problem:
                self._app.trouble("heard", as_sentence(str(problem)))
            else:
                self._app.trouble("heard", "")
