"""Offered files, cut into chunks: whole again whatever happens on the way, or refused, and never more memory."""

from __future__ import annotations

import base64
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_common.controller_file import MAX_BYTES
from flora_common.errors import BadController
from flora_common.messages import MAX_PAYLOAD_BYTES, ControllerAnswer, ControllerChunk, ControllerOffer, encode
from flora_common.messages.catalogue import CHUNK_BYTES, MAX_CHUNKS
from flora_common.offering import ASK_EVERY_S, ASK_SLOWLY_EVERY_S, Sending, chunk_of, chunks_of, offer_of
from flora_controller.offers import PATIENCE_S, Assembly

ID, OTHER_ID = "0123456789abcdef", "fedcba9876543210"
DATA = random.Random(1).randbytes(3 * CHUNK_BYTES + 100)


def offered(data: bytes = DATA, *, offer: str = ID, shadow_ticks: int = 0) -> ControllerOffer:
    return offer_of(data, offer=offer, name="left.controller.json", shadow_ticks=shadow_ticks)


def chunks(data: bytes = DATA, *, offer: str = ID) -> list[ControllerChunk]:
    return [chunk_of(data, offer=offer, number=number) for number in range(chunks_of(len(data)))]


def begun(data: bytes = DATA) -> Assembly:
    assembly = Assembly()
    assembly.begin(offered(data), 0.0)
    return assembly


@pytest.mark.parametrize("size", [1, CHUNK_BYTES - 1, CHUNK_BYTES, CHUNK_BYTES + 1, MAX_BYTES])
def test_files_of_every_size_arrive(size: int) -> None:
    data = random.Random(size).randbytes(size)
    assembly = begun(data)
    for chunk in chunks(data):
        assert assembly.add(chunk, 1.0)
    assert assembly.take() == data
    assert (assembly.offer, assembly.held_bytes) == (None, 0)


def test_the_largest_chunk_fits_into_a_message_and_the_largest_file_into_the_chunks() -> None:
    chunk = chunk_of(b"x" * CHUNK_BYTES, offer=ID, number=0)
    assert len(encode("r" * 32, chunk)[1]) <= MAX_PAYLOAD_BYTES
    assert chunks_of(MAX_BYTES) == MAX_CHUNKS


@st.composite
def deliveries(draw: st.DrawFn) -> list[ControllerChunk]:
    """Chunks in any order, some twice, some never, some of another offer, some damaged."""
    own, strange = chunks(), chunks(DATA[::-1], offer=OTHER_ID)
    delivered = []
    for number in draw(st.lists(st.integers(0, len(own) + 1), max_size=16)):
        fate = draw(st.sampled_from(["whole", "whole", "whole", "bit", "cut", "strange", "no base64", "renamed"]))
        chunk = (own if fate != "strange" else strange)[number % len(own)]
        data, at = bytearray(base64.b64decode(chunk.data)), number % len(own)
        if fate == "bit":
            data[draw(st.integers(0, len(data) - 1))] ^= 1 << draw(st.integers(0, 7))
        elif fate == "cut":
            data = data[: draw(st.integers(0, len(data)))]
        elif fate == "renamed":
            at = draw(st.integers(0, MAX_CHUNKS - 1))
        text = "=!" if fate == "no base64" else base64.b64encode(data).decode()
        delivered.append(ControllerChunk(offer=chunk.offer, number=at, data=text))
    return delivered


@settings(max_examples=300, deadline=None)
@given(deliveries())
def test_any_order_repetition_and_damage_gives_the_exact_bytes_or_a_refusal(delivered: list[ControllerChunk]) -> None:
    assembly = begun()
    for chunk in delivered:
        assembly.add(chunk, 0.0)
        assert assembly.held_bytes <= len(DATA)
    missing = assembly.missing
    try:
        outcome: bytes | str = assembly.take()
    except BadController as problem:
        outcome = str(problem)
    refused = f"{len(missing)} chunks have not arrived" if missing else "has another SHA-256"
    assert outcome == DATA if isinstance(outcome, bytes) else refused in outcome


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.builds(
            ControllerOffer,
            offer=st.sampled_from([ID, OTHER_ID]),
            name=st.just("x"),
            sha256=st.sampled_from(["0" * 64, "1" * 64]),
            bytes=st.integers(1, CHUNK_BYTES * MAX_CHUNKS),
            chunks=st.integers(1, MAX_CHUNKS),
        )
        | st.sampled_from(chunks()),
        max_size=20,
    )
)
def test_offers_that_contradict_each_other_never_take_more_than_one_file(
    said: list[ControllerOffer | ControllerChunk],
) -> None:
    assembly = Assembly()
    for message in said:
        if isinstance(message, ControllerChunk):
            assembly.add(message, 0.0)
        else:
            try:
                assembly.begin(message, 0.0)
            except BadController:
                continue
        assert assembly.held_bytes <= (assembly.offer.bytes if assembly.offer else 0) <= MAX_BYTES


