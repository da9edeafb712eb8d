"""The Raspberry Pi camera by picamera2 (apt: python3-picamera2), exposure, gains and white balance locked.

``capture_request(flush=True)`` waits for a picture whose exposure began after the call, so after the flash was lit;
``wait=<seconds>`` makes it give up, where the default waits for ever.
"""

from __future__ import annotations

import io
from typing import Any, Final

from flora_capture.wire import CameraSettings, Request
from flora_common.errors import CameraGone, CameraTimeout

WANTED: Final = (
    "ExposureTime",
    "AnalogueGain",
    "DigitalGain",
    "ColourGains",
    "SensorTimestamp",
    "SensorTemperature",
    "Lux",
)
FRAME_US: Final = 200_000
"""Five pictures a second are enough between two photographs, and keep the Pi cool."""


class PiCamera:
    """Runs all the time with fixed controls; a photograph is the first whole frame after the request."""

    def __init__(self, settings: CameraSettings) -> None:
        try:
            from picamera2 import Picamera2  # noqa: PLC0415 - on a Pi only
        except ImportError as problem:
            raise CameraGone(f"picamera2 cannot be loaded ({problem}): apt install python3-picamera2") from problem
        self._wait_s = settings.wait_s
        exposure_us = round(settings.exposure_us)
        frame_us = max(FRAME_US, exposure_us)
        try:
            self._camera = Picamera2(int(settings.source or "0"))
            self._camera.options["quality"] = settings.jpeg_quality
            self._camera.configure(
                self._camera.create_still_configuration(
                    main={"size": (settings.width_px, settings.height_px)},
                    buffer_count=2,
                    controls={
                        "AeEnable": False,
                        "AwbEnable": False,
                        "ExposureTime": exposure_us,
                        "AnalogueGain": settings.analogue_gain,
                        "ColourGains": settings.colour_gains,
                        "FrameDurationLimits": (frame_us, frame_us),
                    },
                )
            )
            self._camera.start()
        except (RuntimeError, IndexError, ValueError, OSError) as problem:
            raise CameraGone(f"Pi camera {settings.source or '0'}: {problem}") from problem

    def shoot(self, request: Request) -> tuple[bytes, dict[str, Any]]:
        try:
            taken = self._camera.capture_request(wait=self._wait_s, flush=True)
        except TimeoutError as problem:  # concurrent.futures.TimeoutError, the same class since Python 3.11
            raise CameraTimeout(f"no picture within {self._wait_s:g} s") from problem
        try:
            metadata = taken.get_metadata()
            file = io.BytesIO()
            taken.save("main", file, format="jpeg")
        except (RuntimeError, OSError, ValueError) as problem:
            raise CameraGone(f"Pi camera: {problem}") from problem
        finally:
            taken.release()
        return file.getvalue(), {key: metadata[key] for key in WANTED if key in metadata}

    def close(self) -> None:
        self._camera.close()


def open_camera(settings: CameraSettings) -> PiCamera:
    return PiCamera(settings)
