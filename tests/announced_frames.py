"""What flora-capture says of a photograph that is on the disk."""

from __future__ import annotations

import hashlib

from flora_common.messages import Frame


def announced(path: str, data: bytes, tick: int) -> Frame:
    """The frame of a tick, five minutes apart.

    Args:
        path: inside the run folder.
        data: the file's bytes.
        tick: from 1.
    """
    return Frame(
        time_s=300.0 * tick,
        path=path,
        run="run",
        sha256=hashlib.sha256(data).hexdigest(),
        bytes=len(data),
        width_px=1640,
        height_px=1232,
        light="left",
        flash_confirmed=True,
        exposure_ok=True,
        tick=tick,
    )
