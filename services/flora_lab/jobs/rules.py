"""What a lab may be asked to do: which subcommands, and with which arguments.

Whoever reaches the bus may ask. So a job works in the folder of all jobs and in no other, reaches no other machine, and
needs no key: nothing is signed and nothing published. Links in that folder, which only its owner makes, may lead to
what a job reads, and to nothing that it writes.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from flora_common.errors import BadInput
from flora_common.messages.catalogue import JobStage
from flora_common.suggest import did_you_mean

WORKS: Final = ("track", "report", "dataset", "train", "rollout", "evolve", "evaluate", "diagnose", "rhythm", "paper")
GO_ON: Final = frozenset({"track", "train", "evolve"})
"""Subcommands that go on where they were stopped when they are given :data:`RESUME`; others find that out themselves,
or begin anew."""
RESUME: Final = "--resume"
OVER: Final[frozenset[JobStage]] = frozenset({"done", "refused", "failed", "stopped"})
"""Stages after which nothing more becomes of a job."""
KNOWN: Final = "known"
"""Work of a message that only asks how a job is, or ends it."""
_SHOWN: Final = frozenset({"rollout", "evaluate", "rhythm"})
"""Subcommands that show what they found where they are told no folder for it; a job has no screen."""
_OUTPUT: Final = re.compile(r"^(-o|--output(=|$))")
_WRITES: Final = re.compile(r"-q*o(.*)|--(?:output|overlays|contact|film|strip|tensorboard)(?:=(.*))?")
"""Options that name what is written; the value is in the same argument, or is the next one."""
_REFUSED: Final = ("--cluster",)
_OPTION: Final = re.compile(r"^-{1,2}[A-Za-z][A-Za-z-]*=?")


def check(work: str, arguments: Sequence[str]) -> None:
    """Whether a lab does this.

    Raises:
        BadInput: it does not; one line that says why.
    """
    if work not in WORKS:
        raise BadInput(f"`{work[:40]}` is no work for a lab{did_you_mean(work, WORKS)}")
    for argument in arguments:
        if not argument.isprintable():
            raise BadInput(f"argument {argument!r:.60}: has signs that cannot be printed")
        option = _OPTION.match(argument)
        named = option.group(0).rstrip("=") if option else ""
        if named in _REFUSED:
            raise BadInput(f"{named}: a job stays on the lab's own machine")
        value = argument[option.end() :] if option else argument
        if value.startswith(("/", "~", "\\")) or ".." in re.split(r"[/\\]", value):
            raise BadInput(f"argument `{argument[:60]}`: name files relative to the folder of all jobs, and inside it")
    if work in _SHOWN and not any(_OUTPUT.match(argument) for argument in arguments):
        raise BadInput(f"{work}: what it finds would be lost; name a folder for it with -o")


def check_outputs(arguments: Sequence[str], folder: Path) -> None:
    """Whether what is written comes to lie in the folder of all jobs, whatever links there are in it.

    Args:
        arguments: that were checked, spelled out.
        folder: of all jobs.

    Raises:
        BadInput: it does not; one line that says why.
    """
    inside = Path(os.path.realpath(folder))
    for argument, following in itertools.zip_longest(arguments, arguments[1:], fillvalue=""):
        found = _WRITES.fullmatch(argument)
        if found is None:
            continue
        value = found[1] or found[2] or following
        if not Path(os.path.realpath(folder / value)).is_relative_to(inside):
            raise BadInput(
                f"output `{value[:60]}`: a link leads it out of the folder of all jobs, where jobs may read only"
            )


def spelled_out(arguments: Sequence[str], folder: Path) -> Iterator[str]:
    """Arguments with what patterns such as ``nine/*`` stand for, in order: who asks does not see the lab's folder.

    One that nothing fits stays as it is; the work says that there is no such thing.

    Args:
        arguments: that were checked.
        folder: of all jobs.
    """
    for argument in arguments:
        is_pattern = any(sign in argument for sign in "*?[") and not argument.startswith("-")
        found = sorted(str(path.relative_to(folder)) for path in folder.glob(argument)) if is_pattern else []
        yield from found or [argument]
