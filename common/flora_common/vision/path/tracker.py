"""The path method over a sequence of pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import distance_to_polyline_cm, resample_by_height
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import EmptySetup
from flora_common.vision.path import along_way, doubts, guide, length, nearby
from flora_common.vision.path.apex import Apex, Followed
from flora_common.vision.path.chain import Chain
from flora_common.vision.path.curve import Stem
from flora_common.vision.path.evidence import Evidence, PlantFinder
from flora_common.vision.path.extent import as_long_as, by_arc, in_cm, uncertainty_mm, within_plant
from flora_common.vision.path.fit import HOLDS_FROM, STEPS_BELIEVED, Fitter, Past
from flora_common.vision.path.guide import Way
from flora_common.vision.path.length import LengthState
from flora_common.vision.path.likeness import OF_FRAMES, OF_THE_FIRST, USUAL, Likeness, SetupLikeness
from flora_common.vision.path.memory import (
    DOUBTS_BELIEVED,
    LEAST_SEEN,
    Memory,
    State,
    before_of,
    doubted_for,
    is_little_known,
    remembered,
)
from flora_common.vision.path.reduced import reduced
from flora_common.vision.path.rivals import after as rivals_after
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.second_look import closely
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.sight import Sight
from flora_common.vision.path.strands import plant_mask
from flora_common.vision.path.survey import Survey, nearest_in_window
from flora_common.vision.path.tip import Tip
from flora_common.vision.picture import Picture
from flora_common.vision.reading import (
    JUMPED,
    OCCLUDED,
    OK,
    TOUCHES_EDGE,
    PictureOutcome,
    StemReading,
    bad_picture,
    no_stem,
)

FAINT, LEVEL = 15.0, 0.4
"""Code units, and rise over length."""
UNCERTAIN_TIP_MM: Final = 4.0
BLUR_PX: Final = 2.0
"""A thin stem looks wider in a photograph, by lens, JPEG and smoothing."""
FOLD_CM: Final = 0.15
COMPARED_EVERY: Final = 8
"""Of the points of a line, some px apart, one in so many is held against the line before."""
EDGE_CM: Final = 0.2
"""A tip as near to the edge of the window as this lies on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """What a picture shows at a quarter of its size, and how much of it is like the empty setup."""

    survey: Survey
    likeness: Likeness


