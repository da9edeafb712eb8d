"""The report page: one HTML file that needs nothing else, to look at, print and send."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from flora_common.counted import counted
from flora_lab import html_page
from flora_lab.report.summary import RunSummary

_SHAPES: Final = html_page.section("Shape through time")


def is_page(path: Path) -> bool:
    """Whether a file is a page of :func:`page`."""
    return html_page.is_document(path) and _SHAPES.encode() in path.read_bytes()


def page(
    summary: RunSummary,
    *,
    title: str,
    strip_jpeg: bytes,
    figures: Mapping[str, str],
    notes: Sequence[tuple[str, str]] = (),
) -> str:
    """The whole page as HTML text.

    Args:
        summary: the run in numbers.
        title: heading.
        strip_jpeg: the picture strip.
        figures: SVG text by name: ``shapes``, ``tip``, ``fitness`` (empty where there is no target).
        notes: further rows of the table at the end: (name, value).
    """
    body = [
        html_page.heading(title, _lead(summary)),
        html_page.tiles(_headline(summary)),
        html_page.section("The plant"),
        html_page.picture(
            strip_jpeg,
            "jpeg",
            alt="Photographs of the run",
            caption="Stem as measured (ten points), obstacle (grey), target (red); circles at the top: the left and the"
            " right lamp, filled when lit.",
        ),
        html_page.section("Tip and lamps"),
        figures["tip"],
        *([html_page.section("Fitness"), figures["fitness"]] if figures["fitness"] else []),
        _SHAPES,
        figures["shapes"],
        html_page.section("All figures"),
        html_page.pairs([*_rows(summary), *notes]),
    ]
    return html_page.document(title, body)


def _lead(summary: RunSummary) -> str:
    plant = summary.run.plant or "a plant"
    return f"Rig {summary.run.rig}, {plant}: {summary.hours:.1f} hours, {counted(len(summary.frames), 'photograph')}."


def _headline(summary: RunSummary) -> list[tuple[str, str]]:
    tiles = []
    if summary.fitness_at_target is not None and summary.reached_h is not None:
        tiles.append(
            (
                f"{100 * summary.fitness_at_target:.1f} %",
                f"fitness when the target was reached, {_hour(summary.reached_h)}",
            )
        )
    elif summary.fitness_at_stop is not None:
        tiles.append(
            (f"{100 * summary.fitness_at_stop:.1f} %", f"fitness when {summary.stop_reason}; target not reached")
        )
    if summary.best_fitness is not None:
        tiles.append((f"{100 * summary.best_fitness:.1f} %", "best fitness on the way"))
    if summary.run.obstacle is not None:
        tiles.append(("none" if summary.collided_h is None else _hour(summary.collided_h), "collision"))
        tiles.append((f"{summary.clearance_cm:.1f} cm", "least distance to the obstacle"))
    tiles.append((f"{summary.track.points_cm[summary.stop_row, -1, 1]:.1f} cm", "tip height at the end"))
    tiles.append((f"{summary.readings}/{len(summary.frames)}", "photographs with a stem"))
    return tiles


def _hour(hour: float) -> str:
    return f"at {hour:.1f} h"


def _rows(summary: RunSummary) -> list[tuple[str, str]]:
    first, last = summary.track.points_cm[0, -1], summary.track.points_cm[summary.stop_row, -1]
    rows = [
        ("tip at the first reading", f"({first[0]:.2f}, {first[1]:.2f}) cm"),
        (
            "tip when the run was over",
            f"({last[0]:.2f}, {last[1]:.2f}) cm, hour {summary.track.time_s[summary.stop_row] / 3600:.2f}",
        ),
        ("run over because", summary.stop_reason),
        ("lamp changes", str(summary.switches)),
    ]
    if summary.fitness_at_stop is not None:
        rows.append(("fitness when the run was over", f"{100 * summary.fitness_at_stop:.1f} %"))
    target, obstacle = summary.run.target, summary.run.obstacle
    if target is not None:
        rows.append(("target", f"({target.x_cm:g}, {target.y_cm:g}) cm, radius {target.radius_cm:g} cm"))
    if obstacle is not None:
        size = f"{obstacle.width_cm:g} x {obstacle.height_cm:g} cm"
        rows.append(("obstacle", f"{size}, centre ({obstacle.x_cm:g}, {obstacle.y_cm:g}) cm"))
    return rows
