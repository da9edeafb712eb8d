"""A simulator on the disk: a folder with ``simulator.toml`` and ``weights.safetensors``.

Neither torch nor any other learning library is needed to read one. The same data, settings and seed give the same
bytes: no time and no name of a machine is in them.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import numpy as np
import safetensors
import safetensors.numpy

from flora_common import files, outputs
from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.toml_strict import to_toml
from flora_lab.made_folders import read_info, read_named

FORMAT: Final = 1
SUFFIX: Final = ".simulator"
INFO_FILE: Final = "simulator.toml"
WEIGHTS_FILE: Final = "weights.safetensors"
FILES: Final = frozenset({INFO_FILE, WEIGHTS_FILE})
FIGURES: Final = frozenset({"training.png"})
"""What else may lie in the folder."""

Sha256 = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$(?!\n)")]
LEAST_STEP_S: Final = 1e-3
"""No camera is faster, and the times of a track are still counted in whole steps."""
StepSeconds = Annotated[float, msgspec.Meta(ge=LEAST_STEP_S, le=1e9)]

EXTENSION: Final = "extension"
"""The part of runs that a simulator was extended by."""


class TrackEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[provenance.track]]``: a run that the simulator was made from, and what for."""

    name: str
    plant: str
    sha256: Sha256
    part: str = "train"
    """``train``, ``validate`` or ``test``; ``all`` where the paper's shuffled rows were split; ``memory`` or
    ``extension`` where a diagnosis fitted these to it."""


