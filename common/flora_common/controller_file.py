"""``*.controller.json``: an evolved network, what it wants to be fed, and where it comes from.

One JSON object, at most 1 MB::

    {"format": "flora-controller", "version": 1, "name": "left-target-17",
     "network": { neat-python's JSON export, format_version 1.0, network_type feedforward },
     "inputs": [{"name": "x1", "offset": 0.0, "scale": 25.0}, …],
     "output_rule": "at most 0.5 is left",
     "task": {"name": "left", "target": {"x_cm": -5.12, "y_cm": 17.9, "radius_cm": 2.0},
              "obstacles": [{"x_cm": -6.3, "y_cm": 12.5, "width_cm": 7.0, "height_cm": 3.0}]},
     "provenance": {"simulator_sha256": "…", "seed": 1},
     "stem_range": {"left_cm": -14.2, "right_cm": 14.1, "lowest_tip_cm": 6.2, "highest_tip_cm": 21.1,
                    "shortest_cm": 6.5, "longest_cm": 27.3},
     "serial": 1795344000, "expires": "2027-01-01T00:00:00Z",
     "signature": {"algorithm": "ed25519", "key": "…", "value": "…"}}

The network is fed ``(x - offset) / scale`` for each entry of ``inputs``, in that order. The names are those of
:data:`INPUT_NAMES`: ten points, target, and the obstacle as its four edges (left, bottom, right, top), all in cm; a
controller may leave out those that it does not use. Its single output C means left where C <= 0.5, otherwise right
(Wahby et al. 2018, section "Evolutionary approach").

``stem_range`` is how far the simulated plants reached that the network was evolved with; a rig whose plant is outside
of it goes back to the controller before. Without it (or null) no stem is outside.

``serial`` orders the files of one key: a rig that has accepted one takes no other whose serial is not higher. From
``expires`` on a rig accepts the file no more. Both may be left out (0, never), and so may ``signature``
(:mod:`flora_common.signing`).

Never a pickle: loading one runs whatever is in it. Unknown keys, keys given twice, numbers that are not finite,
functions that neat-python does not define and networks with cycles are refused, each with one line.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec

from flora_common.counted import counted
from flora_common.errors import BadController
from flora_common.files import sha256_of_bytes
from flora_common.json_strict import canonical_bytes, read_table
from flora_common.network import Network
from flora_common.network_export import NetworkExport, Number, Strict, network_from
from flora_common.runs import ObstacleSection, TargetSection
from flora_common.shapes import STEM_POINTS, Obstacle, Target
from flora_common.stem_range import StemRange
from flora_common.suggest import did_you_mean
from flora_common.toml_strict import convert

SUFFIX: Final = ".controller.json"
MAX_BYTES: Final = 1_000_000
LEFT_AT_MOST: Final = 0.5
"""C <= 0.5 is left, otherwise right (Wahby et al. 2018, section "Evolutionary approach")."""
OUTPUT_RULE: Final = "at most 0.5 is left"

POINT_NAMES: Final = tuple(f"{axis}{i}" for i in range(1, STEM_POINTS + 1) for axis in "xy")
TARGET_NAMES: Final = ("target_x", "target_y")
OBSTACLE_NAMES: Final = ("obstacle_left", "obstacle_bottom", "obstacle_right", "obstacle_top")
INPUT_NAMES: Final = POINT_NAMES + TARGET_NAMES + OBSTACLE_NAMES
"""The 26 inputs of the paper, in its order."""

Text = Annotated[str, msgspec.Meta(max_length=1000)]
LARGEST_SERIAL: Final = 2**53
"""Up to where every program that reads JSON counts exactly."""
Serial = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_SERIAL)]
UtcTime = Annotated[datetime, msgspec.Meta(tz=True)]
Label = Annotated[str, msgspec.Meta(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")]


class InputScale(Strict, frozen=True):
    """One input: the network is fed ``(x - offset) / scale``."""

    name: str
    offset: Number = 0.0
    scale: Number = 1.0


class Task(Strict, frozen=True):
    """What the controller was evolved for; a rig that is set to something else refuses it, or is told not to."""

    name: Label
    target: TargetSection | None = None
    obstacles: Annotated[tuple[ObstacleSection, ...], msgspec.Meta(max_length=100)] = ()


class Signature(Strict, frozen=True):
    """Ed25519 over :func:`bytes_to_sign`, checked by :func:`flora_common.signing.signer_of`.

    Attributes:
        key: the short name of the public key.
        value: 64 bytes in base64.
    """

    algorithm: Literal["ed25519"]
    key: Annotated[str, msgspec.Meta(max_length=200)]
    value: Annotated[str, msgspec.Meta(max_length=200)]


class ControllerFile(Strict, frozen=True):
    """The whole file, as it stands."""

    format: Literal["flora-controller"]
    version: Literal[1]
    name: Label
    network: NetworkExport
    inputs: Annotated[list[InputScale], msgspec.Meta(min_length=1, max_length=len(INPUT_NAMES))]
    output_rule: Literal["at most 0.5 is left"]
    task: Task
    provenance: dict[Text, Text | int | float | bool] = msgspec.field(default_factory=dict)
    stem_range: StemRange | None = None
    serial: Serial = 0
    expires: UtcTime | None = None
    signature: Signature | None = None


@dataclass(frozen=True, slots=True)
class LoadedController:
    """A file that passed every check.

    Attributes:
        file: its content.
        network: ready to be asked.
        sha256: of the file's bytes.
        data: the bytes.
    """

    file: ControllerFile
    network: Network
    sha256: str
    data: bytes

    def values(
        self, points_cm: Sequence[Sequence[float]], target: Target | None, obstacle: Obstacle | None
    ) -> tuple[float, ...]:
        """What the network is fed, scaled and in its order.

        Args:
            points_cm: ten points (x, y) in cm, anchor first.
            target, obstacle: in cm.

        Raises:
            BadController: it wants to know a target or an obstacle and there is none.
        """
        known = dict(zip(POINT_NAMES, (float(v) for point in points_cm for v in point), strict=True))
        if target is not None:
            known |= {"target_x": target.x_cm, "target_y": target.y_cm}
        if obstacle is not None:
            edges = (obstacle.left_cm, obstacle.bottom_cm, obstacle.right_cm, obstacle.top_cm)
            known |= dict(zip(OBSTACLE_NAMES, edges, strict=True))
        self.check_task(target, obstacle)
        return tuple((known[entry.name] - entry.offset) / entry.scale for entry in self.file.inputs)

    def check_task(self, target: Target | None, obstacle: Obstacle | None) -> None:
        """Whether everything that the network wants to know is there.

        Raises:
            BadController: it wants a target or an obstacle and there is none.
        """
        names = {entry.name for entry in self.file.inputs}
        for wanted, there, section in ((TARGET_NAMES, target, "target"), (OBSTACLE_NAMES, obstacle, "obstacle")):
            if there is None and names.intersection(wanted):
                raise BadController(
                    f"controller `{self.file.name}` wants to know the {section}; give run.toml a section [{section}]"
                )


def load_controller(path: Path) -> LoadedController:
    """Read and check a controller file.

    A symbolic link, such as ``current.controller.json``, is followed once; what it leads to must be a regular file and
    is opened as that, so that nothing can be put in its place between the two.

    Raises:
        BadController: any violation, in one line with the file and the place in it.
    """
    return parse_controller(_read(path), where=str(path))


def parse_controller(data: bytes, *, where: str) -> LoadedController:
    """Check a controller file's bytes; errors as in :func:`load_controller`."""
    if len(data) > MAX_BYTES:
        raise BadController(f"{where}: {len(data)} bytes; a controller file has at most {MAX_BYTES}")
    if not data.strip():
        raise BadController(f"{where}: is empty")
    table = read_table(data, where=where, what="a controller file", error=BadController)
    if table.get("format") != "flora-controller":
        found = str(table.get("format"))[:40] if "format" in table else "missing"
        raise BadController(f"{where}: not a controller file (`format` is {found}, expected flora-controller)")
    if table.get("version") != 1:
        raise BadController(
            f"{where}: version {str(table.get('version'))[:20]} is not known; this program reads version 1"
        )
    network = table.get("network")
    kind = network.get("network_type", "feedforward") if isinstance(network, dict) else "feedforward"
    if kind != "feedforward":
        raise BadController(f"{where}: network is `{str(kind)[:40]}`; only a feedforward one can be evaluated")
    file = convert(table, ControllerFile, where=where, error=BadController)
    _check_inputs(file, where)
    if file.stem_range is not None and not file.stem_range.is_ordered:
        raise BadController(f"{where}: `stem_range` has a least value above its greatest")
    if file.expires is not None and file.expires.utcoffset() != timedelta(0):
        raise BadController(f"{where}: `expires` is not in UTC; write it as 2027-01-01T00:00:00Z")
    return LoadedController(file, network_from(file.network, where), sha256_of_bytes(data), data)


