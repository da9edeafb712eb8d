"""The flash lamp of the virtual grow box."""

from __future__ import annotations

from flora_common.twin_link import TwinLink


class VirtualLamp:
    """Asks the box, which tells what its lamp really does.

    Args:
        address: the box's endpoint.
        timeout_s: real seconds to wait for an answer.
    """

    excuse = "the lamp of the virtual grow box does not follow"

    def __init__(self, address: str, *, timeout_s: float = 5.0) -> None:
        self._link = TwinLink(address, timeout_s=timeout_s)

    def switch(self, on: bool) -> bool:
        return self._link.ask("flash", on=on).get("on") is True

    def close(self) -> None:
        self._link.close()
