"""What a plant of a given shape and age looks like: stem, apex, petioles and leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_twin.parameters import PlantParameters
from flora_twin.render import mesh
from flora_twin.render.mesh import Leaf, Mesh

STEM_BGR: Final = np.array([0.18, 0.54, 0.47])
STEM_FOOT_BGR: Final = np.array([0.36, 0.44, 0.42])
STEM_RED_BGR: Final = np.array([0.20, 0.21, 0.42])
LEAF_BGR: Final = np.array([0.085, 0.34, 0.165])
YOUNG_LEAF_BGR: Final = np.array([0.15, 0.46, 0.31])

TIP_PAST_STEM_CM: Final = 0.08
"""How far the folded leaflets reach past the stem's end at most."""
_LEAST_NODE_CM: Final = 0.30
"""How far below the tip the youngest leaf stands at least."""
_BLUNT_CM: Final = 0.5
"""Length over which the stem's end grows thin."""
_BLUNT: Final = 0.40


@dataclass(frozen=True, slots=True)
class Subject:
    """A plant as the camera meets it.

    Attributes:
        centreline_cm: shape (n, 3), anchor first.
        leaf_nodes_cm: distance along the stem to the nodes of primary pair and trifoliate.
        age_h: hours since the start of the run.
        parameters: thickness, leaves and colour of the individual.
    """

    centreline_cm: FloatArray
    leaf_nodes_cm: tuple[float, float]
    age_h: float
    parameters: PlantParameters


@dataclass(frozen=True, slots=True)
class Foliage:
    """A plant in faces.

    Attributes:
        mesh: all faces.
        blades: the leaves that cast shadows; ``mesh.owner`` counts them.
        bud_owner: number of the first blade that belongs to the bud; all later ones do.
        line_cm: the stem's middle line (n, 3), points every 2 mm.
    """

    mesh: Mesh
    blades: list[Leaf]
    bud_owner: int
    line_cm: FloatArray


def plant(subject: Subject, eye_cm: FloatArray) -> Foliage:
    """All faces of the plant as the eye at ``eye_cm`` sees them."""
    line, arc = _fine(subject.centreline_cm)
    p = subject.parameters
    meshes = [stem_mesh(subject, eye_cm)]
    leaves = _leaves(subject, line, arc)
    bud = _bud(line, arc, p)
    blades = [leaf for leaf, _ in leaves] + bud
    for leaf, petiole in leaves:
        if len(petiole):
            thick = np.linspace(1.0, 0.78, len(petiole)) * p.petiole_radius_cm * min(1.0, 0.55 + leaf.length_cm / 7.0)
            green = np.repeat((STEM_BGR * _tint(p))[None, :], len(petiole), axis=0)
            meshes.append(mesh.tube(petiole, thick, green, eye_cm))
    meshes += [mesh.blade(blade, owner) for owner, blade in enumerate(blades)]
    return Foliage(mesh.join(meshes), blades, len(leaves), line)


def stem_mesh(subject: Subject, eye_cm: FloatArray) -> Mesh:
    """The faces of the bare stem, from the anchor to the tip and no farther."""
    line, arc = _fine(subject.centreline_cm)
    p = subject.parameters
    below_tip = arc[-1] - arc
    radius = p.tip_radius_cm + (p.base_radius_cm - p.tip_radius_cm) * -np.expm1(-below_tip / 6.0)
    end = np.clip(below_tip / _BLUNT_CM, 0.0, 1.0)
    radius = radius * (_BLUNT + (1.0 - _BLUNT) * np.sqrt(end * (2.0 - end)))
    foot = np.exp(-arc / 3.0)[:, None]
    red = p.stem_red * np.exp(-arc / 4.5)[:, None]
    young = np.exp(-below_tip / 1.5)[:, None]
    albedo = foot * STEM_FOOT_BGR + (1.0 - foot) * STEM_BGR
    albedo = (1.0 - 0.5 * young) * albedo + 0.5 * young * YOUNG_LEAF_BGR
    albedo = (1.0 - red) * albedo + red * STEM_RED_BGR
    # Lenticels, hairs and scars: a stem is not of one brightness along its length.
    spots = 0.06 * np.sin(2.9 * arc + p.irregularity) + 0.05 * np.sin(11.0 * arc + 2.0 * p.irregularity)
    return mesh.tube(line, radius, albedo * _tint(p) * (1.0 + spots)[:, None], eye_cm)


