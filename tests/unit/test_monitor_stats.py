"""The monitor's counting and judging, with time handed in."""

from __future__ import annotations

import json
import statistics

import msgspec
import pytest

from flora_common.bus import Arrival
from flora_common.clock import NS
from flora_common.errors import BadInput
from flora_common.health import HealthBoard, services_of_catalogue
from flora_common.messages import CATALOGUE, DiagnosisFound, Health, LightCommand, Message, Stem, Tick, encode, spec_of
from flora_monitor import show
from flora_monitor.stats import MAX_STREAMS, OTHERS, Board, Spread, checked_pattern, matches, topic_lines


def good(message: Message, *, mono_s: float = 0.0, rig: str = "box1", lost: int = 0) -> Arrival:
    source = spec_of(type(message)).owner if message.source == "nobody" else message.source
    stamped = msgspec.structs.replace(message, source=source, t_mono_ns=round(mono_s * NS), t_utc_ns=10**18)
    return Arrival(encode(rig, stamped), "good", rig, stamped, lost)


def board(*, lock_step: bool = False) -> Board:
    return Board(tick_s=300.0, health_s=10.0, is_lock_step=lock_step)


def test_spread_is_mean_and_deviation() -> None:
    values = [300.0, 300.1, 299.8, 301.0]
    spread = Spread()
    for value in values:
        spread.add(value)
    assert spread.mean == pytest.approx(statistics.mean(values))
    assert spread.deviation == pytest.approx(statistics.stdev(values))
    assert Spread().deviation == 0.0


@pytest.mark.parametrize(
    ("pattern", "topic", "fits"),
    [
        ("*", "box1/stem", True),
        ("stem", "box1/stem", True),
        ("box1/*", "box1/stem", True),
        ("box2/*", "box1/stem", False),
        ("frame*", "box1/frame_missed", True),
        ("frame", "box1/frame_missed", False),
    ],
)
def test_patterns(pattern: str, topic: str, fits: bool) -> None:
    assert matches(pattern, topic) is fits


@pytest.mark.parametrize("pattern", ["*", "[ab]*", "box[12]/[!s]*", "[]]", "[!]x]", "[[]", "a]", ""])
def test_good_patterns_are_taken_as_they_are(pattern: str) -> None:
    assert checked_pattern(pattern) == pattern


@pytest.mark.parametrize("pattern", ["[", "box1/[s", "[]", "[!]", "[ab][", "[ab]*[!"])
def test_a_bracket_that_is_not_closed_is_refused(pattern: str) -> None:
    with pytest.raises(BadInput, match=r"`\[` without `\]`"):
        checked_pattern(pattern)
    assert not any(matches(pattern, f"box1/{kind}") for kind in CATALOGUE)


def test_intervals_of_ticks_are_rig_time_and_those_of_health_real_time() -> None:
    b = board(lock_step=True)
    assert b.hear(good(Tick(time_s=0.0), mono_s=0.0), 0.0) is None
    assert b.hear(good(Tick(time_s=0.0), mono_s=300.0), 0.3) == pytest.approx(300.0)
    b.hear(good(Health(state="ready", source="flora-led"), mono_s=0.0), 0.0)
    assert b.hear(good(Health(state="ready", source="flora-led"), mono_s=300.0), 10.0) == pytest.approx(10.0)
    health, tick = b.rows(10.0)
    assert (tick.topic, tick.count, tick.period_s) == ("box1/tick", 2, 300.0)
    assert (health.source, health.period_s) == ("flora-led", 10.0)


def test_late_on_a_rig_is_told_by_its_clock_even_when_all_are_silent() -> None:
    b = board()
    b.hear(good(Tick(time_s=0.0), mono_s=1000.0), 5.0)
    (row,) = b.rows(5.0 + 749.0)
    assert not row.late
    (row,) = b.rows(5.0 + 751.0)
    assert row.late
    assert row.age_s == pytest.approx(751.0)


def test_late_in_lock_step_is_measured_against_the_newest_rig_time() -> None:
    b = board(lock_step=True)
    b.hear(good(Tick(time_s=0.0), mono_s=0.0), 0.0)
    b.hear(good(Stem(time_s=0.0, outcome="ok"), mono_s=0.0), 0.0)
    assert not any(row.late for row in b.rows(10_000.0))  # the whole world rests
    b.hear(good(Tick(time_s=0.0), mono_s=900.0), 1.0)
    stem, tick = b.rows(1.0)
    assert (stem.topic, stem.late, stem.age_s) == ("box1/stem", True, 900.0)
    assert (tick.late, tick.age_s) == (False, 0.0)


