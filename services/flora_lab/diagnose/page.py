"""A diagnosis as a page: what is wrong, why, how sure, and what to do next, for a biologist to read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final, Literal

from flora_common.counted import counted
from flora_lab import html_page
from flora_lab.diagnose import gain_told, learned_told
from flora_lab.diagnose.diagnosis import Diagnosis, NamedCause
from flora_lab.diagnose.next_experiment import NOTHING, NOTHING_TOLD
from flora_lab.diagnose.replayed import Plant
from flora_lab.diagnose.residual_words import mm, p_text, percent_sure
from flora_lab.diagnose.summary import set_right
from flora_lab.diagnose.verdict import meaning
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import Parameter

Evidence = Sequence[Sequence[tuple[str, float]]]

_COLOURS: Final = {"nothing_wrong": "#1d7a33", "explained": "#D55E00", "unexplained": "#b3261e"}
_WHERE: Final = {
    "plant": "in the plant or about it",
    "camera": "in the picture, not in the plant",
    "clock": "in the clocks, not in the plant",
    "simulator": "in the simulator itself",
}
_SURE: Final = (
    (0.99, "practically certain"),
    (0.95, "almost certain"),
    (0.8, "likely"),
    (0.5, "more likely than not"),
    (0.0, "no more than a guess"),
)
_PLANTS: Final[dict[Plant, str]] = {
    "typical": "Simulated is the typical plant, from the first measured stem on and never told of another.",
    "own": (
        "The simulated plants start from the first measured stem and have constants of their own, fitted to the run: "
        "what is still wrong then, being an individual cannot explain."
    ),
}
_EXTENDED: Final = "Where orange follows black, the causes make up for it."
_RESIDUALS: Final = (
    "Residuals are measured less simulated, of the typical plant and in mm where nothing else is said: positive is "
    "farther to the right, higher, or faster."
)
_NAMED: Final = "A long bar without a name says much the same of the runs as one with a name, and says it less well."
_NAMELESS: Final = "None is named, however far its bar goes, for none of them makes up for all that is wrong."
_UNITS: Final = (("_per_cm_h", " /(cm h)"), ("_cm", " cm"), ("_deg", "°"), ("_h", " h"))
_RATES: Final = (("per_degree", " per °C"), ("per_hour", " per hour"))
"""What a name ends in, and the unit; the former are left out where the unit is shown, the latter say what it is."""


def page(diagnosis: Diagnosis, pictures: Mapping[str, bytes], *, evidence: Evidence = (), plant: Plant = "own") -> str:
    """The page, complete in itself.

    Args:
        diagnosis: what it says.
        pictures: by name, PNG, and ``film`` a GIF: ``paths``, ``phase``, ``stem``, ``spectrum``, ``evidence``,
            ``gain``, ``controllers``, ``stems``, ``learned``. Those that are missing are left out.
        evidence: of each round of the search, titles of causes and their nats, best first.
        plant: which of the simulated plants the pictures show.
    """
    body = [
        html_page.heading("What the simulation gets wrong", _lead(diagnosis)),
        _verdict(diagnosis),
        html_page.tiles(_tiles(diagnosis)),
        *_causes(diagnosis),
        *_confusable(diagnosis),
        *_seen(diagnosis, pictures, plant),
        *_left(diagnosis),
        *learned_told.pieces(diagnosis.learned, pictures),
        *gain_told.pieces(diagnosis.gain, pictures),
        *_next(diagnosis),
        *_record(diagnosis),
        html_page.section("All the numbers"),
        *_numbers(diagnosis, evidence),
    ]
    return html_page.document("What the simulation gets wrong", [piece for piece in body if piece])


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The whole diagnosis in one sentence."""
    if diagnosis.verdict == "nothing_wrong":
        return "The simulator is right, as far as these runs can show."
    if diagnosis.verdict == "unexplained":
        return "The simulator is wrong in a way that no known cause explains."
    said = [meaning(BY_NAME[cause.effect], cause.parameters, cause.interval) for cause in diagnosis.causes]
    text = said[0] if len(said) == 1 else f"{'; '.join(said[:-1])}; and {said[-1]}"
    return f"{text[:1].upper()}{text[1:]}."