def leaves_of(subject: Subject) -> list[Leaf]:
    """The blades on petioles that :func:`plant` draws, without the bud."""
    line, arc = _fine(subject.centreline_cm)
    return [leaf for leaf, _ in _leaves(subject, line, arc)]


def _tint(p: PlantParameters) -> FloatArray:
    return np.asarray(1.0 + p.leaf_hue * np.array([0.30, 0.02, -0.10]), dtype=np.float64)


def _leaves(subject: Subject, line: FloatArray, arc: FloatArray) -> list[tuple[Leaf, FloatArray]]:
    p, age = subject.parameters, subject.age_h
    rng = np.random.default_rng([int(p.irregularity), 51])
    out: list[tuple[Leaf, FloatArray]] = []
    tint = 1.0 + 0.12 * p.leaf_hue * np.array([1.0, 0.1, -1.0])
    grown = _logistic(age, 36.0, 11.0)
    sleep = p.leaf_sleep_rad * np.sin(2 * np.pi * age / 24.0 + p.growth_rhythm_phase_rad)
    at, tangent = _node(line, arc, subject.leaf_nodes_cm[0])
    for i in range(2):
        # The two are never quite alike.
        share = grown * (1.0 if i == 0 else 0.86 + 0.12 * rng.random())
        azimuth = p.leaf_azimuth_rad + np.pi * i + 0.25 * rng.standard_normal() * i
        rise = 0.62 - 0.12 * i - 0.25 * p.leaf_droop_rad * share + 0.15 * rng.standard_normal()
        petiole, end = _petiole(at, tangent, azimuth, rise, (0.25 + 2.3 * share) * p.leaf_scale)
        length = (1.1 + 4.5 * share) * p.leaf_scale
        albedo = (share * LEAF_BGR + (1.0 - share) * YOUNG_LEAF_BGR) * tint * np.exp(0.13 * rng.standard_normal())
        pitch = -0.20 - (0.10 + p.leaf_droop_rad) * share + (0.3 + 0.7 * share) * sleep + 0.12 * rng.standard_normal()
        roll = 0.22 * rng.standard_normal()
        wave, phase = 0.015 + 0.03 * rng.random(), rng.uniform(0.0, 2 * np.pi)
        droop = 0.5 + 0.7 * rng.random()
        out.append(
            (
                _blade(end, tangent, azimuth, pitch, roll, length, 0.8 - 0.65 * share, droop, albedo, wave, phase),
                petiole,
            )
        )
    opened = _logistic(age, 54.0, 9.0)
    # It hangs from its node and leaves the tip in view, as in photographs of such plants.
    at, tangent = _node(line, arc, min(subject.leaf_nodes_cm[1], float(arc[-1]) - _LEAST_NODE_CM))
    azimuth = p.leaf_azimuth_rad + np.pi / 2 + p.leaf_turn_rad
    petiole, end = _petiole(
        at, tangent, azimuth, 0.10 - 0.3 * p.leaf_droop_rad * opened, (0.12 + 2.0 * opened) * p.leaf_scale
    )
    for turn, size in ((0.0, 1.0), (1.15, 0.86), (-1.15, 0.86)):
        albedo = (0.7 * opened * LEAF_BGR + (1.0 - 0.7 * opened) * YOUNG_LEAF_BGR) * tint
        albedo = albedo * np.exp(0.10 * rng.standard_normal())
        length = (0.45 + 2.5 * opened) * size * p.leaf_scale
        spread = turn * (0.30 + 0.70 * opened) + 0.1 * rng.standard_normal()
        pitch = -0.65 - 0.6 * p.leaf_droop_rad * opened + 0.7 * sleep * opened + 0.12 * rng.standard_normal()
        roll = 0.2 * rng.standard_normal()
        wave, phase = 0.015 + 0.03 * rng.random(), rng.uniform(0.0, 2 * np.pi)
        leaf = _blade(
            end, tangent, azimuth + spread, pitch, roll, length, 1.15 - 0.9 * opened, 0.6, albedo, wave, phase
        )
        out.append((leaf, petiole if turn == 0.0 else np.zeros((0, 3))))
    return out


