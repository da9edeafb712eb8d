"""Settings of NEAT: those of ``neat.cfg`` beside this file, with what a file of the user's changes.

neat-python reads its settings from a file and answers a wrong one with errors of many kinds; a rate of 7 it takes. So
everything is checked here first, and neat-python is given a file that is complete and right.
"""

from __future__ import annotations

import configparser
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import neat
from neat.math_util import stat_functions

from flora_common.controller_file import INPUT_NAMES
from flora_common.errors import BadInput
from flora_common.network import ACTIVATIONS, AGGREGATIONS, MAX_NUMBER
from flora_common.suggest import clipped, did_you_mean

SETTINGS_FILE: Final = Path(__file__).with_name("neat.cfg")
NAMED: Final[Mapping[str, Path]] = {"sparse": Path(__file__).with_name("neat-sparse.cfg")}
"""Settings that come with flora and change some of those in ``neat.cfg``, by the name that people give."""
LARGEST_POPULATION: Final = 1_000_000
LARGEST_COUNT: Final = 10_000

Value = bool | int | float | str
Sections = Mapping[str, Mapping[str, Value]]


@dataclass(frozen=True, slots=True)
class NeatTypes:
    """The four classes that neat-python works with.

    Attributes:
        genome, reproduction, species_set, stagnation: neat-python's own or subclasses of them.
    """

    genome: type[Any] = neat.DefaultGenome
    reproduction: type[Any] = neat.DefaultReproduction
    species_set: type[Any] = neat.DefaultSpeciesSet
    stagnation: type[Any] = neat.DefaultStagnation


STOCK: Final = NeatTypes()
"""neat-python as it is."""


RESTART: Final = "Restart"
"""The section that is flora's own; neat-python is not shown it."""


@dataclass(frozen=True, slots=True)
class Restart:
    """When a population that comes no further is left for a new one; see ``neat.cfg``.

    Attributes:
        after: so many generations without a better best fitness; 0 never.
        after_best: the same for a population that holds the best of the run so far.
        gain: by more than so much it must be better.
    """

    after: int
    after_best: int
    gain: float


@dataclass(frozen=True, slots=True)
class NeatSettings:
    """Settings that were checked, all of them.

    Attributes:
        sections: name of a section of ``neat.cfg`` to its settings.
    """

    sections: Sections

    @property
    def population(self) -> int:
        """How many genomes a generation has."""
        return int(self.sections["NEAT"]["pop_size"])

    @property
    def restart(self) -> Restart:
        """Flora's own settings."""
        values = self.sections[RESTART]
        return Restart(int(values["restart_after"]), int(values["restart_after_best"]), float(values["restart_gain"]))

    @property
    def text(self) -> str:
        """All settings as the text of a file: the same text for the same settings, however they were given.

        Without ``[Restart]`` where populations are never left: evolutions begun before it existed go on.
        """
        return "\n".join(
            f"[{section}]\n" + "".join(f"{key} = {values[key]}\n" for key in sorted(values))
            for section, values in sorted(self.sections.items())
            if section != RESTART or self.restart.after > 0
        )

    def config(self, types: NeatTypes = STOCK) -> Any:
        """A new ``neat.Config``. Each engine needs one of its own: neat-python keeps counters in it."""
        names = {
            "DefaultGenome": types.genome.__name__,
            "DefaultReproduction": types.reproduction.__name__,
            "DefaultSpeciesSet": types.species_set.__name__,
            "DefaultStagnation": types.stagnation.__name__,
        }
        # neat-python reads its settings from a file only, with sections named after the classes.
        with tempfile.NamedTemporaryFile("w", suffix=".cfg", encoding="utf-8") as file:
            for section, values in self.sections.items():
                if section == RESTART:
                    continue
                file.write(f"[{names.get(section, section)}]\n")
                file.writelines(f"{key} = {value}\n" for key, value in values.items())
            file.flush()
            return neat.Config(types.genome, types.reproduction, types.species_set, types.stagnation, file.name)


