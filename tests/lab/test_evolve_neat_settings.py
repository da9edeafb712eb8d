"""Settings of NEAT: complete, and whatever is wrong in a file is told in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from flora_common.errors import BadInput
from flora_lab.evolve.neat_fast import FAST
from flora_lab.evolve.neat_settings import NAMED, SETTINGS_FILE, STOCK, load_settings, settings_named


def test_those_of_the_package() -> None:
    settings = load_settings()

    for types in (STOCK, FAST):
        config = settings.config(types)
        genome = config.genome_config
        assert (config.pop_size, genome.num_inputs, genome.num_outputs) == (150, 26, 1)
        assert (genome.feed_forward, genome.activation_options, genome.aggregation_options) == (
            True,
            ["sigmoid"],
            ["sum"],
        )
        assert config.genome_type is types.genome


def test_a_file_names_only_what_it_changes(tmp_path: Path) -> None:
    path = tmp_path / "mine.cfg"
    path.write_text("[NEAT]\npop_size = 40\n[DefaultGenome]\nweight_max_value = 3\n", encoding="utf-8")

    changed = load_settings(path)

    assert (changed.population, changed.config().genome_config.weight_max_value) == (40, 3.0)
    assert changed.config().genome_config.weight_min_value == -8.0
    assert load_settings(path, population=7).population == 7
    assert load_settings().population == 150


def test_the_same_settings_are_the_same_text(tmp_path: Path) -> None:
    path = tmp_path / "mine.cfg"
    path.write_text("[DefaultGenome]\nweight_max_value = 8\n[NEAT]\npop_size=40\n", encoding="utf-8")

    assert load_settings(path).text == load_settings(population=40).text != load_settings().text


def test_settings_that_come_with_flora_have_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sparse = settings_named("sparse", population=40)

    assert sparse.population == 40
    assert sparse.sections["DefaultGenome"]["initial_connection"] == "fs_neat_nohidden"
    assert sparse.restart.after > 0
    assert settings_named(None).text == load_settings().text != settings_named("sparse").text
    assert settings_named(None).restart.after == 0
    assert "[Restart]" in sparse.text
    assert "[Restart]" not in load_settings().text

    monkeypatch.chdir(tmp_path)
    Path("sparse").write_text("[NEAT]\npop_size = 7\n", encoding="utf-8")
    assert settings_named("sparse").population == 150
    assert settings_named("./sparse").population == 7
    assert {path.parent for path in NAMED.values()} == {SETTINGS_FILE.parent}
    with pytest.raises(BadInput, match=r"--neat spars: neither .* nor a file; did you mean `sparse`\?"):
        settings_named("spars")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[NEAT]\npop_sise = 3", r"unknown setting `pop_sise` in \[NEAT\]; did you mean `pop_size`\?"),
        ("[DefaultGenom]\nnum_hidden = 3", r"unknown section \[DefaultGenom\]; did you mean `DefaultGenome`\?"),
        (f"[{'x' * 5000}]\nseed = 3", r"unknown section \[x{60}…\]; known"),
        (f"[NEAT]\n{'x' * 5000} = 3", r"unknown setting `x{60}…` in \[NEAT\]"),
        ("[NEAT]\nseed = 3", r"unknown setting `seed` in \[NEAT\]"),
        ("[NEAT]\npop_size = 1", "pop_size is 1; it must be between 2 and 1000000"),
        ("[NEAT]\npop_size = many", "pop_size is `many`; it must be a whole number"),
        ("[NEAT]\npop_size = 3.5", "pop_size is `3.5`; it must be a whole number"),
        ("[NEAT]\nreset_on_extinction = perhaps", "must be True or False"),
        ("[NEAT]\nfitness_criterion = most", "fitness_criterion is `most`; known: max, mean, min"),
        ("[DefaultGenome]\nconn_add_prob = 7", "conn_add_prob is 7.0; it must be between 0 and 1"),
        ("[DefaultGenome]\nconn_add_prob = nan", "conn_add_prob is nan; it must be finite"),
        ("[DefaultGenome]\nweight_max_value = inf", "weight_max_value is inf; it must be finite"),
        ("[DefaultGenome]\nweight_mutate_power = -1", "weight_mutate_power is -1.0; it must not be negative"),
        ("[DefaultGenome]\nweight_max_value = -9", "weight_min_value is above weight_max_value"),
        ("[DefaultGenome]\nweight_mutate_rate = often", "weight_mutate_rate is `often`; it must be a number"),
        ("[DefaultGenome]\nfeed_forward = False", "feed-forward networks only"),
        ("[DefaultGenome]\nactivation_options = sigmod", "unknown activation `sigmod`; did you mean `sigmoid`"),
        ("[DefaultGenome]\nactivation_options = tanh", "activation_default is `sigmoid`, not one of"),
        ("[DefaultGenome]\naggregation_options = sum mode", "unknown aggregation `mode`"),
        ("[DefaultGenome]\ninitial_connection = ful_direct", "did you mean `full_direct`"),
        ("[DefaultGenome]\ninitial_connection = partial_direct", "needs a share between 0 and 1"),
        ("[DefaultGenome]\ninitial_connection = partial_direct 2", "needs a share between 0 and 1"),
        ("[DefaultGenome]\nweight_init_type = odd", "weight_init_type is `odd`"),
        ("[DefaultStagnation]\nspecies_fitness_func = best", "species_fitness_func is `best`"),
        ("[DefaultReproduction]\nelitism = 151", "elitism is 151; the population is only 150"),
        ("pop_size = 3", "not a settings file"),
        ("[NEAT]\n[NEAT]", "not a settings file"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.cfg"
    path.write_text(text, encoding="utf-8")

    with pytest.raises(BadInput, match=message) as told:
        load_settings(path)

    assert str(told.value).startswith(str(path))
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(("key", "count"), [("num_inputs", 26), ("num_outputs", 1)])
def test_networks_that_are_no_controllers_are_refused_before_they_evolve(key: str, count: int, tmp_path: Path) -> None:
    path = tmp_path / "mine.cfg"
    path.write_text(f"[DefaultGenome]\n{key} = 3\n", encoding="utf-8")
    with pytest.raises(BadInput, match=f"mine.cfg: {key} is 3; controllers have {count}, leave it out"):
        settings_named(str(path))


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"gone.cfg: cannot be read \(No such file"):
        load_settings(tmp_path / "gone.cfg")
    (tmp_path / "bytes.cfg").write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match="not UTF-8 text"):
        load_settings(tmp_path / "bytes.cfg")


def test_a_population_of_one() -> None:
    with pytest.raises(BadInput, match="population 1: a population needs 2 genomes or more"):
        load_settings(population=1)
