"""Form 0: the plant that a modeller would write down first.

A stem in the picture plane. Curvature changes in a zone of about 6 cm below the tip, evenly, ending within a
centimetre; elongation likewise. The response to light is linear in its brightness (no Weber-Fechner law), and light
falls with the first power of the distance, as it does from long lamps between bright walls. Gravity is felt as the sine
of the lean. Light acts after about a quarter of an hour, by two equal stages.

Rates are such that the tip swings over several centimetres within two hours of a switch of lamps at 15 cm of height
(Wahby et al. 2018), and the stem grows from 6.5 to 21 cm in 72 h.
"""

from __future__ import annotations

from .scene import Laws, Plant


def laws_and_plant() -> tuple[Laws, Plant]:
    """The laws and the typical plant of form 0."""
    return Laws(), Plant()
