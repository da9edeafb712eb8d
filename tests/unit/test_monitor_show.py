"""What the monitor shows, and whom it misses."""

from __future__ import annotations

from flora_common.health import services_of_catalogue
from flora_common.messages import ControllerChunk, LightCommand
from flora_monitor.show import compact


def test_a_piece_of_a_file_is_counted_and_a_sentence_is_shown() -> None:
    chunk = ControllerChunk(offer="0123456789abcdef", number=2, data="A" * 20_000)

    assert compact(chunk) == "offer=0123456789abcdef number=2 data=[20000 characters]"
    assert compact(LightCommand(light="left", reason="x " * 250)).endswith('"' + "x " * 250 + '"')


def test_a_rig_is_well_without_the_lab() -> None:
    services = services_of_catalogue()

    assert "flora-lab" not in services
    assert "flora-controller" in services
