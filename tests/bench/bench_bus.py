"""Bus throughput: publisher, broker and subscriber as processes, ours against bare pyzmq with zmq.proxy.

    .venv/bin/python tests/bench/bench_bus.py [--quick] [--messages 100000] [--rounds 5]

The same three-frame stem messages go through each, in turns, so that a machine that slows down slows all. The publisher
keeps at most 400 messages on the way, by the subscriber's acknowledgements, so nothing is dropped and every message is
counted. The third way is what services use: BusClient.publish and receive, with packing and every check.
"""

from __future__ import annotations

import argparse
import multiprocessing
import subprocess
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median

import msgspec
import zmq

from flora_common.bus import HIGH_WATER_MARK, BusAddress, BusClient
from flora_common.clock import SystemClock
from flora_common.messages import Stem, encode

WINDOW = 400  # ZeroMQ tells the sender what has been read only every half high-water mark
ACKNOWLEDGE_EVERY = 50
STEM = Stem(
    tick=1, time_s=300.0, outcome="ok", quality=1.0, points_cm=tuple((0.1 * i, 2.0 * i) for i in range(10)), seq=1
)
TOPIC = b"bench/stem"


def proxy(address: BusAddress, told: Connection) -> None:
    """What pyzmq gives for free: the C proxy."""
    context = zmq.Context()
    incoming, outgoing = context.socket(zmq.XSUB), context.socket(zmq.XPUB)
    for socket in (incoming, outgoing):
        socket.set_hwm(HIGH_WATER_MARK)
    incoming.bind(address.publish)
    outgoing.bind(address.subscribe)
    told.send("ready")
    zmq.proxy(incoming, outgoing)


def acknowledger(address: str) -> zmq.Socket[bytes]:
    socket = zmq.Context.instance().socket(zmq.PUSH)
    socket.connect(address)
    return socket


def bare_subscriber(address: BusAddress, acks: str, count: int, told: Connection) -> None:
    socket = zmq.Context.instance().socket(zmq.SUB)
    socket.set_hwm(HIGH_WATER_MARK)
    socket.subscribe(b"bench/")
    socket.connect(address.subscribe)
    ack = acknowledger(acks)
    while socket.recv_multipart()[1] != b"warm":  # the publisher repeats it until it comes through
        pass
    ack.send(b"")
    told.send("ready")
    received = 0
    began_s = 0.0
    while received < count:
        parts = socket.recv_multipart()
        if parts[1] == b"warm":
            continue
        if received == 0:
            began_s = time.perf_counter()
        received += 1
        if received % ACKNOWLEDGE_EVERY == 0:
            ack.send(b"")
    told.send((received, time.perf_counter() - began_s))


def client_subscriber(address: BusAddress, acks: str, count: int, told: Connection) -> None:
    client = BusClient(address, rig="bench", source="bench-sub", clock=SystemClock())
    client.subscribe(Stem)
    client.connect()
    ack = acknowledger(acks)
    poller = zmq.Poller()
    poller.register(client.subscriber, zmq.POLLIN)
    poller.register(client.publisher, zmq.POLLIN)
    while not client.connected:
        poller.poll()
        client.handle_publisher()
        client.receive()
    ack.send(b"")
    told.send("ready")
    received, acknowledged = 0, 0
    began_s = 0.0
    while received < count:
        client.subscriber.poll()
        got = len(client.receive())
        if received == 0 and got:
            began_s = time.perf_counter()
        received += got
        while received - acknowledged >= ACKNOWLEDGE_EVERY:
            acknowledged += ACKNOWLEDGE_EVERY
            ack.send(b"")
    told.send((received, time.perf_counter() - began_s))


class Window:
    """Keeps what is on the way below :data:`WINDOW`."""

    def __init__(self, address: str) -> None:
        self.socket = zmq.Context.instance().socket(zmq.PULL)
        self.socket.bind(address)
        self.open = WINDOW

    def take_batch(self, count: int) -> None:
        while self.open < count:
            self.socket.recv()
            self.open += ACKNOWLEDGE_EVERY
        self.open -= count


def publish_bare(address: BusAddress, window: Window, count: int) -> None:
    parts = encode("bench", msgspec.structs.replace(STEM, t_utc_ns=time.time_ns()))
    socket = zmq.Context.instance().socket(zmq.PUB)
    socket.set_hwm(HIGH_WATER_MARK)
    socket.connect(address.publish)
    while not window.socket.poll(10):
        socket.send_multipart([TOPIC, b"warm", b"0"])
    window.socket.recv()
    for _ in range(count // ACKNOWLEDGE_EVERY):
        window.take_batch(ACKNOWLEDGE_EVERY)
        for _ in range(ACKNOWLEDGE_EVERY):
            socket.send_multipart(parts)
    socket.close()


def publish_client(address: BusAddress, window: Window, count: int) -> None:
    client = BusClient(address, rig="bench", source="bench-pub", clock=SystemClock())
    client.connect()
    while not client.connected:
        client.publisher.poll(100)
        client.handle_publisher()
        client.receive()
    window.socket.recv()
    for _ in range(count // ACKNOWLEDGE_EVERY):
        window.take_batch(ACKNOWLEDGE_EVERY)
        for _ in range(ACKNOWLEDGE_EVERY):
            client.publish(STEM)
    client.close()


def measure(way: str, count: int) -> float:
    """Messages per second from first to last at the subscriber."""
    processes = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="flora-bench-") as folder:
        address = BusAddress(f"ipc://{folder}/pub", f"ipc://{folder}/sub")
        acks = f"ipc://{folder}/ack"
        here, there = processes.Pipe()
        broker = None
        bus = None
        if way == "bare pyzmq":
            broker = processes.Process(target=proxy, args=(address, there))
            broker.start()
            here.recv()
        else:
            config = Path(folder) / "flora.toml"
            config.write_text(
                f'[rig]\nstate_dir = "{folder}"\nbus_publish = "{address.publish}"\n'
                f'bus_subscribe = "{address.subscribe}"\nhealth_every_s = 60.0\n'
            )
            bus = subprocess.Popen([Path(sys.executable).parent / "flora-bus", "-q", "--config", str(config)])
        is_client = way == "BusClient through flora-bus"
        target = client_subscriber if is_client else bare_subscriber
        subscriber = processes.Process(target=target, args=(address, acks, count, there))
        window = Window(acks)
        subscriber.start()
        try:
            (publish_client if is_client else publish_bare)(address, window, count)
            assert here.recv() == "ready"
            received, took_s = here.recv()
            assert received == count
            return float((received - 1) / took_s)
        finally:
            subscriber.join()
            window.socket.close()
            if broker is not None:
                broker.kill()
                broker.join()
            if bus is not None:
                bus.kill()
                bus.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few seconds, rough figures")
    parser.add_argument("--messages", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    count, rounds = (20_000, 1) if options.quick else (options.messages, options.rounds)
    count -= count % ACKNOWLEDGE_EVERY
    ways = ("bare pyzmq", "flora-bus", "BusClient through flora-bus")
    rates: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(rounds):
        for way in ways:
            rates[way].append(measure(way, count))
    size = sum(map(len, encode("bench", STEM)))
    print(f"{count} stems of {size} bytes, {rounds} rounds in turns; messages per second")
    print(f"{'way':<30} {'median':>9} {'least':>9} {'most':>9} {'of bare':>8}")
    bare = median(rates["bare pyzmq"])
    for way in ways:
        middle = median(rates[way])
        print(f"{way:<30} {middle:>9.0f} {min(rates[way]):>9.0f} {max(rates[way]):>9.0f} {middle / bare:>8.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
