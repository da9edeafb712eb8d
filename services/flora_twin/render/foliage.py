"""What a plant of a given shape and age looks like: stem, bud, petioles and leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flora_common.geometry import FloatArray
from flora_twin.parameters import PlantParameters
from flora_twin.render import mesh
from flora_twin.render.mesh import Leaf, Mesh


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


def plant_mesh(plant: Subject, eye_cm: FloatArray) -> Mesh:
    """All faces of the plant."""
    line, arc = _fine(plant.centreline_cm)
    below_tip = arc[-1] - arc
    p = plant.parameters
    radius = p.tip_radius_cm + (p.base_radius_cm - p.tip_radius_cm) * -np.expm1(-below_tip / 6.0)
    foot = np.exp(-arc / 2.5)[:, None]
    albedo = foot * mesh.STEM_FOOT_BGR + (1.0 - foot) * mesh.STEM_BGR
    tint = 1.0 + 0.08 * p.leaf_hue * np.array([1.0, 0.2, -1.0])
    meshes = [mesh.tube(line, radius, albedo * tint, eye_cm), _bud(line, p, eye_cm)]
    for leaf, petiole in _leaves(plant, line, arc):
        if len(petiole):
            thick = np.linspace(0.085, 0.06, len(petiole)) * min(1.0, 0.45 + leaf.length_cm / 6.0)
            green = np.repeat((mesh.STEM_BGR * tint)[None, :], len(petiole), axis=0)
            meshes.append(mesh.tube(petiole, thick, green, eye_cm))
        meshes.append(mesh.blade(leaf))
    return mesh.join(meshes)


def leaves_of(plant: Subject) -> list[Leaf]:
    """The blades that :func:`plant_mesh` draws."""
    line, arc = _fine(plant.centreline_cm)
    return [leaf for leaf, _ in _leaves(plant, line, arc)]


def _leaves(plant: Subject, line: FloatArray, arc: FloatArray) -> list[tuple[Leaf, FloatArray]]:
    p, age = plant.parameters, plant.age_h
    out: list[tuple[Leaf, FloatArray]] = []
    tint = 1.0 + 0.12 * p.leaf_hue * np.array([1.0, 0.1, -1.0])
    grown = _logistic(age, 36.0, 11.0)
    at, tangent = _node(line, arc, plant.leaf_nodes_cm[0])
    for i in range(2):
        # The two are never quite alike.
        share = grown * (1.0 if i == 0 else 0.93)
        azimuth = p.leaf_azimuth_rad + np.pi * i + 0.12 * np.sin(5.0 * p.leaf_azimuth_rad + i)
        petiole, end = _petiole(at, tangent, azimuth, 0.62 - 0.12 * i, (0.25 + 2.3 * share) * p.leaf_scale)
        length = (1.1 + 4.5 * share) * p.leaf_scale
        albedo = (share * mesh.LEAF_BGR + (1.0 - share) * mesh.YOUNG_LEAF_BGR) * tint
        pitch = -0.25 - 0.40 * share
        out.append((_blade(end, tangent, azimuth, pitch, length, 0.75 - 0.6 * share, 0.7, albedo), petiole))
    opened = _logistic(age, 54.0, 9.0)
    at, tangent = _node(line, arc, plant.leaf_nodes_cm[1])
    azimuth = p.leaf_azimuth_rad + np.pi / 2 + 0.35
    petiole, end = _petiole(at, tangent, azimuth, 0.45, (0.12 + 2.0 * opened) * p.leaf_scale)
    albedo = (0.7 * opened * mesh.LEAF_BGR + (1.0 - 0.7 * opened) * mesh.YOUNG_LEAF_BGR) * tint
    for turn, size in ((0.0, 1.0), (1.15, 0.86), (-1.15, 0.86)):
        length = (0.45 + 2.5 * opened) * size * p.leaf_scale
        spread = turn * (0.35 + 0.65 * opened)
        leaf = _blade(end, tangent, azimuth + spread, -0.35 - 0.25 * opened, length, 1.0 - 0.75 * opened, 0.6, albedo)
        out.append((leaf, petiole if turn == 0.0 else np.zeros((0, 3))))
    return out


def _blade(
    base: FloatArray,
    tangent: FloatArray,
    azimuth: float,
    pitch: float,
    length_cm: float,
    fold_rad: float,
    droop_rad: float,
    albedo: FloatArray,
) -> Leaf:
    out = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
    flat = np.array([-np.sin(azimuth), 0.0, np.cos(azimuth)])
    along = mesh.carried(np.cos(pitch) * out + np.sin(pitch) * np.array([0.0, 1.0, 0.0]), tangent)
    across = mesh.carried(flat, tangent)
    if np.cross(across, along)[1] < 0:
        across = -across  # the upper side is the one that faces up
    return Leaf(base, along, across, length_cm, fold_rad, droop_rad, np.clip(albedo, 0.0, 0.9))


def _petiole(
    at: FloatArray, tangent: FloatArray, azimuth: float, rise_rad: float, length_cm: float
) -> tuple[FloatArray, FloatArray]:
    t = np.linspace(0.0, 1.0, 7)[:, None]
    out = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
    start = mesh.carried(np.cos(rise_rad + 0.5) * out + np.sin(rise_rad + 0.5) * np.array([0.0, 1.0, 0.0]), tangent)
    end = mesh.carried(np.cos(rise_rad - 0.5) * out + np.sin(rise_rad - 0.5) * np.array([0.0, 1.0, 0.0]), tangent)
    line = at + length_cm * ((t - 0.5 * t * t) * start + 0.5 * t * t * end)
    return line, line[-1]


def _bud(line: FloatArray, p: PlantParameters, eye_cm: FloatArray) -> Mesh:
    """The shoot's apex: a small blunt end on the tip, no higher than half a millimetre."""
    tangent = line[-1] - line[-2]
    tangent /= np.linalg.norm(tangent)
    t = np.linspace(-2.0, 0.5, 6)
    points = line[-1] + np.outer(t * p.tip_radius_cm, tangent)
    radius = p.tip_radius_cm * np.array([1.0, 1.12, 1.12, 1.0, 0.7, 0.25])
    return mesh.tube(points, radius, np.repeat(mesh.YOUNG_LEAF_BGR[None, :], 6, axis=0), eye_cm)


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
