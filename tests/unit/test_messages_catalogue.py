"""The catalogue: bounded by type, documented, and never at odds with what was recorded."""

from __future__ import annotations

import math
import random
import re
import typing
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_common.errors import BadMessage
from flora_common.messages import CATALOGUE, MAX_PAYLOAD_BYTES, Message, Tick, TopicSpec, decode, encode, split_topic
from flora_common.messages.reference import page, schema_of, schema_text
from flora_common.messages.wire import is_known

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden" / "messages" / "v1"
SPECS = list(CATALOGUE.values())
KINDS = list(CATALOGUE)


@pytest.mark.parametrize(("name", "text"), [("messages.md", page), ("messages.schema.json", schema_text)])
def test_reference_is_what_the_catalogue_says(name: str, text: Any) -> None:
    path = ROOT / "docs" / "reference" / name
    assert path.read_text(encoding="utf-8") == text(), f"{path} is out of date: run `make messages`"


def unbounded(kind: Any, where: str, meta: tuple[Any, ...] = ()) -> list[str]:
    """Places in a type where a number has no bounds or a text no length."""
    if get_origin(kind) is Annotated:
        inner, *own = get_args(kind)
        return unbounded(inner, where, (*meta, *own))
    if kind in (bool, type(None)) or get_origin(kind) is Literal:
        return []
    limits = [m for m in meta if isinstance(m, msgspec.Meta)]
    if kind in (int, float):
        has_low = any(m.ge is not None or m.gt is not None for m in limits)
        has_high = any(m.le is not None or m.lt is not None for m in limits)
        return [] if has_low and has_high else [f"{where}: {kind.__name__} without bounds"]
    if kind is str:
        return [] if any(m.max_length is not None for m in limits) else [f"{where}: str without length"]
    if get_origin(kind) is tuple:
        items = get_args(kind)
        if items[-1] is Ellipsis:
            found = [] if any(m.max_length is not None for m in limits) else [f"{where}: tuple without length"]
            return found + unbounded(items[0], f"{where}[]")
        return [f for i, item in enumerate(items) for f in unbounded(item, f"{where}[{i}]")]
    if get_origin(kind) is typing.Union or isinstance(kind, typing.types.UnionType):  # type: ignore[attr-defined]
        return [f for option in get_args(kind) for f in unbounded(option, where, meta)]
    return [f"{where}: {kind} is of no kind that the catalogue allows"]


@pytest.mark.parametrize("spec", SPECS, ids=KINDS)
def test_everything_is_bounded_by_its_type(spec: TopicSpec) -> None:
    hints = typing.get_type_hints(spec.type, include_extras=True)
    assert [f for name, kind in hints.items() for f in unbounded(kind, f"{spec.kind}.{name}")] == []


def test_the_walk_finds_what_is_not_bounded() -> None:
    class Loose(msgspec.Struct):
        a: float
        b: Annotated[float, msgspec.Meta(ge=0)]
        c: str
        d: tuple[Annotated[float, msgspec.Meta(ge=0, le=1)], ...]
        e: dict[str, int] | None

    found = [f for n, k in typing.get_type_hints(Loose, include_extras=True).items() for f in unbounded(k, n)]
    assert [f.partition(":")[0] for f in found] == ["a", "b", "c", "d", "e"]


@pytest.mark.parametrize("spec", SPECS, ids=KINDS)
def test_golden_messages_read_as_they_did(spec: TopicSpec) -> None:
    payload = (GOLDEN / f"{spec.kind}.msgpack").read_bytes()
    rig, message = decode([f"box1/{spec.kind}".encode(), payload, b"0"])
    assert rig == "box1"
    assert type(message) is spec.type
    recorded = msgspec.msgpack.decode(payload)
    now = msgspec.msgpack.decode(encode("box1", message)[1])
    assert {name: now.get(name) for name in recorded} == recorded


def test_each_kind_has_a_golden_message_and_no_golden_message_lost_its_kind() -> None:
    assert sorted(path.stem for path in GOLDEN.iterdir()) == sorted(CATALOGUE)


@pytest.mark.parametrize("spec", SPECS, ids=KINDS)
def test_unknown_fields_from_a_later_version_are_ignored(spec: TopicSpec) -> None:
    fields = msgspec.msgpack.decode((GOLDEN / f"{spec.kind}.msgpack").read_bytes())
    later = msgspec.msgpack.encode(fields | {"a_field_of_the_future": [1, {"x": None}]})
    assert type(decode([f"box1/{spec.kind}".encode(), later, b"0"])[1]) is spec.type


@pytest.mark.parametrize("spec", SPECS, ids=KINDS)
def test_nan_and_infinity_stop_at_the_door_in_every_number(spec: TopicSpec) -> None:
    fields = msgspec.msgpack.decode((GOLDEN / f"{spec.kind}.msgpack").read_bytes())
    numbers = [name for name, value in fields.items() if isinstance(value, float)]
    for name in numbers:
        for odd in (math.nan, math.inf, -math.inf, 1e308):
            with pytest.raises(BadMessage, match=f"{spec.kind}: .*{name}"):
                decode([f"box1/{spec.kind}".encode(), msgspec.msgpack.encode(fields | {name: odd}), b"0"])


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("frame", "path", "/etc/passwd"),
        ("frame", "path", "frames/../../x.jpg"),
        ("frame", "path", "frames\n/../x.jpg"),
        ("frame", "path", "frames/1.jpg\n"),
        ("frame", "run", "bean\n"),
        ("frame", "run", "../bean"),
        ("stem", "frame_sha256", "\n"),
        ("stem", "run", "../bean"),
        ("setup", "shot", "left.jpg\n"),
        ("setup", "shot", "../left.jpg"),
        ("tick", "source", "flora flash"),
    ],
)
def test_names_that_could_lead_astray_are_refused(kind: str, name: str, value: str) -> None:
    fields = msgspec.msgpack.decode((GOLDEN / f"{kind}.msgpack").read_bytes())
    with pytest.raises(BadMessage, match=name):
        decode([f"box1/{kind}".encode(), msgspec.msgpack.encode(fields | {name: value}), b"0"])


