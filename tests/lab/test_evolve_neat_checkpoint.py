"""Saved equals unsaved, resumed equals straight, byte for byte; and what is no saved evolution is refused."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from evolve_neat_toys import everything_of, genes_of, settings_with, toy_fitness

from flora_common.errors import BadInput, DiskFull
from flora_lab.evolve import neat_checkpoint
from flora_lab.evolve.neat_checkpoint import decode, encode, engine_from, load, save, state_of
from flora_lab.evolve.neat_engine import NeatEngine
from flora_lab.evolve.neat_fast import FAST
from flora_lab.evolve.neat_settings import STOCK, load_settings

SETTINGS = load_settings(population=40)
GENERATIONS = 24


def straight(generations: int = GENERATIONS) -> NeatEngine:
    engine = NeatEngine(SETTINGS, 5)
    for _ in range(generations):
        engine.generation(toy_fitness)
    return engine


def test_saving_changes_nothing() -> None:
    engine = NeatEngine(SETTINGS, 5)
    for _ in range(GENERATIONS):
        encode(engine)
        engine.generation(toy_fitness)

    assert encode(engine) == encode(straight())
    assert everything_of(engine) == everything_of(straight())


def test_read_in_every_generation_goes_on_as_if_never_stopped(tmp_path: Path) -> None:
    engine = NeatEngine(SETTINGS, 5)
    for _ in range(GENERATIONS):
        save(tmp_path / "evolution.json", engine)
        engine = load(tmp_path / "evolution.json", SETTINGS)
        engine.generation(toy_fitness)

    assert encode(engine) == encode(straight())
    assert everything_of(engine) == everything_of(straight())
    assert genes_of(engine.best) == genes_of(straight().best)


def test_what_is_read_is_written_again_as_it_was() -> None:
    data = encode(straight())

    assert encode(engine_from(decode(data), SETTINGS)) == data


def test_with_fitness_by_chance_the_best_is_the_same() -> None:
    """An elite's new fitness must not become that of the best that was kept, read or not."""

    def by_chance(engine: NeatEngine) -> None:
        engine.generation(lambda genomes: [((engine.generation_number * 37 + g.key * 11) % 101) / 7 for g in genomes])

    kept, read = NeatEngine(SETTINGS, 5), NeatEngine(SETTINGS, 5)
    for _ in range(12):
        by_chance(kept)
        by_chance(read)
        read = engine_from(decode(encode(read)), SETTINGS)

    assert encode(kept) == encode(read)


def test_through_extinctions(tmp_path: Path) -> None:
    settings = settings_with(tmp_path, Stagnation__max_stagnation=2, Stagnation__species_elitism=0)
    kept, read = NeatEngine(settings, 5), NeatEngine(settings, 5)
    extinct = 0
    for _ in range(10):
        extinct += kept.generation(lambda genomes: [0.0] * len(genomes)).is_extinct
        read.generation(lambda genomes: [0.0] * len(genomes))
        read = engine_from(decode(encode(read)), settings)

    assert extinct > 0
    assert encode(kept) == encode(read)


def test_through_restarts(tmp_path: Path) -> None:
    settings = settings_with(
        tmp_path, Restart__restart_after=3, Restart__restart_after_best=5, Restart__restart_gain=1.0
    )
    kept, read = NeatEngine(settings, 5), NeatEngine(settings, 5)
    restarts = 0
    for _ in range(GENERATIONS):
        restarts += kept.generation(toy_fitness).is_extinct
        read.generation(toy_fitness)
        read = engine_from(decode(encode(read)), settings)

    assert restarts > 1
    assert encode(kept) == encode(read)
    assert everything_of(kept) == everything_of(read)


def test_saved_with_the_fast_classes_and_read_with_neat_pythons_own() -> None:
    engine = engine_from(decode(encode(straight(10))), SETTINGS, STOCK)
    assert engine.types is STOCK
    for _ in range(GENERATIONS - 10):
        engine.generation(toy_fitness)

    assert encode(engine) == encode(straight())
    assert straight().types is FAST


