"""The folder of a diagnosis.

diagnosis.json        everything that was found, for programs
report.html           the same for people
pictures/             the pictures in it
base.simulator        what was learned from --reference; give it as --simulator the next time
extended.simulator    the same with what was found in plants
corrected/*.csv       tracks without what was found in the record of them
next-experiment.lights.toml  the light that would tell what these runs cannot
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from flora_common import files
from flora_common.light_plan import SUFFIX as LIGHTS_SUFFIX
from flora_lab.diagnose import (
    corrected_tracks,
    figures,
    figures_of_controllers,
    figures_of_learned,
    figures_of_runs,
    stored_base,
)
from flora_lab.diagnose.film import film
from flora_lab.diagnose.page import page
from flora_lab.diagnose.schedules import write_experiment
from flora_lab.diagnose.work import Result
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.simulator.corrected import CorrectedSimulator
from flora_lab.simulator.remembering import RememberingSimulator
from flora_lab.simulator.store import EXTENSION, Extension, Provenance, TrackEntry, write_simulator

JSON_FILE: Final = "diagnosis.json"
PAGE_FILE: Final = "report.html"
PICTURES: Final = "pictures"
BASE: Final = "base.simulator"
EXTENDED: Final = "extended.simulator"
EXPERIMENT: Final = f"next-experiment{LIGHTS_SUFFIX}"


def write(path: Path, result: Result) -> None:
    """Write all of it, whole or not at all."""
    with files.whole_folder(path) as folder:
        _write_report(folder, result)
        _write_found(folder, result)


def write_without_report(path: Path, result: Result) -> None:
    """Write all but report.html and pictures, whole or not at all; nothing is drawn, which takes seconds."""
    with files.whole_folder(path) as folder:
        _write_found(folder, result)


def _write_report(folder: Path, result: Result) -> None:
    pictures = pictures_of(result)
    (folder / PICTURES).mkdir()
    for name, data in pictures.items():
        (folder / PICTURES / f"{name}.{'gif' if name == 'film' else 'png'}").write_bytes(data)
    evidence = [[(t.effect.title, t.gain) for t in stage.tried] for stage in result.explanation.stages]
    text = page(result.diagnosis, pictures, evidence=evidence, plant=result.tables.plant)
    (folder / PAGE_FILE).write_text(text, encoding="utf-8")


def _write_found(folder: Path, result: Result) -> None:
    (folder / JSON_FILE).write_bytes(as_json(result))
    start = result.start
    if start.is_new:
        stored_base.write_known(folder / BASE, start.simulator, start.known, start.provenance)
    if result.corrected is not None:
        _write_corrected(folder / EXTENDED, result)
    elif result.mended is not None:
        _write_mended(folder / EXTENDED, result)
    elif result.extended is not None:
        provenance = _and_from(start.provenance, result, EXTENSION)
        stored_base.write_known(folder / EXTENDED, result.extended, start.known, provenance)
    corrected_tracks.write(folder / corrected_tracks.FOLDER, result.runs, result.explanation.found)
    asked = result.diagnosis.next_experiment
    if asked.light_schedule:
        write_experiment(folder / EXPERIMENT, asked.light_schedule, hours=asked.hours, why=asked.why)


def _write_corrected(path: Path, result: Result) -> None:
    """A learned simulator beside which the mechanistic one adds what it lacks."""
    simulator, judged = result.corrected, result.start.judged
    assert simulator is not None
    learned = () if judged is None else judged.info.provenance.track
    provenance = msgspec.structs.replace(result.start.provenance, track=[*result.start.provenance.track, *learned])
    _write_learned(path, simulator, _and_from(provenance, result, EXTENSION), simulator.extensions)


def _write_mended(path: Path, result: Result) -> None:
    """The paper's simulator with its clock set right and a memory beside it."""
    assert result.mended is not None
    assert result.start.judged is not None
    learned = result.start.judged.info.provenance
    extensions = [
        Extension(cause.effect, dict(cause.parameters), cause.form)
        for cause in result.diagnosis.causes
        if BY_NAME[cause.effect].where == "simulator"
    ]
    _write_learned(path, result.mended.simulator, _and_from(learned, result, "memory"), extensions)


def _and_from(learned: Provenance, result: Result, part: str) -> Provenance:
    """What a simulator was made from, where a part of it is from the runs that were diagnosed."""
    told = [TrackEntry(run.name, run.plant, run.sha256, part) for run in result.runs.tracks]
    return msgspec.structs.replace(learned, track=[*learned.track, *told])


def _write_learned(
    path: Path,
    simulator: CorrectedSimulator | RememberingSimulator,
    provenance: Provenance,
    extensions: Sequence[Extension],
) -> None:
    write_simulator(
        path,
        kind=simulator.kind,
        step_s=simulator.step_s,
        weights=simulator.weights(),
        scales=simulator.scales(),
        provenance=provenance,
        extensions=extensions,
    )


def as_json(result: Result) -> bytes:
    """``diagnosis.json``."""
    return msgspec.json.format(msgspec.json.encode(result.diagnosis), indent=1) + b"\n"


def pictures_of(result: Result) -> dict[str, bytes]:
    """By name, see :func:`flora_lab.diagnose.page.page`."""
    tables, extended, explanation = result.tables, result.extended_tables, result.explanation
    gain = result.diagnosis.gain
    first = explanation.stages[0]
    tried = [(t.effect.title, t.gain) for t in first.tried]
    named = [BY_NAME[cause.effect].title for cause in result.diagnosis.causes]
    made = {
        "paths": figures_of_runs.paths(tables, extended),
        "stems": figures_of_runs.stems(tables, extended),
        "phase": figures.by_phase(tables, extended),
        "stem": figures.along_stem(tables, extended),
        "spectrum": figures.spectra(tables, explanation.swing),
        "evidence": figures.evidence(tried, named, explanation.claim),
        "film": film(tables, extended),
    }
    if gain.free_running:
        made["gain"] = figures.gain(gain.free_running, gain.one_step)
    if result.mended is not None:
        made["learned"] = figures_of_learned.heights(result.mended)
    if gain.controller_fitness:
        made["controllers"] = figures_of_controllers.controllers(gain.controller_fitness)
    return made
