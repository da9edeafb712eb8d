"""The part of ``make install-rig`` that runs on the rig, as root, with nothing but Debian's Python.

``install BUNDLE`` makes a release and switches to it, ``rollback`` goes back to the one before, ``decide`` is what
``on-flora-installed.service`` runs. Each says in lines what it changed; 0 is well, 1 is not, 2 is what cannot be done.
"""

from __future__ import annotations

import fcntl
import os
import sys
import tomllib
from pathlib import Path

import nas
import releases
import trial
import units
from machine import CONFIG, KEYS, OPT, Failed, Refused, install_packages, is_pi, remove_tree, run, say, write_if_other

LOCK = OPT / ".lock"
PACKAGES = ("python3-venv", "python3-systemd", "python3-dev", "gcc")
PACKAGES_OF_A_PI = ("python3-picamera2",)
DEFAULT_RUN_DIR = "/var/lib/flora/runs/current"


def install(bundle: Path) -> None:
    """Make the release that is in ``bundle``, and switch to it."""
    name = releases.read_bundle(bundle)["release"]
    try:
        install_packages([*PACKAGES, *(PACKAGES_OF_A_PI if is_pi() else ())])
        releases.build(bundle, name)
        units.install_machine_files(name)
        _write_default_config(bundle)
    finally:
        remove_tree(bundle)  # hundreds of megabytes, which the next try brings anew, mostly under another name
    try:
        releases.check(name, CONFIG)
    except Failed as problem:
        running = releases.name_of(releases.CURRENT)
        releases.discard(name)
        raise Failed(f"{name} was not switched to: {problem}. {running or 'nothing'} runs on") from problem
    if releases.name_of(releases.CURRENT) == name and units.is_enabled() and not trial.TRIAL.is_file():
        _look_again(name)
    else:
        _switch(name)
    releases.prune()


def rollback() -> None:
    """Go back to the release before; a second time comes forth again."""
    name = releases.name_of(releases.PREVIOUS)
    if name is None:
        raise Refused(f"there is no release to go back to; installed: {', '.join(releases.installed()) or 'none'}")
    releases.check(name, CONFIG)
    _switch(name)


def _switch(name: str) -> None:
    run_dir = _run_dir()
    if not (run_dir / "run.toml").is_file():
        trial.TRIAL.unlink(missing_ok=True)  # an undecided one must not switch back at the next boot
        releases.switch(name)
        units.install_units(name)
        say(f"not started: {run_dir} has no run.toml yet; write {CONFIG} and the run folder, then")
        say("             sudo systemctl enable --now flora-rig.target")
        return
    trial.begin(name)
    trial.decide_by_systemd()
    nas.look(CONFIG)


def _look_again(name: str) -> None:
    """The same release once more: only what somebody else changed is put right."""
    changed = units.install_units(name)
    releases.switch(name)
    if not units.ready_now():
        say("unchanged  the rig is stopped; sudo systemctl start 'flora-*'")
        return
    if changed:
        units.restart()
    problem = trial.still_well()
    if problem:
        raise Failed(f"{name} was there already and is not well: {problem}")
    say(f"well       {name} runs")
    nas.look(CONFIG)


def _write_default_config(bundle: Path) -> None:
    KEYS.mkdir(mode=0o755, parents=True, exist_ok=True)
    if CONFIG.exists():
        say(f"unchanged  {CONFIG} is yours")
        return
    write_if_other(CONFIG, (bundle / "flora.toml").read_bytes())
    say(f"changed    {CONFIG}, to be edited")


def _run_dir() -> Path:
    table = tomllib.loads(CONFIG.read_text(encoding="utf-8-sig"))  # as the services read it, byte order mark or not
    return Path(table.get("rig", {}).get("run_dir", DEFAULT_RUN_DIR))


def main(arguments: list[str]) -> int:
    program = "on the rig"
    os.umask(0o022)
    try:
        if os.geteuid() != 0:
            raise Refused("must be root")
        if arguments == ["decide"]:
            # Whoever installs holds the lock and waits for this.
            trial.decide()
            return 0
        OPT.mkdir(mode=0o755, parents=True, exist_ok=True)
        with LOCK.open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise Refused("somebody else installs on this rig now; wait for them to end") from None
            match arguments:
                case ["install", bundle]:
                    install(Path(bundle))
                case ["rollback"]:
                    rollback()
                case _:
                    raise Refused("install BUNDLE, rollback or decide")
        run(["sync"])
    except Refused as problem:
        print(f"{program}: {problem}", file=sys.stderr, flush=True)
        return 2
    except (Failed, OSError) as problem:
        print(f"{program}: {problem}", file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
