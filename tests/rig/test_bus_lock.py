"""Two buses at one address: the second one is refused, and the first one is heard as before."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

from flora_common.messages import Tick


def test_a_second_bus_with_other_folders_does_not_take_the_sockets_away(bus: Any) -> None:
    first = bus.start_service("flora-bus")
    client = bus.client("flora-flash")
    inode = Path(bus.address.publish.removeprefix("ipc://")).stat().st_ino

    bus.sections["rig"]["state_dir"] = str(bus.folder / "other-state")
    second = bus.start_service("flora-bus")
    _, err = second.communicate(timeout=20)
    assert second.returncode == 2
    assert err.splitlines()[-1] == (
        f"flora-bus: {bus.address.publish}: already served by pid {first.pid}; stop it first, "
        "or give this rig endpoints of its own"
    )
    assert Path(bus.address.publish.removeprefix("ipc://")).stat().st_ino == inode
    client.publish(Tick(tick=1, time_s=0.0))
    bus.hear(client, lambda heard: any(isinstance(a.message, Tick) for a in heard))

    first.send_signal(signal.SIGKILL)  # a killed bus leaves its files, and no lock
    first.wait()
    bus.start_service("flora-bus")
    client.publish(Tick(tick=2, time_s=0.0))
    bus.hear(client, lambda heard: any(getattr(a.message, "tick", 0) == 2 for a in heard))


def test_one_shared_endpoint_is_enough_to_be_refused(bus: Any) -> None:
    first = bus.start_service("flora-bus")
    bus.client()
    bus.sections["rig"] |= {
        "state_dir": str(bus.folder / "other-state"),
        "bus_publish": bus.address.publish + "-other",
    }
    second = bus.start_service("flora-bus")
    _, err = second.communicate(timeout=20)
    assert second.returncode == 2
    assert f"{bus.address.subscribe}: already served by pid {first.pid}" in err


def test_both_endpoints_the_same_is_bad_input(bus: Any) -> None:
    bus.sections["rig"]["bus_subscribe"] = bus.address.publish
    process = bus.start_service("flora-bus")
    _, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert err.splitlines()[-1].endswith("they must differ")


def test_a_folder_for_sockets_that_cannot_be_made_is_bad_input(bus: Any) -> None:
    (bus.folder / "file").touch()
    bus.sections["rig"]["bus_publish"] = f"ipc://{bus.folder}/file/p"
    process = bus.start_service("flora-bus")
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err.count("\n")) == (2, 1)
    assert "the socket's folder cannot be written" in err
