"""Writes the small bad examples under ``pictures_bad/`` and ``runs_bad/``.

    python tests/golden/make_bad_pictures_and_runs.py

Each has the sentence that a user should see in the ``sentences.toml`` beside it, which is written by hand. The files
are kept in the tree: what was once refused stays refused, with whatever OpenCV writes the files next.
"""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

HERE = Path(__file__).parent
SIZE = (24, 16)

RUN_TOML = """\
interval_s = 300

[camera]
anchor_px = [12, 15]
px_per_cm = 2.0
width_px = 24
height_px = 16
"""
FRAMES_CSV = "file,time_s,light\nframes/0000.jpg,0,left\nframes/0001.jpg,300,left\n"


def picture(width: int = SIZE[0], height: int = SIZE[1]) -> np.ndarray:
    """A grey ramp: enough texture that cutting the file short loses some of it."""
    ramp = np.linspace(20, 230, width * height).reshape(height, width).astype(np.uint8)
    return np.dstack([ramp, ramp, ramp])


def encoded(suffix: str, image: np.ndarray) -> bytes:
    done, data = cv2.imencode(suffix, image)
    assert done
    return data.tobytes()


def png_header(width: int, height: int) -> bytes:
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))


def write_pictures(folder: Path) -> None:
    jpeg, png = encoded(".jpg", picture()), encoded(".png", picture())
    end = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))
    flipped = bytearray(jpeg)
    flipped[-20] ^= 0x10
    broken_sum = bytearray(png)
    broken_sum[45] ^= 0x01
    examples = {
        "empty.jpg": b"",
        "a_text.jpg": b"This is not a picture.\n",
        "cut_short.jpg": jpeg[: len(jpeg) // 2],
        "end_marker_lost.jpg": jpeg[:-2],
        "filled_with_zeros.jpg": jpeg[: len(jpeg) // 2] + bytes(len(jpeg) - len(jpeg) // 2),
        "no_frame_header.jpg": jpeg[:2] + b"\xff\xe0\x00\x04ab\xff\xd9",
        "one_bit_flipped.jpg": bytes(flipped),
        "other_size.jpg": encoded(".jpg", picture(16, 16)),
        "cut_short.png": png[:-30],
        "wrong_check_sum.png": bytes(broken_sum),
        "gigapixel.png": png_header(60_000, 60_000) + end,
        "no_pixels.png": png_header(0, 16) + end,
    }
    for name, data in examples.items():
        (folder / name).write_bytes(data)


def write_run(folder: Path, **changed: str | bytes | None) -> None:
    """A run folder that is good but for what is changed; in keys ``__`` stands for ``/`` and ``_dot_`` for ``.``."""
    content: dict[str, str | bytes | None] = {
        "run_dot_toml": RUN_TOML,
        "frames_dot_csv": FRAMES_CSV,
        "frames__0000_dot_jpg": encoded(".jpg", picture()),
        "frames__0001_dot_jpg": encoded(".jpg", picture()),
        "background__dark_dot_jpg": encoded(".jpg", picture()),
        **changed,
    }
    for key, data in content.items():
        if data is None:
            continue
        path = folder / key.replace("__", "/").replace("_dot_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)


def write_runs(folder: Path) -> None:
    torn = encoded(".jpg", picture())[:-40]
    (folder / "neither_run_nor_pictures").mkdir(parents=True)
    (folder / "neither_run_nor_pictures" / "notes.txt").write_text("Nothing here.\n")
    (folder / "a_text.mp4").write_text("This is not a film.\n")
    write_run(folder / "unknown_key", run_dot_toml=RUN_TOML.replace("px_per_cm", "px_per_cmm"))
    write_run(folder / "no_scale", run_dot_toml=RUN_TOML.replace("px_per_cm = 2.0\n", ""))
    write_run(folder / "no_frames_csv", frames_dot_csv=None)
    write_run(folder / "no_frames", frames_dot_csv="file,time_s,light\n")
    write_run(folder / "unknown_light", frames_dot_csv=FRAMES_CSV.replace("0,left", "0,lfet", 1))
    write_run(folder / "time_goes_back", frames_dot_csv=FRAMES_CSV.replace("300,left", "-300,left"))
    write_run(folder / "file_outside", frames_dot_csv=FRAMES_CSV.replace("frames/0000.jpg", "../../secret.jpg"))
    write_run(folder / "anchor_above_picture", run_dot_toml=RUN_TOML.replace("[12, 15]", "[12, -4]"))
    write_run(folder / "torn_background", background__dark_dot_jpg=torn)
    write_run(folder / "all_frames_torn", frames__0000_dot_jpg=torn, frames__0001_dot_jpg=torn)
    write_run(folder / "nothing_but_setup")
    write_run(folder / "no_background_two_frames", background__dark_dot_jpg=None)


def main() -> None:
    for name, write in (("pictures_bad", write_pictures), ("runs_bad", write_runs)):
        folder = HERE / name
        for entry in folder.iterdir() if folder.exists() else []:
            if entry.name != "sentences.toml":
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        folder.mkdir(exist_ok=True)
        write(folder)


if __name__ == "__main__":
    main()
