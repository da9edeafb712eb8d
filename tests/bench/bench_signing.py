"""Every single bit of a signed controller file flipped, one after the other: how many are refused, and how fast.

    .venv/bin/python tests/bench/bench_signing.py                  a network of 2 inputs, some 5 seconds
    .venv/bin/python tests/bench/bench_signing.py CONTROLLER       any other; the work grows with the square of its size

A check is what a rig does: parse the bytes, build the network, compare with the canonical text, verify the signature.
Most flipped bits are refused long before the signature is looked at, so that the time of a good file is told too. Ends
with status 1 where one bit went unnoticed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from flora_common.controller_file import load_controller, parse_controller
from flora_common.errors import BadController
from flora_common.json_strict import read_table
from flora_common.signing import PublicKey, public_key, signed_bytes, signer_of

TIP_ONLY = Path(__file__).parent.parent / "golden" / "controllers" / "good" / "tip_only.controller.json"
REPEATS = 300


def is_believed(data: bytes, key: PublicKey) -> bool:
    try:
        signer_of(parse_controller(data, where="x"), {key.id: key})
    except BadController:
        return False
    return True


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("controller", type=Path, nargs="?", default=TIP_ONLY)
    path = parser.parse_args(argv).controller
    loaded = load_controller(path)
    private, other = Ed25519PrivateKey.generate(), Ed25519PrivateKey.generate()
    key = public_key(private.public_key())
    table = read_table(loaded.data, where=str(path), what="a controller file", error=BadController)
    good = signed_bytes(table, private)

    began_s = time.perf_counter()
    believed = sum(is_believed(good, key) for _ in range(REPEATS))
    good_us = (time.perf_counter() - began_s) / REPEATS * 1e6
    parsed = parse_controller(good, where="x")
    began_s = time.perf_counter()
    for _ in range(REPEATS):
        signer_of(parsed, {key.id: key})
    signature_us = (time.perf_counter() - began_s) / REPEATS * 1e6

    flipped, refused = bytearray(good), 0
    began_s = time.perf_counter()
    for place in range(len(good)):
        for bit in range(8):
            flipped[place] ^= 1 << bit
            refused += not is_believed(bytes(flipped), key)
            flipped[place] ^= 1 << bit
    flipped_us = (time.perf_counter() - began_s) / (8 * len(good)) * 1e6
    refused += not is_believed(good, public_key(other.public_key()))

    asked = 8 * len(good) + 1
    print(f"{path.name}, signed: {len(good)} bytes, {len(loaded.network.nodes)} nodes")
    print(f"every bit flipped, and another key: {refused:,} of {asked:,} refused, {flipped_us:.0f} us each")
    print(
        f"the good file: believed {believed} of {REPEATS} times, {good_us:.0f} us each, "
        f"of which canonical text and signature {signature_us:.0f} us"
    )
    return 0 if refused == asked and believed == REPEATS else 1


if __name__ == "__main__":
    sys.exit(main())
