"""Pictures, film and page of a diagnosis."""

from __future__ import annotations

import functools
import io
import re

import msgspec
import numpy as np
import pytest
from diagnose_fakes import BASE, colours_in, found_of, scene_of
from html_reader import Reader
from PIL import Image

from flora_lab.diagnose import figures, figures_of_runs, gain_told
from flora_lab.diagnose.diagnosis import Diagnosis, Gain, NamedCause, NextExperiment, Residuals
from flora_lab.diagnose.film import film
from flora_lab.diagnose.page import page, sure_text, value_text, verdict_sentence
from flora_lab.diagnose.residuals import ReferenceResiduals, ResidualTables, reference_residuals, residuals_of
from flora_lab.diagnose.rhythm import Swing
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Change
from flora_lab.simulator import terms

MOST_FILM_BYTES = 2_000_000
GAIN = Gain(
    one_step={"base": 0.63, "extended": 0.62, "boosted": 0.61, "still": 1.2},
    free_running={
        "1h": {"base": 1.5, "extended": 1.2, "boosted": 2.0, "still": 4.0},
        "end": {"base": 16.0, "extended": 7.0, "boosted": 21.0, "still": 140.0},
    },
    judged_on="Each run was left out in turn.",
)
UNEQUAL = NamedCause(
    "lamp_asymmetry",
    {"right_to_left": 0.78},
    {"right_to_left": (0.74, 0.83)},
    0.97,
    0.002,
    ["camera_roll"],
    "The runs are 17 nats more probable with it.",
    17.0,
)
NEXT = NextExperiment(
    "left 30 h, right 30 h",
    ["lamp_asymmetry", "camera_roll"],
    "Long phases tell them apart.",
    {"lamp_asymmetry / camera_roll": {"6 h": 3.0, "30 h": 5.6}},
    "a plumb line",
)


def push(change: Change) -> None:
    change.terms[terms.PUSH] += 0.06


@functools.cache
def reference() -> ReferenceResiduals:
    others = [scene_of(f"reference{seed}", seed, hours=26.0) for seed in range(4)]
    return reference_residuals([scene for scene, _ in others], BASE, [found_of([s], [own]) for s, own in others])


@functools.cache
def judged() -> tuple[Residuals, ResidualTables, ResidualTables]:
    """Two runs beside the simulator, and beside itself as if it had been extended."""
    runs = [scene_of(name, seed, hours=26.0, effect=push) for seed, name in ((7, "$one$ <b>"), (8, "two"))]
    scenes, traits = [scene for scene, _ in runs], [own for _, own in runs]
    said, base = residuals_of(scenes, BASE, found_of(scenes, traits, 2.0), reference())
    _, extended = residuals_of(scenes, BASE, found_of(scenes, [own + 0.05 for own in traits]), reference())
    return said, base, extended


def diagnosis(verdict: str = "explained", **how: object) -> Diagnosis:
    known = {"causes": [UNEQUAL], "gain": GAIN, "next_experiment": NEXT, "record": ["two: 3 stems jump"], **how}
    return msgspec.convert(
        {
            "verdict": verdict,
            "residuals": judged()[0],
            "summary": "All in all.",
            "runs": ["$one$ <b>", "two"],
            "base": {"runs": 9},
            **known,
        },
        Diagnosis,
        from_attributes=True,
    )


BLUE, ORANGE = (0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)


def test_pictures_show_both_simulators_and_without_causes_one() -> None:
    _, base, extended = judged()
    for draw in (figures_of_runs.paths, figures_of_runs.stems, figures.by_phase, figures.along_stem):
        both, one = colours_in(draw(base, extended)), colours_in(draw(base, None))
        assert {BLUE, ORANGE} <= both
        assert BLUE in one
        assert ORANGE not in one


def test_hours_without_a_measured_stem_are_said_to_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures_of_runs, "png", lambda figure: figure)
    scene, traits = scene_of("gap", 9, hours=26.0, hidden=slice(130, 160))  # 10.8 to 13.2 h
    _, base = residuals_of([scene], BASE, found_of([scene], [traits]), reference())
    written = {ax.get_title(): [text.get_text() for text in ax.texts] for ax in figures_of_runs.stems(base, None).axes}
    assert written["12 h"] == ["not measured"]
    assert written["24 h"] == []