def load_settings(path: Path | None = None, *, population: int | None = None) -> NeatSettings:
    """Read the settings.

    Args:
        path: a file in neat-python's format that names only what it changes.
        population: in place of the file's ``pop_size``.

    Raises:
        BadInput: the file cannot be read, or a setting is unknown, of the wrong type or out of range; one line that
            says which and where.
    """
    sections = {name: {k: _guess(v) for k, v in values.items()} for name, values in _parsed(SETTINGS_FILE).items()}
    where: str | Path = SETTINGS_FILE.name
    if path is not None:
        where = path
        for name, values in _parsed(path).items():
            if name not in sections:
                raise BadInput(f"{path}: unknown section [{clipped(name)}]{did_you_mean(name, sections)}")
            known = sections[name]
            for key, text in values.items():
                if key not in known:
                    raise BadInput(f"{path}: unknown setting `{clipped(key)}` in [{name}]{did_you_mean(key, known)}")
                known[key] = _converted(text, known[key], f"{path}: {key}")
    if population is not None:
        sections["NEAT"]["pop_size"] = population
        if population < 2:
            raise BadInput(f"population {population}: a population needs 2 genomes or more")
    _check(sections, where)
    return NeatSettings(sections)


def settings_named(name: str | None, *, population: int | None = None) -> NeatSettings:
    """Settings by a name of :data:`NAMED`, or from a file; one that is called like them is given as ``./NAME``.

    Raises:
        BadInput: neither is there, or its networks are no controllers', or see :func:`load_settings`.
    """
    path = None if name is None else NAMED.get(name, Path(name))
    if path is not None and not path.exists():
        raise BadInput(f"--neat {name}: neither flora's own nor a file{did_you_mean(path.name, NAMED)}")
    settings = load_settings(path, population=population)
    genome = settings.sections["DefaultGenome"]
    for key, count in (("num_inputs", len(INPUT_NAMES)), ("num_outputs", 1)):
        if genome[key] != count:
            # Networks of others evolve as well, and only in the end no controller can be made of them.
            raise BadInput(f"{path}: {key} is {genome[key]}; controllers have {count}, leave it out")
    return settings


def _parsed(path: Path) -> dict[str, dict[str, str]]:
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(path.read_text(encoding="utf-8-sig"))
    except OSError as problem:
        raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        raise BadInput(f"{path}: not UTF-8 text (byte {problem.start})") from problem
    except configparser.Error as problem:
        message = str(problem).replace("\n", " ")
        raise BadInput(f"{path}: not a settings file: {message[:150]}") from problem
    return {name: dict(parser[name]) for name in parser.sections()}


def _guess(text: str) -> Value:
    """A setting of ``neat.cfg``: what it is there is its type everywhere."""
    if text in ("True", "False"):
        return text == "True"
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def _converted(text: str, like: Value, where: str) -> Value:
    if isinstance(like, bool):
        if text.lower() not in ("true", "false"):
            raise BadInput(f"{where} is `{clipped(text)}`; it must be True or False")
        return text.lower() == "true"
    if isinstance(like, str):
        return text
    try:
        return type(like)(text)
    except ValueError as problem:
        kind = "a whole number" if isinstance(like, int) else "a number"
        raise BadInput(f"{where} is `{text[:40]}`; it must be {kind}") from problem


