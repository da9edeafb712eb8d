"""The controller that the demo steers with is one that a careful rig would take."""

from __future__ import annotations

from pathlib import Path

from flora_common.controller_file import load_controller
from flora_common.paper_experiment import REALITY_OBSTACLE, REALITY_TARGET
from flora_common.signing import read_trusted_keys
from flora_controller.acceptance import Acceptance, Policy
from flora_controller.serials import Serials
from flora_twin.rig.shipped_controller import CONTROLLER, KEYS_DIR


def test_it_is_signed_and_fits_the_demos_task() -> None:
    policy = Policy("required", "same", REALITY_TARGET, REALITY_OBSTACLE, read_trusted_keys(KEYS_DIR))
    acceptance = Acceptance(policy, Serials(), keep=lambda serials: None, utc=lambda: None)
    signer = acceptance.check(load_controller(CONTROLLER), offered=False)
    assert signer is not None
    assert signer.id in policy.keys


def test_it_says_where_it_is_from() -> None:
    file = load_controller(CONTROLLER).file
    assert file.task.name == "round"
    for name in ("simulator_sha256", "dataset_sha256", "settings_sha256", "task_sha256"):
        assert len(str(file.provenance[name])) == 64
    assert {"seed", "run_seed", "generation", "individuals", "fitness", "software"} <= set(file.provenance)


def test_the_key_that_signs_is_not_shipped() -> None:
    assert not [path for path in Path(KEYS_DIR).rglob("*") if path.is_file() and b"PRIVATE" in path.read_bytes()]
