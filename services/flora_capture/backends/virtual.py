"""The camera of the virtual grow box."""

from __future__ import annotations

from typing import Any

from flora_capture.wire import CameraSettings, Request
from flora_common.errors import BadPicture, CameraGone
from flora_common.twin_link import TwinGone, TwinLink


class VirtualCamera:
    """Presses the box's shutter. Its time-out is longer than the service's: a camera that hangs is killed there."""

    def __init__(self, settings: CameraSettings) -> None:
        self._settings = settings
        self._link = TwinLink(settings.source, timeout_s=settings.wait_s)
        self._link.now()

    def shoot(self, request: Request) -> tuple[bytes, dict[str, Any]]:
        try:
            answer = self._link.ask(
                "shutter",
                exposure_us=self._settings.exposure_us,
                analogue_gain=self._settings.analogue_gain,
                colour_gains=list(self._settings.colour_gains),
                name=request.name,
            )
        except TwinGone as problem:
            raise CameraGone(str(problem)) from problem
        jpeg, metadata = answer.get("jpeg"), answer.get("metadata")
        if not isinstance(jpeg, bytes) or not isinstance(metadata, dict):
            raise BadPicture("the virtual grow box sent no picture")
        return jpeg, metadata

    def close(self) -> None:
        self._link.close()


def open_camera(settings: CameraSettings) -> VirtualCamera:
    return VirtualCamera(settings)
