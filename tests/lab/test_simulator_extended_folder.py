"""An extended simulator in its folder: read again it is the same plant, and what no simulator can have is told."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from extended_plants import ALL_AT_ONCE, OF_PLANTS, base, course, lit, tips, with_effect, written
from simulator_contract import RIGHT

from flora_common.errors import BadInput
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Effect
from flora_lab.simulator.load import load
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension
from flora_lab.simulator.tropism_traits import NAMES, prior_mean


def test_read_again_it_is_the_same_plant(tmp_path: Path) -> None:
    swing = Extension("circumnutation", {"period_h": 1.7, "amplitude_cm": 0.8})
    plant = base().extended([*ALL_AT_ONCE, swing])
    again = load(written(tmp_path / "sim", plant))
    assert isinstance(again, RodSimulator)
    assert again.extensions == plant.extensions == (*ALL_AT_ONCE, swing)
    assert course(again) == course(plant) != course(base())
    written(tmp_path / "twice", again)
    written(tmp_path / "plain", base())
    for file in (tmp_path / "sim").iterdir():
        assert file.read_bytes() == (tmp_path / "twice" / file.name).read_bytes()
    plain, extended = (tomllib.loads((tmp_path / name / "simulator.toml").read_text()) for name in ("plain", "sim"))
    assert extended.pop("extension")[4] == {
        "effect": "diurnal_growth",
        "parameters": {"amplitude": 0.4, "peak_h": 5.0},
        "form": 1,
    }
    plain.pop("extension", None)
    assert extended == plain  # what was fitted, and where it is from, stays as it was


def test_with_another_typical_plant_its_effects_stay(tmp_path: Path) -> None:
    moved = np.zeros(len(NAMES))
    moved[NAMES.index("growth_late_cm_per_day")] = np.log(1.5)
    plant = base().extended(ALL_AT_ONCE)
    other = plant.with_typical(moved)
    assert other.extensions == plant.extensions
    assert other.prior.mean - plant.prior.mean == pytest.approx(moved)
    assert other.without_extensions().prior.mean == pytest.approx(base().prior.mean + moved)
    again = load(written(tmp_path / "sim", other))
    assert isinstance(again, RodSimulator)
    assert course(again) == course(other) != course(plant)


def test_what_is_found_later_comes_on_top(tmp_path: Path) -> None:
    one, other = ALL_AT_ONCE[:4], [*ALL_AT_ONCE[4:], Extension("gravitropism", {"factor": 1.5})]
    again = load(written(tmp_path / "sim", base().extended(one)))
    assert isinstance(again, RodSimulator)
    assert course(again.extended(other)) == course(base().extended([*one, *other]))
    assert course(again.extended(other).without_extensions()) == course(base())
    assert again.extended([Extension("gravitropism", {"factor": 1.5})] * 2).prior.mean == pytest.approx(
        prior_mean() + 2.0 * np.log(1.5) * (np.array(NAMES) == "graviception_per_cm_h")
    )


def test_whole_numbers_and_no_form_will_do(tmp_path: Path) -> None:
    file = written(tmp_path / "sim", base()) / "simulator.toml"
    table = {**tomllib.loads(file.read_text()), "extension": [{"effect": "growth_rate", "parameters": {"factor": 1}}]}
    file.write_text(tomli_w.dumps(table))
    again = load(tmp_path / "sim")
    assert isinstance(again, RodSimulator)
    assert again.extensions == (Extension("growth_rate", {"factor": 1.0}, 0),)


@pytest.mark.parametrize("effect", [effect for effect in CATALOGUE if effect.forms and effect.where == "plant"])
def test_whatever_a_search_may_find_can_be_read_again(tmp_path: Path, effect: Effect) -> None:
    for parameter in effect.parameters:
        ends = (parameter.low, parameter.high) if parameter.is_cyclic else map(parameter.value, parameter.reach)
        for number, value in enumerate((*ends, parameter.most or parameter.high)):
            values = {other.name: other.high for other in effect.parameters} | {parameter.name: value}
            folder = tmp_path / f"{parameter.name}{number}"
            written(folder, base(), extensions=[Extension(effect.name, values, 0)])
            again = load(folder)
            assert isinstance(again, RodSimulator)
            assert again.extensions[0].parameters == values


BAD: list[tuple[Extension, str]] = [
    (Extension("gravitropsm", {"factor": 1.5}), "no effect `gravitropsm`; did you mean `gravitropism`?"),
    (Extension("camera_roll", {"angle_deg": 2.0}), "effect `camera_roll` is one of the camera: correct the data"),
    (Extension("clock_skew", {"per_hour": 0.01}), "effect `clock_skew` is one of the clock: correct the data"),
    (Extension("gravitropism"), "effect `gravitropism` lacks its parameter `factor`"),
    (Extension("circumnutation", {"period_h": 1.7}), "effect `circumnutation` lacks its parameter `amplitude_cm`"),
    (Extension("sag", {"amplitude": 0.5, "amplitud": 0.5}), "has no parameter `amplitud`; did you mean `amplitude`?"),
    (Extension("sag", {"amplitude": float("nan")}), "`amplitude` is nan; 0.2 to 2 are plausible"),
    (Extension("sag", {"amplitude": float("inf")}), "`amplitude` is inf"),
    (Extension("sag", {"amplitude": 3.2}), "`amplitude` is 3.2; 0.2 to 2 are plausible, and -0.7 to 3.08 are taken"),
    (Extension("circumnutation", {"period_h": 1.7, "amplitude_cm": 21.0}), "`amplitude_cm` is 21; 0.3 to 3 are plau"),
    (Extension("gravitropism", {"factor": 0.0}), "`factor` is 0;"),
    (Extension("gravitropism", {"factor": -1.0}), "`factor` is -1;"),
    (Extension("gravitropism", {"factor": 12.0}), "`factor` is 12;"),
    (Extension("sag", {"amplitude": 0.5}, 1), "effect `sag` has no form 1; it has 0 to 0"),
    (Extension("growth_rate", {"factor": 1.2}, -1), "effect `growth_rate` has no form -1; it has 0 to 2"),
]


@pytest.mark.parametrize(("extension", "said"), BAD)
def test_an_extension_that_no_simulator_can_have_is_told(tmp_path: Path, extension: Extension, said: str) -> None:
    folder = written(tmp_path / "sim", base(), extensions=[ALL_AT_ONCE[0], extension])
    for ask, where in (
        (lambda: load(folder), str(folder / "simulator.toml")),
        (lambda: base().extended([extension]), "extended simulator"),
    ):
        with pytest.raises(BadInput) as told:
            ask()
        assert said in str(told.value)
        assert str(told.value).startswith(f"{where}: ")
        assert "\n" not in str(told.value)


def test_a_usual_temperature_that_is_none_is_told(tmp_path: Path) -> None:
    folder = written(tmp_path / "sim", base(), scales={**base().scales(), "usual_temperature_c": "warm"})
    with pytest.raises(BadInput, match=r"scales\.usual_temperature_c is warm, not a number"):
        load(folder)


def test_values_at_the_ends_of_what_is_plausible_are_taken() -> None:
    for name in OF_PLANTS:
        ends: Sequence[dict[str, float]] = [
            {p.name: getattr(p, end) for p in BY_NAME[name].parameters} for end in ("low", "high")
        ]
        for values in ends:
            heights = tips(with_effect(name, **values), lit((2.0, RIGHT)))[:, 1]
            assert np.isfinite(heights).all()
