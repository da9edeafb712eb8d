"""What the monitor says when it hears nothing, with a bus in the same process."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from flora_bus.broker import Broker
from flora_common import bus_connection
from flora_common.bus import BusAddress, BusClient
from flora_common.clock import SystemClock
from flora_common.config import RigSection
from flora_monitor import listen
from flora_monitor.listen import Listener, rigs_on
from flora_monitor.stats import rig_of


@pytest.fixture
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RigSection]:
    """A bus that nobody else is on, in a thread."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(listen, "SILENT_AFTER_S", 0.2)
        name = tmp_path_factory.mktemp("bus").name
        address = BusAddress(f"inproc://{name}-pub", f"inproc://{name}-sub")
        is_bound, is_over = threading.Event(), threading.Event()

        def serve() -> None:
            broker = Broker(address)
            is_bound.set()
            poller = zmq.Poller()
            poller.register(broker.incoming, zmq.POLLIN)
            poller.register(broker.outgoing, zmq.POLLIN)
            while not is_over.is_set():
                poller.poll(20)
                broker.pass_on()
                broker.serve_subscriptions()
            broker.close()

        thread = threading.Thread(target=serve)
        thread.start()
        assert is_bound.wait(10.0)
        yield RigSection(name="test", bus_publish=address.publish, bus_subscribe=address.subscribe)
        is_over.set()
        thread.join()


def turns(listener: Listener, count: int) -> None:
    for number, _ in enumerate(listener.batches(every_s=0.05)):
        if number == count:
            return


@pytest.mark.parametrize("only_rig", [None, "nosuch"])
def test_a_bus_without_messages_is_told_once(
    rig: RigSection, only_rig: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    listener = Listener(rig, only_rig=only_rig)
    turns(listener, 20)
    listener.explain_silence()
    listener.close()
    said = f"flora-monitor: nothing is heard, of any rig; the bus at {rig.bus_subscribe} answers\n"
    assert capsys.readouterr().err == said
    assert rigs_on(rig) == []


def test_a_rig_by_a_message_that_cannot_be_read_is_a_rig_too(
    rig: RigSection, capsys: pytest.CaptureFixture[str]
) -> None:
    loud = BusClient(rig.bus, rig="test", source="loud", clock=SystemClock())
    loud.subscribe_prefixes(b"")
    loud.connect()
    heard_of: set[str] = set()
    while len(heard_of) < listen.MOST_RIGS + 2:
        loud.subscriber.poll(50)
        loud.handle_publisher()
        heard_of |= {rig_of(arrival) for arrival in loud.receive_all()}
        for number in range(listen.MOST_RIGS + 2 if loud.connected else 0):
            # A kept kind, and a payload that only its receivers find wrong.
            loud.publisher.send_multipart([f"box{number:02}/tick".encode(), b"\xc1", b"0"])
    listener = Listener(rig, only_rig="nosuch")
    turns(listener, 20)
    shown = ", ".join(f"box{number:02}" for number in range(listen.MOST_RIGS))
    assert capsys.readouterr().err == (
        f"flora-monitor: nothing is heard of rig `nosuch`; on this bus are: {shown} and 2 more\n"
    )
    heard = Listener(rig, only_rig="box03")
    turns(heard, 20)
    assert capsys.readouterr().err == ""
    for one in (loud, listener, heard):
        one.close()


def test_while_the_monitor_itself_stood_still_it_waited_for_no_bus(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_connection, "NO_BUS_AFTER_S", 0.5)
    nobody = RigSection(bus_publish=f"ipc://{tmp_path}/p", bus_subscribe=f"ipc://{tmp_path}/s")
    listener = Listener(nobody)
    time.sleep(0.6)  # stopped, or on a busy machine
    turns(listener, 2)
    assert capsys.readouterr().err == ""  # it may answer at once
    turns(listener, 20)
    listener.close()
    assert capsys.readouterr().err == f"flora-monitor: no bus answers at ipc://{tmp_path}/s; waiting for it\n"
