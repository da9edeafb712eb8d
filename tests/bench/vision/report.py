"""What the bench says: a table per family, a JSON file, and pictures of the worst frames."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from bench.vision.figures import FIGURES, RunScores, intervals, pooled
from bench.vision.work import WORST, BadFrame, RunResult, Timing
from flora_common.arrays import FloatArray
from flora_common.vision.draw import CYAN, RED, CmToPx, Colour, contact_sheet, draw_caption
from flora_common.vision.picture import Picture, decode_picture

MARGIN_CM = 3.0
TILE_PX = 640


def rows_of(results: Sequence[RunResult], family: str) -> dict[str, list[RunScores]]:
    """The rows of a family's table: each method, and each that reads every frame once more with all of them."""
    of_family = [result for result in results if result.family == family]
    rows: dict[str, list[RunScores]] = {}
    for result in of_family:
        for method, scores in result.scores.items():
            rows.setdefault(method, []).append(scores)
    for result in of_family:
        for method, scores in result.all_scores.items():
            rows.setdefault(f"{method}, every frame", []).append(scores)
    return rows


def summary(results: Sequence[RunResult], timings: dict[str, dict[str, Timing]]) -> dict[str, object]:
    """All that the tables hold and each run's own figures, ready for JSON."""
    families: dict[str, object] = {}
    for family in dict.fromkeys(result.family for result in results):
        methods: dict[str, object] = {}
        for name, runs in rows_of(results, family).items():
            values, between = pooled(runs), intervals(runs)
            methods[name] = {
                "frames": sum(run.frames for run in runs),
                "figures": {
                    key: {"value": _plain(values[key]), "low": _plain(between[key][0]), "high": _plain(between[key][1])}
                    for key in FIGURES
                },
                "individuals": [
                    {key: _plain(value) for key, value in {**pooled([run]), "growth": run.growth_percent}.items()}
                    for run in runs
                ],
            }
        names = [result.name for result in results if result.family == family]
        time_ms = {
            method: {"method_ms": timing.method_ms, "decode_ms": timing.decode_ms}
            for method, timing in timings.get(family, {}).items()
        }
        families[family] = {"runs": names, "methods": methods, "time": time_ms}
    return families


def _plain(value: float) -> float | None:
    """JSON has no NaN."""
    return float(value) if math.isfinite(value) else None


def show(results: Sequence[RunResult], timings: dict[str, dict[str, Timing]], console: Console) -> None:
    """The tables: figures, the range over the individuals under them."""
    for family in dict.fromkeys(result.family for result in results):
        count = len({result.name for result in results if result.family == family})
        table = Table(title=f"{family}: {count} individuals", title_justify="left")
        table.add_column("figure")
        rows = rows_of(results, family)
        for name in rows:
            table.add_column(name.replace(", ", ",\n"), justify="right", no_wrap=True)
        table.add_row("frames", *(str(sum(run.frames for run in runs)) for runs in rows.values()), end_section=True)
        values = [pooled(runs) for runs in rows.values()]
        between = [intervals(runs) for runs in rows.values()]
        for key, head in FIGURES.items():
            cells = [_short(of_row[key]) for of_row in values]
            if count > 1:
                cells = [f"{cell}\n{_range(of_row[key])}" for cell, of_row in zip(cells, between, strict=True)]
            table.add_row(head, *cells, end_section=True)
        console.print(table)
        times = Table(title=f"{family}: ms per frame, one core, medians", title_justify="left")
        for head in ("method", "file to stem", "bare decode", "ratio"):
            times.add_column(head, justify="left" if head == "method" else "right")
        for method, timing in timings.get(family, {}).items():
            ratio = timing.method_ms / timing.decode_ms
            times.add_row(method, f"{timing.method_ms:.1f}", f"{timing.decode_ms:.1f}", f"{ratio:.2f}")
        if times.row_count:
            console.print(times)


def _range(between: tuple[float, float]) -> str:
    low, high = (_short(value) for value in between)
    return low if low == high else f"{low}–{high}"


def _short(value: float) -> str:
    if not math.isfinite(value):
        return "none"
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def write_json(path: Path, results: Sequence[RunResult], timings: dict[str, dict[str, Timing]], scale: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    told = {"scale": scale, "families": summary(results, timings)}
    path.write_text(json.dumps(told, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def write_pictures(folder: Path, results: Sequence[RunResult]) -> int:
    """The worst frames of each method and family as a contact sheet and one by one; returns how many pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    written = 0
    groups: dict[tuple[str, str], list[BadFrame]] = {}
    for result in results:
        for method, worst in result.worst.items():
            groups.setdefault((result.family, method), []).extend(worst)
    for (family, method), bad_frames in groups.items():
        without = [bad for bad in bad_frames if bad.found.line_cm is None]
        with_stem = sorted((bad for bad in bad_frames if bad.found.line_cm is not None), key=lambda bad: -bad.mm)
        chosen = with_stem[:WORST] + without[: WORST // 3]
        tiles = [overlaid(bad) for bad in chosen]
        for number, tile in enumerate(tiles, start=1):
            cv2.imwrite(str(folder / f"{family}-{method}-{number:02d}.jpg"), tile)
        cv2.imwrite(str(folder / f"{family}-{method}.jpg"), contact_sheet(tiles, columns=4))
        written += len(tiles) + 1
    return written


def overlaid(bad: BadFrame) -> Picture:
    """The part of a photograph in which the plant is, with the true stem in cyan and the found one in red."""
    picture = decode_picture(bad.jpeg, where=f"{bad.run} at {bad.time_s:g} s")
    to_px = CmToPx(bad.camera, picture.shape[1])
    lines = [bad.true_cm] if bad.found.line_cm is None else [bad.true_cm, bad.found.line_cm]
    corners = to_px(np.concatenate(lines))
    margin = MARGIN_CM * to_px.px_per_cm
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    half = np.ptp(corners, axis=0).max() / 2 + margin
    low = np.clip(middle - half, 0, None).astype(int)
    high = np.minimum(middle + half, (picture.shape[1], picture.shape[0])).astype(int)
    part = picture[low[1] : high[1], low[0] : high[0]]
    enlarged = TILE_PX / max(part.shape[:2])
    size = (round(part.shape[1] * enlarged), round(part.shape[0] * enlarged))
    square = np.zeros((TILE_PX, TILE_PX, 3), dtype=np.uint8)
    square[: size[1], : size[0]] = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    colours: tuple[Colour, ...] = (CYAN, RED)
    for line, colour in zip(lines, colours, strict=False):
        _draw_line(square, (to_px(line) - low + 0.5) * enlarged - 0.5, colour)
    mm = "no stem" if bad.found.line_cm is None else f"{bad.mm:.1f} mm"
    draw_caption(square, f"{bad.run}, {bad.time_s / 3600:.2f} h: {bad.found.outcome}, {mm}")
    return square


def _draw_line(out: Picture, px: FloatArray, colour: Colour) -> None:
    fine = np.rint(px * 16.0).astype(np.int32)
    cv2.polylines(out, [fine.reshape(-1, 1, 2)], False, colour, 1, cv2.LINE_AA, 4)
    cv2.circle(out, (int(fine[-1, 0]), int(fine[-1, 1])), 64, colour, 1, cv2.LINE_AA, 4)
