"""Messages as lines, rows as tables. Nothing from the bus reaches a terminal unescaped."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, Final

import msgspec
from rich.table import Table
from rich.text import Text

from flora_common.bus import Arrival
from flora_common.clock import NS
from flora_common.health import Line
from flora_common.messages import CATALOGUE, Message
from flora_monitor.stats import Row, Topic, topic_text

COLOURS: Final = ("cyan", "green", "yellow", "magenta", "blue", "bright_cyan", "bright_green", "bright_magenta")
ENVELOPE: Final = frozenset(field.name for field in msgspec.structs.fields(Message))
LONGEST_TEXT: Final = 500
"""A longer text is no sentence, but a piece of a file."""
STATE_STYLE: Final = {"ready": "green", "starting": "yellow", "degraded": "red", "fault": "bold red"}


def printable(text: str) -> str:
    """Control characters as escapes: a message must not drive the terminal that shows it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def colour_of(topic: str) -> str:
    """The same colour for a kind each time."""
    return COLOURS[zlib.crc32(topic.rpartition("/")[2].encode()) % len(COLOURS)]


def compact(message: Message) -> str:
    """Fields that say something, on one line: defaults are left out, hashes cut, points counted."""
    said = []
    for field in msgspec.structs.fields(type(message)):
        value = getattr(message, field.name)
        if field.name in ENVELOPE or value == field.default:
            continue
        said.append(f"{field.name}={_value_text(field.name, value)}")
    return printable(" ".join(said))


def _value_text(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return f"[{len(value)} points, last ({value[-1][0]:.2f}, {value[-1][1]:.2f})]"
    if isinstance(value, tuple):
        return "(" + ", ".join(f"{v:.2f}" if isinstance(v, float) else str(v) for v in value) + ")"
    if isinstance(value, str) and name.endswith("sha256"):
        return value[:8]
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"[{len(value)} characters]"
    if isinstance(value, str) and (" " in value or not value):
        return f'"{value}"'
    return str(value)


def line_for_terminal(arrival: Arrival, since_s: float | None) -> Text:
    """Clock time, time since the last of its topic, topic, tick, fields; what is wrong in red."""
    text = Text(no_wrap=True, overflow="ellipsis", end="")
    topic = printable(topic_text(arrival))
    message = arrival.message
    if message is None:
        size = sum(map(len, arrival.parts))
        text.append(f"{'':13} {'':>9} ")
        text.append(f"{topic:<20} ", style="bold red")
        text.append(
            f"{arrival.verdict}: {printable(arrival.reason)} ({len(arrival.parts)} frames, {size} bytes)", "red"
        )
        return text
    if arrival.lost:
        text.append(f"{arrival.lost} lost ", style="bold red")
    clock = datetime.fromtimestamp(message.t_utc_ns // NS, UTC).strftime("%H:%M:%S") if message.t_utc_ns else ""
    text.append(f"{clock}.{message.t_utc_ns % NS // 1_000_000:03d}Z ", style="dim")
    text.append(f"{'' if since_s is None else f'+{since_s:.3f}':>9} ", style="dim")
    text.append(f"{topic:<20} ", style=colour_of(topic))
    if message.tick:
        text.append(f"#{message.tick} ", style="bold")
    name = f"{message.source} " if message.source != CATALOGUE[topic.rpartition("/")[2]].owner else ""
    text.append(name, style="italic")
    text.append(compact(message))
    return text


def line_for_programs(arrival: Arrival) -> str:
    """One JSON object: the topic and the message's fields; ``lost_before`` and ``bad`` only where that is so."""
    message = arrival.message
    shown: dict[str, Any] = {"topic": topic_text(arrival)}
    if message is None:
        shown |= {"bad": arrival.reason, "verdict": arrival.verdict}
        shown |= {"frames": len(arrival.parts), "bytes": sum(map(len, arrival.parts))}
    else:
        shown |= msgspec.to_builtins(message)
        if arrival.lost:
            shown["lost_before"] = arrival.lost
    return json.dumps(shown, allow_nan=False)


def json_lines(items: Iterable[Any]) -> str:
    """One JSON object a line."""
    return "\n".join(msgspec.json.encode(item).decode() for item in items)


def _number(value: float | None, digits: str = ".3g") -> str:
    return "" if value is None else f"{value:{digits}}"


def _count(value: int) -> Text:
    return Text(str(value), style="red" if value else "dim")


def rates_table(rows: Iterable[Row]) -> Table:
    """Red rows are late."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("topic", overflow="fold")
    for name in ("count", "per s", "period s", "jitter s", "lost", "repeated", "bad", "age s"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        style = "bold red" if row.late else ""
        name = printable(f"{row.topic} {row.source}".rstrip())
        table.add_row(
            Text(name, style=style or colour_of(row.topic)),
            str(row.count),
            _number(row.rate_hz),
            _number(row.period_s, ".6g"),
            _number(row.jitter_s, ".3g"),
            _count(row.lost),
            Text(str(row.repeated), style="dim"),
            _count(row.bad),
            Text(_number(row.age_s, ".1f") + (" late" if row.late else ""), style=style),
        )
    return table


def health_table(lines: Iterable[Line]) -> Table:
    """Red lines are not well."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("service", "state", "age s", "up h", "MiB", "lost", "bad"):
        table.add_column(name, justify="left" if name in ("service", "state") else "right", no_wrap=True)
    table.add_column("reason")
    for line in lines:
        style = STATE_STYLE.get(line.state, "bold red")
        table.add_row(
            Text(printable(line.service), style="" if line.ok else "bold red"),
            Text(line.state, style=style),
            _number(line.age_s, ".1f"),
            _number(line.uptime_s / 3600, ".2f"),
            _number(line.resident_kib / 1024, ".1f"),
            _count(line.gaps),
            _count(line.bad),
            Text(printable(line.reason)),
        )
    return table


def topics_table(topics: Iterable[Topic]) -> Table:
    """The catalogue beside what was heard."""
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("kind", "said by", "every", "kept", "messages", "heard on"):
        table.add_column(name, justify="right" if name == "messages" else "left")
    for topic in topics:
        table.add_row(
            Text(printable(topic.kind), style=colour_of(topic.kind)),
            topic.owner,
            {"none": "when it happens"}.get(topic.every, topic.every),
            "yes" if topic.kept else "no",
            str(topic.messages) if topic.heard else "",
            Text(printable(", ".join(topic.heard)), style="" if topic.heard else "dim"),
        )
    return table
