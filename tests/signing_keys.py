"""Keys and signed files for tests: the same keys in every run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from flora_common.controller_file import LoadedController, parse_controller
from flora_common.signing import PublicKey, public_key, signed_bytes

GOOD = Path(__file__).parent / "golden" / "controllers" / "good"
TIP_ONLY = GOOD / "tip_only.controller.json"
EXPORT = GOOD / "neat_export.controller.json"

ADA = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
BOB = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))


def trusted(*keys: Ed25519PrivateKey) -> dict[str, PublicKey]:
    """The public halves, by their short names."""
    made = (public_key(key.public_key()) for key in keys)
    return {key.id: key for key in made}


def signed(path: Path = TIP_ONLY, key: Ed25519PrivateKey = ADA, **changes: Any) -> LoadedController:
    """A golden file with some of its keys changed, then signed."""
    table = json.loads(path.read_text(encoding="utf-8")) | changes
    return parse_controller(signed_bytes(table, key), where="x")
