"""What a diagnosis says of controllers: for a terminal, and for the page.

Functions take ``gain.controller_fitness`` of a diagnosis, or one kind of controllers in it, see
:func:`flora_lab.diagnose.controller_gain.controller_gain`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from flora_common.counted import counted
from flora_lab import html_page
from flora_lab.diagnose.diagnosis import SIMULATOR_NAMES, SURE_ERRORS
from flora_lab.evolve.task import Task

KINDS: Final = {"feedback": "controllers that see the stem", "plan": "light plans, which see nothing"}
WHERE: Final = {
    "without_effect": "simulator as it is, on its own plants",
    **SIMULATOR_NAMES,
}
"""Where controllers were evolved, and on which plants they were run if not on those with the causes."""
_COLUMNS: Final = ("fitness", "worst plant", "sd of plants", "sd of evolutions", "collisions")
_SHORT: Final = ("fitness", "worst plant", "collisions")
"""What a terminal has room for."""


def for_plans(task: Task) -> Task:
    """The task with its first possible scenario alone: a plan cannot be told which one it meets."""
    return replace(task, scenarios=(next(scenario for scenario in task.scenarios if scenario.is_possible),))


def judged_on(task: Task, seeds: int, plants: int, *, is_beside_another: bool) -> str:
    """How controllers were compared, in sentences.

    Args:
        task: of the controllers.
        seeds: evolutions in each simulator.
        plants: that judged.
        is_beside_another: whether the simulator that was given is a learned one, and another was extended.
    """
    which = ", the mechanistic one beside the one that was given," if is_beside_another else ""
    scenario = for_plans(task).scenarios[0].name
    plans = f" Light plans are made for its scenario {scenario} alone." if len(task.scenarios) > 1 else ""
    return (
        f"Task {task.name}: {seeds} evolutions in the simulator as it is{which} and {seeds} in the extended one, run "
        f"on the same {counted(plants, 'plant')}, which no evolution has seen.{plans} Nobody knows the plant better "
        "than the extended simulator, so its plants stand for it: this tells what the causes are worth to controllers "
        "if they are right, not whether they are."
    )


def sentence(told: Mapping[str, Any]) -> str:
    """What came of one kind."""
    cost, apart = told["cost"], told["difference"]
    better = "better" if apart["mean"] >= 0.0 else "worse"
    if not _is_sure(apart):
        share = ", no more than chance"
    elif told["recovered"] is None or apart["mean"] < 0.0:
        share = ""
    else:
        share = f", which brings back {min(100.0 * told['recovered'], 100.0):.0f} % of it"
    chance = "" if told["recovered"] is not None else ", no more than chance"
    name = KINDS[told["kind"]]
    return (
        f"{name[:1].upper()}{name[1:]}: what was found costs those of the simulator as it is {_with_error(cost)} of "
        f"their fitness{chance}; those of the extended one are {_with_error(apart, of=abs)} {better}{share}."
    )


def lines(fitness: Mapping[str, Any]) -> list[str]:
    """For a terminal; none where nothing was compared."""
    out = []
    for told in fitness.values():
        out.append(KINDS[told["kind"]].ljust(42) + "".join(f"{name:>13}" for name in _SHORT))
        for key, name in WHERE.items():
            cells = dict(zip(_COLUMNS, _cells(told[key]), strict=True))
            out.append(f"  {name:<40}" + "".join(f"{cells[column]:>13}" for column in _SHORT))
    if not out:
        return []
    out += [sentence(told) for told in fitness.values()]
    return [*out, f"judged on: {_words(fitness)}", ""]


def pieces(fitness: Mapping[str, Any], pictures: Mapping[str, bytes]) -> list[str]:
    """For the page, as HTML; none where nothing was compared.

    Args:
        fitness: see the module.
        pictures: by name; ``controllers`` is shown.
    """
    if not fitness:
        return []
    out = [html_page.section("What it gains where it counts: controllers"), html_page.paragraph(_words(fitness))]
    if "controllers" in pictures:
        caption = (
            "Above: each dot is a plant, at its mean over evolutions; grey lines join the same plant, boxes hold the "
            "middle half of all, black bars are means. Below: runs that ended at the obstacle."
        )
        alt = "fitness and collisions of controllers, by the simulator that they were evolved in"
        picture = html_page.picture(pictures["controllers"], "png", alt=alt, caption=caption)
        out.append(html_page.spaced(picture))
    for told in fitness.values():
        out.append(html_page.paragraph(sentence(told)))
        rows = [[name, *_cells(told[key])] for key, name in WHERE.items()]
        out.append(html_page.table(["evolved in", *_COLUMNS], rows))
    return out


def _words(fitness: Mapping[str, Any]) -> str:
    """The same for all kinds."""
    return str(next(iter(fitness.values()))["judged_on"])


def _cells(own: Mapping[str, Any]) -> list[str]:
    figures = [f"{own[name]:.3f}" for name in ("mean", "worst_plant", "sd_of_plants", "sd_of_seeds")]
    return [*figures, f"{100.0 * own['collisions']:.0f} %"]


def _is_sure(told: Mapping[str, float]) -> bool:
    return abs(told["mean"]) > SURE_ERRORS * told["standard_error"]


def _with_error(told: Mapping[str, float], of: Any = float) -> str:
    return f"{of(told['mean']):.3f} ± {told['standard_error']:.3f}".replace("-", "−")
