"""What people read of an evaluation: its tables and notes, on the screen and in the page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from flora_common.counted import counted
from flora_lab.evaluate.evaluation import Evaluation
from flora_lab.evaluate.gap import MEASURES, REAL_PLANTS, Average, Measure, Row, averages, gaps
from flora_lab.evaluate.trial import TWIN

NOTHING: Final = "-"
MEASURE_WORDS: Final[dict[Measure, str]] = {
    "fitness": "fitness",
    "fitness_at_end": "at the end",
    "best_fitness": "best",
}

GAP_WORDS: Final = "reality gap: simulated minus virtual plants' mean, in percentage points"
Table = tuple[list[str], list[list[str]]]
"""Names over the columns, and rows of cells."""


def text(one: Evaluation) -> str:
    """All tables and notes, as plain text."""
    parts = []
    for place in one.places:
        parts.append(f"{place_words(one, place)}\n{_aligned(*summary_table(one, place))}")
    if one.on_twin:
        parts.append(f"each virtual plant\n{_aligned(*trials_table(one))}")
    if gaps(one.rows):
        parts.append(f"{GAP_WORDS}\n{_aligned(*gap_table(one))}")
    parts.append("\n".join(notes(one)) + "\n")
    return "\n".join(parts)


def places_text(one: Evaluation) -> str:
    """All places in a clause."""
    return " and ".join([*(f"in {name}" for name in one.simulators), *(["on virtual plants"] if one.on_twin else [])])


def place_words(one: Evaluation, place: str) -> str:
    """A place as the heading of its table."""
    if place == TWIN:
        return f"virtual plants through the whole rig, {counted(one.plan.repeat, 'plant')}"
    return f"simulator {place} ({one.simulators[place].kind}): its typical plant" + (
        f", and {counted(one.plan.repeat, 'plant')} that it draws" if one.plan.repeat else ""
    )


def summary_table(one: Evaluation, place: str) -> Table:
    """A place: a line for each controller and scenario, and the averages under them."""
    is_simulator = place != TWIN
    kinds = [*(["typical"] if is_simulator else []), *(["mean", "worst"] if one.plan.repeat else [])]
    head = ["controller", "scenario", *(f"{word}, {kind}" for word in MEASURE_WORDS.values() for kind in kinds)]
    head += ["reached", "ended", "hours", "least cm"]
    body = []
    for row in one.rows:
        if row.place == place:
            cells = [c for m in MEASURES for c in _values(row.of_typical(m), row.mean(m), row.worst(m), kinds)]
            body.append([row.controller, scenario_words(row), *cells, *_ends(row)])
    for average in averages(one.plan, one.rows):
        if average.place == place:
            cells = [c for m in MEASURES for c in _values(average.typical[m], average.mean[m], None, kinds)]
            body.append([average.controller, _average_words(average), *cells, "", "", "", ""])
    return head, body


def trials_table(one: Evaluation) -> Table:
    """A line for each run on the virtual rig."""
    head = ["controller", "scenario", "plant", "fitness", "reached at", "at the end", "best", "ended", "hours"]
    head += ["least cm, measured", "least cm, true"]
    return head, [
        [
            trial.controller,
            trial.scenario.name,
            str(trial.seed),
            percent(trial.fitness),
            _hours(trial.reached_h),
            percent(trial.fitness_at_end),
            percent(trial.best_fitness),
            trial.ended,
            _hours(trial.hours),
            f"{trial.clearance_cm:.1f}",
            NOTHING if trial.true_clearance_cm is None else f"{trial.true_clearance_cm:.1f}",
        ]
        for trial in one.trials
        if trial.place == TWIN
    ]


def gap_table(one: Evaluation) -> Table:
    """A line for each simulator, controller and scenario that virtual plants were tried in too."""
    head = ["simulator", "controller", "scenario"]
    head += [f"{word}, {kind}" for word in MEASURE_WORDS.values() for kind in ("typical", "drawn")]
    return head, [
        [
            gap.simulator,
            gap.controller,
            gap.scenario,
            *(_points(value) for m in MEASURES for value in (gap.of_typical[m], gap.of_drawn[m])),
        ]
        for gap in gaps(one.rows)
    ]


def notes(one: Evaluation) -> list[str]:
    """What a reader of the tables must know, a sentence or two each."""
    task = one.plan.task
    found = [
        "Fitness in percent: when the tip first lay in the target's circle, as the paper tells it of its real plants; "
        "where it never did (reached), at the end. At the end is how the paper judges controllers that it evolves. "
        "Best is how near the tip came to the target's middle on the way.",
        f"A run ends when the stem touches the obstacle (collision), when the tip is {task.stop_height_cm:g} cm high "
        f"(height), or after {task.hours:g} h (time).",
    ]
    if one.simulators and one.on_twin:
        found.append(
            f"Simulated plants start {task.start_stem_cm[-1, 1]:g} cm high, as the task says; virtual ones as each is."
        )
    if not all(task.is_possible):
        found.append("A scenario in brackets is one that no plant can do; averages are told with and without it.")
    if one.has_real_plants:
        theirs = ", ".join(f"{100 * value:.1f}" for value in REAL_PLANTS)
        found.append(f"The paper's three real plants in this experiment: {theirs} %.")
    found += [f"Failed: {words}: {said}" for words, said in one.failed.items()]
    return found


def scenario_words(row: Row) -> str:
    """A scenario's name; in brackets where no plant can do it."""
    return row.scenario.name if row.scenario.is_possible else f"({row.scenario.name})"


def percent(value: float | None) -> str:
    """A fitness without the sign, which stands in the notes."""
    return NOTHING if value is None else f"{100 * value:.1f}"


def _values(typical: float | None, mean: float | None, worst: float | None, kinds: Sequence[str]) -> list[str]:
    known = {"typical": typical, "mean": mean, "worst": worst}
    return [percent(known[kind]) for kind in kinds]


def _ends(row: Row) -> list[str]:
    trials = row.trials
    reached = sum(trial.fitness_at_target is not None for trial in trials)
    ended = Counter(trial.ended for trial in trials)
    how = ", ".join(f"{reason} {count}" if len(ended) > 1 else reason for reason, count in ended.most_common())
    hours = sum(trial.hours for trial in trials) / len(trials)
    return [f"{reached}/{len(trials)}", how, f"{hours:.1f}", f"{min(trial.clearance_cm for trial in trials):.1f}"]


def _average_words(average: Average) -> str:
    return "all but the impossible" if average.possible_only else "all scenarios"


def _hours(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1f}"


def _points(value: float | None) -> str:
    return NOTHING if value is None else f"{100 * value:+.1f}"


def _aligned(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """A table as text: words to the left, everything else to the right."""
    wide = [max(len(cell) for cell in column) for column in zip(head, *body, strict=True)]
    words = [k for k, name in enumerate(head) if name in ("simulator", "controller", "scenario", "ended")]
    lines = [
        "  ".join(
            cell.ljust(w) if k in words else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, wide, strict=True))
        )
        for line in (head, *body)
    ]
    return "".join(f"{line.rstrip()}\n" for line in lines)
