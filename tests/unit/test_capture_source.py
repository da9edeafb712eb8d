"""``[capture] source``: which camera, film or run it names, and what is refused before a camera is opened."""

from __future__ import annotations

from pathlib import Path

import pytest

from flora_capture.backends.opencv import open_camera
from flora_capture.service import CaptureSection
from flora_capture.source import check_source, device_number, is_device
from flora_common.errors import CameraGone, ConfigError
from flora_common.runs import CameraSection

UNPLUGGED = "/dev/v4l/by-id/usb-none-video-index0"


@pytest.mark.parametrize(("source", "number"), [("2", 2), ("/dev/video7", 7), ("bean.avi", None), (UNPLUGGED, None)])
def test_a_camera_is_known_by_number_or_device(source: str, number: int | None) -> None:
    assert device_number(source) == number
    assert is_device(source) == (source != "bean.avi")


def test_a_camera_is_known_by_a_link_that_stays_its_own(tmp_path: Path) -> None:
    link = tmp_path / "usb-046d_C270-video-index0"
    link.symlink_to("/dev/video7")
    assert device_number(str(link)) == 7
    check_source("opencv", str(link))


def test_a_usb_camera_that_is_not_plugged_in_may_come() -> None:
    check_source("opencv", UNPLUGGED)
    section = CaptureSection(backend="opencv", source=UNPLUGGED)
    with pytest.raises(CameraGone, match="no such camera; is it plugged in"):
        open_camera(section.settings(CameraSection((32.0, 40.0), 4.0), ""))


@pytest.mark.parametrize("source", ["", "0", "1"])
def test_a_pi_camera_has_a_number(source: str) -> None:
    check_source("picamera2", source)


@pytest.mark.parametrize("source", ["front", "-1", "/dev/video0", "imx219"])
def test_what_is_no_number_of_a_pi_camera_is_refused(source: str) -> None:
    with pytest.raises(ConfigError, match=f"source {source}: not the number of a Pi camera, 0 for the first one"):
        check_source("picamera2", source)