def test_how_far_off_a_tip_is_stands_over_its_height(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "png", lambda figure: figure)
    _, base, _ = judged()
    _, over_time, by_height = figures.along_stem(base, None).axes
    drawn = [line.get_ydata() for ax in (over_time, by_height) for line in ax.lines]
    assert over_time.get_ylim() == by_height.get_ylim()
    assert by_height.get_ylim()[0] == 0.0
    assert by_height.get_ylim()[1] >= max(np.nanmax(values) for values in drawn)
    heights_cm = np.concatenate([run.measured_cm[:, -1, 1] for run in base.runs])
    thin, thick = by_height.lines[0], by_height.lines[-1]
    at_cm, off_mm = thick.get_xdata(), thick.get_ydata()
    known = np.isfinite(off_mm)
    assert known.any()
    assert at_cm[known].min() > np.nanmin(heights_cm) - 1.0
    assert at_cm[known].max() < np.nanmax(heights_cm) + 1.0
    run = base.runs[0]
    place = int(np.flatnonzero(np.isfinite(thin.get_ydata()))[0])
    here = np.abs(run.measured_cm[:, -1, 1] - at_cm[place]) < 0.5
    off = np.hypot(*run.error_mm(base.plant)[here, -1].T)
    assert thin.get_ydata()[place] == pytest.approx(np.sqrt(np.nanmean(off**2)), rel=0.02)


def test_the_same_tables_give_the_same_picture() -> None:
    _, base, extended = judged()
    assert figures_of_runs.paths(base, extended) == figures_of_runs.paths(base, extended)


@pytest.mark.parametrize(
    ("extended", "said"),
    [
        ((0.7, 1.6, 17.0), "After one step, 1 h and the end the extended simulator is farther off"),
        ((0.62, 1.6, 7.0), "After 1 h the extended simulator is farther off"),
        ((0.62, 1.2, 7.0), ""),
    ],
)
def test_where_the_extension_is_worse_is_said(extended: tuple[float, float, float], said: str) -> None:
    step, hour, end = extended
    free = {"1h": {"base": 1.5, "extended": hour}, "end": {"base": 16.0, "extended": end}}
    gain = Gain(one_step={"base": 0.63, "extended": step}, free_running=free, judged_on="Each run in turn.")
    assert ("farther off" in page(diagnosis(gain=gain), {})) is bool(said)
    assert said in page(diagnosis(gain=gain), {})
    assert said in "\n".join(gain_told.lines(gain))


def test_a_record_that_was_set_right_is_told_with_its_tracks() -> None:
    said = "what is wrong in it was set right: 2 tracks without that are in the folder corrected"
    assert said in page(diagnosis(corrected=["01-a.csv", "02-b.csv"], record=[]), {})
    assert "set right" not in page(diagnosis(), {})


def test_a_found_swing_is_marked_in_the_spectrum() -> None:
    _, base, _ = judged()
    swing = Swing(1.7, 0.5, 30.0, 20.0, (1.6, 1.8), (0.4, 0.6))
    assert ORANGE in colours_in(figures.spectra(base, swing))
    assert ORANGE not in colours_in(figures.spectra(base, None))


def test_bars_of_evidence_and_gain_in_all_cases() -> None:
    tried = [
        (effect.title, float(nats)) for effect, nats in zip(CATALOGUE, np.geomspace(0.1, 20000.0, 40), strict=False)
    ]
    tried.append(("worst", -np.inf))
    assert {BLUE, ORANGE} <= colours_in(figures.evidence(tried, [tried[3][0]], 6.0))
    assert ORANGE not in colours_in(figures.evidence(tried, [], 6.0))
    assert {BLUE, ORANGE} <= colours_in(figures.gain(GAIN.free_running, GAIN.one_step))
    assert BLUE in colours_in(figures.gain({"end": {"base": 3.0}}, {}))


def test_the_film_is_small_and_ends_with_the_last_stems() -> None:
    _, base, extended = judged()
    data = film(base, extended)
    assert len(data) < MOST_FILM_BYTES
    pictures = Image.open(io.BytesIO(data))
    assert pictures.format == "GIF"
    assert pictures.n_frames > 50  # type: ignore[attr-defined]
    first = np.asarray(pictures.convert("RGB")).astype(int)
    assert (first[0, 0] == 255).all()
    pictures.seek(pictures.n_frames - 1)  # type: ignore[attr-defined]
    last = np.asarray(pictures.convert("RGB")).astype(int)
    # the stems have grown: what is dark now lies higher than at first
    assert (np.abs(last - first).max(axis=2) > 60).sum() > 300


