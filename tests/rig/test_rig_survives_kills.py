"""Each service is killed at a random moment of a virtual run; the run goes on and nothing announced is lost."""

from __future__ import annotations

import random
import time
from collections.abc import Callable

import pytest

from flora_common.files import sha256_of_file
from flora_twin.rig.integrity import check_run
from flora_twin.rig.virtual_rig import BOX, BUS, SERVICES, Seen, VirtualRig

SEED = 20260301
TICKS_BETWEEN_KILLS = 3
VICTIMS = (BUS, *SERVICES, BOX)


def after_tick(number: int) -> Callable[[Seen], bool]:
    return lambda seen: seen.tick is not None and seen.tick.tick >= number


def test_the_run_survives_the_death_of_every_process(virtual_rig: Callable[..., VirtualRig]) -> None:
    draw = random.Random(SEED)
    rig = virtual_rig(seed=3)
    rig.start()
    rig.calibrate()
    rig.run(lambda seen: seen.lamps is not None and seen.tick is not None)

    for victim in draw.sample(VICTIMS, len(VICTIMS)):
        assert rig.seen.tick is not None
        before = rig.seen.tick.tick
        rig.run(after_tick(before + 1))
        # Somewhere inside a tick: they take a quarter of a second or so.
        moment_s = time.monotonic() + draw.uniform(0.0, 0.4)
        rig.run(lambda seen, moment_s=moment_s: time.monotonic() > moment_s)  # type: ignore[misc]
        rig.supervisor.kill(victim)
        rig.run(after_tick(rig.seen.tick.tick + TICKS_BETWEEN_KILLS), stalled_after_s=100.0)

    last = rig.seen.tick
    assert rig.restarts() == dict.fromkeys(VICTIMS, 1)
    rig.finish()

    run = rig.layout.run
    integrity = check_run(run, rig.layout.nas / run.path.name)
    assert integrity.whole, integrity
    for frame in rig.seen.frames:
        assert sha256_of_file(run.path / frame.path) == frame.sha256
    # The tables are whole: times increase, every file is there, no line twice.
    rows = run.read_frames()
    assert len({row.file for row in rows}) == len(rows)
    assert last is not None
    ticks = last.tick
    # A tick without a photograph is allowed only where its camera, box or beat was killed in that very tick.
    assert len(rows) >= ticks - len(run.background_pictures()) - len(VICTIMS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_many_deaths_at_random(virtual_rig: Callable[..., VirtualRig], seed: int) -> None:
    draw = random.Random(seed)
    rig = virtual_rig(seed=seed)
    rig.start()
    rig.calibrate()
    for _ in range(30):
        assert rig.seen.tick is not None or rig.seen.lamps is not None
        ahead = (rig.seen.tick.tick if rig.seen.tick else 0) + draw.randint(1, 3)
        rig.run(after_tick(ahead), stalled_after_s=100.0)
        rig.supervisor.kill(draw.choice(VICTIMS))
    rig.run(after_tick((rig.seen.tick.tick if rig.seen.tick else 0) + 5), stalled_after_s=100.0)
    rig.finish()
    integrity = check_run(rig.layout.run, rig.layout.nas / rig.layout.run.path.name)
    assert integrity.whole, integrity
