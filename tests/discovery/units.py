"""Parameters of the worlds, and of what ``flora-lab`` tells of them: alike but where a unit is a model's own."""

from __future__ import annotations

from collections.abc import Mapping

from .worlds.effects import SAG_PER_CM3

FINDER_SAG_PER_CM3 = 0.01
"""What ``diagnosis.json`` calls a sag's amplitude of 1."""
FINDERS_OWN = {("sag", "amplitude"): SAG_PER_CM3 / FINDER_SAG_PER_CM3}
"""How many of the finder's units one of the worlds' is, by effect and parameter."""


def as_finder_tells(effect: str, parameters: Mapping[str, float]) -> dict[str, float]:
    """Parameters of a hidden effect, as ``diagnosis.json`` would tell them."""
    return {name: value * FINDERS_OWN.get((effect, name), 1.0) for name, value in parameters.items()}


def as_worlds_have(effect: str, parameters: Mapping[str, float]) -> dict[str, float]:
    """What ``diagnosis.json`` tells of an effect, as a world would draw it."""
    return {name: value / FINDERS_OWN.get((effect, name), 1.0) for name, value in parameters.items()}
