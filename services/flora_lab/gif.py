"""Drawn pictures as a film that any page can show: a figure at several moments, as an animated GIF of few colours."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from PIL import Image

LAST_FRAME_MS: Final = 2500
COLOURS: Final = 48
"""Of the film's palette: edges of lines are smooth with as many, and a frame takes few bytes."""
NEARLY: Final = 8
"""Steps of 255: Pillow looks colours up in cells of 4 steps, and may take a neighbour for the colour itself."""


def pictures_of(
    figure: Figure, moving: Sequence[Artist], moments: Iterable[float], show: Callable[[float], None]
) -> list[Image.Image]:
    """A figure at several moments, RGB, laid out as it is now; only what moves is drawn for each.

    Args:
        figure: with all that moves in it.
        moving: from the back to the front.
        moments: to draw.
        show: brings what moves to where it is at a moment.
    """
    canvas: Any = figure.canvas
    canvas.draw()  # settles the layout, which must not move from picture to picture
    figure.set_layout_engine("none")
    for artist in moving:
        artist.set_visible(False)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    for artist in moving:
        artist.set_visible(True)
    pictures = []
    for moment in moments:
        canvas.restore_region(still)
        show(moment)
        for artist in moving:
            figure.draw_artist(artist)
        pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3].copy()))
    return pictures


def gif(pictures: Sequence[Image.Image], *, frame_ms: int) -> bytes:
    """All pictures in the colours of the first, a middle and the last one; the last stays for a while.

    Args:
        pictures: one or more, RGB, of one size.
        frame_ms: how long each of the others is shown.
    """
    picked = [pictures[place] for place in sorted({0, len(pictures) // 2, len(pictures) - 1})]
    wide, high = pictures[0].size
    sheet = Image.new("RGB", (wide, high * len(picked)))
    for k, picture in enumerate(picked):
        sheet.paste(picture, (0, k * high))
    palette = sheet.quantize(COLOURS, dither=Image.Dither.NONE)
    _keep_background(palette, pictures[0])
    flat = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    durations = [frame_ms] * (len(flat) - 1) + [LAST_FRAME_MS]
    data = io.BytesIO()
    flat[0].save(data, format="GIF", save_all=True, append_images=flat[1:], duration=durations, loop=0)
    return data.getvalue()


def _keep_background(palette: Image.Image, picture: Image.Image) -> None:
    """Give the corner's own colour to all of the palette's that are nearly like it: pages are of the same white."""
    exact = np.asarray(picture)[0, 0].astype(np.int64)
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[(np.abs(colours - exact) <= NEARLY).all(axis=1)] = exact
    palette.putpalette(colours.ravel().tolist())
