"""Every error that a person can cause or mend.

    FloraError                 one clear line: what, where, what to do; exit status 2 or 1, never a traceback
    ├── BadInput               exit status 2: the caller gave something that cannot be used
    │   ├── ConfigError        the TOML configuration
    │   ├── BadRunFolder       run.toml, frames.csv, track.csv, background/
    │   │   └── NotPermitted   the run folder may be a good one, for another user
    │   ├── BadPicture         an image that is torn, empty, of the wrong size, or not what was announced
    │   ├── BadController      a controller file that must not steer a plant
    │   └── BadMessage         bytes from the bus that are not a message of the catalogue
    ├── DeviceError            exit status 1: the world did not answer as it should
    │   ├── CameraGone         no camera, or it died
    │   ├── CameraTimeout      the camera hung and was killed
    │   ├── FlashDead          the flash lamp did not light
    │   └── LampsDead          the strips could not be written
    ├── StoreError             exit status 1: writing or verifying a file
    │   ├── DiskFull
    │   ├── NasUnreachable     the folder is not there, or its marker file is missing
    │   ├── NasRefused         read-only, or not permitted
    │   └── NasDamaged         what came back is not what was sent
    └── BusUnreachable         exit status 1: nobody answers at the bus address

Anything else that escapes is a bug: it keeps its traceback and ends the process with status 1.
"""

from __future__ import annotations


class FloraError(Exception):
    """An expected failure, told in one line."""

    exit_status = 1


class BadInput(FloraError):
    """The caller gave something that cannot be used."""

    exit_status = 2


class ConfigError(BadInput):
    """The TOML configuration cannot be used."""


class BadRunFolder(BadInput):
    """A file of a run folder is missing or cannot be used."""


class NotPermitted(BadRunFolder):
    """Whoever asks may not look into the run folder; for another user it may be a good one."""


class BadPicture(BadInput):
    """An image is torn, empty, of the wrong size, or not what was announced."""


class BadController(BadInput):
    """A controller file must not steer a plant."""


class BadMessage(BadInput):
    """Bytes from the bus are no message of the catalogue."""


class DeviceError(FloraError):
    """The world did not answer as it should."""


class CameraGone(DeviceError):
    """There is no camera, or it died."""


class CameraTimeout(DeviceError):
    """The camera hung and was killed."""


class FlashDead(DeviceError):
    """The flash lamp did not light."""


class LampsDead(DeviceError):
    """The strips could not be written."""


class StoreError(FloraError):
    """A file could not be written or verified."""


class DiskFull(StoreError):
    """The disk has no room left."""


class NasUnreachable(StoreError):
    """The folder is not there, or its marker file is missing."""


class NasRefused(StoreError):
    """The folder is read-only, or access to it is not permitted."""


class NasDamaged(StoreError):
    """What came back is not what was sent."""


class BusUnreachable(FloraError):
    """Nobody answers at the bus address."""
