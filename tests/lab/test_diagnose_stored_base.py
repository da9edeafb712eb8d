"""A base on the disk: what was learned comes back to the bit, and what is damaged is told in a line."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
import tomli_w
from diagnose_runs import LAMPS, base, known

from flora_common.errors import BadInput
from flora_common.files import sha256_of_file
from flora_lab.diagnose import chance, stored_base
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.residuals import as_arrays
from flora_lab.simulator.extended import change_of
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.load import load
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension, Provenance, read_stored, write_simulator
from flora_lab.simulator.terms import NEUTRAL
from flora_lab.simulator.terms import SAG as SAG_TERM

PROVENANCE = Provenance(recipe="diagnose", seed=0, software="flora")
SAG = Extension("sag", {"amplitude": 0.7})


def simulator(usual_c: float | None = 22.5) -> RodSimulator:
    return stored_base.simulator_of(base(), LAMPS, DataRange(30.0, 10.0), usual_c)


def written(path: Path, extensions: tuple[Extension, ...] = ()) -> Path:
    stored_base.write_known(path, simulator().extended(extensions), known(), PROVENANCE)
    return path


def bits(one: Knowledge) -> dict[str, bytes]:
    arrays: dict[str, Any] = {
        "swing_per_hour": one.swings.per_hour,
        "swing_power": one.swings.power,
        "error_sizes": one.errors.sizes,
        "error_mean": one.errors.mean,
        "error_doubt": one.errors.doubt,
        "left": one.left,
        "swing_evidence": one.swing_evidence,
        "push_mean": one.pushes.mean,
        "push_doubt": one.pushes.doubt,
        "push_scatter": one.pushes.scatter,
        "cross_fit": one.cross_fit,
        **{name: getattr(one.base, name) for name in one.base.__slots__ if name != "runs"},
        **{f"shown.{name}": array for name, array in as_arrays(one.residuals).items()},
    }
    return {name: np.asarray(array, dtype=np.float64).tobytes() for name, array in arrays.items()}


def test_what_was_learned_comes_back_to_the_bit(tmp_path: Path) -> None:
    stored = read_stored(written(tmp_path / "base.simulator"))
    assert stored_base.is_known(stored)
    again = stored_base.read_known(stored)
    assert bits(again) == bits(known())
    assert again.base.runs == known().base.runs
    assert again.swings.follows == known().swings.follows


def test_written_twice_it_is_the_same_bytes(tmp_path: Path) -> None:
    there, back = written(tmp_path / "a"), written(tmp_path / "b")
    for file in there.iterdir():
        assert file.read_bytes() == (back / file.name).read_bytes()
    with pytest.raises(BadInput, match="a: is there already"):
        written(tmp_path / "a")


def test_it_is_a_simulator_whose_plants_differ(tmp_path: Path) -> None:
    plain, extended = load(written(tmp_path / "plain")), load(written(tmp_path / "extended", (SAG,)))
    assert isinstance(plain, RodSimulator)
    assert isinstance(extended, RodSimulator)
    assert plain.usual_temperature_c == 22.5
    assert extended.extensions == (SAG,)
    assert np.abs(plain.prior.mean - base().mean).max() < 1e-6
    assert np.abs(plain.prior.covariance - base().spread - base().doubt).max() < 1e-6
    # what is known of plants is the same, and the effect comes with the simulator
    there, back = (stored_base.read_known(read_stored(tmp_path / name)) for name in ("plain", "extended"))
    assert bits(there) == bits(back)
    assert plain.terms.tobytes() == NEUTRAL.tobytes()
    assert extended.terms[SAG_TERM] == pytest.approx(0.007)


def test_plants_that_were_found_to_grow_faster_are_known_to(tmp_path: Path) -> None:
    faster = Extension("growth_rate", {"factor": 1.5})
    there, back = (
        stored_base.read_known(read_stored(written(tmp_path / name, effects)))
        for name, effects in (("plain", ()), ("faster", (faster,)))
    )
    more = change_of((faster,), "here").traits
    assert np.abs(more).max() == pytest.approx(np.log(1.5))
    assert back.base.mean - there.base.mean == pytest.approx(more)


def test_chance_of_the_simulator_is_that_of_the_base() -> None:
    noise = stored_base.noise_of(base().sizes)
    named = chance.as_dict(base().sizes)
    wander = [named[name] for name in ("wander_fast_per_cm_h", "wander_per_cm_h", "wander_slow_per_cm_h")]
    assert noise.wander_per_cm_h == pytest.approx(np.sqrt(np.sum(np.square(wander))))
    assert 1.5 <= noise.wander_h <= 20.0
    assert noise.nutation_per_cm_h == named["nutation_per_cm_h"]
    assert noise.rhythm_share == named["growth_rhythm_share"]


def test_a_simulator_that_was_trained_knows_nothing_of_it(tmp_path: Path) -> None:
    plain = simulator()
    write_simulator(
        tmp_path / "rod",
        kind=plain.kind,
        step_s=plain.step_s,
        weights=plain.weights(),
        scales=plain.scales(),
        provenance=PROVENANCE,
    )
    assert not stored_base.is_known(read_stored(tmp_path / "rod"))


Weights = dict[str, np.ndarray]


def damaged(path: Path, weights: Callable[[Weights], None] = lambda _: None, **told: object) -> Path:
    """A folder whose hash is right, but in which something is not as it should be."""
    written(path)
    arrays = safetensors.numpy.load_file(path / "weights.safetensors")
    weights(arrays)
    safetensors.numpy.save_file(arrays, path / "weights.safetensors")
    table: dict[str, Any] = tomllib.loads((path / "simulator.toml").read_text())
    table["weights_sha256"] = sha256_of_file(path / "weights.safetensors")
    diagnose: dict[str, Any] = table["scales"]["diagnose"]
    for name, value in told.items():
        if value is None:
            del diagnose[name]
        else:
            diagnose[name] = value
    (path / "simulator.toml").write_text(tomli_w.dumps(table))
    return path


def without(name: str) -> Callable[[Weights], None]:
    def drop(arrays: Weights) -> None:
        del arrays[name]

    return drop


def other_shape(arrays: Weights) -> None:
    arrays["diagnose.spread"] = np.eye(3)


def of_two_runs(arrays: Weights) -> None:
    arrays["diagnose.shown.misfit"] = arrays["diagnose.shown.misfit"][:2].copy()


BAD: Mapping[str, tuple[dict[str, Any], str]] = {
    "missing": ({"weights": without("diagnose.sizes")}, "holds no `diagnose.sizes`"),
    "shown": ({"weights": without("diagnose.shown.misfit")}, "holds no `diagnose.shown.misfit`"),
    "few": ({"weights": of_two_runs}, "`diagnose.shown.misfit` is of 2 runs, at least 3 are needed"),
    "shape": ({"weights": other_shape}, "`diagnose.spread` is (3, 3); expected (9, 9)"),
    "effects": ({"causes": ["hope 0"]}, "was made by a version that knows other effects"),
    "no effects": ({"causes": None}, "was made by a version that knows other effects"),
    "runs": ({"runs": 0}, "must name `runs` and `swing_follows`"),
    "no runs": ({"runs": None}, "must name `runs` and `swing_follows`"),
    "follows": ({"swing_follows": 2.0}, "must name `runs` and `swing_follows`"),
    "words": ({"swing_follows": "much"}, "must name `runs` and `swing_follows`"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_told_in_a_line(tmp_path: Path, case: str) -> None:
    how, said = BAD[case]
    path = damaged(tmp_path / "bad.simulator", **how)
    with pytest.raises(BadInput) as told:
        stored_base.read_known(read_stored(path))
    assert said in str(told.value)
    assert "bad.simulator" in str(told.value)
    assert "\n" not in str(told.value)


def test_a_damaged_file_is_told(tmp_path: Path) -> None:
    path = written(tmp_path / "bad.simulator")
    data = bytearray((path / "weights.safetensors").read_bytes())
    data[-3] ^= 1
    (path / "weights.safetensors").write_bytes(bytes(data))
    with pytest.raises(BadInput, match=r"bad\.simulator"):
        read_stored(path)
