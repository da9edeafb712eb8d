"""The physical world at the far end of the wires: plant, lamps, flash, camera and time. No sockets, no clock."""

from __future__ import annotations

import io
import json
import math
import zipfile
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.geometry import resample_by_height
from flora_common.runs import CameraSection, Light
from flora_common.shapes import STEM_POINTS
from flora_twin import faults as menu
from flora_twin.box import BOX, CAMERA, Box, PinholeCamera
from flora_twin.faults import ActiveFaults
from flora_twin.parameters import PlantParameters, draw_individual
from flora_twin.plant import STEP_S, Plants
from flora_twin.render import Exposure, Lighting, Studio, Subject
from flora_twin.render.foliage import leaves_of
from flora_twin.strips import DARK, LampLight, light_name, read_strips

CHECKPOINT_VERSION: Final = 1
MAX_ADVANCE_S: Final = 30 * 86_400.0
_DAMAGE: Final = (
    *(ValueError, KeyError, TypeError, EOFError, OSError, ArithmeticError),
    *(RuntimeError, MemoryError, zipfile.BadZipFile),
)
"""What zipfile, numpy and json raise over damaged archives."""
_TORN_SHARE: Final = 0.6
_READOUT_US: Final = 23_300


@dataclass(frozen=True, slots=True)
class Truth:
    """What is really there, as a perfect measurement in the picture would find it.

    Attributes:
        time_s: when.
        centreline_cm: shape (n, 2), anchor first, tip last, at the scale of the plant's plane.
        centreline_px: shape (n, 2), x to the right, y down.
        centreline_3d_cm: shape (n, 3), in the box.
        points_cm: shape (10, 2), the convention of ``track.csv``.
        tip_cm: shape (2,), the last of ``points_cm``.
        height_cm: of the tip.
        length_cm: along the stem.
        leaves: where each blade starts (x, y) and how long it is, in cm.
    """

    time_s: float
    centreline_cm: FloatArray
    centreline_px: FloatArray
    centreline_3d_cm: FloatArray
    points_cm: FloatArray
    tip_cm: FloatArray
    height_cm: float
    length_cm: float
    leaves: tuple[dict[str, float], ...]