def test_nan_inside_points_is_refused() -> None:
    fields = msgspec.msgpack.decode((GOLDEN / "stem.msgpack").read_bytes())
    for odd in (math.nan, math.inf, 501.0):
        fields["points_cm"][3][0] = odd
        with pytest.raises(BadMessage, match="points_cm"):
            decode([b"box1/stem", msgspec.msgpack.encode(fields), b"0"])


@pytest.mark.parametrize("spec", SPECS, ids=KINDS)
def test_schema_is_self_contained_and_describes_the_envelope(spec: TopicSpec) -> None:
    schema = schema_of(spec)
    own = schema["$defs"][spec.type.__name__]
    assert set(own["properties"]) == {f.name for f in msgspec.structs.fields(spec.type)}
    references = re.findall(r'"\$ref":"([^"]*)"', msgspec.json.encode(schema).decode())
    assert {f"#/$defs/{name}" for name in schema["$defs"]} >= set(references)


def test_a_message_is_three_frames_with_unix_seconds() -> None:
    parts = encode("box1", Tick(time_s=0.0, t_utc_ns=1_732_105_956_123_456_789))
    assert parts[0] == b"box1/tick"
    assert parts[2] == b"1732105956.123456"
    assert msgspec.msgpack.decode(parts[1])["t_utc_ns"] == 1_732_105_956_123_456_789


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ([], "0 frames instead of three"),
        ([b"box1/tick", b"\x80"], "2 frames instead of three"),
        ([b"tick", b"\x80", b"0"], "topic b'tick' is not of the form <rig>/<kind>"),
        ([b"\xff/tick", b"\x80", b"0"], "is not of the form"),
        ([b"box1/tick\n", b"\x80", b"0"], "is not of the form"),
        ([b"a" * 1000 + b"/tick", b"\x80", b"0"], "is not of the form"),
        ([b"box1/stemm", b"\x80", b"0"], "unknown kind `stemm`; did you mean `stem`?"),
        ([b"box1/tick", b"\x80", b"0"], "tick: Object missing required field `time_s`"),
        ([b"box1/tick", b"", b"0"], "tick: Input data was truncated"),
        ([b"box1/tick", b"x" * (MAX_PAYLOAD_BYTES + 1), b"0"], "at most 32768 are allowed"),
        ([b"box1/tick", b"\x81\xa6source\xa2\xff\xfe", b"0"], "tick: "),
        ([b"box1/tick", b"\x91" * 20_000, b"0"], "tick: "),
        ([b"box1/tick", b"\xdf\xff\xff\xff\xff", b"0"], "tick: "),
    ],
)
def test_what_is_wrong_is_told(parts: list[bytes], said: str) -> None:
    with pytest.raises(BadMessage) as caught:
        decode(parts)
    assert said in str(caught.value)


def test_known_and_unknown_kinds() -> None:
    assert is_known(b"box1/stem")
    assert not is_known(b"box1/stems")
    assert not is_known(b"\xff\xfe")
    assert split_topic(b"box-2/frame_missed") == ("box-2", "frame_missed")


def only_bad_message(parts: list[bytes]) -> Message | None:
    try:
        return decode(parts)[1]
    except BadMessage:
        return None


@settings(max_examples=300, deadline=None)
@given(st.lists(st.binary(max_size=200), max_size=5))
def test_random_frames_raise_nothing_but_bad_message(parts: list[bytes]) -> None:
    only_bad_message(parts)


NESTED = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=20)
    | st.binary(max_size=20),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=10), inner, max_size=5),
    max_leaves=10,
)


@settings(max_examples=300, deadline=None)
@given(kind=st.sampled_from(KINDS), data=st.data())
def test_values_of_other_types_raise_nothing_but_bad_message(kind: str, data: st.DataObject) -> None:
    fields = msgspec.msgpack.decode((GOLDEN / f"{kind}.msgpack").read_bytes())
    name = data.draw(st.sampled_from(sorted(fields)))
    payload = msgspec.msgpack.encode(fields | {name: data.draw(NESTED)})
    message = only_bad_message([f"box1/{kind}".encode(), payload, b"0"])
    if message is not None:
        for value in msgspec.to_builtins(message).values():
            assert not isinstance(value, float) or math.isfinite(value)


def test_mutated_bytes_raise_nothing_but_bad_message() -> None:
    draw = random.Random(3)
    payloads = {kind: (GOLDEN / f"{kind}.msgpack").read_bytes() for kind in KINDS}
    accepted = 0
    for _ in range(30_000):
        kind = draw.choice(KINDS)
        data = bytearray(payloads[kind])
        for _ in range(draw.randrange(1, 5)):
            data[draw.randrange(len(data))] = draw.randrange(256)
        accepted += only_bad_message([f"box1/{kind}".encode(), bytes(data), b"0"]) is not None
    assert 0 < accepted < 15_000
