"""The path method over a sequence of pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import cv2
import msgspec
import numpy as np

from flora_common.geometry import FloatArray, resample_by_height
from flora_common.runs import CameraSection
from flora_common.shapes import STEM_POINTS
from flora_common.vision.lamp_states import EmptySetup
from flora_common.vision.path import curve, length, steady
from flora_common.vision.path.chain import Before, Chain, best_chain
from flora_common.vision.path.curve import Sampler, Stem, arc_length
from flora_common.vision.path.evidence import Evidence, PlantFinder, nearest_in_window
from flora_common.vision.path.length import LengthState
from flora_common.vision.path.likeness import OF_FRAMES, OF_THE_FIRST, USUAL, Likeness, SetupLikeness
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.steady import TurnState
from flora_common.vision.path.strands import Strands, find_strands
from flora_common.vision.path.tip import Tip, find_tip
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

SHORTEST_STEM_CM: Final = 0.4
LEAST_SOLID_CM: Final = 0.3
"""Of a chain of pieces that ends where no stem was before: one that hangs together less is made of coincidences."""
SAME_TIP_CM: Final = 1.0
LEAST_COVER: Final = 0.75
"""Share of the line that must lie on plant."""
REACHES_IN_CM: Final = 2.0
"""A leaf may touch the picture's sides or upper edge over this length; an arm does over more."""
EDGE_PX: Final = 3
FAINT, LEVEL = 15.0, 0.4
"""Code units, and rise over length."""
REACH_CM: Final = 0.15
"""What is nearer than twice this hangs together."""
GOES_ON_CM, GOES_ON_SHARE = 1.5, 0.5
"""Plant that hangs together with the tip and goes on above it by more than the first, and by more than this share of
the stem's length: the stem goes on in it."""
UNCERTAIN_TIP_MM: Final = 4.0
LEAST_SEEN: Final = 0.35
BLUR_PX: Final = 2.0
"""A thin stem looks wider in a photograph, by lens, JPEG and smoothing."""
FORGETS_S: Final = 900.0
"""Where the stem was counts half after this time."""
FLOOR_MM: Final = 0.1
"""Of the uncertainty: lens, anchor and scale are not known better."""
FOLD_CM: Final = 0.15
DOUBTS_BELIEVED: Final = 3
LINE_KEPT_EVERY: Final = 4
"""Points of the line that memory keeps: one in so many, some 6 px apart."""


