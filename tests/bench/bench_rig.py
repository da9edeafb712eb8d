"""The whole rig, measured: latency from photograph to lamps, memory per service, idle CPU, and time per tick.

    .venv/bin/python tests/bench/bench_rig.py [--ticks 200] [--idle-s 20]

Everything is real but the world: services as processes, bus, files with fsync, JPEG at 1640x1232. Latency is measured
by one listener on the bus, by its own monotonic clock, so it holds the bus's share too.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path
from statistics import median, quantiles

from flora_common.runs import RunFile
from flora_twin.box import camera_section
from flora_twin.rig.layout import make_layout, with_task
from flora_twin.rig.virtual_rig import BOX, DASHBOARD, SERVICES, Seen, VirtualRig

TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Arrivals:
    """When each message of a tick was heard, in real seconds."""

    def __init__(self) -> None:
        self.at: dict[int, dict[str, float]] = defaultdict(dict)

    def look(self, seen: Seen) -> None:
        now_s = time.monotonic()
        flash = seen.flash
        if flash is not None and flash.lit and flash.purpose == "run":
            self.at[flash.tick].setdefault("flash", now_s)
        if seen.frames and seen.frames[-1].purpose == "run":
            self.at[seen.frames[-1].tick].setdefault("frame", now_s)
        for name, message in (("stem", seen.stem), ("lamps", seen.lamps)):
            if message is not None and message.tick in self.at:
                self.at[message.tick].setdefault(name, now_s)

    def steps_ms(self, first: str, last: str) -> list[float]:
        return [1000 * (t[last] - t[first]) for t in self.at.values() if first in t and last in t]


def rig_in(folder: Path, rate: float) -> VirtualRig:
    run_file = RunFile(camera=camera_section(), rig="bench", start=datetime.now(UTC).replace(microsecond=0))
    return VirtualRig(make_layout(folder / f"rig{rate:g}", with_task(run_file)), seed=1, rate=rate)


def memory_mib(pid: int) -> tuple[float, float]:
    """Resident and proportional (shared pages divided among their users) memory, children included."""
    resident = proportional = 0.0
    for each in [pid, *children_of(pid)]:
        text = Path(f"/proc/{each}/smaps_rollup").read_text()
        fields = {line.split(":")[0]: line.split()[1] for line in text.splitlines() if line.endswith("kB")}
        resident += int(fields["Rss"]) / 1024
        proportional += int(fields["Pss"]) / 1024
    return resident, proportional


def children_of(pid: int) -> list[int]:
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def cpu_s(pid: int) -> float:
    total = 0.0
    for each in [pid, *children_of(pid)]:
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        total += (int(fields[11]) + int(fields[12])) / TICKS_PER_S
    return total


def bench_latency(folder: Path, ticks: int) -> None:
    arrivals = Arrivals()
    with rig_in(folder, 0.0) as rig:
        rig.start((*SERVICES, DASHBOARD))
        rig.calibrate()
        began_s = time.monotonic()
        rig.run(lambda seen: seen.tick is not None and seen.tick.time_s >= 300.0 * (ticks - 1), each=arrivals.look)
        took_s = time.monotonic() - began_s
        print(
            f"\n{ticks} ticks in lock-step: {took_s:.1f} s, {1000 * took_s / ticks:.0f} ms a tick, rendering included\n"
        )
        print("| step | p50 ms | p99 ms | n |\n|---|---|---|---|")
        for first, last, name in (
            ("flash", "frame", "flash to photograph on disk (box renders meanwhile)"),
            ("frame", "stem", "photograph announced to stem"),
            ("stem", "lamps", "stem to lamps confirmed"),
            ("frame", "lamps", "**photograph to lamps**"),
        ):
            values = arrivals.steps_ms(first, last)
            print(f"| {name} | {median(values):.1f} | {quantiles(values, n=100)[98]:.1f} | {len(values)} |")
        print("\n| service | resident MiB | proportional MiB |\n|---|---|---|")
        totals = [0.0, 0.0]
        for name, child in rig.supervisor.children.items():
            if child.pid is None or name == BOX:
                continue
            resident, proportional = memory_mib(child.pid)
            if name != DASHBOARD:
                totals[0] += resident
                totals[1] += proportional
            print(f"| {name} | {resident:.1f} | {proportional:.1f} |")
        print(f"| **all** (without virtual box and flora-dashboard) | **{totals[0]:.0f}** | **{totals[1]:.0f}** |")


def bench_idle(folder: Path, seconds: float) -> None:
    with rig_in(folder, 1.0) as rig:
        rig.start((*SERVICES, DASHBOARD))
        rig.calibrate()
        rig.run(lambda seen: seen.lamps is not None and seen.tick is not None and seen.lamps.tick == seen.tick.tick)
        pids = {name: child.pid for name, child in rig.supervisor.children.items() if child.pid is not None}
        before = {name: cpu_s(pid) for name, pid in pids.items()}
        until_s = time.monotonic() + seconds
        rig.run(lambda _: time.monotonic() > until_s)
        print(
            f"\nidle between two ticks, {seconds:g} s (health every 2 s):\n\n| service | CPU % of one core |\n|---|---|"
        )
        used = {name: 100 * (cpu_s(pid) - before[name]) / seconds for name, pid in pids.items() if name != BOX}
        for name, share in used.items():
            print(f"| {name} | {share:.2f} |")
        print(f"| **all** but flora-dashboard | **{sum(used.values()) - used[DASHBOARD]:.2f}** |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--ticks", type=int, default=200)
    parser.add_argument("--idle-s", type=float, default=20.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="flora-bench-") as folder:
        bench_latency(Path(folder), options.ticks)
        bench_idle(Path(folder), options.idle_s)


if __name__ == "__main__":
    main()
