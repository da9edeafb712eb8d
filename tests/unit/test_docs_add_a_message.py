"""The example of docs/how-to/add-a-message.md, as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from flora_common.messages import CATALOGUE, catalogue, decode, encode, envelope

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "how-to" / "add-a-message.md").read_text(encoding="utf-8")


def test_the_example_is_a_message_that_goes_over_the_bus_and_back() -> None:
    (source,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    told: dict[str, Any] = dict(vars(catalogue))
    before = set(CATALOGUE)
    try:
        exec(source, told)
        assert set(CATALOGUE) - before == {"climate"}
        said = told["Climate"](time_s=300.0, temperature_c=21.5)
        assert decode(encode("box1", said)) == ("box1", said)
    finally:
        CATALOGUE.pop("climate", None)
        envelope._BY_TYPE.pop(told.get("Climate", object), None)


def test_every_file_that_it_names_is_there() -> None:
    named = re.findall(r"`((?:common|tests|services)/[\w/.]+)`", TEXT)
    assert "tests/golden/make_messages.py" in named
    assert [name for name in named if not (ROOT / name).is_file()] == []
