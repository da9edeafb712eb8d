"""A diagnosis from its inputs to its results, step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import msgspec

from flora_common import files
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_lab.diagnose import chance, clocks, corrected_tracks, emulated, stored_base
from flora_lab.diagnose.corrected_gain import corrected_gain
from flora_lab.diagnose.cross_fit import ROUNDS
from flora_lab.diagnose.diagnosis import Described, Diagnosis, NamedCause, Residuals
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Explanation, Tried
from flora_lab.diagnose.gain import measure_gain
from flora_lab.diagnose.inputs import (
    Runs,
    check_known,
    check_unseen,
    read_holdout,
    read_reference,
    read_runs,
    told_again,
)
from flora_lab.diagnose.knocks import KNOCKED
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.known_swing import swing_of, with_swing
from flora_lab.diagnose.learned_base import learned_base
from flora_lab.diagnose.learned_simulator import faults_of, still_wrong
from flora_lab.diagnose.mended_simulator import Mended
from flora_lab.diagnose.mended_simulator import mended as mended_of
from flora_lab.diagnose.next_experiment import next_experiment
from flora_lab.diagnose.residuals import ResidualTables, residuals_of
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.summary import nearest, summary
from flora_lab.diagnose.verdict import Left, beside_a_knock, left_of, left_words, named, verdict_of
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.simulator.corrected import CorrectedSimulator, LearnedSimulator
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.load import simulator_of
from flora_lab.simulator.paper import PaperSimulator
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import EXTENSION, Extension, Provenance, Stored, read_stored
from flora_lab.threads import one_blas_thread

OnStage = Callable[[str, int], Callable[[], None]]
"""Begins a stage of so many steps, and is told of each; one of the same name begins anew."""

IN_PLANTS: Final = ("plant", "simulator")


@dataclass(frozen=True, slots=True)
class Start:
    """What a diagnosis starts from.

    Attributes:
        simulator: the mechanistic simulator that is extended.
        known: what the reference tells.
        usual_c: temperature that its plants are used to.
        provenance: where the simulator is from.
        learned_from: a sentence.
        is_new: whether it was learned here, and is to be kept.
        judged: the simulator that was given, if it is not the mechanistic one.
    """

    simulator: RodSimulator
    known: Knowledge
    usual_c: float | None
    provenance: Provenance
    learned_from: str
    is_new: bool
    judged: Stored | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """All that is written and told.

    Attributes:
        start: what it started from.
        diagnosis: ``diagnosis.json``.
        explanation: how it was come to.
        tables: residuals of the simulator as it is, for pictures.
        extended_tables: of the extended one; None where nothing was found.
        extended: the mechanistic simulator with the causes in plants, and of plants of which these runs have told, too;
            None where there is no such cause.
        extensions: what it is extended by.
        runs: that were diagnosed.
        corrected: the learned simulator with what it lacks beside it; None where none was given, or nothing found.
        mended: the paper's simulator without what is wrong with it as a whole; None where nothing is.
    """

    start: Start
    diagnosis: Diagnosis
    explanation: Explanation
    tables: ResidualTables
    extended_tables: ResidualTables | None
    extended: RodSimulator | None
    extensions: tuple[Extension, ...]
    runs: Runs
    corrected: CorrectedSimulator | None = None
    mended: Mended | None = None


def start_from(
    runs: Runs, held_out: Runs | None, stored: Stored | None, reference: Path | None, stage: OnStage
) -> Start:
    """Learn the base, or take it from a simulator that was read.

    Raises:
        BadInput: see :func:`flora_lab.diagnose.inputs.read_reference` and
            :func:`flora_lab.diagnose.inputs.check_known`; it was learned from runs that are diagnosed or held out, or
            is none that a diagnosis can start from.
    """
    if stored is not None:
        seen = stored.info.provenance.track
        check_unseen(runs, {track.sha256 for track in seen if track.part != EXTENSION})
        check_unseen(held_out, {track.sha256 for track in seen})
        judged = simulator_of(stored)
        for told in (runs, held_out):
            check_known(judged, told)
    if reference is not None:
        healthy = read_reference(reference, runs)
        check_unseen(held_out, {track.sha256 for track in healthy.tracks})
        start = _learned(healthy, "the runs of --reference", counted(len(healthy.measured), "reference run"), stage)
        return replace(start, judged=stored)
    assert stored is not None
    simulator = stored.path
    if stored_base.is_known(stored):
        read = RodSimulator.from_stored(stored)
        known = stored_base.read_known(stored)
        words = ", and extended with ".join(
            [f"{simulator.name}, learned from {counted(known.base.runs, 'run')}", *(e.effect for e in read.extensions)]
        )
        return Start(read, known, read.usual_temperature_c, stored.info.provenance, words, is_new=False)
    if not judged.has_individuals:
        raise BadInput(
            f"{simulator}: its plants are all alike, so nobody knows what of a run is chance; add --reference with a "
            "folder of healthy runs"
        )
    told = emulated.reference_of(judged, runs)
    runs_of_it = counted(len(told.measured), "run")
    words = f"{runs_of_it} of {simulator.name} itself: what it is wrong in is judged by its own chance alone"
    start = _learned(told, f"runs simulated by {simulator.name}", words, stage)
    return replace(start, judged=stored)


def _learned(told: Runs, source: str, words: str, stage: OnStage) -> Start:
    step = stage("learning from the reference", ROUNDS)
    simulator, known, provenance = learned_base(told, source, step)
    return Start(simulator, known, simulator.usual_temperature_c, provenance, words, is_new=True)


def knowledge_of(start: Start) -> Knowledge:
    """What is known of the plants, their own swing included: of that the simulator's folder holds no more than its
    name."""
    swing = swing_of(start.simulator.extensions, start.simulator.noise.nutation_coherence_h)
    return start.known if swing is None else with_swing(start.known, swing)


def diagnose(
    paths: Sequence[Path],
    *,
    simulator: Path | None,
    reference: Path | None,
    holdout: Sequence[Path],
    stage: OnStage,
    note: Callable[[str], None],
) -> Result:
    """The whole of it.

    Raises:
        BadInput: anything that cannot be read, or is too little.
    """
    # before the runs are read, and noted on: what cannot be used is the first line
    stored = read_stored(simulator) if simulator is not None else None
    notes: list[str] = []
    runs = read_runs(paths, notes.append)
    further = read_holdout(holdout, runs)
    seen = stored.info.provenance.track if stored is not None else []
    again = told_again(runs, {track.sha256 for track in seen if track.part == EXTENSION})
    notes += [again] if again else []
    for text in notes:
        note(text)
    start = start_from(runs, further, stored, reference, stage)
    terms, known = start.simulator.terms, knowledge_of(start)
    scenes = runs.scenes(start.usual_c, terms)
    with one_blas_thread():
        explainer = Explainer(scenes, known, lambda causes: stage("looking for causes", causes))
        explanation = explainer.explain()
        left_out = clocks.left_out(scenes, explainer.scenes)
        scenes = list(explainer.scenes)
        left = left_of(explanation, known)
        causes = named(explanation, left)
        if runs.knocked:
            causes = beside_a_knock(causes)
        given = None if start.judged is None else simulator_of(start.judged)
        faults = [] if given is None else faults_of(given, runs.measured)
        beside = corrected_by(given, start.simulator, extensions_of(causes))
        if beside is not None:
            faults = still_wrong(faults, beside, runs.measured)
        mended = _mended(given, faults, runs, further)
        said, tables = residuals_of(scenes, known.base, explanation.null, known.residuals)
        extended_tables = _extended(scenes, known, explanation)
        step = stage("measuring the gain", len(scenes) + (len(further.measured) if further else 0))
        held_out = further.scenes(start.usual_c, terms) if further else []
        gain = measure_gain(scenes, known.base, explanation, held_out, step)
        learned = _learned_gain(given, start.simulator, mended, explanation, runs, further)
        asked = next_experiment(scenes, known.base, explanation, known.errors, known.swing)
    causes = [*faults, *causes]
    diagnosis = Diagnosis(
        verdict=verdict_of(causes, left, bool(runs.knocked)),
        causes=causes,
        residuals=_with_left(said, left, explanation, known),
        gain=gain,
        next_experiment=asked,
        summary=summary(causes, left, nearest(explanation), explanation.dropped, said.when["p_value"], runs.knocked),
        described=_described(left),
        record=[*runs.notes, *(f"{one}: {KNOCKED}" for one in runs.knocked), *left_out],
        corrected=corrected_tracks.names_of(runs, explanation.found),
        runs=[files.shown(track.file) for track in runs.tracks],
        considered=[_considered(stage.tried) for stage in explanation.stages],
        needed_nats=round(explanation.claim, 1),
        base={
            "learned_from": start.learned_from,
            **({"extended_by_these_runs": again} if again else {}),
            **_base_words(known),
        },
        learned=learned,
    )
    extensions = extensions_of(causes[len(faults) :])
    extended = None
    if extensions:
        moved = explanation.typical - known.base.mean
        extended = start.simulator.with_typical(moved).extended(extensions)
    corrected = corrected_by(given if mended is None else mended.simulator, start.simulator, extensions)
    return Result(start, diagnosis, explanation, tables, extended_tables, extended, extensions, runs, corrected, mended)


def _considered(tried: Sequence[Tried]) -> dict[str, float]:
    return {one.effect.name: round(one.gain, 1) for one in tried if math.isfinite(one.gain)}


def _mended(
    given: Simulator[Any] | None, faults: Sequence[NamedCause], runs: Runs, further: Runs | None
) -> Mended | None:
    if not isinstance(given, PaperSimulator):
        return None
    return mended_of(given, faults, runs.measured, further.measured if further else ())


def _learned_gain(
    given: Simulator[Any] | None,
    mechanistic: RodSimulator,
    mended: Mended | None,
    explanation: Explanation,
    runs: Runs,
    further: Runs | None,
) -> dict[str, Any]:
    """What the learned simulator that was given gains; nothing where none was."""
    if mended is not None:
        return mended.told()
    if isinstance(given, RodSimulator) or not isinstance(given, LearnedSimulator):
        return {}
    held_out = further.measured if further is not None else ()
    return corrected_gain(given, mechanistic, explanation, runs.measured, held_out)


def corrected_by(
    learned: Simulator[Any] | None, mechanistic: RodSimulator, extensions: Sequence[Extension]
) -> CorrectedSimulator | None:
    """A learned simulator with what it lacks beside it; None where there is none, or it lacks nothing."""
    if learned is None or not extensions:
        return None
    if isinstance(learned, CorrectedSimulator):
        return CorrectedSimulator(learned.learned, learned.mechanistic.extended(extensions))
    if isinstance(learned, RodSimulator) or not isinstance(learned, LearnedSimulator):
        return None
    return CorrectedSimulator(learned, mechanistic.extended(extensions))


def extensions_of(causes: Sequence[NamedCause]) -> tuple[Extension, ...]:
    """What a simulator is extended by: causes in plants. Those in the record correct the data instead."""
    return tuple(
        Extension(cause.effect, dict(cause.parameters), cause.form)
        for cause in causes
        if BY_NAME[cause.effect].where in IN_PLANTS and BY_NAME[cause.effect].forms
    )


def _extended(scenes: Sequence[Scene], known: Knowledge, explanation: Explanation) -> ResidualTables | None:
    if not explanation.found.hypothesis.causes:
        return None
    return residuals_of(scenes, known.base, explanation.found, known.residuals)[1]


def _with_left(said: Residuals, left: Left, explanation: Explanation, known: Knowledge) -> Residuals:
    return msgspec.structs.replace(said, left=left_words(left, explanation, known))


def _described(left: Left) -> Described | None:
    found = left.unnamed
    if found is None:
        return None
    size = [round(float(value), 4) for value in found.size]
    course = found.course
    period_h = None if course.period_h is None else round(course.period_h, 2)
    return Described(found.drive, course.where, size, round(found.gain, 1), found.words, period_h, dict(course.peaks_h))


def _base_words(known: Knowledge) -> dict[str, Any]:
    law = [extension.effect for extension in known.law] or ["as written"]
    return {
        "runs": known.base.runs,
        "law": law,
        "cross_fit_nats": [round(float(nats), 1) for nats in known.cross_fit.max(axis=1)],
        "chance": {k: round(v, 5) for k, v in chance.as_dict(known.base.sizes).items()},
    }
