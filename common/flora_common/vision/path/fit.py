"""The stem in what one picture shows, given those before: the network's way, a chain of pieces, or where it was.

The network's way is taken where it is sure of its end; else the chain of pieces that looks most like a stem. Either is
held against the picture before: a leaf that is taken for the tip in one picture is not in the next ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.geometry import arc_length
from flora_common.runs import CameraSection
from flora_common.vision.path import along_way, curve, doubts, forks, guide, nearby, neighbours
from flora_common.vision.path.apex import Followed
from flora_common.vision.path.chain import Before, Chain, best_chain
from flora_common.vision.path.curve import Stem
from flora_common.vision.path.guide import Way
from flora_common.vision.path.memory import ASTRAY_BELIEVED, LEAST_SEEN, Memory, doubted_for
from flora_common.vision.path.rivals import Rivals
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.sight import Sight
from flora_common.vision.path.strands import Strands
from flora_common.vision.path.tip import Tip, find_tip, round_bends

MOST_BENDS: Final = 3
SHORTEST_STEM_CM: Final = 0.4
LEAST_SOLID_CM: Final = 0.3
"""Of a chain of pieces that ends where no stem was before: one that hangs together less is made of coincidences."""
SAME_TIP_CM: Final = 1.0
CLEAR_CHOICE_CM: Final = 0.75
"""By so much the best chain must be better than any other, in a picture by itself."""
STEPS_BELIEVED: Final = 4
"""After so many pictures in a row that say so it is the stem all the same."""
HOLDS_FROM, HOLDING_TRUST = 0.4, 4.0
"""Only a stem that was seen well and lately is held to, and then so much more than usually."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A stem, and how it was found.

    Attributes:
        tip: where it ends.
        reached: the smooth line to there.
        sure_px: distance from the anchor up to which it was measured.
        chain: the pieces that it was found along; None where the network told its way.
        way: that way.
        held: whether it is the stem of the picture before.
    """

    tip: Tip
    reached: Stem
    sure_px: float
    chain: Chain | None = None
    way: Way | None = None
    held: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Past:
    """What is known from the pictures before.

    Attributes:
        memory: all of it; None in the first picture.
        before: the stem, its end where its apex is now; None where it is not believed.
        followed: that apex.
        time_s: of this picture.
    """

    memory: Memory | None
    before: Before | None
    followed: Followed
    time_s: float


@dataclass(frozen=True, slots=True)
class Judged:
    """What speaks against a stem in a picture.

    Attributes:
        doubt: why it may be no stem, one clause; empty where nothing says so.
        unsure: why it may be another part of the plant, or end elsewhere.
        is_clear: whether this picture by itself makes clear which part of the plant it is.
        is_sure: whether that is clear from this picture or those before.
        petiole: for how many more clear pictures it is doubted as a petiole.
    """

    doubt: str
    unsure: str
    is_clear: bool
    is_sure: bool
    petiole: int = 0


class Fitter:
    """Finds stems in what pictures show.

    Args:
        camera: anchor and scale, px of the full picture.
        settings: numbers of the method.
    """

    def __init__(self, camera: CameraSection, settings: PathSettings) -> None:
        self._camera, self._settings, self._scale = camera, settings, camera.px_per_cm

    def found(self, sight: Sight, sampler: Sampler, past: Past) -> Fit | str:
        """What looks most like the stem, or why nothing does."""
        return self._by_way(sight, sampler, past) or self._by_chain(sight, sampler, past.before, past.memory)

    def _by_way(self, sight: Sight, sampler: Sampler, past: Past) -> Fit | None:
        before, scale = past.before, self._scale
        way = along_way.chosen(sight.ways, before, scale)
        if before is not None and along_way.cuts_short(way, before, scale):
            # a known stem goes on behind what hides a part of it, where its apex is still to be seen
            known = guide.near(sight.evidence, before.line_px, scale)
            way = max(way, known, key=lambda one: along_way.worth(one, before, scale))
        if not along_way.is_usable(way):
            return None
        stem, tip = along_way.stem_along(way, sampler, scale)
        if stem.length < SHORTEST_STEM_CM * scale:
            return None
        return Fit(tip, stem, float(arc_length(stem.line)[min(tip.safe, len(stem.line) - 1)]), way=way)

    def _by_chain(self, sight: Sight, sampler: Sampler, before: Before | None, memory: Memory | None) -> Fit | str:
        scale = self._scale
        chain = best_chain(sight.strands, self._camera, self._settings, before)
        if chain is None:
            return "no piece of stem begins near the anchor"
        if chain.solid_cm < LEAST_SOLID_CM and not self._ends_as_before(chain, memory):
            return "what begins near the anchor is too broken to be a stem"
        stem = curve.along_chain(chain, sampler, scale)
        tip = find_tip(stem, sampler, scale, before)
        for _ in range(MOST_BENDS):
            band = round_bends(stem, tip, sampler, scale, before)
            if not len(band):
                break
            stem = curve.round_bend(stem, tip.safe, band, sampler, scale)
            tip = find_tip(stem, sampler, scale, before)
        reached = curve.with_tip(stem, tip.safe, tip.places, sampler, scale)
        if reached.length < SHORTEST_STEM_CM * scale:
            return f"what stands at the anchor is only {reached.length / scale:.1f} cm long"
        return Fit(tip, reached, float(arc_length(stem.line)[tip.safe]), chain=chain)

    def _ends_as_before(self, chain: Chain, memory: Memory | None) -> bool:
        if memory is None or memory.seen < LEAST_SEEN:
            return False
        return math.dist(chain.points[-1], memory.line_px[-1]) < SAME_TIP_CM * self._scale

    def held(self, fit: Fit, sight: Sight, sampler: Sampler, past: Past) -> tuple[Fit, int]:
        """The same, unless its tip is farther from the one before than any grows and the old place shows a stem too.

        Then that, and for how many pictures in a row it was preferred: a leaf that is taken for the tip in one picture
        is not in the next ones, and a stem that was mistaken is. A stem that gets to the same tip by a detour is not
        counted, for the old one is plainly better; an apex that was never plain to see is not held to.
        """
        memory, before, followed, scale = past.memory, past.before, past.followed, self._scale
        if memory is None or before is None or before.trust < HOLDS_FROM:
            return fit, 0
        hours = max(0.0, past.time_s - memory.length.time_s) / 3600.0
        most_px = (nearby.STEP_CM + nearby.STEP_SHARE * self._settings.fastest_cm_per_h * hours) * scale
        count, near, seen = memory.elsewhere, memory.near, memory.seen
        if math.dist(fit.reached.line[-1], before.line_px[-1]) <= most_px:
            if near is not None and nearby.is_detour(fit.reached, before, scale):
                stem, tip = nearby.found(before.line_px, near, sampler, scale, before)
                if nearby.same_stem(stem, before, seen, scale):
                    return replace(fit, tip=tip, reached=stem, sure_px=near.sure_px, held=True), 0
            return fit, 0
        if followed.there is not None and not followed.is_known:
            return fit, 0
        if fit.way is not None and along_way.is_refuted(
            before.line_px[-1], sight.ways, scale, elsewhere=doubted_for(memory)
        ):
            return fit, 0
        late = count >= (ASTRAY_BELIEVED if followed.is_known else STEPS_BELIEVED)
        if near is not None:
            there = nearby.still_there(before, near, seen, fit.reached, sampler, scale, only_plain=late)
            if there is not None and fit.way is not None and along_way.agrees(fit.way, there[0], scale):
                return fit, 0
            if there is not None:
                return replace(fit, tip=there[1], reached=there[0], sure_px=near.sure_px, held=True), count + 1
        if not late:
            again = self._by_chain(sight, sampler, replace(before, trust=HOLDING_TRUST), memory)
            if not isinstance(again, str) and math.dist(again.reached.line[-1], before.line_px[-1]) <= most_px:
                return again, count + 1
        return fit, 0

    def is_further(self, fit: Fit, past: Past) -> bool:
        """Whether the stem goes on beyond where it was believed to end in the picture before."""
        return (
            fit.way is not None
            and past.before is not None
            and along_way.is_passed(past.before.line_px[-1], [fit.way], self._scale)
        )

    def judged(self, fit: Fit, final: Stem, sight: Sight, sampler: Sampler, past: Past, rivals: Rivals) -> Judged:
        """What speaks against a stem.

        Args:
            fit: as it was found.
            final: as it will be told, its end where all pictures together say.
            sight, sampler: of the picture.
            past: what is known from the pictures before.
            rivals: how likely its end and others have been lately, this picture included.
        """
        if fit.way is not None:
            return self._way_judged(fit.way, fit, final, sight, sampler, past, rivals)
        assert fit.chain is not None
        told = self._chain_judged(fit.chain, final, sight, sampler, past)
        way = along_way.chosen(sight.ways, past.before, self._scale)
        # rules by themselves follow a stem that crosses the plant's own, or a part of it
        looks_like_one = rivals.here >= along_way.USABLE and along_way.agrees(way, final, self._scale)
        if not told.unsure and (past.before is None or not looks_like_one):
            return replace(told, unsure=doubts.NO_APEX)
        if not told.unsure and (rivals.are_strong or rivals.are_hidden):
            return replace(told, unsure=doubts.ANOTHER_PART if rivals.are_strong else doubts.HIDDEN_END)
        return told

    def _way_judged(
        self, way: Way, fit: Fit, final: Stem, sight: Sight, sampler: Sampler, past: Past, rivals: Rivals
    ) -> Judged:
        scale, is_first = self._scale, past.before is None
        unsure = along_way.unsure(way, fit.reached, past.before, scale)
        if rivals.are_strong:
            unsure = unsure or doubts.ANOTHER_PART
        if is_first and not unsure:
            strength, width = float(np.median(sampler.plant(final.line))), float(np.median(final.width))
            pieces = sight.strands.pieces
            if neighbours.another_stem(final.line, strength, width, pieces, self._camera):
                unsure = neighbours.BESIDE
            elif neighbours.goes_over(final.line, strength, pieces, self._camera):
                unsure = neighbours.GOES_OVER
            else:
                unsure = doubts.hides_more(final.line, sight.flat, scale)
        if fit.held:
            unsure = doubts.ANOTHER_PART
        # the lower part of a stem that sinks into noise is as plain as any, up to where it sinks
        sinks = doubts.sinks(final.line, sight.flat, scale)
        fades = doubts.fades(final, sampler, scale, may_be_steady=not (is_first and sinks), may_be_paler=not sinks)
        unsure = fades or doubts.ends_in_leaf(final, sampler, scale) or unsure
        if not unsure and rivals.are_hidden:
            unsure = doubts.HIDDEN_END
        if not unsure and not self._is_plain(way, final, sight, sampler, past):
            unsure = "where it ends is not plain to see"
        doubt = doubts.doubt(final, sampler, scale, touching_cm=sight.touching_cm, above_cm=0.0)
        return Judged(doubt, unsure, is_clear=not unsure, is_sure=not (is_first and unsure))

    def _is_plain(self, way: Way, final: Stem, sight: Sight, sampler: Sampler, past: Past) -> bool:
        """Whether the end of a way is believed: it is likely, was plain to see before, or the rules come to it."""
        is_first = past.before is None
        if along_way.is_believed(way, is_first=is_first):
            return True
        if way.sure >= along_way.SURE_AGAIN and past.followed.is_known and past.followed.is_near(final.line[-1]):
            return True
        other = self._by_chain(sight, sampler, past.before, past.memory)
        if isinstance(other, str) or not along_way.agrees(way, other.reached, self._scale):
            return False
        if along_way.is_believed_of_two(way, is_first=is_first):
            return True
        if is_first:
            return False
        assert other.chain is not None
        told = self._chain_judged(other.chain, other.reached, sight, sampler, past)
        return not (told.unsure or told.doubt)

    def _chain_judged(self, chain: Chain, final: Stem, sight: Sight, sampler: Sampler, past: Past) -> Judged:
        scale, camera, strands = self._scale, self._camera, sight.strands
        above_cm, ahead_cm = (v / scale for v in doubts.beyond_px(final.line, strands.mask, strands.origin_px, scale))
        unseen_cm = doubts.longest_gap_px(chain) / scale
        alone = chain.worth_cm - chain.rival_cm > CLEAR_CHOICE_CM
        petiole = self._petiole(final, strands, past.memory)
        sure = past.before is not None or (alone and unseen_cm < doubts.LONGEST_UNSEEN_CM and not petiole)
        unsure = "" if sure else doubts.ANOTHER_PART
        if alone and not sure:
            unsure = doubts.unseen(unseen_cm)
        width = float(np.nanmedian(chain.width))
        if neighbours.another_stem(chain.points, chain.strength, width, strands.pieces, camera):
            unsure = neighbours.BESIDE
        elif past.before is None and neighbours.goes_over(final.line, chain.strength, strands.pieces, camera):
            unsure = neighbours.GOES_OVER
        if doubts.begins_aside(chain, camera):
            unsure = doubts.BEGINS_ASIDE
        if petiole:
            unsure = "it bears nothing but one leaf from a fork on, as a petiole does"
        unsure = unsure or doubts.unsure_of_end(final, sampler, scale, above_cm, ahead_cm)
        if past.before is None and not unsure:
            unsure = doubts.hides_more(final.line, sight.flat, scale)
        doubt = doubts.doubt(final, sampler, scale, touching_cm=sight.touching_cm, above_cm=above_cm)
        return Judged(doubt, unsure, alone, sure, petiole)

    def _petiole(self, stem: Stem, strands: Strands, memory: Memory | None) -> int:
        """For how many more clear pictures a line is doubted, because it is, or was, a petiole's."""
        same = memory is not None and math.dist(stem.line[-1], memory.line_px[-1]) < SAME_TIP_CM * self._scale
        before = memory.petiole if memory is not None and same else 0
        is_petiole = math.isfinite(forks.petiole_from(stem.line, strands, self._scale))
        return forks.doubted_for(before, is_petiole=is_petiole)