def test_a_chunk_counts_once_and_the_first_one_counts() -> None:
    assembly = begun()
    first = chunks()[0]
    other = ControllerChunk(offer=ID, number=0, data=base64.b64encode(bytes(CHUNK_BYTES)).decode())

    assert assembly.add(first, 0.0)
    assert not assembly.add(first, 0.0)
    assert not assembly.add(other, 0.0)
    assert assembly.missing == (1, 2, 3)


def test_the_same_offer_again_keeps_what_has_arrived() -> None:
    assembly = begun()
    assembly.add(chunks()[2], 0.0)

    assert assembly.begin(offered(shadow_ticks=5), 1.0) is None
    assert assembly.missing == (0, 1, 3)
    assert assembly.offer is not None
    assert assembly.offer.shadow_ticks == 5


def test_a_later_offer_takes_the_place_of_one_that_is_still_coming() -> None:
    assembly = begun()
    assembly.add(chunks()[0], 0.0)

    displaced = assembly.begin(offered(DATA[:50], offer=OTHER_ID), 1.0)

    assert displaced is not None
    assert displaced.offer == ID
    assert (assembly.missing, assembly.held_bytes) == ((0,), 0)
    assert not assembly.add(chunks()[1], 1.0)


def test_an_offer_that_changes_its_file_or_contradicts_itself_is_refused() -> None:
    assembly = begun()
    with pytest.raises(BadController, match="was another file a moment ago"):
        assembly.begin(offered(DATA[:50]), 1.0)
    with pytest.raises(BadController, match="at most 1000000"):
        Assembly().begin(offered(bytes(MAX_BYTES + 1)), 0.0)
    wrong = ControllerOffer(offer=ID, name="x", sha256="0" * 64, bytes=10, chunks=2)
    with pytest.raises(BadController, match="10 bytes are 1 chunk, not 2"):
        Assembly().begin(wrong, 0.0)


def test_a_sender_that_falls_silent_is_given_up_and_one_that_goes_on_is_not() -> None:
    assembly = begun()
    assembly.add(chunks()[0], PATIENCE_S)
    assert assembly.expire(2 * PATIENCE_S) is None

    gone = assembly.expire(2 * PATIENCE_S + 1.0)

    assert gone is not None
    assert gone.offer == ID
    assert (assembly.offer, assembly.held_bytes) == (None, 0)
    assert assembly.expire(1e9) is None


# The other end


def answered(stage: str, *missing: int, offer: str = ID) -> ControllerAnswer:
    return ControllerAnswer(offer=offer, stage=stage, sha256=offered().sha256, missing=missing)  # type: ignore[arg-type]


def sending(*, wait_steering: bool = False) -> Sending:
    return Sending(DATA, offered(), wait_steering=wait_steering, now_s=0.0)


def test_the_sender_says_the_offer_until_it_is_answered_and_then_only_what_is_missing() -> None:
    sender = sending()
    assert sender.due(0.0) == [offered()]
    assert sender.due(ASK_EVERY_S / 2) == []
    assert sender.due(ASK_EVERY_S) == [offered()]

    sender.hear(answered("received", 1, 3), 1.5)

    assert sender.due(1.5) == [chunks()[1], chunks()[3]]
    assert sender.arrived == 2
    assert sender.due(1.6) == []
    assert sender.due(1.5 + ASK_EVERY_S) == [offered()]


def test_the_sender_is_done_when_the_rig_has_decided() -> None:
    for stage, waits in (("refused", True), ("steering", True), ("returned", True), ("shadowing", False)):
        sender = sending(wait_steering=waits)
        sender.hear(answered(stage), 0.0)
        assert sender.done
        assert sender.due(1e9) == []


def test_a_sender_that_waits_for_the_end_of_the_shadow_asks_slowly() -> None:
    sender = sending(wait_steering=True)
    sender.hear(answered("shadowing"), 0.0)
    assert not sender.done
    assert sender.due(ASK_SLOWLY_EVERY_S - 0.1) == []
    assert sender.due(ASK_SLOWLY_EVERY_S) == [offered()]
    assert sender.due(ASK_SLOWLY_EVERY_S + ASK_EVERY_S) == []


def test_answers_to_others_and_numbers_beyond_the_file_are_left_alone() -> None:
    sender = sending()
    assert not sender.hear(answered("steering", offer=OTHER_ID), 0.0)
    assert not sender.done
    sender.hear(answered("received", 3, 60), 0.0)
    assert sender.due(0.0) == [chunks()[3]]


@settings(max_examples=100, deadline=None)
@given(st.randoms(use_true_random=False), st.floats(0.0, 0.6))
def test_both_ends_together_bring_every_file_over_a_bus_that_loses_messages(draw: random.Random, loss: float) -> None:
    sender, assembly, now_s, arrived = sending(), Assembly(), 0.0, b""
    while not arrived:
        now_s += 0.25
        assert now_s < 1000.0
        for message in sender.due(now_s):
            if draw.random() < loss:
                continue
            if isinstance(message, ControllerOffer):
                assembly.begin(message, now_s)
                if draw.random() >= loss:
                    sender.hear(answered("received", *assembly.missing), now_s)
            elif isinstance(message, ControllerChunk):
                assembly.add(message, now_s)
        if assembly.offer is not None and not assembly.missing:
            arrived = assembly.take()
    assert arrived == DATA
