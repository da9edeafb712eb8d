"""Made tests/golden/messages/v1 once: one message of each kind. Files that are there are never written again.

    .venv/bin/python tests/golden/make_messages.py

They stand for recordings of the past: whatever becomes of the catalogue, they must decode, with the same values.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from flora_common.messages import (
    CATALOGUE,
    ControllerAnswer,
    ControllerChunk,
    ControllerOffer,
    ControllerState,
    Departure,
    DiagnosisFound,
    Flash,
    Frame,
    FrameMissed,
    Health,
    Job,
    JobProgress,
    Lamps,
    LightCommand,
    Message,
    Recording,
    Setup,
    Stem,
    Stored,
    Tick,
    encode,
    spec_of,
)

FOLDER = Path(__file__).parent / "messages" / "v1"
OFFER = "0123456789abcdef"
SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

MESSAGES: tuple[Message, ...] = (
    Tick(time_s=3600.0, tick=13, late_s=0.002, skipped=1),
    Flash(lit=True, confirmed=True, time_s=3600.0, tick=13),
    Frame(
        tick=13,
        time_s=3600.0,
        path="frames/000013.jpg",
        run="bean-07",
        sha256=SHA256,
        bytes=512_345,
        width_px=1640,
        height_px=1232,
        light="left",
        flash_confirmed=True,
        exposure_ok=False,
        exposure_note="exposure 20010 µs instead of 20000 µs",
        exposure_us=20_010.0,
        analogue_gain=1.0,
        digital_gain=1.0,
        red_gain=1.9,
        blue_gain=1.6,
    ),
    FrameMissed(tick=14, time_s=3900.0, because="camera_hung", reason="no picture within 25 s; the camera was killed"),
    Stem(
        tick=13,
        time_s=3600.0,
        outcome="ok",
        points_cm=tuple((-0.25 * i, 1.5 * i) for i in range(10)),
        quality=0.9,
        light="left",
        method="paper",
        frame_sha256=SHA256,
        took_ms=83.5,
    ),
    LightCommand(tick=13, time_s=3600.0, light="right", output=0.73, reason="tip left of the target"),
    ControllerState(
        tick=13,
        controller="middle.controller.json",
        sha256=SHA256,
        time_s=3600.0,
        fitness=0.41,
        best_fitness=0.42,
        tip_cm=(-2.25, 13.5),
        clearance_cm=1.25,
        decisions=13,
        switches=4,
    ),
    Lamps(tick=13, lit="right", commanded="right", current_a=2.75, scale=0.8),
    Setup(active=True, step=2, steps=4, lamps="left", shot="left.jpg"),
    Stored(
        stage="stored",
        path="frames/000013.jpg",
        sha256=SHA256,
        bytes=512_345,
        destination="/mnt/nas/flora/bean-07/frames/000013.jpg",
        waiting=3,
        stored=12,
    ),
    Recording(path="bus/20260301T080000Z-0001.mcap", messages=120, bytes=40_960, bad=1),
    ControllerOffer(
        offer=OFFER, name="left-17.controller.json", sha256=SHA256, bytes=40_000, chunks=3, shadow_ticks=12
    ),
    ControllerChunk(offer=OFFER, number=2, data="eyJmb3JtYXQiOiAiZmxvcmEtY29udHJvbGxlciJ9"),
    ControllerAnswer(offer=OFFER, stage="received", sha256=SHA256, missing=(0, 2), steers="waypoint", reason="2 to go"),
    Departure(
        tick=301,
        run="bean-07",
        is_departed=True,
        hours=25,
        tip_error_mm=17.5,
        right_mm=-17.0,
        up_mm=4.25,
        expected_mm=9.5,
        compared_with="watched",
        sentence="The plant departs from its simulator since hour 25.",
    ),
    DiagnosisFound(
        run="bean-07",
        verdict="explained",
        plant="Saxa 7",
        causes=("sag", "lamp_asymmetry"),
        confidence=(0.97, 0.61),
        path="/var/lib/flora-lab/found/box1-bean-07-9f86d081",
        track_sha256=SHA256,
        sentence="The stem bends under its own weight.",
    ),
    Job(job=OFFER, work="evolve", arguments=("bean.simulator", "--task", "round", "-o", "round"), stop=False),
    JobProgress(job=OFFER, work="evolve", stage="working", share=0.25, text="generations", before=0, took_s=42.5),
    Health(
        state="degraded",
        reason="no frame for 11 min (expected every 5 min)",
        version="0.1.0",
        config_sha256=SHA256,
        uptime_s=3600.5,
        resident_kib=41_000,
        sent=40,
        received=400,
        gaps=1,
        bad=2,
        unknown=3,
        duplicates=4,
        slowest_ms=12.5,
    ),
)


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    assert [spec_of(type(m)).kind for m in MESSAGES] == list(CATALOGUE)
    for message in MESSAGES:
        spec = spec_of(type(message))
        path = FOLDER / f"{spec.kind}.msgpack"
        if path.exists():
            print(f"{path.name} is there: left as it is")
            continue
        source = spec.owner if spec.owner.startswith("flora-") else "flora-stem"
        stamped = msgspec.structs.replace(
            message,
            schema=spec.version,
            source=source,
            session="0123abcd",
            seq=13,
            t_utc_ns=1_772_355_600_123_456_789,
            t_mono_ns=3_600_000_000_000,
        )
        path.write_bytes(encode("box1", stamped)[1])


if __name__ == "__main__":
    main()