def test_the_page_tells_all_and_stands_alone() -> None:
    said, base, extended = judged()
    pictures = {"paths": figures_of_runs.paths(base, extended), "film": film(base, extended)}
    evidence = [[("Unequal lamps", 17.0), ("Steady push to a side", -3.25)], [("Stiffening", 1.0)]]
    text = page(diagnosis(), pictures, evidence=evidence, plant=base.plant)
    assert text == page(diagnosis(), pictures, evidence=evidence, plant=base.plant)
    assert "http" not in re.sub(r"base64,[^\"]*", "", text)
    assert "<b>two" not in text
    read = Reader(text)
    sources = [str(own["src"]) for tag, own in read.tags if tag == "img"]
    assert [source.split(";")[0] for source in sources] == ["data:image/png", "data:image/gif"]
    assert all(own["alt"] for tag, own in read.tags if tag == "img")
    assert "0.78 times as much" in read.text
    assert said.description in read.text
    assert "almost certain (97 %)" in read.text
    assert "0.74 and 0.83" in read.cells
    assert "Rolled camera" in read.cells
    assert "a plumb line" in read.cells
    assert "140.0 mm" in read.cells
    assert "−3.2" in read.cells
    assert "$one$ <b>, two" in read.cells
    assert "two: 3 stems jump" in read.text
    assert sum(tag == "details" for tag, _ in read.tags) > 8


def test_a_page_of_nothing_wrong_names_no_cause() -> None:
    fine = diagnosis("nothing_wrong", causes=[], gain=Gain(), next_experiment=NextExperiment(), record=[])
    read = Reader(page(fine, {}))
    assert "The simulator is right, as far as these runs can show." in read.text
    for absent in ("The cause", "What the extension gains", "What to do next", "What was wrong", "cannot tell apart"):
        assert absent not in read.text


def test_a_page_of_something_unexplained_says_what_is_left() -> None:
    residuals = msgspec.structs.replace(judged()[0], left="The tip stands still above 14 cm.")
    odd = diagnosis("unexplained", causes=[], gain=Gain(), residuals=residuals)
    read = Reader(page(odd, {"evidence": b""}))
    assert "no known cause explains" in read.text
    assert "The tip stands still above 14 cm." in read.text
    assert "None is named, however far its bar goes" in read.text
    assert "None is named" not in Reader(page(diagnosis(), {"evidence": b""})).text


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_every_cause_can_be_told(name: str) -> None:
    effect = BY_NAME[name]
    middle = {p.name: p.value(0.5 * (p.coordinate(p.low) + p.coordinate(p.high))) for p in effect.parameters}
    ends = {p.name: (p.low, p.high) for p in effect.parameters}
    cause = NamedCause(name, middle, ends, 0.6, 0.03, [], "So it is.", 7.0)
    read = Reader(page(diagnosis(causes=[cause, UNEQUAL]), {}))
    assert f"1. {effect.title}" in read.text
    assert "more likely than not (60 %)" in read.text
    assert verdict_sentence(diagnosis(causes=[cause, UNEQUAL])) in read.text


def test_values_have_units_and_hours_lie_on_the_clock() -> None:
    latency, peak = BY_NAME["phototropic_latency"].parameters[0], BY_NAME["diurnal_growth"].parameters[1]
    assert value_text(latency, 0.4123) == "0.412 h"
    assert value_text(peak, 25.5) == "1.5 h"
    assert value_text(BY_NAME["camera_roll"].parameters[0], -2.5) == "−2.5°"
    assert (sure_text(0.999), sure_text(0.3)) == ("practically certain (over 99 %)", "no more than a guess (30 %)")


@pytest.mark.parametrize(
    ("row", "title", "words"),
    [
        ({"base": 20.0, "corrected": 8.0, "still": 60.0}, "corrected", "is added to its own"),
        ({"base": 20.0, "clock": 9.0, "still": 60.0}, "mended", "slowed down to real time"),
    ],
)
def test_what_a_learned_simulator_gains_is_told(row: dict[str, float], title: str, words: str) -> None:
    told = page(diagnosis(learned={"tip_error_mm": {"24h": row}, "judged_on": "3 runs held out"}), {})
    assert f"The learned simulator, {title}" in told
    assert words in told
    assert "judged on 3 runs held out" in told
    assert all(f"{value:.1f}" in told for value in row.values())