def _blade(
    base: FloatArray,
    tangent: FloatArray,
    azimuth: float,
    pitch: float,
    roll: float,
    length_cm: float,
    fold_rad: float,
    droop_rad: float,
    albedo: FloatArray,
    ruffle: float,
    phase_rad: float,
) -> Leaf:
    out = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
    flat = np.array([-np.sin(azimuth), 0.0, np.cos(azimuth)])
    along = mesh.carried(np.cos(pitch) * out + np.sin(pitch) * np.array([0.0, 1.0, 0.0]), tangent)
    across = mesh.carried(flat, tangent)
    if np.cross(across, along)[1] < 0:
        across = -across  # the upper side is the one that faces up
    across = np.cos(roll) * across + np.sin(roll) * np.cross(along, across)
    return Leaf(
        base, along, across, length_cm, fold_rad, droop_rad, np.clip(albedo, 0.0, 0.9), float(ruffle), float(phase_rad)
    )


def _petiole(
    at: FloatArray, tangent: FloatArray, azimuth: float, rise_rad: float, length_cm: float
) -> tuple[FloatArray, FloatArray]:
    t = np.linspace(0.0, 1.0, 7)[:, None]
    out = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
    start = mesh.carried(np.cos(rise_rad + 0.5) * out + np.sin(rise_rad + 0.5) * np.array([0.0, 1.0, 0.0]), tangent)
    end = mesh.carried(np.cos(rise_rad - 0.5) * out + np.sin(rise_rad - 0.5) * np.array([0.0, 1.0, 0.0]), tangent)
    line = at + length_cm * ((t - 0.5 * t * t) * start + 0.5 * t * t * end)
    return line, line[-1]


def _bud(line: FloatArray, arc: FloatArray, p: PlantParameters) -> list[Leaf]:
    """Folded leaflets and stipules partly round the stem's end; they end within a millimetre of it."""
    rng = np.random.default_rng([int(p.irregularity), 52])
    around = rng.uniform(0.0, 2 * np.pi)
    tint = _tint(p)
    out: list[Leaf] = []
    # How far below the tip it stands, its angle with the stem, its length where the tip does not limit it.
    for below, lean, length, fold in ((0.52, 0.10, 0.62, 1.30), (0.40, 0.42, 0.52, 1.15), (0.85, 0.75, 0.42, 1.05)):
        below_cm = below * p.bud_scale
        at, tangent = _node(line, arc, float(arc[-1] - below_cm))
        angle = lean * np.exp(0.25 * rng.standard_normal())
        around += 2.2 + 0.5 * rng.standard_normal()
        out_of = mesh.carried(np.array([np.cos(around), 0.0, np.sin(around)]), tangent)
        along = np.cos(angle) * tangent + np.sin(angle) * out_of
        across = np.cross(along, out_of)
        across /= np.linalg.norm(across)
        longest = (below_cm + TIP_PAST_STEM_CM) / np.cos(angle)
        albedo = YOUNG_LEAF_BGR * tint * np.exp(0.12 * rng.standard_normal())
        out.append(
            Leaf(
                at + 0.6 * p.tip_radius_cm * out_of,
                along,
                across,
                min(length * p.bud_scale, longest),
                fold,
                -0.25,
                np.clip(albedo, 0.0, 0.9),
                0.03,
                float(rng.uniform(0.0, 2 * np.pi)),
            )
        )
    return out


def _node(line: FloatArray, arc: FloatArray, where_cm: float) -> tuple[FloatArray, FloatArray]:
    at = np.array([np.interp(where_cm, arc, line[:, k]) for k in range(3)])
    k = int(np.clip(np.searchsorted(arc, where_cm), 2, len(arc) - 2))
    tangent = line[k + 1] - line[k - 2]
    return at, tangent / np.linalg.norm(tangent)


def _fine(line_cm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points every 2 mm along the line, and their distance along it."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line_cm, axis=0), axis=1))])
    even = np.linspace(0.0, arc[-1], max(8, int(arc[-1] / 0.22) + 2))
    return np.stack([np.interp(even, arc, line_cm[:, k]) for k in range(3)], axis=1), even


def _logistic(age_h: float, half_h: float, width_h: float) -> float:
    return float(1.0 / (1.0 + np.exp(-(age_h - half_h) / width_h)))
