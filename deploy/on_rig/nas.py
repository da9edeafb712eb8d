"""One file to the NAS and back, as the uploader's user, by the release that runs."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

from machine import Failed, run, say
from releases import CURRENT

ANSWERS_WITHIN_S = 40.0


def look(config: Path) -> None:
    """Write a file to ``[uploader] target``, read it back and remove it.

    Raises:
        Failed: that did not work; the release is well all the same.
    """
    printed = run([str(CURRENT / "bin/flora-uploader"), "--config", str(config), "--print-config"])
    section = tomllib.loads(printed.stdout)["uploader"]
    if not section["target"]:
        say("unchanged  NAS: [uploader] target is empty, nothing is uploaded")
        return
    probe = [str(CURRENT / "bin/python"), "-P", "-m", "flora_monitor.doctor_nas", section["target"], section["marker"]]
    done = run(["runuser", "-u", "flora", "--", *probe, "--touch"], within_s=ANSWERS_WITHIN_S)
    problem = json.loads(done.stdout.splitlines()[-1])["problem"]
    if problem:
        raise Failed(f"the release is well, but not the NAS: {problem}")
    say(f"well       NAS: one file written to {section['target']}, read back and removed")
