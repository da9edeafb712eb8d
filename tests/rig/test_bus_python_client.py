"""The Python client of docs/how-to/python-client.md, as it stands there, against a real bus."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest
import zmq

from bus_over_tcp import NetworkBus
from flora_common.messages import Stem

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "python-client.md"


def programs() -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def program() -> str:
    found = programs()
    assert found, f"no Python program in {PAGE}"
    return found[0]


def test_is_thirty_lines_with_only_pyzmq_and_msgpack() -> None:
    text = program()
    assert len(text.splitlines()) <= 30
    imported = [name.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import) for name in node.names]
    assert sorted(imported) == ["msgpack", "sys", "zmq"]


def test_reads_stems(bus: Any, tmp_path: Path) -> None:
    script = tmp_path / "client.py"
    script.write_text(program(), encoding="utf-8")
    bus.start_service("flora-bus")
    client = bus.client("flora-stem")
    client.publish(Stem(tick=1, time_s=300.0, outcome="ok", points_cm=((0.0, 0.0), (1.5, 9.25))))
    process = bus.start(str(script), bus.address.subscribe, "test")
    assert process.stdout.readline() == "1 ok [1.5, 9.25]\n"
    bus.client("late-comer", prefixes=(b"test/stem",))  # makes the bus say the kept value again
    client.publish(Stem(tick=2, time_s=600.0, outcome="no_stem"))
    assert process.stdout.readline() == "2 no_stem None\n"


@pytest.mark.skipif(not zmq.has("curve"), reason="this libzmq was built without CURVE")
def test_reads_stems_from_another_machine(bus: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    net = NetworkBus(bus)
    script = tmp_path / "client.py"
    with_keys = program().replace("socket.connect(", f"{programs()[1]}\nsocket.connect(")
    assert with_keys.count("load_certificate") == 2
    script.write_text(with_keys, encoding="utf-8")
    net.start()
    bus.client("flora-stem").publish(Stem(tick=1, time_s=300.0, outcome="ok", points_cm=((0.0, 0.0), (1.5, 9.25))))
    monkeypatch.chdir(net.keys_of("lab"))
    process = bus.start(str(script), net.address.subscribe, "test")
    assert process.stdout.readline() == "1 ok [1.5, 9.25]\n"
