"""``flora-controller offer FILE``: the rig's own way to bring a controller, the same as ``flora-lab publish`` goes.

For whoever is logged in on the rig, and for ``make deploy HOST=…``, which has no other way to its bus.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from flora_common.cli import ArgumentParser, run_cli
from flora_common.config import checked_rig_name, load_rig
from flora_common.controller_file import MAX_BYTES, SUFFIX, LoadedController, load_controller, parse_controller
from flora_common.deliver import NOBODY_AFTER_S, as_json, deliver, outcome, raise_unless_taken
from flora_common.errors import BadInput
from flora_common.messages.catalogue import MOST_SHADOW_TICKS

SOURCE: Final = "flora-controller-offer"
STANDARD_INPUT: Final = "-"


def offer_file(argv: Sequence[str]) -> int:
    """Run the command; returns the exit status: 0 taken, 2 the file or the rig says no, 1 nobody answers."""

    def work() -> None:
        options = _parser().parse_args(argv)
        if not 0 <= options.shadow <= MOST_SHADOW_TICKS:
            raise BadInput(f"--shadow: must be from 0 to {MOST_SHADOW_TICKS}")
        rig = load_rig(options.config)
        if options.rig is not None and checked_rig_name(options.rig) != rig.name:
            raise BadInput(f"--rig {options.rig}: this rig is `{rig.name}`")
        loaded, name = _read(options.file)
        answer = deliver(
            loaded,
            rig,
            name=options.name or name,
            source=SOURCE,
            shadow_ticks=options.shadow,
            wait_steering=options.wait_steering,
            timeout_s=NOBODY_AFTER_S,
        )
        if options.json:
            print(as_json(answer, rig=rig.name, name=options.name or name))
        raise_unless_taken(answer, rig=rig.name, name=options.name or name)
        if not options.json:
            print(outcome(answer, rig=rig.name, name=options.name or name))

    return run_cli("flora-controller", work)


def _read(file: str) -> tuple[LoadedController, str]:
    if file == STANDARD_INPUT:
        return parse_controller(sys.stdin.buffer.read(MAX_BYTES + 1), where="standard input"), "standard input"
    return load_controller(Path(file)), Path(file).name


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        "flora-controller offer", description="Offer a signed controller file to the flora-controller that runs here."
    )
    parser.add_argument("file", metavar="FILE", help=f"a signed controller file, *{SUFFIX}; - is standard input")
    parser.add_argument("--config", type=Path, metavar="FILE", help="the rig's TOML file")
    parser.add_argument("--rig", metavar="NAME", help="end with status 2 where this rig is called otherwise")
    parser.add_argument("--name", metavar="TEXT", help="what to call the file")
    parser.add_argument("--shadow", type=int, default=0, metavar="TICKS", help="ticks in shadow before it steers")
    parser.add_argument("--wait-steering", action="store_true", help="also wait for the end of the shadow")
    parser.add_argument("--json", action="store_true", help="print the answer as one JSON object")
    return parser