def value_text(parameter: Parameter, value: float) -> str:
    """A parameter's value with its unit."""
    shown = value % 24.0 if parameter.is_cyclic else value
    digits = f"{shown:.3g}" if abs(shown) < 100 else f"{shown:.0f}"
    unit = next((unit for end, unit in _UNITS + _RATES if parameter.name.endswith(end)), "")
    return digits.replace("-", "−") + unit


def sure_text(confidence: float) -> str:
    """A probability in words, with the number."""
    words = next(words for least, words in _SURE if confidence >= least)
    return f"{words} ({percent_sure(confidence)})"


def _lead(diagnosis: Diagnosis) -> str:
    runs = len(diagnosis.runs)
    text = f"{counted(runs, 'measured run')} beside the simulator" if runs else "Beside the simulator"
    learned = diagnosis.base.get("runs")
    if isinstance(learned, int) and learned:
        text += f", which was learned from {counted(learned, 'reference run')}"
    return f"{text}."


def _verdict(diagnosis: Diagnosis) -> str:
    colour = _COLOURS[diagnosis.verdict]
    style = f"border-left:.45rem solid {colour};background:#f7f8f7;padding:.9rem 1.2rem;border-radius:.3rem"
    summary = f'<p style="margin:.5rem 0 0">{escape(diagnosis.summary)}</p>' if diagnosis.summary else ""
    large = f'<p style="font-size:1.3rem;line-height:1.35;margin:0"><b>{escape(verdict_sentence(diagnosis))}</b></p>'
    return f'<div style="{style}">{large}{summary}</div>'


