"""``flora-controller check FILE``: whether a controller file or a light plan could steer, what it is, who signed it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flora_common.cli import ArgumentParser, run_cli
from flora_common.controller_file import SUFFIX, LoadedController, load_controller
from flora_common.counted import counted
from flora_common.errors import BadController, BadInput
from flora_common.light_plan import SUFFIX as LIGHTS_SUFFIX
from flora_common.light_plan import read_light_plan
from flora_common.signing import read_trusted_keys, signer_of


def check_file(argv: Sequence[str]) -> int:
    """Run the command; returns the exit status."""
    parser = ArgumentParser("flora-controller check", description="Check a controller file or a light plan, and end.")
    told = f"a controller file, *{SUFFIX}, or a light plan, *{LIGHTS_SUFFIX}"
    parser.add_argument("file", type=Path, metavar="FILE", help=told)
    parser.add_argument(
        "--keys", type=Path, metavar="DIR", help="public keys; a signature must then be there and be by one of them"
    )

    def work() -> None:
        options = parser.parse_args(argv)
        if options.file.name.endswith(LIGHTS_SUFFIX):
            if options.keys is not None:
                raise BadInput(f"{options.file}: light plans are not signed; leave --keys out")
            plan = read_light_plan(options.file).plan
            print(f"{options.file}: good; {plan.hours:g} h of light by the clock: {plan.schedule}")
            return
        loaded = load_controller(options.file)
        network, file = loaded.network, loaded.file
        links = sum(len(node.links) for node in network.nodes)
        print(
            f"{options.file}: good; `{file.name}`, task `{file.task.name}`, {counted(len(network.inputs), 'input')}, "
            f"{counted(len(network.nodes), 'node')}, {counted(links, 'link')}, {_range(loaded)}, "
            f"sha256 {loaded.sha256[:12]}; {_signed(loaded, options.keys)}"
        )

    return run_cli("flora-controller", work)


def _range(loaded: LoadedController) -> str:
    met = loaded.file.stem_range
    if met is None:
        return "no stem range"
    return (
        f"stems from x {met.left_cm:g} to {met.right_cm:g} cm, tips {met.lowest_tip_cm:g} to {met.highest_tip_cm:g} cm "
        f"high, {met.shortest_cm:g} to {met.longest_cm:g} cm long"
    )


def _signed(loaded: LoadedController, keys_dir: Path | None) -> str:
    file = loaded.file
    if keys_dir is not None:
        if not keys_dir.is_dir():
            raise BadInput(f"--keys {keys_dir}: no such folder")
        try:
            signer = str(signer_of(loaded, read_trusted_keys(keys_dir)))
        except BadController as problem:
            raise BadController(f"{problem}; the keys asked are those in {keys_dir}") from problem
    elif file.signature is not None:
        signer = f"`{file.signature.key}`, not verified without --keys"
    else:
        return "not signed"
    until = f", expires {file.expires:%Y-%m-%d %H:%M} UTC" if file.expires is not None else ""
    return f"signed by {signer}, serial {file.serial}{until}"
