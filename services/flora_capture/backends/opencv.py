"""A USB camera (V4L2), or a video file in its place."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

from flora_common.counted import counted

# Read when OpenCV is loaded: its own chatter about a device that is not there would stand before our one line.
os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import cv2

from flora_capture.backends import FilmEnded
from flora_capture.source import device_number, is_device
from flora_capture.wire import CameraSettings, Request
from flora_common.errors import BadPicture, CameraGone

STALE_FRAMES: Final = 5
"""V4L2 drivers hold up to four pictures ready, taken before the flash was lit; a fifth may be in the making."""
V4L2_MANUAL_EXPOSURE: Final = 1
US_PER_V4L2_UNIT: Final = 100.0


class OpenCvCamera:
    """Pictures by OpenCV; metadata are what the driver tells of exposure, and nothing for a file."""

    def __init__(self, settings: CameraSettings) -> None:
        self._name = settings.source
        self._quality = settings.jpeg_quality
        device = device_number(settings.source)
        self._is_device = device is not None
        if device is None:
            if is_device(settings.source):
                raise CameraGone(f"{settings.source}: no such camera; is it plugged in?")
            if not Path(settings.source).is_file():
                raise CameraGone(f"{settings.source}: no such video file")
            self._capture = cv2.VideoCapture(settings.source)
        else:
            self._capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            what = "no such camera, or it is in use" if self._is_device else "not a video that OpenCV can read"
            raise CameraGone(f"{settings.source}: {what}")
        if self._is_device:
            self._lock(settings)

    def _lock(self, settings: CameraSettings) -> None:
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, settings.width_px),
            (cv2.CAP_PROP_FRAME_HEIGHT, settings.height_px),
            (cv2.CAP_PROP_BUFFERSIZE, 1),
            (cv2.CAP_PROP_AUTO_EXPOSURE, V4L2_MANUAL_EXPOSURE),
            (cv2.CAP_PROP_EXPOSURE, settings.exposure_us / US_PER_V4L2_UNIT),
            (cv2.CAP_PROP_AUTO_WB, 0),
        ):
            self._capture.set(key, value)  # what a driver does not know it ignores; the metadata tell

    def shoot(self, request: Request) -> tuple[bytes, dict[str, Any]]:
        if self._is_device:
            for _ in range(STALE_FRAMES):
                self._capture.grab()
        elif int(self._capture.get(cv2.CAP_PROP_POS_FRAMES)) != request.index:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, request.index)
        is_read, picture = self._capture.read()
        if not is_read or picture is None:
            if self._is_device:
                raise CameraGone(f"{self._name}: the camera gives no picture")
            raise FilmEnded(f"{self._name}: the film has ended after {counted(self._length(request.index), 'picture')}")
        is_packed, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self._quality])
        if not is_packed:
            raise BadPicture(f"{self._name}: the picture cannot be written as JPEG")
        return jpeg.tobytes(), self._metadata()

    def _length(self, missing: int) -> int:
        """Pictures of the film, where ``missing`` (from 0) is one that it has not; containers tell but an estimate."""
        told = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        return min(told, missing) if told > 0 else missing

    def _metadata(self) -> dict[str, Any]:
        exposure = float(self._capture.get(cv2.CAP_PROP_EXPOSURE)) if self._is_device else 0.0
        return {"ExposureTime": exposure * US_PER_V4L2_UNIT} if exposure > 0.0 else {}

    def close(self) -> None:
        self._capture.release()


def open_camera(settings: CameraSettings) -> OpenCvCamera:
    return OpenCvCamera(settings)