def bytes_to_sign(table: Mapping[str, Any]) -> bytes:
    """The bytes that a signature covers: the one text of the file's table without ``signature``."""
    return canonical_bytes({key: value for key, value in table.items() if key != "signature"})


def _read(path: Path) -> bytes:
    try:
        real = path.resolve(strict=True)
        # Not waiting for a writer: a named pipe in the file's place must not stop the service.
        descriptor = os.open(real, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise BadController(f"{path}: not a regular file")
            if status.st_size > MAX_BYTES:
                raise BadController(f"{path}: {status.st_size} bytes; a controller file has at most {MAX_BYTES}")
            return file.read(MAX_BYTES + 1)
    except RuntimeError as problem:  # a loop of links
        raise BadController(f"{path}: cannot be read (its links run in a circle)") from problem
    except IsADirectoryError as problem:
        told = f"{path}: cannot be read ({problem.strerror}); name the file in it, such as best.controller.json"
        raise BadController(told) from problem
    except OSError as problem:
        raise BadController(f"{path}: cannot be read ({problem.strerror})") from problem
    except ValueError as problem:
        raise BadController(f"{path}: not a path ({problem})") from problem


def _check_inputs(file: ControllerFile, where: str) -> None:
    seen: set[str] = set()
    for place, entry in enumerate(file.inputs, start=1):
        if entry.name not in INPUT_NAMES:
            raise BadController(f"{where}: input {place} is `{entry.name[:40]}`{did_you_mean(entry.name, INPUT_NAMES)}")
        if entry.name in seen:
            raise BadController(f"{where}: input `{entry.name}` is listed twice")
        if abs(entry.scale) < 1e-6:
            raise BadController(f"{where}: input `{entry.name}` has scale {entry.scale:g}; it must not be 0")
        seen.add(entry.name)
    wanted = len(file.network.topology.input_keys)
    if len(file.inputs) != wanted:
        raise BadController(f"{where}: lists {counted(len(file.inputs), 'input')}, the network has {wanted}")
