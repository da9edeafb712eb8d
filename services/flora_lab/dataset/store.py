"""A training set on the disk: a folder with ``data.npz`` and ``dataset.toml``.

The same tracks, recipe and seed give the same bytes: no time and no name of a machine is in them.
"""

from __future__ import annotations

import importlib.metadata
import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import numpy as np
import numpy.typing as npt

from flora_common import files, outputs
from flora_common.errors import BadInput
from flora_common.toml_strict import to_toml
from flora_lab.dataset.build import Built
from flora_lab.dataset.pairs import COORDINATES, Pairs
from flora_lab.dataset.recipe import PAPER_VECTORS, Recipe
from flora_lab.made_folders import read_info, read_named
from flora_lab.run_tracks import RunTrack

FORMAT: Final = 1
DATA_FILE: Final = "data.npz"
INFO_FILE: Final = "dataset.toml"
FILES: Final = frozenset({DATA_FILE, INFO_FILE})

_ARRAYS: Final[dict[str, tuple[str, tuple[int, ...]]]] = {
    "inputs": ("<f4", (COORDINATES + 1,)),
    "outputs": ("<f4", (COORDINATES,)),
    "run": ("<i4", ()),
    "row": ("<i4", ()),
    "sequence": ("<i4", ()),
    "mirrored": ("|b1", ()),
}
"""Type of each array, and its shape after the first axis."""

Sha256 = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$(?!\n)")]


class RunEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[run]]``: a track that went in; its place in the list is ``run`` of its vectors."""

    name: str
    plant: str
    file: str
    sha256: Sha256
    rows: Annotated[int, msgspec.Meta(ge=1)]


class CountEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[count]]``: what there was after a step."""

    step: str
    stems: Annotated[int, msgspec.Meta(ge=0)]
    vectors: Annotated[int, msgspec.Meta(ge=0)]


class DatasetFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``dataset.toml``.

    Attributes:
        format: of the folder.
        vectors: how many.
        paper_vectors: how many the paper has.
        data_sha256: of ``data.npz``; it names the training set in what is made from it.
        software, numpy: versions.
        recipe: everything that decided; ``recipe.unit_cm`` times a coordinate is cm.
        run, count: what went in, and what there was after each step.
    """

    format: int
    vectors: Annotated[int, msgspec.Meta(ge=1)]
    paper_vectors: int
    data_sha256: Sha256
    software: str
    numpy: str
    recipe: Recipe
    run: list[RunEntry]
    count: list[CountEntry]


@dataclass(frozen=True, slots=True)
class Dataset:
    """A training set that was read and checked.

    Attributes:
        pairs: the vectors.
        info: where they came from.
    """

    pairs: Pairs
    info: DatasetFile

    @property
    def plants(self) -> npt.NDArray[np.str_]:
        """The plant of each vector, shape (n,): split by it, or the same plant is trained on and tested with."""
        return np.array([run.plant for run in self.info.run])[self.pairs.run]

    @property
    def unit_cm(self) -> float:
        """What to multiply coordinates with to have cm."""
        return self.info.recipe.unit_cm


def check_output(path: Path, *, force: bool) -> None:
    """Whether a training set may be written there.

    Raises:
        BadInput: something is there, and it is not to be, or must not be, replaced.
    """
    outputs.check_folder(path, force=force, needed=FILES, what="a training set")


def write_dataset(
    path: Path, built: Built, runs: Sequence[RunTrack], recipe: Recipe, *, force: bool = False
) -> Dataset:
    """Write the folder, whole or not at all.

    Raises:
        BadInput: see :func:`check_output`.
        DiskFull: no room.
    """
    check_output(path, force=force)
    with files.whole_folder(path, replace=force) as folder:
        data = folder / DATA_FILE
        arrays: dict[str, Any] = {
            name: np.ascontiguousarray(getattr(built.pairs, name), dtype=kind) for name, (kind, _) in _ARRAYS.items()
        }
        with data.open("wb") as file:
            np.savez(file, **arrays)
        info = DatasetFile(
            format=FORMAT,
            vectors=len(built.pairs),
            paper_vectors=PAPER_VECTORS,
            data_sha256=files.sha256_of_file(data),
            software=f"flora {importlib.metadata.version('flora')}",
            numpy=np.__version__,
            recipe=recipe,
            run=[RunEntry(r.name, r.plant, files.shown(r.file), r.sha256, len(r.track.time_s)) for r in runs],
            count=[CountEntry(c.step, c.stems, c.vectors) for c in built.counts],
        )
        (folder / INFO_FILE).write_text(to_toml(info), encoding="utf-8")
    return Dataset(built.pairs, info)


def read_dataset(path: Path) -> Dataset:
    """A training set, checked: its hash, shapes, types, that numbers are finite and lights 0 or 1.

    Raises:
        BadInput: anything of that does not hold; one line that says what and where.
    """
    info_path, data_path = path / INFO_FILE, path / DATA_FILE
    if not path.is_dir():
        raise BadInput(f"{path}: no such training set")
    if not info_path.is_file():
        raise BadInput(f"{path}: not a training set, it has no {INFO_FILE}")
    info = read_info(info_path, DatasetFile, FORMAT)
    data = read_named(data_path, info.data_sha256, INFO_FILE)
    arrays = _arrays(data_path, data, info.vectors)
    pairs = Pairs(**arrays)
    for name in ("inputs", "outputs"):
        bad = ~np.isfinite(arrays[name]).all(axis=1)
        if bad.any():
            vector = int(np.argmax(bad))
            run, row = int(pairs.run[vector]), int(pairs.row[vector])
            raise BadInput(f"{data_path}: `{name}` of vector {vector + 1} (run {run + 1}, row {row + 1}) is not finite")
    if not np.isin(pairs.inputs[:, -1], (0.0, 1.0)).all():
        raise BadInput(f"{data_path}: holds a light that is neither 0 (left) nor 1 (right)")
    if pairs.run.min() < 0 or pairs.run.max() >= len(info.run):
        raise BadInput(f"{data_path}: holds vectors of a run that {INFO_FILE} does not list")
    return Dataset(pairs, info)


def _arrays(path: Path, data: bytes, vectors: int) -> dict[str, Any]:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            found = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as problem:
        raise BadInput(f"{path}: not an archive of arrays ({problem})") from problem
    if set(found) != set(_ARRAYS):
        raise BadInput(f"{path}: holds {', '.join(sorted(found)) or 'nothing'}; expected {', '.join(_ARRAYS)}")
    for name, (kind, rest) in _ARRAYS.items():
        array = found[name]
        if array.dtype != np.dtype(kind) or array.shape != (vectors, *rest):
            raise BadInput(f"{path}: `{name}` is {array.dtype} {array.shape}; expected {kind} {(vectors, *rest)}")
    return found