class PathTracker:
    """Finds the stem in each of a sequence of pictures.

    Args:
        setup: the empty setup.
        camera: anchor and scale, px of the full picture.
        settings: numbers of the method.

    Attributes:
        seen: how pictures are looked at; the setup is at that size, too.

    Raises:
        BadInput: setup and camera disagree, or no pixel is left in the window.
    """

    def __init__(self, setup: EmptySetup, camera: CameraSection, settings: PathSettings | None = None) -> None:
        self.seen = reduced(camera, settings if settings is not None else PathSettings())
        self.settings, self.camera = self.seen.settings, self.seen.camera
        self._memory: Memory | None = None
        self._finder = PlantFinder(setup, self.camera, self.settings)
        # such a setup has been seen in the same light as the picture, and its ghosts have structure of their own
        self._likeness = SetupLikeness(setup, self.camera.anchor_px[1]) if setup.made_by == "background" else None
        self._demands = USUAL if self._likeness is not None else OF_FRAMES
        self._fitter = Fitter(self.camera, self.settings)
        self._doubtful_starts = 0
        self._foot_px = nearest_in_window(self.camera, self.settings)
        self._widest_px = self.seen.widest_px + BLUR_PX

    @property
    def memory(self) -> Memory | None:
        """Of the pictures before; None at first. May be set, to go on from a stored reading, or to begin anew."""
        return self._memory

    @memory.setter
    def memory(self, known: Memory | None) -> None:
        self._doubtful_starts = 0
        self._memory = known if known is not None and known.reduction == self.seen.reduction else None

    def read(self, picture: Picture, time_s: float) -> StemReading:
        """The stem in a picture, which must follow the one read before.

        Args:
            picture: shape (height, width, 3), uint8, blue-green-red, at 1/``seen.reduction`` of the full size.
            time_s: when it was taken.

        Raises:
            BadPicture: not an 8-bit colour picture of that size. The memory is unchanged.
        """
        return self.read_on(self.glance(picture), time_s)

    def glance(self, picture: Picture) -> Glance:
        """The first part of reading a picture, which is the same in whatever order pictures come.

        Raises:
            BadPicture: as :meth:`read`.
        """
        survey = self._finder.survey(picture)
        return Glance(survey, self._likeness.of(survey) if self._likeness is not None else Likeness())

    def read_on(self, glance: Glance, time_s: float) -> StemReading:
        """The rest of it, in order."""
        return self._near(glance, time_s) or self.follow(self._sight(glance), time_s)

    def look(self, picture: Picture) -> Sight:
        """What the whole picture shows, the same in whatever order pictures come.

        Raises:
            BadPicture: as :meth:`read`.
        """
        return self._sight(self.glance(picture))

    def _sight(self, glance: Glance) -> Sight:
        survey, likeness = glance.survey, glance.likeness
        evidence = self._finder.all_of(survey)
        ways: tuple[Way, ...] = ()
        if not (evidence.empty or self._demands.unmet(evidence.changed, likeness)):
            ways = guide.everywhere(evidence, np.array(self._foot_px), self.camera.px_per_cm)
        flat = survey.flat if self._likeness is not None else None
        return Sight(evidence, likeness, self.camera, self._widest_px, self._foot_px, flat, ways)

    def _near(self, glance: Glance, time_s: float) -> StemReading | None:
        """The stem where it was in the picture before; None where only the whole picture can tell."""
        survey, likeness = glance.survey, glance.likeness
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
        way = guide.near(evidence, before.line_px, scale)
        if along_way.is_usable(way):
            stem, tip = along_way.stem_along(way, sampler, scale)
        elif memory.near.is_guided:
            return None
        else:
            stem, tip = nearby.found(before.line_px, memory.near, sampler, scale, before)
        if not nearby.same_stem(stem, before, memory.seen, scale):
            return None
        belief = self._belief(stem, tip, time_s)
        final, apex = self._ended(stem, tip, sampler, followed, belief)
        if followed.is_astray(final.line[-1]):
            return None
        if doubts.badly_covered(final, sampler):
            return None
        if not along_way.is_usable(way):
            mask = plant_mask(evidence, self._widest_px)
            beyond = doubts.beyond_px(final.line, mask, evidence.origin_px, scale)
            above_cm, ahead_cm = (nearby.DOUBTS_SOONER * v / scale for v in beyond)
            if doubts.unsure_of_end(final, sampler, scale, above_cm, ahead_cm):
                return None
        near = nearby.again(memory.near, survey)
        state = State(belief, stem.length / scale, followed, apex, near, rivals=memory.rivals)
        reading, after = self._told(final, state, evidence, "", "")
        if reading.outcome != OK:
            return None
        self._memory = after
        return reading

    def follow(self, sight: Sight, time_s: float) -> StemReading:
        """The stem in what a picture shows, given those before."""
        evidence = sight.evidence
        unusable = self._demands.unmet(evidence.changed, sight.likeness)
        if unusable:
            return bad_picture(unusable)
        if evidence.empty:
            return no_stem("nothing at the anchor differs from the empty setup")
        memory, scale = self.memory, self.camera.px_per_cm
        followed = Followed(memory.apex if memory else None, evidence, time_s, scale)
        elsewhere = doubted_for(memory)
        if followed.there is not None and along_way.is_refuted(followed.there, sight.ways, scale, elsewhere=elsewhere):
            followed = Followed(None, evidence, time_s, scale)
        before = before_of(memory, time_s)
        before = before and replace(before, line_px=followed.drawn(before.line_px))
        if before is None or is_little_known(memory):
            sight = sight.with_ways(closely(evidence, np.array(self._foot_px), scale))
        sampler = Sampler(evidence)
        past = Past(memory, before, followed, time_s)
        fit = self._fitter.found(sight, sampler, past)
        if isinstance(fit, str):
            return no_stem(fit)
        fit, elsewhere = self._fitter.held(fit, sight, sampler, past)
        near = nearby.after(fit.reached, fit.sure_px, evidence, is_guided=fit.way is not None)
        by_rules = fit.chain is not None and before is not None and self._likeness is not None
        if by_rules and near.bends_from_px is None:
            again, tip = nearby.found(fit.reached.line, near, sampler, scale, before)
            if math.dist(again.line[-1], fit.reached.line[-1]) < nearby.SAME_CM * scale:
                # measured as in pictures that are looked at nearby only, so that its end does not move to and fro
                fit = replace(fit, reached=again, tip=tip)
        belief = self._belief(fit.reached, fit.tip, time_s, is_new=self._fitter.is_further(fit, past))
        final, apex = self._ended(fit.reached, fit.tip, sampler, followed, belief)
        alone = rivals_after(None, sight.ways, final.line[-1], time_s, scale)
        rivals = rivals_after(memory.rivals, sight.ways, final.line[-1], time_s, scale) if memory else alone
        told = self._fitter.judged(fit, final, sight, sampler, past, rivals)
        doubt = told.doubt or self._doubt_of_start(sight, fit.chain, final)
        unsure = told.unsure
        if followed.is_astray(final.line[-1]):
            unsure = "it ends elsewhere than the apex before, which is still to be seen"
        if elsewhere > STEPS_BELIEVED:
            unsure = "another part of the plant has looked more like the stem for some time"
        known = memory.near if memory else None
        kept = near if told.is_clear or fit.held else nearby.since_clear(known, fit.reached, before, scale)
        length_cm = fit.reached.length / scale
        state = State(belief, length_cm, followed, apex, kept, elsewhere, told.is_sure, told.petiole, rivals, alone)
        reading, self._memory = self._told(final, state, evidence, doubt, unsure)
        return reading

    def _ended(
        self, stem: Stem, tip: Tip, sampler: Sampler, followed: Followed, belief: LengthState
    ) -> tuple[Stem, Apex | None]:
        """The stem up to where its apex is believed to be, or as long as it is believed to be; and that apex."""
        if not followed.is_near(stem.line[-1]):
            scale = self.camera.px_per_cm
            stem = as_long_as(stem, within_plant(tip, sampler, scale), belief.length_cm * scale)
        line, apex = followed.believed(stem.line)
        return replace(stem, line=line), apex

    def _belief(self, stem: Stem, tip: Tip, time_s: float, *, is_new: bool = False) -> LengthState:
        """How long the stem is; ``is_new`` where what was believed before is known to be wrong."""
        scale = self.camera.px_per_cm
        before = self.memory.length if self.memory and not is_new else None
        return length.measured(before, time_s, stem.length / scale, tip.error_px / scale, hidden=not tip.open_end)

    def _doubt_of_start(self, sight: Sight, chain: Chain | None, stem: Stem) -> str:
        """A first picture must be clearer than those that follow others, unless the next ones are no clearer."""
        if self.memory is not None or self._likeness is None:
            return ""
        unmet = OF_THE_FIRST.unmet(sight.evidence.changed, sight.likeness)
        if chain is not None and chain.strength < FAINT and float(np.ptp(stem.line[:, 1])) < LEVEL * stem.length:
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
        if state.rivals is not None:
            uncertainty[-1] = math.hypot(uncertainty[-1], 10.0 * state.rivals.tip_error_cm)
        if doubt and outcome in (OK, JUMPED):
            outcome, reason = OCCLUDED, doubt
        if unsure and outcome == OK:
            outcome, reason = OCCLUDED, unsure
        memory = remembered(
            self.memory, stem.line, state, outcome, seen, doubted=bool(doubt), reduction=self.seen.reduction
        )
        line_px = self.seen.full_px(stem.line)
        folded = bool(line_cm[:, 1].max() - line_cm[-1, 1] > FOLD_CM or (np.diff(line_cm[::4, 1]) < -0.05).any())
        reading = StemReading(
            outcome,
            seen,
            points,
            (float(line_px[-1, 0]), float(line_px[-1, 1])),
            reason,
            uncertainty_mm=uncertainty,
            folded=folded,
            line_px=line_px,
            stem_pixels=evidence.plant_pixels,
        )
        return reading, memory

    def _judge(self, stem: Stem, seen: float, tip_mm: float, time_s: float) -> tuple[PictureOutcome, str]:
        scale = self.camera.px_per_cm
        if self._at_edge(stem.line[-1]):
            return TOUCHES_EDGE, "the tip lies on the edge of the window, the plant may go on beyond it"
        if self.memory is not None:
            before_cm, now_cm = np.array(self.memory.line_px) / scale, stem.line / scale
            hours = max(0.0, time_s - self.memory.length.time_s) / 3600.0
            most_cm = self.settings.jump_cm + self.settings.fastest_cm_per_h * hours
            if (moved_cm := math.dist(now_cm[-1], before_cm[-1])) > most_cm:
                return JUMPED, f"the tip is {moved_cm:.1f} cm from the one before"
            # a line that goes over to another plant may come back to the tip
            if (moved_cm := float(distance_to_polyline_cm(now_cm[::COMPARED_EVERY], before_cm).max())) > most_cm:
                return JUMPED, f"a part of the stem is {moved_cm:.1f} cm from where it was"
        if seen < LEAST_SEEN:
            return OCCLUDED, f"only {seen:.0%} of the stem can be seen"
        if tip_mm > UNCERTAIN_TIP_MM:
            return OCCLUDED, f"the tip is hidden; it may lie {tip_mm:.0f} mm off"
        return OK, ""

    def _at_edge(self, tip: FloatArray) -> bool:
        x0, y0, x1, _ = self.settings.window_px or (0.0, 0.0, self.camera.width_px - 1.0, 0.0)
        near = max(2.0, EDGE_CM * self.camera.px_per_cm)
        return bool(tip[0] <= x0 + near or tip[0] >= x1 - near or tip[1] <= y0 + near)
