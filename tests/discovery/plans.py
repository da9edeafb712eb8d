"""Which cases a judging draws: kinds, forms, effects and seeds, each of its own world or several of one.

A world is a species with its nine reference runs; seed and form make it. Seeds count from 0 upwards where each case has
a world of its own, each kind in a range of its own; shared worlds count from :data:`SHARED_FROM` upwards. In both,
each judging has a range of its own: no two judgings of different seeds see the same plants. What is the same case has
the same key, however it was come to.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TypeVar

import numpy as np

from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean

from .worlds.case import ALL_EFFECTS, KINDS
from .worlds.effects import CATALOGUE
from .worlds.outside import ON_REQUEST, OUTSIDE

SEEDS_PER_KIND = 100_000
SEEDS_PER_JUDGING = SEEDS_PER_KIND * len(KINDS)
MOST_CASES = SEEDS_PER_KIND
MOST_SEED = 999_999
"""Of a judging."""
SHARED_FROM = 10**12
"""Above the worlds' seeds of every judging that shares none."""
OTHER_PHYSICS_EVERY = 5
MIXTURE = {"none": 10, "outside": 4, "pair": 5, "single": 21}
"""Of 40 cases: a quarter, a tenth, an eighth, and the rest."""
Thing = TypeVar("Thing")


@dataclass(frozen=True)
class Plan:
    """What a case is drawn from; see :func:`.worlds.case.draw_case`."""

    seed: int
    form: int
    kind: str
    effect: str | None
    runs: int
    number: int = 0

    @property
    def key(self) -> str:
        """Of its result: the same for the same case, and for no other."""
        of_world = f".{self.number}" if self.number else ""
        return f"{self.kind}-{self.form}-{self.effect or 'any'}-{self.seed}{of_world}-{self.runs}"

    @property
    def world(self) -> tuple[int, int]:
        """Plans of one world have the same reference runs."""
        return self.form, self.seed


def plans(
    cases: int,
    seed: int,
    runs: int = 3,
    kinds: Sequence[tuple[str, int]] = (),
    effects: Sequence[str] = (),
    per_world: int = 1,
) -> list[Plan]:
    """The cases of a judging, shuffled so that any beginning of them is a fair sample; those of a world stay together.

    More cases with the same seed are the same ones and others.

    Args:
        cases: how many.
        seed: of the judging.
        runs: measured runs in each.
        kinds: kinds and forms to share the cases among; the usual mixture where empty.
        effects: only these effects, in turn; the whole catalogue, or all outside of it, where empty.
        per_world: so many cases share a world, all of one form and each of the mixture.
    """
    if per_world == 1:
        worlds = [[plan] for plan in _alone(cases, seed, runs, kinds, effects)]
    else:
        worlds = _sharing(cases, seed, runs, kinds, effects, per_world)
    order = np.random.default_rng(seed).permutation(len(worlds))
    return [plan for i in order for plan in worlds[int(i)]]


def by_world(wanted: Sequence[Plan]) -> list[list[Plan]]:
    """The same plans, those of one world in one list, in the order of each world's first."""
    worlds: dict[tuple[int, int], list[Plan]] = {}
    for plan in wanted:
        worlds.setdefault(plan.world, []).append(plan)
    return list(worlds.values())


def in_proportion(weights: Mapping[Thing, int]) -> Iterator[Thing]:
    """These for ever, each as often as its weight says and so evenly that any stretch is a fair sample.

    All get their weight as credit at each step; who has most comes next and pays the whole.
    """
    credit = dict.fromkeys(weights, 0)
    while True:
        for thing, weight in weights.items():
            credit[thing] += weight
        richest = max(credit, key=credit.__getitem__)
        credit[richest] -= sum(weights.values())
        yield richest


def parse_kinds(text: str) -> list[tuple[str, int]]:
    """``single:0,none:1`` as kinds and forms, each once; a kind alone means both forms.

    Raises:
        BadInput: an unknown kind or form.
    """
    found = []
    for part in filter(None, text.split(",")):
        kind, _, form = part.strip().partition(":")
        if kind not in KINDS:
            raise BadInput(f"--kinds: no kind `{kind}`{did_you_mean(kind, KINDS)}")
        if form not in {"", "0", "1"}:
            raise BadInput(f"--kinds: form `{form}` in `{part}` is neither 0 nor 1")
        found += [(kind, int(form))] if form else [(kind, 0), (kind, 1)]
    return list(dict.fromkeys(found))


def parse_effects(text: str, kinds: Sequence[tuple[str, int]] = ()) -> list[str]:
    """``sag,draught`` as names.

    Raises:
        BadInput: an unknown effect, or one that no case of these kinds hides.
    """
    names = [name for name in text.split(",") if name]
    for name in names:
        if name not in ALL_EFFECTS:
            raise BadInput(f"--effects: no effect `{name}`{did_you_mean(name, list(ALL_EFFECTS))}")
        if kinds and _kind_of(name) not in {kind for kind, _ in kinds}:
            raise BadInput(f"--effects: `{name}` is hidden in cases of kind `{_kind_of(name)}`; add it to --kinds")
    return names


def _kind_of(effect: str) -> str:
    return "outside" if effect in {**OUTSIDE, **ON_REQUEST} else "single"


def _turn(kind: str, effects: Sequence[str]) -> list[str | None]:
    """The effects that cases of a kind hide in turn; None leaves it to chance, or hides none."""
    known = {"single": CATALOGUE, "outside": OUTSIDE}.get(kind, {})
    chosen = [name for name in effects if known and _kind_of(name) == kind]
    return [*(chosen or known)] or [None]


def _alone(
    cases: int, seed: int, runs: int, kinds: Sequence[tuple[str, int]], effects: Sequence[str]
) -> Iterator[Plan]:
    """Each case has a world of its own."""
    counts: dict[tuple[str, int], int] = {}
    if kinds:
        for number, key in enumerate(kinds):
            counts[key] = cases // len(kinds) + (number < cases % len(kinds))
    else:
        of = {"none": -(-cases // 4), "outside": -(-cases // 10), "pair": cases // 8}
        of["single"] = cases - sum(of.values())
        for kind, count in of.items():
            counts[kind, 1] = count // OTHER_PHYSICS_EVERY
            counts[kind, 0] = count - counts[kind, 1]
    for (kind, form), count in counts.items():
        base = seed * SEEDS_PER_JUDGING + KINDS.index(kind) * SEEDS_PER_KIND
        for i, effect in zip(range(count), cycle(_turn(kind, effects)), strict=False):
            yield Plan(base + i, form, kind, effect, runs)


def _sharing(
    cases: int, seed: int, runs: int, kinds: Sequence[tuple[str, int]], effects: Sequence[str], per_world: int
) -> list[list[Plan]]:
    """So many cases in each world, the last may have fewer; forms, and kinds within a form, in proportion."""
    forms = Counter(form for _, form in kinds) if kinds else {0: OTHER_PHYSICS_EVERY - 1, 1: 1}
    next_form = in_proportion(forms)
    next_kind = {
        form: in_proportion({kind: 1 for kind, of in kinds if of == form} if kinds else MIXTURE) for form in forms
    }
    next_effect = {(kind, form): cycle(_turn(kind, effects)) for kind in KINDS for form in forms}
    worlds = []
    for first in range(0, cases, per_world):
        form = next(next_form)
        world = []
        for number in range(min(per_world, cases - first)):
            kind = next(next_kind[form])
            effect = next(next_effect[kind, form])
            world.append(Plan(SHARED_FROM + seed * SEEDS_PER_JUDGING + len(worlds), form, kind, effect, runs, number))
        worlds.append(world)
    return worlds
