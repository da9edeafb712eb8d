"""All steps in the paper's order, with a count after each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flora_common.errors import BadInput
from flora_lab.dataset.generic import smoothest, translated, translations
from flora_lab.dataset.loading import measured
from flora_lab.dataset.noise import noisy_sequences
from flora_lab.dataset.pairs import Pairs, changed, mirrored, no_jump, paired
from flora_lab.dataset.recipe import DUPLICATES, GENERIC, JUMPS, MIRROR, NOISE, PAIRS, SPARSE, TRACKS, Recipe
from flora_lab.dataset.sparse import in_dense_areas
from flora_lab.dataset.stems import Stems, joined
from flora_lab.run_tracks import RunTrack


@dataclass(frozen=True, slots=True)
class StepCount:
    """What there is after a step.

    Attributes:
        step: its name.
        stems: entries of all sequences together.
        vectors: pairs that these make: the number that the paper's 101,162 is to be compared with.
    """

    step: str
    stems: int
    vectors: int


@dataclass(frozen=True, slots=True)
class Built:
    """The training set, and how it came to its size."""

    pairs: Pairs
    counts: tuple[StepCount, ...]


def build(runs: Sequence[RunTrack], recipe: Recipe, *, on_step: Callable[[str], None] = lambda step: None) -> Built:
    """Make the training set.

    Args:
        runs: the tracks.
        recipe: which steps, and their numbers.
        on_step: told each step's name before it is done.

    Raises:
        BadInput: a track that cannot be used (see :func:`flora_lab.dataset.loading.measured`), or nothing is left.
    """
    counts: list[StepCount] = []
    psi = measured(runs, recipe.interval_s, skip_other_lights=recipe.skip_other_lights)
    counts.append(_count(TRACKS, psi))
    if recipe.does(SPARSE):
        on_step(SPARSE)
        psi = psi.take(in_dense_areas(psi, recipe.sparse))
        counts.append(_count(SPARSE, psi))
    if not len(psi.followers()):
        raise BadInput(f"{runs[0].file}{' and the others' if len(runs) > 1 else ''}: {_nothing(counts)}")
    sequences = [psi]
    if recipe.does(NOISE):
        on_step(NOISE)
        sequences += noisy_sequences(psi, recipe.noise, recipe.seed)
        counts.append(_count(NOISE, joined(sequences)))
    if recipe.does(GENERIC):
        on_step(GENERIC)
        shifts_cm = translations(recipe.generic.exponents, recipe.unit_cm)
        chosen = smoothest(psi, recipe.generic, recipe.interval_s)
        sequences += translated(psi, chosen, shifts_cm, first_sequence=len(sequences))
        counts.append(_count(GENERIC, joined(sequences)))
    stems = joined(sequences)
    if recipe.does(MIRROR):
        on_step(MIRROR)
        stems = joined([stems, mirrored(stems)])
        counts.append(_count(MIRROR, stems))
    on_step(PAIRS)
    pairs = paired(stems, recipe.unit_cm)
    counts.append(StepCount(PAIRS, len(stems), len(pairs)))
    if recipe.does(DUPLICATES):
        on_step(DUPLICATES)
        pairs = pairs.take(changed(pairs, recipe.duplicate_cm / recipe.unit_cm))
        counts.append(StepCount(DUPLICATES, len(stems), len(pairs)))
        if not len(pairs):
            raise BadInput(f"{runs[0].file}: {DUPLICATES} leaves nothing; no stem ever moves")
    if recipe.does(JUMPS):
        on_step(JUMPS)
        pairs = pairs.take(no_jump(pairs, recipe.jump_times))
        counts.append(StepCount(JUMPS, len(stems), len(pairs)))
    return Built(pairs, tuple(counts))


def _count(step: str, stems: Stems) -> StepCount:
    return StepCount(step, len(stems), len(stems.followers()))


def _nothing(counts: Sequence[StepCount]) -> str:
    if counts[0].vectors == 0:
        return "no two stems one step apart"
    return f"no area is dense enough; see --min-tips and --min-runs, or add --without {SPARSE}"
