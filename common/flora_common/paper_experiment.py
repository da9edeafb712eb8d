"""The experiment with real plants of Wahby et al. 2018, as both the virtual grow box and the lab repeat it.

Section "Performance of controllers in reality": the target of the task "left target", an obstacle centred 6.3 cm left
of the anchor and 12.5 cm above the soil, of the size that all the paper's obstacles have. A run ends when the tip is
about 21 cm high, which beans reach in about 72 hours (section "Evolutionary approach"), or when the plant touches the
obstacle.
"""

from __future__ import annotations

from typing import Final

from flora_common.shapes import Obstacle, Target

REALITY_TARGET: Final = Target(-5.12, 17.9)
REALITY_OBSTACLE: Final = Obstacle(-6.3, 12.5)
STOP_HEIGHT_CM: Final = 21.0
RUN_HOURS: Final = 72.0