_COUNTS: Final = {
    "pop_size": (2, LARGEST_POPULATION),
    "num_inputs": (1, LARGEST_COUNT),
    "num_outputs": (1, LARGEST_COUNT),
    "num_hidden": (0, LARGEST_COUNT),
    "max_stagnation": (1, LARGEST_POPULATION),
    "species_elitism": (0, LARGEST_POPULATION),
    "elitism": (0, LARGEST_POPULATION),
    "min_species_size": (1, LARGEST_POPULATION),
    "restart_after": (0, LARGEST_POPULATION),
    "restart_after_best": (0, LARGEST_POPULATION),
}
_RATES: Final = ("_rate", "_prob", "survival_threshold")
_NOT_NEGATIVE: Final = ("_stdev", "_power", "_coefficient", "compatibility_threshold", "restart_gain")
_ONE_OF: Final[Mapping[str, tuple[str, ...]]] = {
    "fitness_criterion": ("max", "min", "mean"),
    "species_fitness_func": tuple(stat_functions),
    "structural_mutation_surer": ("default", "true", "false"),
    "weight_init_type": ("gaussian", "uniform"),
    "bias_init_type": ("gaussian", "uniform"),
    "response_init_type": ("gaussian", "uniform"),
}
_CONNECTIVITY: Final = ("unconnected", "fs_neat_nohidden", "fs_neat_hidden", "full_nodirect", "full_direct")


def _check(sections: Sections, where: str | Path) -> None:
    for values in sections.values():
        for key, value in values.items():
            _check_value(key, value, f"{where}: {key}")
    genome = sections["DefaultGenome"]
    for name in ("weight", "bias", "response"):
        if not float(genome[f"{name}_min_value"]) <= float(genome[f"{name}_max_value"]):
            raise BadInput(f"{where}: {name}_min_value is above {name}_max_value")
    for name, known in (("activation", ACTIVATIONS), ("aggregation", AGGREGATIONS)):
        options = str(genome[f"{name}_options"]).split(" ")
        for option in options:
            if option not in known:
                raise BadInput(f"{where}: {name}_options: unknown {name} `{option}`{did_you_mean(option, known)}")
        if genome[f"{name}_default"] not in (*options, "random"):
            raise BadInput(f"{where}: {name}_default is `{genome[f'{name}_default']}`, not one of {name}_options")
    reproduction, population = sections["DefaultReproduction"], int(sections["NEAT"]["pop_size"])
    for key in ("elitism", "min_species_size"):
        if int(reproduction[key]) > population:
            raise BadInput(f"{where}: {key} is {reproduction[key]}; the population is only {population}")
    if genome["feed_forward"] is not True:
        raise BadInput(f"{where}: feed_forward is False; a rig runs feed-forward networks only, leave it True")


def _check_value(key: str, value: Value, where: str) -> None:
    if key in _COUNTS:
        low, high = _COUNTS[key]
        if not low <= int(value) <= high:
            raise BadInput(f"{where} is {value}; it must be between {low} and {high}")
    elif isinstance(value, float):
        if not math.isfinite(value) or abs(value) > MAX_NUMBER:
            raise BadInput(f"{where} is {value}; it must be finite and at most {MAX_NUMBER:g}")
        if key.endswith(_RATES) and not 0.0 <= value <= 1.0:
            raise BadInput(f"{where} is {value}; it must be between 0 and 1")
        if key.endswith(_NOT_NEGATIVE) and value < 0.0:
            raise BadInput(f"{where} is {value}; it must not be negative")
    elif key == "initial_connection":
        _check_connectivity(str(value), where)
    elif key == "enabled_default":
        if not isinstance(value, bool):
            raise BadInput(f"{where} is {value}; it must be True or False")
    elif key in _ONE_OF and value not in _ONE_OF[key]:
        raise BadInput(f"{where} is `{value}`{did_you_mean(str(value), _ONE_OF[key])}")


def _check_connectivity(value: str, where: str) -> None:
    name, _, share = value.partition(" ")
    if name in ("partial_nodirect", "partial_direct"):
        try:
            if 0.0 <= float(share) <= 1.0:
                return
        except ValueError:
            pass
        raise BadInput(f"{where} is `{value}`; `{name}` needs a share between 0 and 1, as in `{name} 0.5`")
    if value not in _CONNECTIVITY:
        raise BadInput(f"{where} is `{value}`{did_you_mean(value, (*_CONNECTIVITY, 'partial_direct'))}")
