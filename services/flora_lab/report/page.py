"""The report page: one HTML file that needs nothing else, to look at, print and send."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape

from flora_lab.report.summary import RunSummary

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1c2420; background: #fff; max-width: 62rem; margin: 2rem auto;
       padding: 0 1rem; }
h1 { font-size: 1.6rem; margin: 0 0 .2rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; }
.lead { color: #55605a; margin: 0 0 1.5rem; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: .8rem; margin: 1.2rem 0; }
.figures div { background: #f2f5f3; border-radius: .5rem; padding: .7rem .9rem; }
.figures b { display: block; font-size: 1.5rem; line-height: 1.2; } .figures span { color: #55605a; font-size: .85rem; }
img, svg { max-width: 100%; height: auto; display: block; }
figcaption { color: #55605a; font-size: .9rem; margin: .3rem 0 0; } figure { margin: 0; }
table { border-collapse: collapse; } td, th { padding: .25rem 1.2rem .25rem 0; text-align: left; vertical-align: top; }
th { font-weight: 500; color: #55605a; }
"""


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
    picture = base64.b64encode(strip_jpeg).decode()
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">{escape(_lead(summary))}</p>',
        _headline(summary),
        "<h2>The plant</h2><figure>",
        f'<img alt="Photographs of the run" src="data:image/jpeg;base64,{picture}">',
        "<figcaption>Stem as measured (ten points), obstacle (grey), target (red); circles at the top: the left and the"
        " right lamp, filled when lit.</figcaption></figure>",
        "<h2>Tip and lamps</h2>",
        figures["tip"],
        *(["<h2>Fitness</h2>", figures["fitness"]] if figures["fitness"] else []),
        "<h2>Shape through time</h2>",
        figures["shapes"],
        "<h2>All figures</h2>",
        _table([*_rows(summary), *notes]),
    ]
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
        + "\n".join(body)
        + "</body></html>\n"
    )


def _lead(summary: RunSummary) -> str:
    plant = summary.run.plant or "a plant"
    return f"Rig {summary.run.rig}, {plant}: {summary.hours:.1f} hours, {len(summary.frames)} photographs."


def _headline(summary: RunSummary) -> str:
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
    return (
        '<div class="figures">' + "".join(f"<div><b>{escape(a)}</b><span>{b}</span></div>" for a, b in tiles) + "</div>"
    )


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


def _table(rows: Sequence[tuple[str, str]]) -> str:
    return "<table>" + "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows) + "</table>"
