"""Drawn photographs of bean plants whose stems are exactly known: a second family beside the virtual grow box.

Numpy and OpenCV only, and nothing in common with the box's renderer, so that a stem finder that does well on both has
not learnt one of them. ``drawn_run`` makes runs, ``damaged`` spoils pictures, ``look.py`` shows what they look like.
"""

from drawings.damage import Damaged, damaged
from drawings.good import Good, goods
from drawings.run import drawn_run, make_world

__all__ = ["Damaged", "Good", "damaged", "drawn_run", "goods", "make_world"]
