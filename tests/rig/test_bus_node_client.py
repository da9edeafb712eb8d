"""A Node.js program that has only npm's zeromq and @msgpack/msgpack reads stems from the bus."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import pytest

from flora_common.files import sha256_of_file
from flora_common.messages import Stem

CLIENT = Path(__file__).parents[1] / "clients" / "node"
FILES = ("package.json", "read_stems.mjs")
INSTALL_TIMEOUT_S = 45


def installed() -> Path:
    """The client with its packages, in a folder outside the tree; used again as long as its files hold."""
    for program in ("node", "npm"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    version = "-".join(sha256_of_file(CLIENT / name)[:12] for name in FILES)
    folder = Path(tempfile.gettempdir()) / f"flora-node-client-{os.getuid()}-{version}"
    if not folder.exists():
        # In a folder of its own, which then takes the name: other tests of the same user may be at the same.
        made = Path(tempfile.mkdtemp(prefix=f"{folder.name}-"))
        for name in FILES:
            shutil.copy(CLIENT / name, made)
        command = ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock", "--loglevel=error"]
        try:
            done = subprocess.run(command, cwd=made, capture_output=True, text=True, timeout=INSTALL_TIMEOUT_S)
            if done.returncode != 0:
                pytest.skip(f"npm could not install the packages: {done.stderr.strip()[-300:]}")
            with contextlib.suppress(OSError):  # somebody was faster
                made.rename(folder)
        except subprocess.TimeoutExpired:
            pytest.skip(f"npm did not finish in {INSTALL_TIMEOUT_S} s")
        finally:
            shutil.rmtree(made, ignore_errors=True)
    if folder.stat().st_uid != os.getuid():
        pytest.skip(f"{folder} belongs to somebody else")
    return folder


def test_node_reads_stems(bus: Any) -> None:
    folder = installed()
    bus.start_service("flora-bus")
    client = bus.client("flora-stem")
    points = tuple((0.1 * i, 2.0 * i) for i in range(10))
    client.publish(Stem(tick=1, time_s=300.0, outcome="ok", points_cm=points))  # kept for the late comer
    program = subprocess.Popen(
        ["node", "read_stems.mjs", bus.address.subscribe, "test", "3"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    bus.processes.append(program)
    assert program.stdout is not None
    first = program.stdout.readline()
    assert first, program.communicate(timeout=20)
    client.publish(Stem(tick=2, time_s=600.0, outcome="no_stem"))
    client.publish(Stem(tick=3, time_s=900.0, outcome="ok", points_cm=((0.0, 0.0), (-1.25, 7.5))))
    out, err = program.communicate(timeout=20)
    stems = [json.loads(line) for line in (first + out).splitlines()]
    assert [(s["tick"], s["outcome"], s["tip"]) for s in stems] == [
        (1, "ok", [0.9, 18]),
        (2, "no_stem", None),
        (3, "ok", [-1.25, 7.5]),
    ], err
    assert all(int(s["t_utc_ns"]) > 2**53 for s in stems)
    assert program.returncode == 0
