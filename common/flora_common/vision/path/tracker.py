"""The path method over a sequence of pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from flora_common.geometry import FloatArray, resample_by_height
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import EmptySetup
from flora_common.vision.path import curve, doubts, forks, length, nearby
from flora_common.vision.path.apex import Apex, Followed
from flora_common.vision.path.chain import Before, Chain, best_chain
from flora_common.vision.path.curve import Sampler, Stem, arc_length
from flora_common.vision.path.evidence import Evidence, PlantFinder
from flora_common.vision.path.extent import as_long_as, by_arc, in_cm, uncertainty_mm
from flora_common.vision.path.length import LengthState
from flora_common.vision.path.likeness import OF_FRAMES, OF_THE_FIRST, USUAL, Likeness, SetupLikeness
from flora_common.vision.path.memory import (
    ASTRAY_BELIEVED,
    DOUBTS_BELIEVED,
    LEAST_SEEN,
    Memory,
    State,
    before_of,
    remembered,
)
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.strands import Strands, find_strands, plant_mask
from flora_common.vision.path.survey import Survey, nearest_in_window
from flora_common.vision.path.tip import Tip, find_tip, round_bends
from flora_common.vision.picture import Picture
from flora_common.vision.reading import (
    JUMPED,
    OCCLUDED,
    OK,
    TOUCHES_EDGE,
    StemReading,
    bad_picture,
    no_stem,
)

MOST_BENDS: Final = 3
SHORTEST_STEM_CM: Final = 0.4
LEAST_SOLID_CM: Final = 0.3
"""Of a chain of pieces that ends where no stem was before: one that hangs together less is made of coincidences."""
SAME_TIP_CM: Final = 1.0
FAINT, LEVEL = 15.0, 0.4
"""Code units, and rise over length."""
CLEAR_CHOICE_CM: Final = 0.75
"""By so much the best chain must be better than any other, in a picture by itself."""
UNCERTAIN_TIP_MM: Final = 4.0
BLUR_PX: Final = 2.0
"""A thin stem looks wider in a photograph, by lens, JPEG and smoothing."""
FOLD_CM: Final = 0.15
STEPS_BELIEVED: Final = 4
"""After so many pictures in a row that say so it is the stem all the same."""
HOLDS_FROM, HOLDING_TRUST = 0.4, 4.0
"""Only a stem that was seen well and lately is held to, and then so much more than usually."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What one picture shows, found without regard to others: can be made anywhere, in any order."""

    evidence: Evidence
    strands: Strands | None
    likeness: Likeness


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A chain of pieces, where it ends, and the smooth line to there; or, ``held``, the stem of the picture before."""

    chain: Chain
    tip: Tip
    reached: Stem
    sure_px: float
    held: bool = False


class PathTracker:
    """Finds the stem in each of a sequence of pictures.

    Args:
        setup: the empty setup.
        camera: anchor and scale, px of the full picture.
        settings: numbers of the method.

    Attributes:
        memory: of the pictures before; None at first. May be set, to go on from a stored reading.

    Raises:
        BadInput: setup and camera disagree, or no pixel is left in the window.
    """

    def __init__(self, setup: EmptySetup, camera: CameraSection, settings: PathSettings | None = None) -> None:
        self.settings = settings if settings is not None else PathSettings()
        self.camera = camera
        self.memory: Memory | None = None
        self._finder = PlantFinder(setup, camera, self.settings)
        # such a setup has been seen in the same light as the picture, and its ghosts have structure of their own
        self._likeness = SetupLikeness(setup, camera.anchor_px[1]) if setup.made_by == "background" else None
        self._demands = USUAL if self._likeness is not None else OF_FRAMES
        self._doubtful_starts = 0
        self._foot_px = nearest_in_window(camera, self.settings)
        self._widest_px = self.settings.widest_stem_cm * camera.px_per_cm + BLUR_PX

    def read(self, picture: Picture, time_s: float) -> StemReading:
        """The stem in a picture, which must follow the one read before.

        Args:
            picture: shape (height, width, 3), uint8, blue-green-red, full size.
            time_s: when it was taken.

        Raises:
            BadPicture: not an 8-bit colour picture of the camera's size. The memory is unchanged.
        """
        survey, likeness = self._surveyed(picture)
        return self._near(survey, likeness, time_s) or self.follow(self._sight(survey, likeness), time_s)

    def look(self, picture: Picture) -> Sight:
        """What the whole picture shows; the larger part of the work, and the same in whatever order pictures come.

        Raises:
            BadPicture: not an 8-bit colour picture of the camera's size.
        """
        return self._sight(*self._surveyed(picture))

    def _surveyed(self, picture: Picture) -> tuple[Survey, Likeness]:
        survey = self._finder.survey(picture)
        return survey, self._likeness.of(survey) if self._likeness is not None else Likeness()

    def _sight(self, survey: Survey, likeness: Likeness) -> Sight:
        evidence = self._finder.all_of(survey)
        if evidence.empty:
            return Sight(evidence, None, likeness)
        return Sight(evidence, find_strands(evidence, widest_px=self._widest_px, foot_px=self._foot_px), likeness)

    def _near(self, survey: Survey, likeness: Likeness, time_s: float) -> StemReading | None:
        """The stem where it was in the picture before; None where only the whole picture can tell."""
        memory, scale = self.memory, self.camera.px_per_cm
        before = before_of(memory, time_s)
        if memory is None or memory.near is None or before is None or memory.doubts or memory.elsewhere:
            return None
        late = not 0.0 <= time_s - memory.length.time_s <= nearby.LONGEST_S
        if late or before.trust < HOLDS_FROM or self._demands.unmet(survey.changed, likeness):
            return None
        part = nearby.part_of(before.line_px, self._finder.box, scale)
        if not nearby.enough(memory.near, before.line_px, survey, part, scale):
            return None
        evidence = self._finder.part(survey, *part, noise=memory.near.noise)
        followed = Followed(memory.apex, evidence, time_s, scale)
        before = replace(before, line_px=followed.drawn(before.line_px))
        sampler = Sampler(evidence)
        stem, tip = nearby.found(before.line_px, memory.near, sampler, scale, before)
        if not nearby.same_stem(stem, before, memory.seen, scale):
            return None
        belief = self._belief(stem, tip, time_s)
        final, apex = self._ended(stem, tip, followed, belief)
        if followed.is_astray(final.line[-1]):
            return None
        mask = plant_mask(evidence, self._widest_px)
        beyond = doubts.beyond_px(final.line, mask, evidence.origin_px, scale)
        above_cm, ahead_cm = (nearby.DOUBTS_SOONER * v / scale for v in beyond)
        if doubts.badly_covered(final, sampler) or doubts.unsure_of_end(final, sampler, scale, above_cm, ahead_cm):
            return None
        near = msgspec.structs.replace(memory.near, looks=memory.near.looks + 1)
        state = State(belief, stem.length / scale, followed, apex, near)
        reading, after = self._told(final, state, evidence, "", "")
        if reading.outcome != OK:
            return None
        self.memory = after
        return reading

    def follow(self, sight: Sight, time_s: float) -> StemReading:
        """The stem in what a picture shows, given those before."""
        evidence, strands = sight.evidence, sight.strands
        unusable = self._demands.unmet(evidence.changed, sight.likeness)
        if unusable:
            return bad_picture(unusable)
        if strands is None:
            return no_stem("nothing at the anchor differs from the empty setup")
        scale = self.camera.px_per_cm
        followed = Followed(self.memory.apex if self.memory else None, evidence, time_s, scale)
        before = before_of(self.memory, time_s)
        before = before and replace(before, line_px=followed.drawn(before.line_px))
        sampler = Sampler(evidence)
        fit = self._fitted(strands, sampler, before)
        if isinstance(fit, str):
            return no_stem(fit)
        fit, elsewhere = self._held(fit, strands, sampler, before, time_s, followed)
        near = nearby.after(fit.reached, fit.sure_px, evidence)
        again, tip = nearby.found(fit.reached.line, near, sampler, scale, before)
        same = math.dist(again.line[-1], fit.reached.line[-1]) < nearby.SAME_CM * scale
        if same and before is not None and self._likeness is not None and near.bends_from_px is None:
            # measured as in pictures that are looked at nearby only, so that its end does not move to and fro
            fit = replace(fit, reached=again, tip=tip)
        belief = self._belief(fit.reached, fit.tip, time_s)
        final, apex = self._ended(fit.reached, fit.tip, followed, belief)
        above_cm, ahead_cm = (v / scale for v in doubts.beyond_px(final.line, strands.mask, strands.origin_px, scale))
        doubt = doubts.doubt(final, sampler, strands, self.camera, above_cm)
        doubt = doubt or self._doubt_of_start(sight, fit.chain, final)
        unseen_cm = doubts.longest_gap_px(fit.chain) / scale
        alone = fit.chain.worth_cm - fit.chain.rival_cm > CLEAR_CHOICE_CM
        petiole = self._petiole(final, strands)
        sure = before is not None or (alone and unseen_cm < doubts.LONGEST_UNSEEN_CM and not petiole)
        unsure = "" if sure else "another part of the plant may as well be the stem"
        if alone and not sure:
            unsure = f"nothing is seen of it over {unseen_cm:.1f} cm; what goes on may be another plant"
        if doubts.another_stem(fit.chain, strands, self.camera):
            unsure = "something else rises beside the anchor as a stem does"
        if doubts.begins_aside(fit.chain, self.camera):
            unsure = "it begins beside the anchor, as another plant does"
        if followed.is_astray(final.line[-1]):
            unsure = "it ends elsewhere than the apex before, which is still to be seen"
        if elsewhere > STEPS_BELIEVED:
            unsure = "another part of the plant has looked more like the stem for some time"
        if petiole:
            unsure = "it bears nothing but one leaf from a fork on, as a petiole does"
        unsure = unsure or doubts.unsure_of_end(final, sampler, scale, above_cm, ahead_cm)
        known = self.memory.near if self.memory is not None else None
        kept = near if alone or fit.held else nearby.since_clear(known, fit.reached, before, scale)
        state = State(belief, fit.reached.length / scale, followed, apex, kept, elsewhere, sure, petiole)
        reading, self.memory = self._told(final, state, evidence, doubt, unsure)
        return reading

    def _petiole(self, stem: Stem, strands: Strands) -> int:
        """For how many more clear pictures a line is doubted, because it is, or was, a petiole's."""
        scale, memory = self.camera.px_per_cm, self.memory
        same = memory is not None and math.dist(stem.line[-1], memory.line_px[-1]) < SAME_TIP_CM * scale
        before = memory.petiole if memory is not None and same else 0
        return forks.doubted_for(before, is_petiole=math.isfinite(forks.petiole_from(stem.line, strands, scale)))

    def _fitted(self, strands: Strands, sampler: Sampler, before: Before | None) -> _Fit | str:
        """What looks most like the stem, or why nothing does."""
        scale = self.camera.px_per_cm
        chain = best_chain(strands, self.camera, self.settings, before)
        if chain is None:
            return "no piece of stem begins near the anchor"
        if chain.solid_cm < LEAST_SOLID_CM and not self._ends_as_before(chain):
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
        return _Fit(chain, tip, reached, float(arc_length(stem.line)[tip.safe]))

    def _held(
        self,
        fit: _Fit,
        strands: Strands,
        sampler: Sampler,
        before: Before | None,
        time_s: float,
        followed: Followed,
    ) -> tuple[_Fit, int]:
        """The same, unless its tip is farther from the one before than any grows and the old place shows a stem too.

        Then that, and for how many pictures in a row it was preferred: a leaf that is taken for the tip in one picture
        is not in the next ones, and a stem that was mistaken is. A stem that gets to the same tip by a detour is not
        counted, for the old one is plainly better; an apex that was never plain to see is not held to.
        """
        if self.memory is None or before is None or before.trust < HOLDS_FROM:
            return fit, 0
        scale = self.camera.px_per_cm
        hours = max(0.0, time_s - self.memory.length.time_s) / 3600.0
        most_px = (nearby.STEP_CM + nearby.STEP_SHARE * self.settings.fastest_cm_per_h * hours) * scale
        count, near, seen = self.memory.elsewhere, self.memory.near, self.memory.seen
        if math.dist(fit.reached.line[-1], before.line_px[-1]) <= most_px:
            if near is not None and nearby.is_detour(fit.reached, before, scale):
                stem, tip = nearby.found(before.line_px, near, sampler, scale, before)
                if nearby.same_stem(stem, before, seen, scale):
                    return _Fit(fit.chain, tip, stem, near.sure_px, held=True), 0
            return fit, 0
        if followed.there is not None and not followed.is_known:
            return fit, 0
        late = count >= (ASTRAY_BELIEVED if followed.is_known else STEPS_BELIEVED)
        if near is not None:
            there = nearby.still_there(before, near, seen, fit.reached, sampler, scale, only_plain=late)
            if there is not None:
                return _Fit(fit.chain, there[1], there[0], near.sure_px, held=True), count + 1
        if not late:
            again = self._fitted(strands, sampler, replace(before, trust=HOLDING_TRUST))
            if not isinstance(again, str) and math.dist(again.reached.line[-1], before.line_px[-1]) <= most_px:
                return again, count + 1
        return fit, 0

    def _ends_as_before(self, chain: Chain) -> bool:
        if self.memory is None or self.memory.seen < LEAST_SEEN:
            return False
        return math.dist(chain.points[-1], self.memory.line_px[-1]) < SAME_TIP_CM * self.camera.px_per_cm

    def _ended(self, stem: Stem, tip: Tip, followed: Followed, belief: LengthState) -> tuple[Stem, Apex | None]:
        """The stem up to where its apex is believed to be, or as long as it is believed to be; and that apex."""
        if not followed.is_near(stem.line[-1]):
            stem = as_long_as(stem, tip, belief.length_cm * self.camera.px_per_cm)
        line, apex = followed.believed(stem.line)
        return replace(stem, line=line), apex

    def _belief(self, stem: Stem, tip: Tip, time_s: float) -> LengthState:
        scale = self.camera.px_per_cm
        before = self.memory.length if self.memory else None
        return length.measured(before, time_s, stem.length / scale, tip.error_px / scale, hidden=not tip.open_end)

    def _doubt_of_start(self, sight: Sight, chain: Chain, stem: Stem) -> str:
        """A first picture must be clearer than those that follow others, unless the next ones are no clearer."""
        if self.memory is not None or self._likeness is None:
            return ""
        unmet = OF_THE_FIRST.unmet(sight.evidence.changed, sight.likeness)
        strength = float(np.median(np.concatenate([piece.strength for piece in chain.pieces])))
        if strength < FAINT and float(np.ptp(stem.line[:, 1])) < LEVEL * stem.length:
            unmet = unmet or "what begins at the anchor lies level and is faint, as the edges of soil and pot are"
        self._doubtful_starts = self._doubtful_starts + 1 if unmet else 0
        return unmet if self._doubtful_starts < DOUBTS_BELIEVED else ""

    def _told(
        self, stem: Stem, state: State, evidence: Evidence, doubt: str, unsure: str
    ) -> tuple[StemReading, Memory | None]:
        """The reading, and what is remembered after it."""
        belief = state.length
        line_cm = in_cm(stem.line, self.camera)
        points = by_arc(line_cm) if self.settings.points == "arc" else resample_by_height(line_cm)
        tip_mm = 10.0 * math.sqrt(belief.length_var)
        uncertainty = uncertainty_mm(stem, line_cm, points, tip_mm, self.camera.px_per_cm)
        seen = float(stem.seen.mean())
        outcome, reason = self._judge(stem, seen, float(uncertainty[-1]), belief.time_s)
        if doubt and outcome in (OK, JUMPED):
            outcome, reason = OCCLUDED, doubt
        if unsure and outcome == OK:
            outcome, reason = OCCLUDED, unsure
        memory = remembered(self.memory, stem.line, state, outcome, seen, doubted=bool(doubt))
        folded = bool(line_cm[:, 1].max() - line_cm[-1, 1] > FOLD_CM or (np.diff(line_cm[::4, 1]) < -0.05).any())
        reading = StemReading(
            outcome,
            seen,
            points,
            (float(stem.line[-1, 0]), float(stem.line[-1, 1])),
            reason,
            uncertainty_mm=uncertainty,
            folded=folded,
            line_px=stem.line,
            stem_pixels=evidence.plant_pixels,
        )
        return reading, memory

    def _judge(self, stem: Stem, seen: float, tip_mm: float, time_s: float) -> tuple[str, str]:
        scale = self.camera.px_per_cm
        if self._at_edge(stem.line[-1]):
            return TOUCHES_EDGE, "the tip lies on the edge of the window, the plant may go on beyond it"
        if self.memory is not None:
            moved_cm = math.dist(stem.line[-1], self.memory.line_px[-1]) / scale
            hours = max(0.0, time_s - self.memory.length.time_s) / 3600.0
            if moved_cm > self.settings.jump_cm + self.settings.fastest_cm_per_h * hours:
                return JUMPED, f"the tip is {moved_cm:.1f} cm from the one before"
        if seen < LEAST_SEEN:
            return OCCLUDED, f"only {seen:.0%} of the stem can be seen"
        if tip_mm > UNCERTAIN_TIP_MM:
            return OCCLUDED, f"the tip is hidden; it may lie {tip_mm:.0f} mm off"
        return OK, ""

    def _at_edge(self, tip: FloatArray) -> bool:
        x0, y0, x1, _ = self.settings.window_px or (0.0, 0.0, self.camera.width_px - 1.0, 0.0)
        return bool(tip[0] <= x0 + 2 or tip[0] >= x1 - 2 or tip[1] <= y0 + 2)