class World:
    """A grow box with one plant.

    The plant moves in steps of 100 s on the world's own grid, each under the mean light of its time, so that its course
    does not depend on how often someone asks for the time.

    Args:
        seed: the individual, the box's textures and all noise.
        parameters: of the plant; drawn from the seed where missing.
        planted: whether the plant stands in the box at the start.
        camera, box: as in the paper where missing.
    """

    def __init__(
        self,
        seed: int,
        *,
        parameters: PlantParameters | None = None,
        planted: bool = True,
        camera: PinholeCamera = CAMERA,
        box: Box = BOX,
    ) -> None:
        if not 0 <= seed < 2**62:
            raise BadInput(f"seed is {seed}; it must be a whole number from 0")
        self.seed, self.camera, self.box = seed, camera, box
        self.time_s = 0.0
        self.lamps: tuple[LampLight, LampLight] = DARK
        self.flash = False
        self.planted = planted
        self.faults = ActiveFaults()
        self.plants = Plants([seed], [parameters or draw_individual(seed)], box)
        self._dose = np.zeros(2)
        self._pictures_now = 0
        self._studio: Studio | None = None

    # Time

    def advance_to(self, time_s: float) -> None:
        """Let time pass until ``time_s`` under the present lamps; a time that is past changes nothing.

        Raises:
            BadInput: not finite, or more than 30 days ahead.
        """
        if not math.isfinite(time_s) or time_s - self.time_s > MAX_ADVANCE_S:
            raise BadInput(f"time {time_s:g} s is more than {MAX_ADVANCE_S / 86_400:g} days after {self.time_s:g} s")
        levels = np.array([lamp.bending for lamp in self.lamps])
        while self.time_s < time_s:
            step_end = (math.floor(self.time_s / STEP_S) + 1) * STEP_S
            until = min(step_end, time_s)
            self._dose += levels * (until - self.time_s)
            self.time_s = until
            self._pictures_now = 0
            if until == step_end:
                if self.planted:
                    self.plants.step(self._dose[0] / STEP_S, self._dose[1] / STEP_S, STEP_S)
                self._dose[:] = 0.0

    # Hands

    def set_strips(self, grb: bytes) -> None:
        """The bytes that the chain of 288 pixels is sent; see :func:`flora_twin.strips.read_strips`.

        Raises:
            BadInput: not 864 bytes.
        """
        lamps = read_strips(grb)
        if not self.faults.occurs(menu.LAMP_COMMAND_LOST):
            self.lamps = lamps

    def set_flash(self, on: bool) -> bool:
        """Switch the flash lamp; returns what it really does."""
        self.flash = on and not self.faults.occurs(menu.FLASH_DEAD)
        return self.flash

    def set_planted(self, present: bool) -> None:
        """Put the plant into the box or take it out. It does not age while it is out."""
        self.planted = present

    def switch_fault(self, name: str, on: bool, *, times: int | None = None, seconds: float | None = None) -> None:
        """See :meth:`flora_twin.faults.ActiveFaults.switch`; a flash that dies while it is lit goes dark."""
        self.faults.switch(name, on, times=times, seconds=seconds)
        if name == menu.FLASH_DEAD and on and self.flash:
            self.flash = not self.faults.occurs(menu.FLASH_DEAD)

    # Eyes

    @property
    def light(self) -> Light:
        """The lamps' state as run folders name it."""
        return light_name(*self.lamps)

    @property
    def camera_section(self) -> CameraSection:
        """The ``[camera]`` section of ``run.toml`` that belongs to these photographs."""
        return self.camera.camera_section()

    def photograph(
        self, exposure_us: float, analogue_gain: float = 1.0, colour_gains: tuple[float, float] = (1.9, 1.6)
    ) -> tuple[bytes, dict[str, Any]]:
        """Open the shutter.

        Returns:
            The JPEG file, and metadata named as picamera2 names a request's.

        Raises:
            BadInput: settings that no camera takes.
        """
        _check("exposure_us", exposure_us, 1.0, 6_000_000.0)
        _check("analogue_gain", analogue_gain, 1.0, 10.67)
        for gain in colour_gains:
            _check("colour_gains", gain, 0.01, 32.0)
        taken = Exposure(exposure_us, analogue_gain, (float(colour_gains[0]), float(colour_gains[1]))).as_taken()
        if self._studio is None:
            self._studio = Studio(self.seed, self.camera, self.box)
        tick = (round(self.time_s * 1000.0), self._pictures_now)
        self._pictures_now += 1
        picture = self._studio.picture(
            Lighting(*self.lamps, flash=self.flash),
            taken,
            self.subject() if self.planted else None,
            tick,
            knocked=self.faults.occurs(menu.CAMERA_KNOCKED),
        )
        jpeg = self._studio.sensor.encode(picture)
        if self.faults.occurs(menu.TORN_JPEG):
            jpeg = jpeg[: int(len(jpeg) * _TORN_SHARE)]
        exposure = round(taken.exposure_us)
        metadata = {
            "ExposureTime": exposure,
            "AnalogueGain": taken.analogue_gain,
            "DigitalGain": 1.0,
            "ColourGains": list(taken.colour_gains),
            "FrameDuration": max(exposure + 500, _READOUT_US),
            "SensorTimestamp": round(self.time_s * 1e9),
        }
        return jpeg, metadata

    def subject(self) -> Subject:
        """The plant as the camera meets it."""
        nodes = self.plants.leaf_nodes_cm[0]
        return Subject(
            self.plants.line_cm(0),
            (float(nodes[0]), float(nodes[1])),
            self.plants.time_s / 3600.0,
            self.plants.parameters[0],
        )

    def truth(self) -> Truth | None:
        """Where the plant really is; none without a plant."""
        if not self.planted:
            return None
        line = self.plants.line_cm(0)
        pixels = self.camera.project(line)
        plane = self.camera.to_picture_plane_cm(pixels)
        points = resample_by_height(plane, STEM_POINTS)
        leaves = tuple(
            {"x_cm": float(leaf.base_cm[0]), "y_cm": float(leaf.base_cm[1]), "length_cm": leaf.length_cm}
            for leaf in leaves_of(self.subject())
        )
        return Truth(
            self.time_s,
            plane,
            pixels,
            line,
            points,
            points[-1],
            float(points[-1, 1]),
            float(self.plants.length_cm[0]),
            leaves,
        )

    # Memory

    def snapshot(self) -> bytes:
        """Everything that is needed to go on, as an uncompressed ``.npz`` file without pickles."""
        head = {
            "version": CHECKPOINT_VERSION,
            "seed": self.seed,
            "time_s": self.time_s,
            "lamps": [[lamp.red, lamp.green, lamp.blue] for lamp in self.lamps],
            "flash": self.flash,
            "planted": self.planted,
            "dose": self._dose.tolist(),
            "pictures_now": self._pictures_now,
            "faults": self.faults.to_json(),
        }
        out = io.BytesIO()
        arrays: dict[str, Any] = {f"plant_{name}": values for name, values in self.plants.state().items()}
        np.savez(out, allow_pickle=False, head=np.frombuffer(json.dumps(head).encode(), np.uint8), **arrays)
        return out.getvalue()

    def restore(self, snapshot: bytes) -> None:
        """Go back to a snapshot of the same world; after an error nothing has changed.

        Raises:
            BadInput: not a snapshot, of another version, or of another seed.
        """
        try:
            with np.load(io.BytesIO(snapshot), allow_pickle=False) as archive:
                head = json.loads(archive["head"].tobytes())
                state = {name[6:]: archive[name] for name in archive.files if name.startswith("plant_")}
            if head["version"] != CHECKPOINT_VERSION:
                raise BadInput(f"snapshot of version {head['version']}, this program reads {CHECKPOINT_VERSION}")
            if head["seed"] != self.seed:
                raise BadInput(f"snapshot of seed {head['seed']}, this world has seed {self.seed}")
            plants = Plants.from_state(state, self.box)
            left, right = (LampLight(*(float(v) for v in lamp)) for lamp in head["lamps"])
            faults = ActiveFaults.from_json(head["faults"])
            time_s, dose = float(head["time_s"]), np.array(head["dose"], dtype=np.float64)
            if dose.shape != (2,) or not np.isfinite(dose).all() or not 0.0 <= time_s < math.inf:
                raise ValueError("time or light dose out of range")
            flash, planted, pictures = bool(head["flash"]), bool(head["planted"]), int(head["pictures_now"])
        except _DAMAGE as problem:
            raise BadInput(f"not a snapshot of a world ({problem})") from problem
        self.plants, self.lamps, self.faults = plants, (left, right), faults
        self.time_s, self._dose = time_s, dose
        self.flash, self.planted, self._pictures_now = flash, planted, pictures


def _check(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise BadInput(f"{name} is {value}; it must lie in [{low:g}, {high:g}]")
