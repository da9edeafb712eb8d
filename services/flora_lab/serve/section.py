"""``[lab]`` of the configuration file: what the service of the lab watches and diagnoses, and where that goes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec

from flora_common.config import RigSection
from flora_common.errors import ConfigError
from flora_common.rig_name import RigName


class RunsSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[lab.rigs.NAME]``: one of several rigs on the bus."""

    runs_dir: str = ""
    """Folder in which its run folders end up; empty: what is heard on the bus is diagnosed."""


class LabSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[lab]``: against what plants are watched and runs diagnosed."""

    simulator: str = ""
    """A simulator folder that ``flora-lab diagnose`` wrote."""

    reference: str = ""
    """Or a folder of healthy runs, from which it is learned once."""

    runs_dir: str = ""
    """Folder in which the run folders of ``[rig]`` end up; empty: what is heard on the bus is diagnosed."""

    output: str = ""
    """Folder of all diagnoses and of the record of them; empty: ``found`` in the state folder."""

    false_alarms: Annotated[float, msgspec.Meta(ge=1e-6, le=0.5)] = 0.01
    """Rate per run at which a plant that is as its simulator says is told to depart from it."""

    settled_s: Annotated[float, msgspec.Meta(ge=0.1, le=1e6)] = 1800.0
    """Real seconds without anything new after which a run has ended, whatever the bus says."""

    settled_when_told_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] = 900.0
    """The same for a run of which the bus said that it is over: what the uploader sends at most so much later."""

    scan_every_s: Annotated[float, msgspec.Meta(ge=0.05, le=3600.0)] = 60.0
    """Real seconds between looks for runs that have ended."""

    longest_s: Annotated[float, msgspec.Meta(ge=1.0, le=1e6)] = 3600.0
    """Real seconds after which a diagnosis is ended."""

    jobs_dir: str = ""
    """Folder in which jobs from the bus work, one at a time, and in no other; empty: none are taken."""

    rigs: Mapping[RigName, RunsSection] = {}
    """Rigs on this bus; none: the one of ``[rig]``."""

    @property
    def is_off(self) -> bool:
        """Whether there is nothing to compare plants with. Jobs are taken all the same."""
        return not self.simulator and not self.reference

    def runs_dirs(self, rig: RigSection) -> dict[str, str]:
        """Each rig's name, and where its runs end up."""
        return {name: one.runs_dir for name, one in self.rigs.items()} or {rig.name: self.runs_dir}

    def output_dir(self, rig: RigSection) -> Path:
        """Folder of all diagnoses."""
        return Path(self.output) if self.output else Path(rig.state_dir) / "found"


def check(_: RigSection, section: LabSection) -> None:
    """What a type cannot say.

    Raises:
        ConfigError: both a simulator and a reference; a file where a folder is to be.
    """
    if section.simulator and section.reference:
        raise ConfigError("[lab] give either `simulator` or `reference`: what plants are compared with")
    for key, folder in (("jobs_dir", section.jobs_dir), ("output", section.output)):
        path = Path(folder)
        nearest = next(one for one in (path, *path.parents, Path("/")) if one.exists())
        if folder and not nearest.is_dir():
            raise ConfigError(f"[lab] {key} {folder}: {nearest} is a file; name a folder")
