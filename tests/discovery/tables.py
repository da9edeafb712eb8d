"""The whole table of a judging, as aligned text and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from .scoring import (
    CONFIDENT,
    SIMULATORS,
    Outcome,
    Share,
    alarmed_worlds,
    calibration_error,
    calibration_error_by_chance,
    confusion,
    gain_share,
    held_out_errors,
    named_share,
    parameter_errors,
    rhythms_told,
    share,
)

RHYTHM_OF = {
    "growth": "growth alone",
    "activity": "growth and bending",
    "gain": "the answer to light",
    "bias": "a push",
}
PERIOD_OFF = 0.1
FORMS = {0: "same physics", 1: "other physics"}
BARS_NATS = (4.0, 5.0, 6.0, 8.0, 10.0)
SECONDS = (
    (True, "seconds per case, base learned in it", "< 240: 180 for the base's fit, 60 for the case"),
    (False, "seconds per case, base given", "< 60"),
)
"""On one core."""
GAINS = (
    ("gain at the end, share of the oracle's", gain_share, ">= 0.90"),
    ("the same, both from the base that was extended", partial(gain_share, from_one_base=True), ">= 0.90"),
    ("worth of what was named, about each plant's own constants", named_share, ">= 0.90"),
    ("the same after 24 h", partial(named_share, when="24h"), ""),
    ("the same after 6 h", partial(named_share, when="6h"), ""),
    ("the same after 1 h", partial(named_share, when="1h"), ""),
    ("gain at the end of gradient boosting, share of the oracle's", partial(gain_share, by="boosted"), "less"),
)
"""Where plants differ by more than an effect moves them, the first two are mostly chance."""


@dataclass(frozen=True)
class Table:
    """A titled table; all cells are text."""

    title: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]


def all_tables(outcomes: Sequence[Outcome]) -> list[Table]:
    """Every table that these outcomes can fill."""
    tables = [f(outcomes) for f in (_summary, _errors, _bars, _by_effect, _rhythms, _parameters, _confusion)]
    return [table for table in tables if table.rows]


def as_text(tables: Sequence[Table]) -> str:
    """Columns aligned, an empty line between tables."""
    parts = []
    for table in tables:
        widths = [max(len(row[i]) for row in [table.header, *table.rows]) for i in range(len(table.header))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in [table.header, tuple("-" * width for width in widths), *table.rows]
        ]
        parts.append("\n".join([table.title, *lines]))
    return "\n\n".join(parts) + "\n"


def as_markdown(tables: Sequence[Table]) -> str:
    """The same for a page."""
    parts = []
    for table in tables:
        rows = [table.header, tuple("---" for _ in table.header), *table.rows]
        parts.append("\n".join([f"### {table.title}", "", *(f"| {' | '.join(row)} |" for row in rows)]))
    return "\n\n".join(parts) + "\n"


def _summary(outcomes: Sequence[Outcome]) -> Table:
    rows: list[tuple[str, str, str, str]] = []
    for form, name in FORMS.items():
        of = {
            kind: [o for o in outcomes if o.kind == kind and o.form == form]
            for kind in ("single", "none", "pair", "outside")
        }
        rows += [(what, name, str(value), aim) for what, value, aim in _figures(of, form) if str(value) != "-"]
    claims = calibration_error(outcomes)
    if not math.isnan(claims):
        exact = calibration_error_by_chance(outcomes)
        told = f"{claims:.3f}; {exact:.3f} if they were exact"
        rows.append(("calibration error of confidences", "both", told, "<= 0.08"))
    for what, tell, aim in GAINS:
        share_of = tell(outcomes)
        if not math.isnan(share_of.value):
            rows.append((what, "both", f"{share_of}, {share_of.cases} cases", aim))
    failed = share(o.diagnosis is None for o in outcomes)
    if failed.count:
        rows.append(("failed", "both", str(failed), "0"))
    for learned, what, aim in SECONDS:
        seconds = [o.seconds for o in outcomes if o.learned == learned]
        if seconds:
            told = f"{np.median(seconds):.0f} median, {max(seconds):.0f} longest, {len(seconds)} cases"
            rows.append((what, "both", told, aim))
    return Table(f"Summary of {len(outcomes)} cases", ("what", "physics", "found", "aim"), rows)


def _figures(of: dict[str, list[Outcome]], form: int) -> list[tuple[str, Share | str, str]]:
    single, none, pair, outside = of["single"], of["none"], of["pair"], of["outside"]
    errors = parameter_errors(single)
    both = [{o.names(c) for c in o.claimed} - {None} for o in pair]
    false_names = [sum(o.names(c) is None for c in o.claimed) for o in pair]
    wrong = [any(float(c["confidence"]) >= CONFIDENT and o.names(c) is None for c in o.causes) for o in outside]
    middle = (
        f"{100 * float(np.median([e.relative for e in errors])):.1f} %, {len(errors)} parameters" if errors else "-"
    )
    return [
        ("right cause first", share(o.right for o in single), ">= 80 %" if form == 0 else ">= 72 %"),
        ("the same, by its own name", share(o.right_alone for o in single), ""),
        ("first in evidence, claimed or not", share(o.ranked_first for o in single), ""),
        ("right of those claimed", share(o.right for o in single if o.claimed), ">= 95 %" if form == 0 else ""),
        ("right name, called unexplained", share(_flagged(o) for o in single), ""),
        ("false alarms", share(o.alarmed for o in none), "<= 5 %"),
        ("worlds with a false alarm", alarmed_worlds(none), ""),
        ("false alarms that name a cause", share(bool(o.claimed) for o in none), ""),
        ("pairs: both named", share(len(names) == 2 for names in both), ">= 65 %"),
        ("pairs: at least one named", share(bool(names) for names in both), ">= 98 %"),
        ("pairs: false names per case", f"{np.mean(false_names):.2f}" if pair else "-", "<= 0.3"),
        ("outside: unexplained", share(o.verdict == "unexplained" for o in outside), ">= 80 %"),
        ("outside: confident wrong name", share(wrong), "<= 10 %"),
        ("outside: taken for nothing", share(o.verdict == "nothing_wrong" for o in outside), ""),
        ("parameter error, median", middle, "<= 8 %"),
        ("90 % intervals that hold", share(e.held for e in errors if e.held is not None), "82-97 %"),
    ]


def _flagged(outcome: Outcome) -> bool:
    causes = outcome.causes
    return outcome.verdict == "unexplained" and bool(causes) and outcome.names(causes[0]) is not None


def _bars(outcomes: Sequence[Outcome]) -> Table:
    """What a reader who asks for more evidence than the command does would be told: rightly, and of nothing."""
    rows = []
    for form, physics in FORMS.items():
        of_form = [o for o in outcomes if o.form == form]
        if not any(o.kind in {"single", "none"} for o in of_form):
            continue
        for least in (0.0, *BARS_NATS):
            judged = [o.if_claims_took(least) for o in of_form]
            single = [o for o in judged if o.kind == "single"]
            healthy = [o for o in judged if o.kind == "none"]
            shares = (
                share(o.right for o in single),
                share(o.right for o in single if o.claimed),
                share(o.alarmed for o in healthy),
            )
            rows.append((f"{least:g} nats" if least else "as claimed", physics, *map(str, shares)))
    header = ("names take", "physics", "right cause first", "right of those claimed", "false alarms")
    return Table("Were more evidence asked for", header, rows)


def _errors(outcomes: Sequence[Outcome]) -> Table:
    rows = []
    for horizon, told in held_out_errors(outcomes).items():
        nearer = share(ours < box for ours, box in zip(told["extended"], told["boosted"], strict=True))
        rows.append((horizon, *(f"{np.mean(told[name]):.1f}" for name in SIMULATORS), str(nearer)))
    header = ("after", "base", "extended", "boosted", "a stem that stands still", "extended nearer than boosted")
    return Table("Tip on held-out runs of rightly named cases, mm (root mean square, mean of cases)", header, rows)


def _by_effect(outcomes: Sequence[Outcome]) -> Table:
    rows = []
    for form, physics in FORMS.items():
        single = [o for o in outcomes if o.kind in {"single", "outside"} and o.form == form]
        for effect in sorted({o.hidden[0] for o in single}):
            these = [o for o in single if o.hidden[0] == effect]
            right = share(o.right for o in these)
            claimed = share(bool(o.claimed) for o in these)
            unknown = share(o.verdict == "unexplained" for o in these)
            rows.append((effect, physics, str(len(these)), *(f"{s.count}" for s in (right, claimed, unknown))))
    return Table("By hidden effect", ("hidden", "physics", "cases", "right first", "claimed", "unexplained"), rows)


def _rhythms(outcomes: Sequence[Outcome]) -> Table:
    told = rhythms_told(outcomes)
    rows = []
    for of, in_step in sorted({(one.of, one.in_step) for one in told}, key=lambda kind: (kind[0], not kind[1])):
        these = [one for one in told if (one.of, one.in_step) == (of, in_step)]
        off = [one.period_off for one in these if not math.isnan(one.period_off)]
        rows.append(
            (
                RHYTHM_OF[of],
                "in step" if in_step else "each its own",
                str(len(these)),
                f"{share(one.is_unexplained for one in these).count}",
                f"{share(one.is_of_that for one in these).count}",
                f"{share(one.period_off < PERIOD_OFF for one in these).count}",
                f"{100.0 * float(np.median(off)):.1f} %" if off else "-",
            )
        )
    within = f"period within {100.0 * PERIOD_OFF:.0f} %"
    header = ("a rhythm of", "runs", "cases", "unexplained", "told as a rhythm of it", within, "period off, median")
    return Table("Rhythms without a name", header, rows)


def _parameters(outcomes: Sequence[Outcome]) -> Table:
    rows = []
    for form, physics in FORMS.items():
        errors = parameter_errors([o for o in outcomes if o.form == form])
        for key in sorted({(e.effect, e.parameter) for e in errors}):
            these = [e for e in errors if (e.effect, e.parameter) == key]
            held = share(e.held for e in these if e.held is not None)
            rows.append(
                (
                    *key,
                    physics,
                    str(len(these)),
                    f"{100 * np.median([e.relative for e in these]):.1f} %",
                    f"{held.count} of {held.total}",
                )
            )
    header = ("effect", "parameter", "physics", "cases", "error, median", "interval holds")
    return Table("Parameters of rightly named causes", header, rows)


def _confusion(outcomes: Sequence[Outcome]) -> Table:
    counts = confusion(outcomes)
    hidden = sorted({key[0] for key in counts})
    rows = []
    for name in hidden:
        answers = sorted(((n, told) for (true, told), n in counts.items() if true == name), reverse=True)
        rows.append((name, str(sum(n for n, _ in answers)), ", ".join(f"{told} {n}" for n, told in answers)))
    return Table("What was hidden and what was said", ("hidden", "cases", "said"), rows)