def test_rigs_have_their_own_time() -> None:
    b = board(lock_step=True)
    b.hear(good(Tick(time_s=0.0), mono_s=0.0, rig="a"), 0.0)
    b.hear(good(Tick(time_s=0.0), mono_s=1e6, rig="b"), 0.0)
    assert not any(row.late for row in b.rows(0.0))


def test_health_is_late_after_two_and_a_half_periods_of_real_time() -> None:
    b = board(lock_step=True)
    b.hear(good(Health(state="ready", source="flora-led")), 0.0)
    assert not b.rows(25.0)[0].late
    assert b.rows(25.1)[0].late


def test_gaps_repeats_and_bad_ones_are_counted() -> None:
    b = board()
    b.hear(good(Tick(time_s=0.0)), 0.0)
    b.hear(good(Tick(time_s=0.0), lost=3), 1.0)
    first = good(Tick(time_s=0.0))
    b.hear(Arrival(first.parts, "repeated", "box1", first.message), 2.0)
    b.hear(Arrival([b"\xff\xfe", b"x"], "bad", reason="2 frames"), 3.0)
    assert (b.messages, b.lost, b.repeated, b.bad) == (2, 3, 1, 1)
    bad, tick = b.rows(4.0)
    assert (bad.topic, bad.bad, bad.age_s) == ("\\xff\\xfe", 1, None)
    assert (tick.count, tick.lost, tick.repeated) == (2, 3, 1)


def test_a_flood_of_topics_is_counted_together() -> None:
    b = board()
    for number in range(MAX_STREAMS + 50):
        b.hear(Arrival([b"x%d" % number, b"", b""], "unknown"), 0.0)
    rows = b.rows(0.0)
    assert len(rows) == MAX_STREAMS + 1
    assert next(row for row in rows if row.topic == OTHERS).bad == 50


def test_topics_lists_catalogue_and_strangers() -> None:
    b = board()
    b.hear(good(Tick(time_s=0.0)), 0.0)
    b.hear(Arrival([b"box1/nosuch", b"", b""], "unknown"), 0.0)
    lines = topic_lines(b.rows(0.0), "*", None)
    by_kind = {line.kind: line for line in lines}
    assert by_kind["tick"].heard == ["box1/tick"]
    assert by_kind["stem"].heard == []
    assert by_kind["nosuch"].owner == "not in the catalogue"
    assert [line.kind for line in topic_lines([], "st*", None)] == ["stem", "stored"]


def test_expected_services_come_from_the_catalogue() -> None:
    assert services_of_catalogue()[:2] == ("flora-bus", "flora-flash")
    assert "flora-recorder" in services_of_catalogue()
    assert "every service" not in services_of_catalogue()


def verdicts(b: HealthBoard, *, real_s: float = 0.0, mono_s: float = 0.0) -> dict[str, tuple[str, bool]]:
    return {line.service: (line.state, line.ok) for line in b.lines(real_s=real_s, mono_ns=round(mono_s * NS))}


def health(source: str, state: str = "ready", *, mono_s: float = 0.0, reason: str = "") -> Health:
    return Health(state=state, source=source, t_mono_ns=round(mono_s * NS), reason=reason)  # type: ignore[arg-type]


def test_health_on_this_machine_is_judged_at_once_by_the_messages_own_time() -> None:
    b = HealthBoard(["flora-led", "flora-stem", "flora-bus"], period_s=10.0, ages_are_known=True)
    b.hear(health("flora-led", mono_s=90.0), real_s=0.0, is_live=False)
    b.hear(health("flora-stem", mono_s=10.0), real_s=0.0, is_live=False)
    b.hear(health("flora-extra", "degraded", mono_s=99.0), real_s=0.0, is_live=False)
    assert b.is_decided
    assert verdicts(b, mono_s=100.0) == {
        "flora-led": ("ready", True),
        "flora-stem": ("silent", False),
        "flora-bus": ("never heard", False),
        "flora-extra": ("degraded", False),
    }


