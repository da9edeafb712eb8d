"""What holds for every simulated plant, whatever it was learned with; each kind's tests call :func:`check_contract`."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.geometry import polyline_length
from flora_common.shapes import STEM_POINTS
from flora_lab.simulator.interface import Chance, History, Simulator, run
from flora_lab.simulator.measured import MeasuredRun, side_by_side

LEFT, RIGHT = (1.0, 0.0), (0.0, 1.0)


class Contract:
    """The checks, on stems and histories of measured runs.

    Args:
        simulator: whom.
        runs: at least three, as long as each other, in the simulator's step.
        start_cm: how far a started stem may lie from the one that was given.
        watch_cm: how far a watched stem may lie from the last one seen.
        shrink_cm: by how much a stem may get shorter in a step.
        merged_cm: how far two steps and one twice as long may differ.
        hours: of the long run.
    """

    def __init__(
        self,
        simulator: Simulator[Any],
        runs: Sequence[MeasuredRun],
        *,
        start_cm: float,
        watch_cm: float,
        shrink_cm: float,
        merged_cm: float,
        hours: float = 72.0,
    ) -> None:
        assert len(runs) >= 3
        self.simulator, self.runs, self.hours = simulator, runs, hours
        self.start_cm, self.watch_cm, self.shrink_cm, self.merged_cm = start_cm, watch_cm, shrink_cm, merged_cm
        self.batch = side_by_side(runs)
        self.points = self.batch.points_cm[0]
        count = len(runs)
        steps = np.arange(24)
        # every plant under lamps of its own
        self.light = np.stack(
            [np.where((steps // (3 + i) % 2 == 0)[:, None], LEFT, RIGHT) for i in range(count)], axis=1
        )

    def history(self, rows: int, plants: Sequence[int] | None = None) -> History:
        """The first rows of some runs."""
        chosen = list(range(len(self.runs)) if plants is None else plants)
        covariates = {name: values[: rows - 1, chosen] for name, values in self.batch.covariates.items()}
        points = self.batch.points_cm[:rows, chosen]
        return History(points, self.batch.light[: rows - 1, chosen], self.batch.step_s, covariates)

    def beginnings(self) -> dict[str, Callable[[Sequence[int]], Any]]:
        """Ways to a state, each for any choice of plants."""
        seeds = np.arange(len(self.runs)) + 40
        return {
            "start": lambda plants: self.simulator.start(self.points[list(plants)]),
            "start by chance": lambda plants: self.simulator.start(
                self.points[list(plants)], Chance(seeds[list(plants)])
            ),
            "watch": lambda plants: self.simulator.watch(self.history(25, plants)),
            "watch one stem": lambda plants: self.simulator.watch(self.history(1, plants)),
        }

    def simulate(self, state: Any, plants: Sequence[int]) -> FloatArray:
        """Stems under the lamps of these plants, the one at the beginning first."""
        first = self.simulator.stems_cm(state)
        after = run(self.simulator, state, self.light[:, list(plants)], self.simulator.step_s)
        return np.concatenate([first[None], after])

    def check_shapes(self) -> None:
        """Stems are finite stems that stand in their anchor; what is beyond the data is told for each plant."""
        every = range(len(self.runs))
        for way, begin in self.beginnings().items():
            state = begin(every)
            stems = self.simulate(state, every)
            assert stems.shape == (len(self.light) + 1, len(self.runs), STEM_POINTS, 2), way
            assert np.isfinite(stems).all(), way
            assert (stems[:, :, 0] == 0.0).all(), f"{way}: the anchor moves"
            beyond = self.simulator.is_beyond_data(state)
            assert beyond.shape == (len(self.runs),), way
            assert beyond.dtype == np.bool_, way

    def check_where_it_begins(self) -> None:
        """A plant begins as the stem that was given, or the last one that was seen."""
        started = self.simulator.stems_cm(self.simulator.start(self.points))
        assert np.abs(started - self.points).max() <= self.start_cm
        for rows in (1, 2, 25):
            watched = self.simulator.stems_cm(self.simulator.watch(self.history(rows)))
            assert np.abs(watched - self.batch.points_cm[rows - 1]).max() <= self.watch_cm, f"{rows} rows"

    def check_batches(self) -> None:
        """A plant alone, and in any batch and order, is the same plant to the last bit."""
        count = len(self.runs)
        for way, begin in self.beginnings().items():
            together = self.simulate(begin(range(count)), range(count))
            for plants in ([0], [count - 1], [count - 1, 0], [*range(count)][::-1]):
                alone = self.simulate(begin(plants), plants)
                assert alone.tobytes() == together[:, plants].tobytes(), f"{way}: plants {plants} of {count}"

    def check_nothing_is_changed(self) -> None:
        """Neither the state nor what was handed over is written to; the same step twice is the same."""
        every = range(len(self.runs))
        light = self.light[0]
        given = [self.points, light, *vars_of(self.history(25))]
        before = pickle.dumps(given)
        for way, begin in self.beginnings().items():
            state = begin(every)
            kept = pickle.dumps(state)
            one, first = self.simulator.step(state, light, self.simulator.step_s)
            then = pickle.dumps(one)
            first_bytes = first.tobytes()
            first += 1.0  # whoever asked may do with the stems what they like
            _, second = self.simulator.step(state, light, self.simulator.step_s)
            self.simulator.stems_cm(state)[:] = 7.0
            self.simulator.is_beyond_data(state)
            assert second.tobytes() == first_bytes, f"{way}: the same step is another the second time"
            assert pickle.dumps(state) == kept, f"{way}: a step changes the state that it is from"
            assert pickle.dumps(one) == then, f"{way}: the state holds the stems that were handed out"
            assert self.simulator.stems_cm(one).tobytes() == first_bytes, f"{way}: stems are not those of the state"
        assert pickle.dumps(given) == before, "what was handed over is changed"

    def check_long_run(self) -> None:
        """Three days without a number that is none, and without a stem that gets shorter."""
        every = range(len(self.runs))
        steps = round(self.hours * 3600.0 / self.simulator.step_s)
        for way, begin in self.beginnings().items():
            for name, period in (("left", None), ("six hours", round(6 * 3600 / self.simulator.step_s))):
                lamps = np.array([LEFT if period is None or k // period % 2 == 0 else RIGHT for k in range(steps)])
                light = np.repeat(lamps[:, None], len(self.runs), axis=1)
                stems = run(self.simulator, begin(every), light, self.simulator.step_s)
                assert np.isfinite(stems).all(), f"{way}, {name}"
                shrinks = -np.diff(polyline_length(stems), axis=0).min()
                assert shrinks <= self.shrink_cm, f"{way}, {name}: a stem gets {shrinks:g} cm shorter in a step"

    def check_steps_of_time(self) -> None:
        """Twice the step is two steps; half of it is taken or refused; time does not stand still or go back."""
        every = range(len(self.runs))
        step_s, light = self.simulator.step_s, self.light[0]
        for way, begin in self.beginnings().items():
            state = begin(every)
            half_way, _ = self.simulator.step(state, light, step_s)
            _, twice = self.simulator.step(half_way, light, step_s)
            _, once = self.simulator.step(state, light, 2.0 * step_s)
            assert np.abs(once - twice).max() <= self.merged_cm, way
        state = self.simulator.start(self.points)
        try:
            _, stems = self.simulator.step(state, light, step_s / 2.0)
        except BadInput:
            pass
        else:
            assert np.isfinite(stems).all()
        for wrong in (0.0, -step_s, float("nan"), float("inf")):
            with pytest.raises(BadInput):
                self.simulator.step(state, light, wrong)

    def check_covariates(self) -> None:
        """Covariates that nobody knows change nothing."""
        every = range(len(self.runs))
        more = {"moon_phase": np.linspace(0.0, 1.0, len(self.runs))}
        for way, begin in self.beginnings().items():
            state = begin(every)
            _, without = self.simulator.step(state, self.light[0], self.simulator.step_s)
            _, beside = self.simulator.step(state, self.light[0], self.simulator.step_s, more)
            assert beside.tobytes() == without.tobytes(), way
        history = self.history(25)
        moons = {**history.covariates, "moon_phase": np.zeros((24, len(self.runs)))}
        with_moon = History(history.points_cm, history.light, history.step_s, moons)
        seen, seen_moon = (self.simulator.stems_cm(self.simulator.watch(h)) for h in (history, with_moon))
        assert seen.tobytes() == seen_moon.tobytes()

    def check_gaps(self) -> None:
        """A history in which stems are missing can be watched, and what follows is finite."""
        history = self.history(25)
        points = history.points_cm.copy()
        points[3:9, 0] = np.nan
        points[1:24, 1] = np.nan
        state = self.simulator.watch(History(points, history.light, history.step_s, history.covariates))
        stems = self.simulate(state, range(len(self.runs)))
        assert np.isfinite(stems).all()
        assert np.abs(stems[0] - points[-1]).max() <= self.watch_cm


def vars_of(history: History) -> list[Any]:
    """All that a history holds."""
    return [history.points_cm, history.light, dict(history.covariates)]


def check_contract(
    simulator: Simulator[Any],
    runs: Sequence[MeasuredRun],
    *,
    start_cm: float = 1e-9,
    watch_cm: float = 1e-9,
    shrink_cm: float = 1e-9,
    merged_cm: float = 1e-9,
    hours: float = 72.0,
) -> None:
    """All checks; see :class:`Contract` for what the tolerances mean."""
    contract = Contract(
        simulator,
        runs,
        start_cm=start_cm,
        watch_cm=watch_cm,
        shrink_cm=shrink_cm,
        merged_cm=merged_cm,
        hours=hours,
    )
    contract.check_shapes()
    contract.check_where_it_begins()
    contract.check_batches()
    contract.check_nothing_is_changed()
    contract.check_long_run()
    contract.check_steps_of_time()
    contract.check_covariates()
    contract.check_gaps()
