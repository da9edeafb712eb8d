"""Steps of long work that can be stopped: each is a command that makes one folder or file, done where it is not there.

``steps.toml`` in the folder holds a key for each step: a hash over its command and over the keys of the steps that it
is made from. A step whose key is there and whose result is there is not done again; where the key is another, the
step is done anew, and so is all that follows from it. How many processes worked on it is no part of a key.

Commands write their results whole or not at all, or keep what is finished in them; so whoever is stopped, or loses
power, goes on with the same command.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from flora_common import files
from flora_lab.paper.ledger import Ledger, StepEntry, read_ledger


@dataclass(frozen=True, slots=True)
class Made:
    """A path in a command: what another step made, or with ``inside`` the paths in it that fit, such as ``*``."""

    step: str
    inside: str = ""

    def paths(self, folder: Path) -> list[str]:
        """As the command is given them, in order."""
        place = folder / self.step
        return [str(path) for path in sorted(place.glob(self.inside))] if self.inside else [str(place)]


@dataclass(frozen=True, slots=True)
class Given:
    """A file in a command that no step makes: its text is written before the command runs."""

    name: str
    text: str


Word = str | Made | Given


@dataclass(frozen=True, slots=True)
class Step:
    """One command that makes one result.

    Attributes:
        name: of the result in the folder.
        title: for people.
        program: an installed command.
        words: its arguments, all but those below.
        output: the option that names the result.
        goes_on: arguments more, where the step was begun before.
        anew: arguments more, where it was not: they drop what an older one may have left beside the result.
        others: arguments that change nothing in the result.
        is_whole: whether the result is all there once it is there.
    """

    name: str
    title: str
    program: str
    words: tuple[Word, ...]
    output: str = "-o"
    goes_on: tuple[str, ...] = ()
    anew: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    is_whole: bool = True

    def arguments(self, folder: Path, *, is_begun: bool) -> list[str]:
        """Of the program."""
        given = [text for word in self.words for text in _texts(word, folder)]
        return [*given, self.output, str(folder / self.name), *(self.goes_on if is_begun else self.anew), *self.others]

    def write_given(self, folder: Path) -> None:
        """Write the files that no step makes."""
        for word in self.words:
            if isinstance(word, Given):
                files.write_text(folder / word.name, word.text)


def keys(steps: Sequence[Step], software: str) -> dict[str, str]:
    """A key for each step.

    Args:
        steps: each after those that it is made from.
        software: that does them.
    """
    found: dict[str, str] = {}
    for step in steps:
        words = [_key_part(word, found) for word in step.words]
        content = json.dumps([step.name, step.program, words, software])
        found[step.name] = files.sha256_of_bytes(content.encode())
    return found


class Watcher(Protocol):
    """Is told how the steps go."""

    def kept(self, number: int, step: Step, took_s: float) -> None:
        """A step was done before."""

    def begins(self, number: int, step: Step, *, is_begun: bool) -> None:
        """A step is done now, from its beginning or on from where it was stopped."""

    def ends(self, number: int, step: Step, took_s: float) -> None:
        """It was done."""


def do_all(
    steps: Sequence[Step],
    folder: Path,
    *,
    software: str,
    run: Callable[[Step, Sequence[str]], None],
    watcher: Watcher,
    monotonic_s: Callable[[], float],
    force: bool = False,
) -> dict[str, float]:
    """Do what is missing.

    Args:
        steps: in order.
        folder: that results go into; it is there, and held by this process.
        software: what the keys say of it.
        run: runs a step's command with these arguments to its end; raises where that fails.
        watcher: is told.
        monotonic_s: a clock.
        force: do all steps anew.

    Returns:
        Seconds that each step took, also those done before.

    Raises:
        BadInput: ``steps.toml`` is damaged.
        DiskFull: no room to note a step.
    """
    ledger = read_ledger(folder)
    if force:
        for name in ledger.names:
            _remove(folder / name)
        ledger.clear()
    wanted = keys(steps, software)
    for number, step in enumerate(steps, start=1):
        key, place, entry = wanted[step.name], folder / step.name, ledger.get(step.name)
        is_begun = entry is not None and entry.key == key
        before_s = entry.took_s if entry is not None and is_begun else 0.0
        if entry is not None and is_begun and place.exists() and (entry.is_finished or step.is_whole):
            if not entry.is_finished:  # its command came to its end, and nobody was left to note it
                ledger.put(StepEntry(step.name, key, True, before_s))
            watcher.kept(number, step, before_s)
            continue
        if not is_begun:
            _remove(place)
            ledger.put(StepEntry(step.name, key, False, 0.0))
        watcher.begins(number, step, is_begun=is_begun)
        for left in folder.glob(f".{step.name}.*{files.TEMPORARY_SUFFIX}"):
            _remove(left)
        step.write_given(folder)
        began_s, is_finished = monotonic_s(), False
        try:
            run(step, step.arguments(folder, is_begun=is_begun))
            is_finished = True
        finally:
            took_s = before_s + monotonic_s() - began_s
            ledger.put(StepEntry(step.name, key, is_finished, took_s))
        watcher.ends(number, step, took_s)
    return {step.name: _took(ledger, step) for step in steps}


def _texts(word: Word, folder: Path) -> list[str]:
    if isinstance(word, Made):
        return word.paths(folder)
    return [str(folder / word.name) if isinstance(word, Given) else word]


def _key_part(word: Word, found: Mapping[str, str]) -> str | list[str]:
    if isinstance(word, Made):
        return [found[word.step], word.inside]
    return [word.name, word.text] if isinstance(word, Given) else word


def _took(ledger: Ledger, step: Step) -> float:
    entry = ledger.get(step.name)
    return entry.took_s if entry else 0.0


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
