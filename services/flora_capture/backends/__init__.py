"""Cameras. Each module has ``open_camera(settings)``; only the camera process imports them, one of them."""

from __future__ import annotations

from typing import Any, Protocol

from flora_capture.wire import Request
from flora_common.errors import CameraGone


class FilmEnded(CameraGone):
    """What stands in a camera's place has no further picture, and never will."""


class Camera(Protocol):
    """Takes one photograph at a time."""

    def shoot(self, request: Request) -> tuple[bytes, dict[str, Any]]:
        """A photograph whose exposure began after the call.

        Returns:
            JPEG file content, and the metadata under libcamera's names: ExposureTime (us), AnalogueGain, DigitalGain,
            ColourGains (red, blue), SensorTimestamp (ns). What the camera does not know is left out.

        Raises:
            CameraTimeout: no picture in time.
            CameraGone: no camera any more.
            FilmEnded: no further picture of a film or an old run.
            BadPicture: a picture that cannot be used.
        """
        ...

    def close(self) -> None: ...