STRUCK = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from evolve_neat_toys import toy_fitness
from flora_lab.evolve.neat_checkpoint import load, save
from flora_lab.evolve.neat_engine import NeatEngine
from flora_lab.evolve.neat_settings import load_settings

path, settings = Path(sys.argv[1]), load_settings(population=40)
engine = NeatEngine(settings, 5)

def evaluate(genomes):
    if engine.generation_number == int(sys.argv[3]):
        os.kill(os.getpid(), signal.SIGKILL)
    return toy_fitness(genomes)

while True:
    engine.generation(evaluate)
    if engine.generation_number % 4 == 0:
        save(path, engine)
"""


@pytest.mark.parametrize("struck_at", [5, 15])
def test_killed_and_resumed_is_as_straight(struck_at: int, tmp_path: Path) -> None:
    path = tmp_path / "evolution.json"
    arguments = [str(path), str(Path(__file__).parent), str(struck_at)]

    ended = subprocess.run([sys.executable, "-c", STRUCK, *arguments], timeout=60, check=False)
    engine = load(path, SETTINGS)
    resumed_at = engine.generation_number
    while engine.generation_number < GENERATIONS:
        engine.generation(toy_fitness)

    assert ended.returncode == -signal.SIGKILL
    assert resumed_at == struck_at // 4 * 4
    assert encode(engine) == encode(straight())


def test_every_damaged_file_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "evolution.json"
    data = encode(straight(3))
    step = len(data) // 150
    damaged = [data[:cut] for cut in range(0, len(data), step)]
    damaged += [data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :] for at in range(0, len(data), step)]

    for content in damaged:
        path.write_bytes(content)
        with pytest.raises(BadInput) as told:
            load(path, SETTINGS)
        assert str(told.value).startswith(f"{path}: ")
        assert "\n" not in str(told.value)


@pytest.mark.parametrize("content", [b"", b"{}", b"[1, 2]", b"\x80\x04.", b"[" * 100_000, b"\xff", b'{"format": 3}'])
def test_foreign_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "evolution.json"
    path.write_bytes(content)

    with pytest.raises(BadInput, match="is damaged or no saved evolution"):
        load(path, SETTINGS)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"gone.json: cannot be read \(No such file"):
        load(tmp_path / "gone.json", SETTINGS)


def test_another_format_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(neat_checkpoint, "FORMAT", "flora-neat-9")
    data = encode(straight(1))
    monkeypatch.undo()

    with pytest.raises(BadInput, match="has the format `flora-neat-9`"):
        decode(data)


def test_other_settings_are_refused_and_named() -> None:
    with pytest.raises(BadInput, match="`pop_size = 40` then, `pop_size = 41` now"):
        engine_from(state_of(straight(1)), load_settings(population=41))


def test_another_neat_python_is_refused() -> None:
    state = msgspec.structs.replace(state_of(straight(1)), neat_python="2.1.0")

    with pytest.raises(BadInput, match=r"saved with neat-python 2.1.0; 2.0.0 would evolve differently"):
        engine_from(state, SETTINGS)


def test_parts_that_do_not_fit_together_are_refused() -> None:
    state = state_of(straight(3))
    key = state.species[0].members[0]
    short = msgspec.structs.replace(state, population=[g for g in state.population if g.key != key])
    odd = msgspec.structs.replace(state, random=msgspec.structs.replace(state.random, version=9))

    with pytest.raises(BadInput, match=f"names genome {key} in a species, but holds no such genome"):
        engine_from(short, SETTINGS)
    with pytest.raises(BadInput, match="a state of randomness that Python does not know"):
        engine_from(odd, SETTINGS)


def test_a_full_disk_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "evolution.json"
    save(path, straight(1))
    before = path.read_bytes()

    def torn(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", torn)
    with pytest.raises(DiskFull, match="no room on the disk"):
        save(path, straight(2))

    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
