"""The mechanistic recipe: the constants of the tropisms, fitted to every run in free running."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.individual import Fitted, Observed, Prior
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import software
from flora_lab.simulator.tropism import TropismLaw
from flora_lab.simulator.tropism_traits import NAMES, PARAMETERS, prior_doubt, prior_mean, prior_spread
from flora_lab.stopped_work import nothing_kept
from flora_lab.threads import one_blas_thread
from flora_lab.train.checkpoint import Checkpoint
from flora_lab.train.growing import range_of, trained, usable
from flora_lab.train.population import Known, Population, first_guess, improved, mean_sd
from flora_lab.train.recipes import Progress, Trained, TrainOptions

ROUNDS: Final = 3
TOLD_SHARE: Final = 0.7
"""Tracks that leave more than this share of the doubt have not told a constant."""
FEWEST_PLANTS: Final = 5
SPLIT: Final = "none held out; judge with flora-lab rollout on runs of other plants"


def train(runs: list[RunTrack], options: TrainOptions, progress: Progress) -> Trained:
    """Fit the law's constants to measured runs: their mean and spread over plants, and what happens by chance.

    Nothing is drawn; ``seed``, ``batch``, ``patience`` and ``split`` have nothing to say. An epoch is a round of
    expectation and maximisation.

    Raises:
        BadInput: runs that are too short, or of boxes with lamps in different places; a checkpoint of other work, or
            of more rounds than are asked for.
    """
    measured = usable(runs)
    lamps = lamps_of(runs, progress)
    law = TropismLaw(lamps)
    seen = [Observed(run, law) for run in measured]
    known = Known(prior_mean(), prior_doubt(), prior_spread())
    rounds = options.epochs or ROUNDS
    work = {
        "recipe": "mechanistic",
        "tracks": [run.sha256 for run in runs],
        "lamps": [lamps.distance_cm, lamps.height_cm],
        "software": software(),
    }
    checkpoint = Checkpoint(options.checkpoint, work)
    found, done = first_guess(known), 0
    saved = checkpoint.begin(resume=options.resume)
    if saved is not None:
        found, done = _restored(saved.arrays, saved.state)
    elif options.resume:
        progress.note(nothing_kept(checkpoint.path))
    if done > rounds:
        raise BadInput(
            f"{checkpoint.path}: holds {done} rounds and {rounds} are asked for; give --epochs {done} or more, or "
            "--force in place of --resume to begin anew"
        )
    progress.begin(rounds, done)
    with one_blas_thread(), checkpoint:
        for number in range(done + 1, rounds + 1):
            found = improved(seen, known, found)
            progress.epoch(number, {"cm": _size(found.plants)})
            checkpoint.offer(*_state(found, number))
            checkpoint.flush()
    simulator = RodSimulator(lamps, found.prior, found.noise, range_of(measured), measured[0].step_s)
    residuals = {run.name: round(_size([fit]), 4) for run, fit in zip(measured, found.plants, strict=True)}
    return trained(
        simulator,
        measured,
        recipe="mechanistic",
        seed=options.seed,
        split=SPLIT,
        settings={"rounds": rounds},
        results={"free_run_residual_cm": residuals, "rounds": rounds, "not_told": _not_told(found, known)},
        figures={},
        table=_table(found, known),
    )


def lamps_of(runs: Sequence[RunTrack], progress: Progress) -> LampsSection:
    """Where the lamps of all runs hang.

    Raises:
        BadInput: not in the same places.
    """
    told = [run for run in runs if run.lamps is not None]
    for run in told:
        if run.lamps != told[0].lamps:
            raise BadInput(f"{run.file}: its lamps hang elsewhere than those of {told[0].file}; train them apart")
    if told and told[0].lamps is not None:
        return told[0].lamps
    lamps = LampsSection()
    progress.note(
        f"no run.toml tells where the lamps hang: taken to be {lamps.distance_cm:g} cm to either side, "
        f"{lamps.height_cm:g} cm high"
    )
    return lamps


def _size(fits: Sequence[Fitted]) -> float:
    return float(np.sqrt(np.mean(np.concatenate([fit.residual for fit in fits]) ** 2)))


def _state(found: Population, done: int) -> tuple[dict[str, Array], dict[str, Any]]:
    arrays = {"mean": found.prior.mean, "covariance": found.prior.covariance}
    for i, fit in enumerate(found.plants):
        arrays |= {f"{i}.traits": fit.traits, f"{i}.covariance": fit.covariance}
        arrays |= {f"{i}.information": fit.information, f"{i}.residual": fit.residual, f"{i}.jacobian": fit.jacobian}
    return arrays, {"round": done, "noise": found.noise.as_dict(), "plants": len(found.plants)}


def _restored(arrays: Mapping[str, Array], state: Mapping[str, Any]) -> tuple[Population, int]:
    fits = tuple(
        Fitted(*(arrays[f"{i}.{name}"] for name in ("traits", "covariance", "information", "residual", "jacobian")))
        for i in range(state["plants"])
    )
    prior = Prior(arrays["mean"], arrays["covariance"])
    return Population(prior, DriveNoise.from_table(state["noise"], where="checkpoint"), fits), int(state["round"])


def _not_told(found: Population, known: Known) -> list[str]:
    """Constants that the tracks say little about: what is stored is what the sources say."""
    sure = mean_sd(found, known)
    return [name for name, sd, doubt in zip(NAMES, sure, known.doubt, strict=True) if sd > TOLD_SHARE * doubt]


def _table(found: Population, known: Known) -> list[str]:
    spread, sure = np.sqrt(np.diag(found.prior.covariance)), mean_sd(found, known)
    silent = _not_told(found, known)
    lines = [f"{'constant':<26}{'typical':>9}{'sure to':>10}{'plants differ by':>18}{'before any data':>17}"]
    rows = zip(NAMES, np.exp(found.prior.mean), sure, spread, PARAMETERS, strict=True)
    for name, typical, sd, differ, before in rows:
        mark = "  not told by these runs" if name in silent else ""
        shares = f"{100.0 * sd:>8.0f} %{100.0 * differ:>16.0f} %"
        lines.append(f"{name:<26}{typical:>9.3f}{shares}{before.typical:>17.3f}{mark}")
    residuals = [f"{10.0 * _size([fit]):.1f}" for fit in found.plants]
    lines.append(f"free-run residual of each run with its own constants, mm: {', '.join(residuals)}")
    if len(found.plants) < FEWEST_PLANTS:
        runs = counted(len(found.plants), "run")
        lines.append(f"{runs}: too few to tell how plants differ; that is mostly what the sources say")
    return lines
