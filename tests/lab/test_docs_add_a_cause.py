"""The example of docs/how-to/add-a-cause.md, as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flora_lab.effects.effect import Change, Effect
from flora_lab.simulator import sag, terms

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "add-a-cause.md"
TERM, MODULE = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_the_new_columns_come_after_those_that_are_there_and_their_neutral_values_too() -> None:
    head = TERM.split("def _pull")[0]
    told: dict[str, Any] = {"np": np, "sag": sag, "Final": None}
    exec(head, told)
    assert (told["GAIN_SWING"], told["GAIN_PEAK_H"]) == (terms.TERMS, terms.TERMS + 1)
    assert told["TERMS"] == terms.TERMS + 2
    assert told["NEUTRAL"].tolist() == [*terms.NEUTRAL.tolist(), 0.0, 0.0]


def test_the_module_is_a_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terms, "GAIN_SWING", terms.TERMS, raising=False)
    monkeypatch.setattr(terms, "GAIN_PEAK_H", terms.TERMS + 1, raising=False)
    told: dict[str, Any] = {}
    exec(MODULE, told)
    effect = told["EFFECT"]
    assert isinstance(effect, Effect)
    change = Change()
    change.terms = np.append(change.terms, [0.0, 0.0])
    values = {"amplitude": 0.4, "peak_h": 9.0}
    effect.forms[0](change, values)
    assert change.terms[-2:].tolist() == [0.4, 9.0]
    assert "40 % more and less" in effect.sentence(values)
