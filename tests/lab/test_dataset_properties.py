"""``flora-lab dataset``: what holds for any tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_common.runs import Light
from flora_common.tracks import Track
from flora_lab.dataset.build import build
from flora_lab.dataset.generic import translated, translations
from flora_lab.dataset.loading import measured
from flora_lab.dataset.noise import local_statistics
from flora_lab.dataset.pairs import change, mirrored
from flora_lab.dataset.recipe import (
    DUPLICATES,
    GENERIC,
    JUMPS,
    MIRROR,
    NOISE,
    PAIRS,
    SPARSE,
    STEP_NAMES,
    GenericSettings,
    Recipe,
    SparseSettings,
)
from flora_lab.run_tracks import RunTrack

STEP_S = 300.0
LOOSE = SparseSettings(min_runs=1, min_tips=1)
SHORT = GenericSettings(exponents=(-3, -4), share=0.2, window_h=0.25)


@st.composite
def runs(draw: st.DrawFn) -> list[RunTrack]:
    """One to three tracks with gaps, stems at rest, jumps, and switching lamps."""
    made = []
    for index in range(draw(st.integers(1, 3))):
        count = draw(st.integers(2, 25))
        random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        steps = random.choice([0.0, 0.0, 0.5, 1.0, 40.0], size=(count, 2), p=[0.2, 0.2, 0.3, 0.28, 0.02])
        tips = np.array([0.0, 6.0]) + np.cumsum(steps * random.normal(size=(count, 2)), axis=0)
        beats = np.cumsum(random.choice([1, 1, 1, 1, 3], size=count))
        beats[1:] = np.maximum(beats[1:], beats[0] + 1)
        beats[1] = beats[0] + 1
        beats[2:] = beats[1] + np.cumsum(random.choice([1, 1, 1, 1, 3], size=count - 2))
        lights: tuple[Light, ...] = tuple(random.choice(["left", "right"], size=count).tolist())
        points = tips[:, None, :] * (np.arange(10) / 9.0)[None, :, None]
        points = np.clip(np.round(points, 4), -40.0, 40.0)  # no stem of the box goes farther
        track = Track(beats * STEP_S, lights, points, {})
        made.append(RunTrack(f"run{index}", f"plant{index}", Path(f"{index}.csv"), "0" * 64, track))
    return made


def recipe(**changes: object) -> Recipe:
    values: dict[str, object] = {"sparse": LOOSE, "generic": SHORT, **changes}
    return Recipe(**values)  # type: ignore[arg-type]


@given(runs())
def test_mirroring_twice_is_nothing(tracks: list[RunTrack]) -> None:
    stems = measured(tracks, STEP_S)
    twice = mirrored(mirrored(stems))
    assert np.array_equal(twice.points_cm, stems.points_cm)
    assert np.array_equal(twice.light, stems.light)
    assert np.array_equal(twice.mirrored, stems.mirrored)
    once = mirrored(stems)
    assert np.array_equal(once.points_cm[..., 0], -stems.points_cm[..., 0])
    assert ((once.light + stems.light) == 1).all()


@given(runs())
def test_translations_keep_shapes_and_movements(tracks: list[RunTrack]) -> None:
    stems = measured(tracks, STEP_S)
    everything = np.ones(len(stems), dtype=np.bool_)
    for part in translated(stems, everything, translations((-3, -6), 65.0), 1):
        assert np.allclose(np.diff(part.points_cm, axis=1), np.diff(stems.points_cm, axis=1), atol=1e-9)
        assert np.allclose(np.diff(part.points_cm, axis=0), np.diff(stems.points_cm, axis=0), atol=1e-9)
        assert not np.array_equal(part.points_cm, stems.points_cm)


@given(runs())
def test_a_pair_is_a_row_and_the_next_one_under_the_next_rows_light(tracks: list[RunTrack]) -> None:
    plain = recipe(without=(SPARSE, NOISE, GENERIC, MIRROR, DUPLICATES, JUMPS), unit_cm=1.0)
    pairs = build(tracks, plain).pairs
    expected = 0
    for run in tracks:
        expected += int((np.diff(run.track.time_s) == STEP_S).sum())
    assert len(pairs) == expected
    for i in range(len(pairs)):
        track, row = tracks[pairs.run[i]].track, int(pairs.row[i])
        assert track.time_s[row + 1] - track.time_s[row] == STEP_S
        assert np.array_equal(pairs.inputs[i, :18], track.points_cm[row, 1:].reshape(-1).astype(np.float32))
        assert np.array_equal(pairs.outputs[i], track.points_cm[row + 1, 1:].reshape(-1).astype(np.float32))
        assert pairs.inputs[i, 18] == (track.light[row + 1] == "right")


@given(runs(), st.integers(0, 2**32 - 1))
def test_pairs_never_cross_runs_or_gaps_whatever_was_removed(tracks: list[RunTrack], seed: int) -> None:
    stems = measured(tracks, STEP_S)
    stems = stems.take(np.random.default_rng(seed).random(len(stems)) < 0.5)
    kept = {(int(run), int(row)) for run, row in zip(stems.run, stems.row, strict=True)}
    expected = sum(
        (run, row + 1) in kept and tracks[run].track.time_s[row + 1] - tracks[run].track.time_s[row] == STEP_S
        for run, row in kept
    )
    now = stems.followers()
    assert len(now) == expected
    assert np.array_equal(stems.run[now], stems.run[now + 1])
    assert np.array_equal(stems.row[now] + 1, stems.row[now + 1])


@settings(deadline=None, max_examples=60)
@given(runs(), st.sets(st.sampled_from([name for name in STEP_NAMES if name != PAIRS])), st.integers(0, 99))
def test_counts_add_up_and_what_was_removed_is_gone(tracks: list[RunTrack], without: set[str], seed: int) -> None:
    chosen = recipe(without=tuple(name for name in STEP_NAMES if name in without), seed=seed)
    moves = any(np.diff(run.track.points_cm, axis=0)[np.diff(run.track.time_s) == STEP_S].any() for run in tracks)
    if not moves and DUPLICATES not in without:
        chosen = recipe(without=(*chosen.without, DUPLICATES), seed=seed)
        without = {*without, DUPLICATES}
    built = build(tracks, chosen)
    counts = {count.step: count for count in built.counts}
    assert [count.step for count in built.counts] == ["tracks", *(s for s in STEP_NAMES if s not in without)]
    assert counts["tracks"].stems == sum(len(run.track.time_s) for run in tracks)
    last = counts["tracks"]
    psi = counts.get(SPARSE, last)
    if NOISE in counts:
        assert counts[NOISE].stems == 4 * psi.stems
        assert counts[NOISE].vectors == 4 * psi.vectors
    before_generic = counts.get(NOISE, psi)
    if GENERIC in counts:
        assert (counts[GENERIC].stems - before_generic.stems) % 16 == 0
        assert (counts[GENERIC].vectors - before_generic.vectors) % 16 == 0
    before_mirror = counts.get(GENERIC, before_generic)
    if MIRROR in counts:
        assert counts[MIRROR].stems == 2 * before_mirror.stems
        assert counts[MIRROR].vectors == 2 * before_mirror.vectors
    before_pairs = counts.get(MIRROR, before_mirror)
    assert counts[PAIRS].vectors == before_pairs.vectors
    assert counts.get(DUPLICATES, counts[PAIRS]).vectors <= counts[PAIRS].vectors
    assert built.counts[-1].vectors == len(built.pairs)
    assert np.isfinite(built.pairs.inputs).all()
    assert np.isfinite(built.pairs.outputs).all()
    if DUPLICATES in counts:
        assert (built.pairs.inputs[:, :18] != built.pairs.outputs).any(axis=1).all()
    if JUMPS in counts:
        all_moves = change(build(tracks, recipe(without=(*chosen.without, JUMPS), seed=seed)).pairs)
        kept = all_moves[all_moves <= 20.0 * all_moves.mean()]
        assert np.array_equal(change(built.pairs), kept)
    if MIRROR in counts:
        assert built.pairs.mirrored.sum() * 2 == len(built.pairs)
        assert (built.pairs.inputs[:, 18] == 1.0).sum() * 2 == len(built.pairs)


@given(st.integers(2, 60), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_local_statistics_are_those_of_a_plain_sort(count: int, theta_3: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    tips = random.integers(-4, 5, size=(count, 2)).astype(np.float64)  # on a grid: many tips are equally far
    light = random.integers(0, 2, size=count).astype(np.int32)
    mean, deviation = local_statistics(tips, light, theta_3)
    for j in range(count):
        others = [i for i in range(count) if i != j and light[i] == light[j]]
        near = sorted(others, key=lambda i: ((tips[i] - tips[j]) ** 2).sum())[:theta_3]
        if near:
            assert np.allclose(mean[j], tips[near].mean(axis=0))
            assert np.allclose(deviation[j], tips[near].std(axis=0))