def test_health_elsewhere_needs_a_live_message() -> None:
    b = HealthBoard(["flora-led"], period_s=10.0, ages_are_known=False)
    b.hear(health("flora-led"), real_s=0.0, is_live=False)
    assert not b.is_decided
    assert verdicts(b, real_s=30.0) == {"flora-led": ("silent", False)}
    b.hear(health("flora-led"), real_s=8.0, is_live=True)
    assert b.is_decided
    assert verdicts(b, real_s=9.0) == {"flora-led": ("ready", True)}
    assert verdicts(b, real_s=34.0) == {"flora-led": ("silent", False)}


def test_the_lab_is_not_called_silent_because_its_machine_has_another_clock() -> None:
    b = HealthBoard(["flora-led"], period_s=10.0, ages_are_known=True)
    b.hear(health("flora-led", mono_s=5000.0), real_s=0.0, is_live=False)
    b.hear(health("flora-lab", mono_s=12.0), real_s=0.0, is_live=False)
    assert verdicts(b, mono_s=5000.0)["flora-lab"] == ("ready", True)
    b.hear(health("flora-lab", "degraded", mono_s=22.0), real_s=4.0, is_live=True)
    assert verdicts(b, real_s=5.0, mono_s=5005.0)["flora-lab"] == ("degraded", False)
    assert verdicts(b, real_s=60.0, mono_s=5005.0)["flora-lab"] == ("silent", False)


def test_line_for_programs_is_one_json_object_with_the_fields() -> None:
    line = show.line_for_programs(good(LightCommand(light="left", output=0.25, tick=7), lost=2))
    shown = json.loads(line)
    assert (shown["topic"], shown["light"], shown["output"], shown["tick"]) == ("box1/light", "left", 0.25, 7)
    assert shown["lost_before"] == 2
    bad = json.loads(show.line_for_programs(Arrival([b"\xff/tick\n", b"abc"], "bad", reason="2 frames")))
    assert bad == {"topic": "\\xff/tick\n", "bad": "2 frames", "verdict": "bad", "frames": 2, "bytes": 10}


def test_terminal_lines_carry_no_control_characters() -> None:
    evil = "\x1b[2J\x1b]0;owned\x07\n\u202e"
    texts = [
        show.line_for_terminal(good(Health(state="fault", reason=evil, source="flora-led")), 1.0).plain,
        show.line_for_terminal(Arrival([evil.encode(), b""], "bad", reason=evil), None).plain,
    ]
    for text in texts:
        assert text.isprintable(), text
        assert "\\x1b[2J" in text


def test_terminal_line_shows_what_differs_from_the_default() -> None:
    stem = Stem(tick=12, time_s=3600.0, outcome="ok", points_cm=((0.0, 0.0), (-1.5, 9.25)), quality=0.9)
    text = show.line_for_terminal(good(stem, lost=1), 300.0).plain
    assert text.startswith("1 lost ")
    assert "+300.000" in text
    assert "#12 time_s=3600 outcome=ok points_cm=[2 points, last (-1.50, 9.25)] quality=0.9" in text
    assert "reason" not in text


def test_a_rig_that_was_started_anew_is_not_late_until_its_clock_has_caught_up() -> None:
    """Its machine's clock counts from nought again: ten days are over, and a minute has begun."""
    b = board()
    for number in range(3):
        b.hear(good(Tick(time_s=0.0, session="00000001"), mono_s=864_000.0 + 300.0 * number), 300.0 * number)
    assert b.hear(good(Tick(time_s=0.0, session="00000002"), mono_s=60.0), 900.0) is None
    (tick,) = b.rows(901.0)
    assert (tick.age_s, tick.late, tick.period_s, tick.count) == (pytest.approx(1.0), False, 300.0, 4)


def test_the_lab_tells_no_rigs_time() -> None:
    """It is another machine, which may have run for longer."""
    b = board()
    b.hear(good(Tick(time_s=0.0), mono_s=100.0), 0.0)
    b.hear(good(DiagnosisFound(run="bean", plant="", verdict="nothing_wrong", source="flora-lab"), mono_s=9e5), 5.0)
    diagnosis, tick = b.rows(10.0)
    assert (tick.topic, tick.age_s, tick.late) == ("box1/tick", pytest.approx(10.0), False)
    assert diagnosis.age_s == pytest.approx(5.0)