class Memory(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the tracker knows from the pictures before; small enough to be written after each.

    Attributes:
        line_px: the stem, anchor first, tip last, px of the full picture.
        length: belief on its length.
        seen: share of it that was seen.
        doubts: readings in a row that lay elsewhere, or showed too little to be believed.
        turn: belief on which way its end points.
    """

    line_px: list[tuple[float, float]]
    length: LengthState
    seen: float = 1.0
    doubts: int = 0
    turn: TurnState | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What one picture shows, found without regard to others: can be made anywhere, in any order."""

    evidence: Evidence
    strands: Strands | None
    likeness: Likeness


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

    def read(self, picture: Picture, time_s: float) -> StemReading:
        """The stem in a picture, which must follow the one read before.

        Args:
            picture: shape (height, width, 3), uint8, blue-green-red, full size.
            time_s: when it was taken.

        Raises:
            BadPicture: not an 8-bit colour picture of the camera's size. The memory is unchanged.
        """
        return self.follow(self.look(picture), time_s)

    def look(self, picture: Picture) -> Sight:
        """What the picture shows; the larger part of the work, and the same in whatever order pictures come.

        Raises:
            BadPicture: not an 8-bit colour picture of the camera's size.
        """
        evidence = self._finder.find(picture)
        likeness = self._likeness.of(picture, evidence) if self._likeness is not None else Likeness()
        if evidence.empty:
            return Sight(evidence, None, likeness)
        widest_px = self.settings.widest_stem_cm * self.camera.px_per_cm + BLUR_PX
        return Sight(evidence, find_strands(evidence, widest_px=widest_px, foot_px=self._foot_px), likeness)

    def follow(self, sight: Sight, time_s: float) -> StemReading:
        """The stem in what a picture shows, given those before."""
        evidence, strands = sight.evidence, sight.strands
        unusable = self._demands.unmet(evidence.changed, sight.likeness)
        if unusable:
            return bad_picture(unusable)
        if strands is None:
            return no_stem("nothing at the anchor differs from the empty setup")
        scale = self.camera.px_per_cm
        before = None
        if self.memory is not None:
            trust = float(np.clip((self.memory.seen - LEAST_SEEN) / (1.0 - 2.0 * LEAST_SEEN), 0.0, 1.0))
            trust /= 1.0 + (max(0.0, time_s - self.memory.length.time_s) / FORGETS_S) ** 2
            before = Before(np.array(self.memory.line_px), trust)
        chain = best_chain(strands, self.camera, self.settings, before)
        if chain is None:
            return no_stem("no piece of stem begins near the anchor")
        if chain.solid_cm < LEAST_SOLID_CM and not self._ends_as_before(chain):
            return no_stem("what begins near the anchor is too broken to be a stem")
        sampler = Sampler(evidence)
        stem = curve.along_chain(chain, sampler, scale)
        tip = find_tip(stem, sampler, scale, before)
        reached = curve.with_tip(stem, tip.safe, tip.places, sampler, scale)
        if reached.length < SHORTEST_STEM_CM * scale:
            return no_stem(f"what stands at the anchor is only {reached.length / scale:.1f} cm long")
        belief = self._belief(reached, tip, time_s)
        final = _as_long_as(reached, tip, belief.length_cm * scale)
        final, turn = self._steadied(final, tip, time_s)
        doubt = self._doubt(final, sampler, strands) or self._doubt_of_start(sight, chain, final)
        return self._reading(final, belief, turn, evidence, doubt)

    def _ends_as_before(self, chain: Chain) -> bool:
        if self.memory is None or self.memory.seen < LEAST_SEEN:
            return False
        return math.dist(chain.points[-1], self.memory.line_px[-1]) < SAME_TIP_CM * self.camera.px_per_cm

    def _steadied(self, stem: Stem, tip: Tip, time_s: float) -> tuple[Stem, TurnState | None]:
        """The stem with its end bent to what is believed of it, and that belief."""
        scale = self.camera.px_per_cm
        measured = steady.turn_of(stem.line, steady.SECTION_CM * scale)
        if measured is None:
            return stem, None
        before = self.memory.turn if self.memory else None
        turn = steady.believed(before, time_s, measured, tip.carried_on_px / scale)
        line = steady.bent(stem.line, turn.turn_rad - measured, steady.SECTION_CM * scale)
        return replace(stem, line=line), turn

    def _belief(self, stem: Stem, tip: Tip, time_s: float) -> LengthState:
        scale = self.camera.px_per_cm
        before = self.memory.length if self.memory else None
        return length.measured(before, time_s, stem.length / scale, tip.error_px / scale, hidden=not tip.open_end)

    def _doubt(self, stem: Stem, sampler: Sampler, strands: Strands) -> str:
        """Why the line may be another thing than the whole stem, one clause; empty where nothing says so."""
        scale = self.camera.px_per_cm
        covered = float((sampler.plant(stem.line[None])[0, stem.seen] > 0).mean()) if stem.seen.any() else 0.0
        if covered < LEAST_COVER:
            return f"only {covered:.0%} of the line lies on plant"
        touching_cm = _touching_px(strands, self.camera) / scale
        if touching_cm > REACHES_IN_CM:
            return f"something wide reaches in over {touching_cm:.0f} cm of the picture's edge"
        above_cm = _above_px(stem.line, strands, round(REACH_CM * scale)) / scale
        length_cm = stem.length / scale
        if above_cm > max(GOES_ON_CM, GOES_ON_SHARE * length_cm):
            return f"the plant goes on for {above_cm:.1f} cm above a stem of {length_cm:.1f} cm"
        return ""

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

    def _reading(
        self, stem: Stem, belief: LengthState, turn: TurnState | None, evidence: Evidence, doubt: str
    ) -> StemReading:
        line_cm = self._to_cm(stem.line)
        line_cm[0] = 0.0
        points = _by_arc(line_cm) if self.settings.points == "arc" else resample_by_height(line_cm)
        tip_mm = 10.0 * math.sqrt(belief.length_var)
        uncertainty = self._uncertainty_mm(stem, line_cm, points, tip_mm)
        seen = float(stem.seen.mean())
        end = (float(stem.line[-1, 0]), float(stem.line[-1, 1]))
        outcome, reason = self._judge(stem, seen, float(uncertainty[-1]), belief.time_s)
        if doubt and outcome in (OK, JUMPED):
            outcome, reason = OCCLUDED, doubt
        self._remember(stem, belief, turn, outcome, seen, bool(doubt))
        folded = bool(line_cm[:, 1].max() - line_cm[-1, 1] > FOLD_CM or (np.diff(line_cm[::4, 1]) < -0.05).any())
        return StemReading(
            outcome,
            seen,
            points,
            end,
            reason,
            uncertainty_mm=uncertainty,
            folded=folded,
            line_px=stem.line,
            stem_pixels=int((evidence.plant > 0).sum()),
        )

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

    def _remember(
        self, stem: Stem, belief: LengthState, turn: TurnState | None, outcome: str, seen: float, doubted: bool
    ) -> None:
        if self.memory is None and doubted:
            return
        doubtful = self.memory is not None and (doubted or outcome == JUMPED or seen < LEAST_SEEN)
        doubts = self.memory.doubts + 1 if doubtful and self.memory is not None else 0
        if self.memory is not None and 0 < doubts < DOUBTS_BELIEVED:
            self.memory = msgspec.structs.replace(self.memory, doubts=doubts)
            return
        kept = [*stem.line[:-1:LINE_KEPT_EVERY], stem.line[-1]]
        # of a new place the length is known, but not what the old one's history says of it
        if doubts:
            belief = LengthState(belief.time_s, stem.length / self.camera.px_per_cm)
        self.memory = Memory([(float(x), float(y)) for x, y in kept], belief, seen, turn=turn)

    def _at_edge(self, tip: FloatArray) -> bool:
        x0, y0, x1, _ = self.settings.window_px or (0.0, 0.0, self.camera.width_px - 1.0, 0.0)
        return bool(tip[0] <= x0 + 2 or tip[0] >= x1 - 2 or tip[1] <= y0 + 2)

    def _to_cm(self, line_px: FloatArray) -> FloatArray:
        off = line_px - np.array(self.camera.anchor_px)
        return np.asarray(off * np.array([1.0, -1.0]) / self.camera.px_per_cm + 0.0, dtype=np.float64)

    def _uncertainty_mm(self, stem: Stem, line_cm: FloatArray, points: FloatArray, tip_mm: float) -> FloatArray:
        nearest = np.argmin(((points[:, None, :] - line_cm[None, :, :]) ** 2).sum(axis=2), axis=1)
        across = 10.0 * stem.deviation[nearest] / self.camera.px_per_cm
        out = np.hypot(across, FLOOR_MM)
        out[-1] = math.hypot(out[-1], tip_mm)
        return np.asarray(out, dtype=np.float64)


def _touching_px(strands: Strands, camera: CameraSection) -> float:
    """Over how many px of the picture's sides and upper edge wide parts of plant touch it."""
    (x, y), width = strands.origin_px, strands.leaf.shape[1]
    count = 0
    if x <= EDGE_PX:
        count += int(strands.leaf[:, : EDGE_PX + 1 - x].any(axis=1).sum())
    if x + width >= camera.width_px - EDGE_PX:
        count += int(strands.leaf[:, -EDGE_PX:].any(axis=1).sum())
    if y <= EDGE_PX:
        count += int(strands.leaf[: EDGE_PX + 1 - y].any(axis=0).sum())
    return float(count)


def _above_px(line: FloatArray, strands: Strands, reach_px: int) -> float:
    """How far above the whole line the plant reaches that hangs together with its last point."""
    half = strands.mask[::2, ::2]
    near = cv2.dilate(half, np.ones((max(1, reach_px) | 1,) * 2, np.uint8))
    _, labels = cv2.connectedComponents(near, connectivity=4)
    x, y = ((line[-1] - np.array(strands.origin_px)) / 2.0).round().astype(int)
    label = labels[int(np.clip(y, 0, half.shape[0] - 1)), int(np.clip(x, 0, half.shape[1] - 1))]
    rows = np.flatnonzero(((labels == label) & (half > 0)).any(axis=1)) if label else np.zeros(0)
    if rows.size == 0:
        return 0.0
    return float(line[:, 1].min() - (strands.origin_px[1] + 2 * int(rows[0])))


def _as_long_as(stem: Stem, tip: Tip, wanted_px: float) -> Stem:
    """The stem cut or carried on to a length."""
    s = arc_length(stem.line)
    if wanted_px <= s[-1] or not len(tip.onwards):
        wanted_px = min(wanted_px, s[-1])
        keep = max(4, int(np.searchsorted(s, wanted_px)))
        end = np.array([[np.interp(wanted_px, s, stem.line[:, k]) for k in range(2)]])
        line = np.concatenate([stem.line[:keep], end])
        pick = np.minimum(np.arange(len(line)), len(s) - 1)
        deviation, seen = stem.deviation[pick], stem.seen[pick]
    else:
        # from where the smooth line ends, not from where the arc did
        more = tip.onwards - (tip.places[-1] if len(tip.places) else stem.line[tip.safe]) + stem.line[-1]
        further = s[-1] + arc_length(np.concatenate([stem.line[-1:], more]))[1:]
        take = further <= wanted_px
        line = np.concatenate([stem.line, more[take][::3]])
        extra = len(line) - len(stem.line)
        grown = stem.deviation[-1] + 0.15 * (arc_length(line)[-extra:] - s[-1]) if extra else np.zeros(0)
        deviation = np.concatenate([stem.deviation, grown])
        seen = np.concatenate([stem.seen, np.zeros(extra, dtype=np.bool_)])
        pick = np.minimum(np.arange(len(line)), len(s) - 1)
    return Stem(line, deviation, seen, stem.clean[pick] & seen, stem.width[pick], float(arc_length(line)[-1]))


def _by_arc(line_cm: FloatArray) -> FloatArray:
    """Ten points evenly spaced along the stem."""
    s = arc_length(line_cm)
    even = np.linspace(0.0, s[-1], STEM_POINTS)
    return np.column_stack([np.interp(even, s, line_cm[:, k]) for k in range(2)])