def _tiles(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    tiles = [(mm(diagnosis.residuals.size_mm), "from the measured tip to the simulated typical plant's")]
    p_value = diagnosis.residuals.when.get("p_value")
    if isinstance(p_value, float):
        more = "more than chance" if diagnosis.residuals.significant else "no more than chance"
        tiles.append((p_text(p_value), f"{more}, all runs taken as wholes"))
    if diagnosis.causes:
        best = diagnosis.causes[0]
        number = percent_sure(best.confidence).replace("over", ">")
        tiles.append((number, f"sure of the first cause: {BY_NAME[best.effect].title.lower()}"))
    end = diagnosis.gain.free_running.get("end", {})
    if "base" in end and "extended" in end:
        tiles.append((f"{end['base']:.0f} → {end['extended']:.0f} mm", "error at the end of runs that no fit has seen"))
    return tiles


def _causes(diagnosis: Diagnosis) -> list[str]:
    if not diagnosis.causes:
        return []
    many = len(diagnosis.causes) > 1
    out = [html_page.section("The causes" if many else "The cause")]
    for number, cause in enumerate(diagnosis.causes, start=1):
        effect = BY_NAME[cause.effect]
        head = f"{number}. {effect.title}" if many else effect.title
        out.append(f'<h3 style="margin:1.1rem 0 .2rem;font-size:1.05rem">{escape(head)}</h3>')
        out.append(html_page.paragraph(cause.evidence))
        rows = [
            (
                _plain(parameter.name),
                value_text(parameter, cause.parameters[parameter.name]),
                _interval(parameter, cause),
                parameter.meaning,
            )
            for parameter in effect.parameters
            if parameter.name in cause.parameters
        ]
        out.append(html_page.table(("", "most probable", "90 % sure to lie between", "what it is"), rows))
        sure = f"{sure_text(cause.confidence)}; as much evidence where nothing is wrong: {p_text(cause.p_value)}"
        out.append(html_page.pairs([("How sure", sure), ("Where it is", _WHERE[effect.where])]))
    return out


def _plain(name: str) -> str:
    """A parameter's name without its unit."""
    for end, _ in _UNITS:
        if name.endswith(end):
            return name.removesuffix(end).replace("_", " ")
    return name.replace("_", " ")


def _interval(parameter: Parameter, cause: NamedCause) -> str:
    ends = cause.interval.get(parameter.name)
    if ends is None:
        return "–"
    return f"{value_text(parameter, ends[0])} and {value_text(parameter, ends[1])}"


def _confusable(diagnosis: Diagnosis) -> list[str]:
    rows = []
    for cause in diagnosis.causes:
        effect = BY_NAME[cause.effect]
        for name in cause.confusable_with:
            other = BY_NAME[name]
            way = effect.same_as.get(name) or other.same_as.get(cause.effect) or "see the next experiment"
            rows.append((effect.title, other.title, way))
    if not diagnosis.causes:
        return []
    out = [html_page.section("What these data cannot tell apart")]
    if not rows:
        return [*out, html_page.paragraph("No other cause of the catalogue explains these runs nearly as well.")]
    out.append(
        html_page.paragraph(
            "Each of these would have left nearly the same tracks. Until something tells them apart, take either for "
            "possible."
        )
    )
    return [*out, html_page.table(("named", "may as well be", "what would tell"), rows)]


_PICTURES: Final[tuple[tuple[str, Literal["png", "gif"], str, str], ...]] = (
    (
        "paths",
        "png",
        "the tip over time, measured and simulated, a row for each run",
        "The way of the tip, sideways and upwards. Grey is where nine of ten plants would be if nothing were wrong; "
        "where black leaves blue, the simulator does not follow this one.",
    ),
    (
        "phase",
        "png",
        "what the simulator leaves over, by time since a switch and by time of day",
        "When it is wrong: sideways, by the time since a lamp came on; and growth, by the hour of the day counted from "
        "the start. Thin lines are runs, thick ones their mean; grey is what reference runs show.",
    ),
    (
        "stem",
        "png",
        "how far apart measured and simulated stems are, along the stem, over time and by its height",
        "Where it is wrong: from the foot of the stem to its tip, over the run, and as it gets higher.",
    ),
    (
        "film",
        "gif",
        "measured and simulated stems growing",
        "The stems themselves: cm to the right of the anchor, and above it; an hour per frame.",
    ),
    ("stems", "png", "measured and simulated stems at some hours", "The stems at some hours of the runs, in cm."),
    (
        "spectrum",
        "png",
        "how strongly the tip swings at each period, beside reference runs",
        "Swings of the tip that the simulator does not have, by their period: a line that stands far above the grey is "
        "a rhythm of the plant's own; single lines a few times above it come and go by chance.",
    ),
    (
        "evidence",
        "png",
        "evidence for each cause of the catalogue",
        "How much better each cause alone explains the runs than none does. Three nats are odds of twenty to one; bars "
        "to the left are causes that the runs speak against.",
    ),
)


def _seen(diagnosis: Diagnosis, pictures: Mapping[str, bytes], plant: Plant) -> list[str]:
    out = [html_page.section("What is seen"), html_page.paragraph(diagnosis.residuals.description)]
    if pictures:
        out.append(html_page.paragraph(_PLANTS[plant]))
    for name, kind, alt, caption in _PICTURES:
        if name in pictures:
            told = caption
            if name == "paths" and diagnosis.causes:
                told = f"{caption} {_EXTENDED}"
            elif name == "evidence" and diagnosis.verdict == "unexplained" and not diagnosis.causes:
                told = f"{caption} {_NAMELESS}"
            elif name == "evidence" and diagnosis.causes:
                told = f"{caption} {_NAMED}"
            out.append(html_page.spaced(html_page.picture(pictures[name], kind, alt=alt, caption=told)))
    return out


def _left(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.verdict == "nothing_wrong" and not diagnosis.residuals.left:
        return []
    nothing = "Nothing that stands out from what reference runs leave over as well."
    return [html_page.section("What is left"), html_page.paragraph(diagnosis.residuals.left or nothing)]


def _next(diagnosis: Diagnosis) -> list[str]:
    asked = diagnosis.next_experiment
    if not (asked.why or asked.light_schedule or asked.picture or asked.map):
        return []
    out = [html_page.section("What to do next")]
    if asked.why:
        out.append(html_page.paragraph(asked.why))
    rows = []
    if asked.separates:
        names = (NOTHING_TOLD if name == NOTHING else _title(name) for name in asked.separates)
        rows.append(("To tell apart", ", ".join(names)))
    if asked.light_schedule:
        rows.append(("Lamps", asked.light_schedule))
    if asked.picture:
        rows.append(("Picture to take", asked.picture))
    if rows:
        out.append(html_page.pairs(rows))
    if asked.map:
        schedules = list(dict.fromkeys(name for row in asked.map.values() for name in row))
        cells = [
            [pair, *(f"{row[name]:.1f}" if name in row else "–" for name in schedules)]
            for pair, row in asked.map.items()
        ]
        inner = html_page.table(["causes", *schedules], cells)
        told = "How well each schedule of the lamps would tell causes apart, in nats: about 6 are enough."
        out += [html_page.paragraph(told), inner]
    return out


def _title(name: str) -> str:
    return BY_NAME[name].title if name in BY_NAME else name


def _record(diagnosis: Diagnosis) -> list[str]:
    lines = [*diagnosis.record, *([set_right(diagnosis.corrected)] if diagnosis.corrected else [])]
    if not lines:
        return []
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return [html_page.section("What was wrong with the record"), f"<ul>{items}</ul>"]


def _numbers(diagnosis: Diagnosis, evidence: Evidence) -> list[str]:
    """Everything else, folded away."""
    out = [html_page.paragraph(_RESIDUALS)] if diagnosis.residuals.where else []
    for number, tried in enumerate(evidence, start=1):
        title = "Evidence of each cause" if number == 1 else f"Evidence of one cause more, round {number}"
        rows = [(name, f"{nats:.1f}".replace("-", "−")) for name, nats in tried]
        out.append(_folded(title, html_page.table(("cause", "nats"), rows)))
    residuals = diagnosis.residuals
    where = [(name.replace("_", " "), *_cells(row)) for name, row in residuals.where.items() if isinstance(row, dict)]
    if where:
        out.append(_folded("Residuals along the stem", html_page.table(_names(residuals.where), where)))
    for name, rows_of in residuals.when.items():
        if not isinstance(rows_of, dict) or not rows_of:
            continue
        tables = [row for row in rows_of.values() if isinstance(row, dict)]
        title = f"Residuals: {name.replace('_', ' ')}"
        if tables:
            rows = [(key.replace("_", " "), *_cells(row)) for key, row in rows_of.items() if isinstance(row, dict)]
            out.append(_folded(title, html_page.table(_names(rows_of), rows)))
        else:
            out.append(_folded(title, html_page.pairs([(_label(k), _flat(v)) for k, v in rows_of.items()])))
    tests = [(key.replace("_", " "), _flat(v)) for key, v in residuals.when.items() if not isinstance(v, dict)]
    if tests:
        out.append(_folded("Is it more than chance?", html_page.pairs(tests)))
    about = [(_label(key), _flat(value)) for key, value in diagnosis.base.items()]
    if diagnosis.runs:
        about.append(("measured runs", ", ".join(diagnosis.runs)))
    if about:
        out.append(_folded("The simulator and the runs", html_page.pairs(about)))
    return out


def _folded(title: str, inner: str) -> str:
    return f'<details style="margin:.4rem 0"><summary>{escape(title)}</summary>{inner}</details>'


def _names(rows: Mapping[str, Any]) -> list[str]:
    """Heads of a table of mappings, as they come in the first."""
    first = next(row for row in rows.values() if isinstance(row, dict))
    return ["", *(_label(str(key)) for key in first)]


def _cells(row: Mapping[str, Any]) -> list[str]:
    return [_flat(value) for value in row.values()]


def _label(name: str) -> str:
    """The name of a figure as people read it, its unit behind a comma."""
    for end, unit in (("_per_cm_h", ", /(cm h)"), ("_mm_per_h", ", mm/h"), ("_mm", ", mm"), ("_h", ", h")):
        if name.endswith(end):
            return name[: -len(end)].replace("_", " ") + unit
    return name.replace("_", " ")


def _flat(value: Any) -> str:
    """A figure, a text, or a mapping or list of such."""
    if value is None:
        return "–"
    if isinstance(value, dict):
        return ", ".join(f"{_label(str(key))}: {_flat(own)}" for key, own in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_flat(own) for own in value)
    if isinstance(value, float):
        return f"{value:.3g}".replace("-", "−")
    return str(value)
