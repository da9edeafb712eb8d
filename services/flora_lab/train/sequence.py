"""``--recipe sequence``, the default: a law with memory (:mod:`flora_lab.simulator.neural_law`) learned from free runs.

Then what happens by chance is measured about it, and every plant is foretold, from its first stem on, by the member
that never saw it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import Array, BoolArray
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.individual import Observed, Prior
from flora_lab.simulator.interface import run as run_free
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.neural_law import TRAITS, NeuralLaw
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.store import software
from flora_lab.simulator.tropism_traits import VIGOUR
from flora_lab.threads import one_blas_thread
from flora_lab.train.checkpoint import Checkpoint
from flora_lab.train.curve import curve_png
from flora_lab.train.growing import range_of, trained, usable
from flora_lab.train.population import noise_about
from flora_lab.train.recipes import Progress, Trained, TrainOptions
from flora_lab.train.sequence_fit import SequenceSettings, SequenceTraining
from flora_lab.train.windows import tracks_of

NAME: Final = "sequence"
HORIZONS_H: Final = (1, 6, 24)
MM_PER_CM: Final = 10.0


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Free runs of plants from their first stem, by the member that never learned from them.

    The same plants chose which epoch of the member is kept: a little too good.

    Attributes:
        horizons: names such as ``6h``, and ``end``.
        tip_mm, still_mm: error of the tip, and that of a stem that does not move, shape (runs, horizons); NaN where a
            run is shorter or no stem was measured.
    """

    horizons: tuple[str, ...]
    tip_mm: Array
    still_mm: Array


def train(runs: list[RunTrack], options: TrainOptions, progress: Progress) -> Trained:
    """Learn from measured runs.

    Raises:
        BadInput: runs that are too short, or rows to be shuffled: this recipe never splits a plant.
    """
    if options.split == "rows":
        raise BadInput("--split rows: the sequence recipe holds out whole plants only; leave the option out")
    measured = usable(runs)
    settings = _settings(options)
    tracks = tracks_of(measured, mirror=settings.mirror)
    work = {
        "recipe": NAME,
        "tracks": [run.sha256 for run in measured],
        "plants": [run.plant for run in measured],
        "seed": options.seed,
        "settings": asdict(settings),
        "software": software(),
    }
    training = SequenceTraining(tracks, settings, options.seed)
    curve = training.run(Checkpoint(options.checkpoint, work), progress, resume=options.resume)
    zone_cm = float(np.exp(training.net.log_zone.detach().cpu().numpy()).mean())
    law = NeuralLaw(training.net.law_weights(), zone_cm)

    progress.stage("measuring what happens by chance")
    prior = Prior(np.zeros(len(TRAITS)), prior_spread())
    with one_blas_thread():
        noise = noise_about([Observed(run, law) for run in measured], prior)
    simulator = SequenceSimulator(law, prior, noise, range_of(measured), measured[0].step_s)
    judged = judge(simulator, measured, training.held, tracks.plant[: len(measured)])
    return trained(
        simulator,
        measured,
        recipe=NAME,
        seed=options.seed,
        split=_split(training.held),
        settings=asdict(settings),
        results={
            "epochs": len(curve.train),
            "best_epoch_of_member": curve.best_epoch,
            "held_out_tip_mm": _medians(judged.horizons, judged.tip_mm),
            "held_out_nothing_moves_mm": _medians(judged.horizons, judged.still_mm),
        },
        figures={"training.png": curve_png(curve.train, curve.validate, curve.best_epoch, unit="loss of free runs")},
        table=_table(judged, simulator.noise, len(curve.train), curve.best_epoch),
    )


def prior_spread() -> Array:
    """Covariance of the traits between plants before any data, shape (4, 4): early and late growth go together."""
    spread = np.eye(len(TRAITS))
    spread[0, 1] = spread[1, 0] = VIGOUR
    return spread


def judge(simulator: SequenceSimulator, runs: Sequence[MeasuredRun], held: BoolArray, plant: Array) -> HeldOut:
    """Foretell each run from its first stem by the members that never saw its plant.

    Args:
        simulator: all members.
        runs: in the order of ``plant``.
        held: which plants each member never saw, shape (members, plants).
        plant: index of each run's plant.
    """
    members = simulator.members() or [simulator]
    names = (*(f"{hours}h" for hours in HORIZONS_H), "end")
    tip = np.full((len(runs), len(names)), np.nan)
    still = tip.copy()
    for i, run in enumerate(runs):
        rows = [round(3600.0 * hours / run.step_s) for hours in HORIZONS_H] + [len(run) - 1]
        inside = [k for k, row in enumerate(rows) if row < len(run)]
        at = [rows[k] for k in inside]
        measured = run.points_cm[at, -1]
        still[i, inside] = MM_PER_CM * np.hypot(*(measured - run.points_cm[0, -1]).T)
        told = []
        for m in np.nonzero(held[:, plant[i]])[0]:
            member = members[m]
            stems = run_free(member, member.start(run.points_cm[:1]), run.light[:, None], run.step_s)
            told.append(MM_PER_CM * np.hypot(*(stems[np.array(at) - 1, 0, -1] - measured).T))
        if told:
            tip[i, inside] = np.mean(told, axis=0)
    return HeldOut(names, tip, still)


def _settings(options: TrainOptions) -> SequenceSettings:
    usual = SequenceSettings()
    return replace(
        usual,
        epochs=options.epochs or usual.epochs,
        patience=options.patience or usual.patience,
        windows=options.batch or usual.windows,
    )


def _split(held: BoolArray) -> str:
    if not held.any():
        return "fewer than three plants: none could be held out"
    counts = ", ".join(str(int(count)) for count in held.sum(axis=1))
    return f"each of {len(held)} members learned without some whole plants ({counts} of {held.shape[1]})"


def _medians(horizons: Sequence[str], values: Array) -> dict[str, float]:
    told = {name: values[np.isfinite(values[:, k]), k] for k, name in enumerate(horizons)}
    return {name: round(float(np.median(column)), 3) for name, column in told.items() if len(column)}


def _table(judged: HeldOut, noise: DriveNoise, epochs: int, best: Sequence[int]) -> list[str]:
    lines = [f"{counted(epochs, 'epoch')}; kept of each member: {', '.join(map(str, best))}"]
    tip, still = _medians(judged.horizons, judged.tip_mm), _medians(judged.horizons, judged.still_mm)
    if tip:
        lines.append("free run from the first stem, by members that never saw the plant; median error of the tip, mm")
        lines.append(f"{'':<18}" + "".join(f"{name:>8}" for name in tip))
        lines.append(f"{'simulated':<18}" + "".join(f"{value:>8.1f}" for value in tip.values()))
        lines.append(f"{'nothing moves':<18}" + "".join(f"{still[name]:>8.1f}" for name in tip))
    else:
        lines.append("fewer than three plants: no error on plants that were never seen can be told")
    lines.append(
        f"by chance: growth {100.0 * noise.growth_share:.0f} % over {noise.growth_h:.0f} h, daily rhythm "
        f"{100.0 * noise.rhythm_share:.0f} %, circumnutation of {noise.nutation_period_min:.0f} min"
    )
    return lines
