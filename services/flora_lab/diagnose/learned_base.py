"""The base learned from runs in which nothing is taken to be wrong, as a simulator, with where it is from."""

from __future__ import annotations

from collections.abc import Callable

from flora_common.runs import LampsSection
from flora_lab.diagnose import stored_base
from flora_lab.diagnose.cross_fit import learn_from
from flora_lab.diagnose.inputs import Runs
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Provenance, TrackEntry, software
from flora_lab.threads import one_blas_thread
from flora_lab.train.growing import range_of


def learned_base(
    told: Runs, words: str, on_round: Callable[[], None] = lambda: None
) -> tuple[RodSimulator, Knowledge, Provenance]:
    """Learn it; the lamps hang where the first run that tells it has them.

    Args:
        told: the runs.
        words: what they are, for the provenance.
        on_round: called :data:`flora_lab.diagnose.cross_fit.ROUNDS` times.
    """
    usual_c = told.usual_temperature_c()
    with one_blas_thread():
        known = learn_from(told.scenes(usual_c), lambda _: on_round())
    lamps = next((run.lamps for run in told.measured if run.lamps is not None), LampsSection())
    simulator = stored_base.simulator_of(known.base, lamps, range_of(told.measured), usual_c, known.law)
    provenance = Provenance(
        recipe="diagnose",
        seed=0,
        software=software(),
        split=f"learned from {words}; the runs that are diagnosed are others",
        track=[TrackEntry(run.name, run.plant, run.sha256) for run in told.measured if run.sha256],
    )
    return simulator, known, provenance