class Provenance(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[provenance]``: what the simulator was made from, how, and with which software."""

    recipe: str
    seed: int
    software: str
    dataset_sha256: str = ""
    """Of the training set's ``data.npz``, where there was one."""
    split: str = ""
    """How training and test were held apart, in a sentence."""
    settings: dict[str, Any] = {}
    """All settings of the recipe."""
    results: dict[str, Any] = {}
    """Errors at the end of the training; units stand in the names."""
    track: list[TrackEntry] = []


class Extension(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[extension]]``: a named effect that was added to the simulator, see :mod:`flora_lab.effects`.

    Attributes:
        effect: its name.
        parameters: of it; units stand in the names.
        form: which of the ways in which it may act.
    """

    effect: str
    parameters: dict[str, float] = {}
    form: int = 0


class SimulatorFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``simulator.toml``.

    Attributes:
        format: of the folder.
        kind: which class reads it.
        step_s: the step that it was made for, in s, at least :data:`LEAST_STEP_S`.
        weights_sha256: of ``weights.safetensors``.
        provenance: where it comes from.
        scales: numbers that the kind needs beside its weights; units stand in the names.
        extension: effects that were added.
    """

    format: int
    kind: str
    step_s: StepSeconds
    weights_sha256: Sha256
    provenance: Provenance
    scales: dict[str, Any] = {}
    extension: list[Extension] = []


@dataclass(frozen=True, slots=True)
class Stored:
    """A simulator folder that was read and checked.

    Attributes:
        path: of the folder.
        info: ``simulator.toml``.
        weights: name to array, all finite.
        part: before the names of its weights and scales in errors, where it is part of another simulator.
    """

    path: Path
    info: SimulatorFile
    weights: Mapping[str, Array]
    part: str = ""

    def inner(self, name: str, kind: str, step_s: float) -> Stored:
        """A simulator within this one: weights that begin with ``name`` and a dot, and the scales of that name.

        Raises:
            BadInput: no table of scales of that name.
        """
        scales = self.info.scales.get(name)
        if not isinstance(scales, dict):
            raise BadInput(f"{self.path / INFO_FILE}: scales.{self.part}{name} is missing, or no table")
        start = f"{name}."
        weights = {key.removeprefix(start): array for key, array in self.weights.items() if key.startswith(start)}
        info = msgspec.structs.replace(self.info, kind=kind, step_s=step_s, scales=scales)
        return Stored(self.path, info, weights, self.part + start)

    def weight(self, name: str, shape: tuple[int | None, ...]) -> Array:
        """One array of the shape that its reader expects; None fits any length.

        Raises:
            BadInput: missing, or of another shape.
        """
        found = self.weights.get(name)
        if found is None:
            raise BadInput(f"{self.path / WEIGHTS_FILE}: holds no `{self.part}{name}`")
        if len(found.shape) != len(shape) or any(
            want is not None and have != want for have, want in zip(found.shape, shape, strict=True)
        ):
            wanted = ", ".join("any" if want is None else str(want) for want in shape)
            raise BadInput(f"{self.path / WEIGHTS_FILE}: `{self.part}{name}` is {found.shape}; expected ({wanted})")
        return found

    def scale(self, name: str) -> float:
        """One number of ``[scales]``.

        Raises:
            BadInput: missing, or not a finite number.
        """
        value = self.info.scales.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise BadInput(f"{self.path / INFO_FILE}: scales.{self.part}{name} is {str(value)[:40]}, not a number")
        return float(value)


def software() -> str:
    """The version that provenance names."""
    return f"flora {importlib.metadata.version('flora')}"


def check_output(path: Path, *, force: bool) -> None:
    """Whether a simulator may be written there.

    Raises:
        BadInput: something is there, and it is not to be, or must not be, replaced.
    """
    outputs.check_folder(path, force=force, needed=FILES, allowed=FIGURES, what="a simulator")


def write_simulator(
    path: Path,
    *,
    kind: str,
    step_s: float,
    weights: Mapping[str, Array],
    scales: Mapping[str, Any],
    provenance: Provenance,
    extensions: Sequence[Extension] = (),
    figures: Mapping[str, bytes] | None = None,
    force: bool = False,
) -> SimulatorFile:
    """Write the folder, whole or not at all.

    Args:
        path: the folder.
        kind, step_s, weights, scales, provenance, extensions: see :class:`SimulatorFile`; weights float32 or float64.
        figures: file name, one of :data:`FIGURES`, to content.
        force: replace a simulator that is there.

    Raises:
        BadInput: see :func:`check_output`.
        ValueError: weights that are not finite.
        DiskFull: no room.
    """
    check_output(path, force=force)
    for name, array in weights.items():
        if not np.isfinite(array).all():
            raise ValueError(f"weight `{name}` is not finite; the training has failed")
    data = safetensors.numpy.save({name: np.ascontiguousarray(weights[name]) for name in sorted(weights)})
    info = SimulatorFile(
        format=FORMAT,
        kind=kind,
        step_s=step_s,
        weights_sha256=files.sha256_of_bytes(data),
        provenance=provenance,
        scales=dict(scales),
        extension=list(extensions),
    )
    with files.whole_folder(path, replace=force) as folder:
        (folder / WEIGHTS_FILE).write_bytes(data)
        (folder / INFO_FILE).write_text(to_toml(info), encoding="utf-8")
        for name, content in (figures or {}).items():
            if name not in FIGURES:
                raise ValueError(f"`{name}` does not belong into a simulator folder")
            (folder / name).write_bytes(content)
    return info


def read_stored(path: Path) -> Stored:
    """A simulator folder, checked: its hash, and that all weights are finite.

    Raises:
        BadInput: anything of that does not hold; one line that says what and where.
    """
    info_path, weights_path = path / INFO_FILE, path / WEIGHTS_FILE
    if not path.is_dir():
        what = "a file, not a simulator folder" if files.is_file(path) else "no such simulator folder"
        raise BadInput(f"{path}: {what}")
    if not info_path.is_file():
        within = sorted(one.parent.name for one in path.glob(f"*/{INFO_FILE}"))
        advice = f"name {path / within[0]}" if within else "make one with `flora-lab train`"
        raise BadInput(f"{path}: not a simulator, it has no {INFO_FILE}; {advice}")
    info = read_info(info_path, SimulatorFile, FORMAT)
    data = read_named(weights_path, info.weights_sha256, INFO_FILE)
    try:
        weights = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, ValueError, KeyError) as problem:
        raise BadInput(f"{weights_path}: not a safetensors file ({str(problem)[:100]})") from problem
    for name, array in weights.items():
        if not np.isfinite(array).all():
            raise BadInput(f"{weights_path}: `{name}` holds numbers that are not finite")
    return Stored(path, info, weights)
