"""A new release is on trial until its services were seen well; if they are not, the one before comes back.

What is on trial stands in a file, and ``on-flora-installed.service`` is who decides: also when the connection of
whoever installs breaks, and at the next boot when the power went away in between.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import asdict, dataclass

from machine import OPT, Failed, point, run, say, write_if_other
from releases import CURRENT, PREVIOUS, discard, is_complete, name_of, switch
from units import CONFIRM, TARGET, install_units, ready_now, restart, states, wait_steady

TRIAL = OPT / "trial.json"
OUTCOME = OPT / "last-trial.txt"
READY_WITHIN_S = 120.0
STEADY_S = 10.0
MOST_RESTARTS = 3
"""A service that waits for another, or finds a device still held, may need a second start."""
UNWELL = ("silent", "never heard", "fault")
"""Of what flora-monitor says. ``degraded`` is a camera or a NAS, which no other release would mend."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What is tried.

    Attributes:
        release: the one that ``current`` points at.
        before: the one to return to; empty where there is none.
        earlier: what ``previous`` pointed at.
        expected: services that must be well.
    """

    release: str
    before: str
    earlier: str
    expected: list[str]


def begin(release: str) -> None:
    """Switch to a release and put it on trial; :func:`decide` ends that.

    A trial that is undecided yet has proven nothing: what was there before it is still what to return to.
    """
    before, earlier = name_of(CURRENT) or "", name_of(PREVIOUS) or ""
    pending = _pending()
    if pending is not None and is_complete(pending.before):
        before, earlier = pending.before, pending.earlier
    now = states()
    unmasked = [name for name, state in now.items() if not state.is_masked]
    # Who was not well before need not be now: a broken camera is not the release's.
    was_ready = [name for name in unmasked if (name in pending.expected if pending else now[name].is_ready)]
    trial = Trial(release, before if before != release else "", earlier, was_ready or unmasked)
    write_if_other(TRIAL, json.dumps(asdict(trial)).encode())
    switch(release)
    install_units(release)


def _pending() -> Trial | None:
    """The trial that is undecided; None where there is none."""
    return Trial(**json.loads(TRIAL.read_text(encoding="utf-8"))) if TRIAL.is_file() else None


def decide_by_systemd() -> None:
    """Let systemd run :func:`decide`, so that it comes to its end without us.

    Raises:
        Failed: the release was not well; the text says what was done.
    """
    OUTCOME.unlink(missing_ok=True)
    run(["systemctl", "enable", "--quiet", TARGET, CONFIRM])
    done = run(["systemctl", "start", CONFIRM], within_s=900.0, check=False)
    said = OUTCOME.read_text(encoding="utf-8").strip() if OUTCOME.is_file() else ""
    if done.returncode != 0 or not said:
        raise Failed(said or f"{CONFIRM} failed: journalctl -u {CONFIRM}")
    say(said)


def decide() -> None:
    """Start the release that is on trial, look whether it is well, and go back where it is not.

    Raises:
        Failed: it was not well.
    """
    trial = _pending()
    if trial is None:
        return
    # Once more: the power may have gone away in :func:`begin`, and what is judged must be the whole release.
    switch(trial.release)
    install_units(trial.release)
    restart()
    problem = _problem(trial.expected)
    if not problem:
        TRIAL.unlink()
        _tell(f"well       {name_of(CURRENT)}: {len(trial.expected)} services are ready, and steady for {STEADY_S:g} s")
        return
    if not trial.before:
        TRIAL.unlink()
        raise _told(f"{trial.release} is not well: {problem}. There is no release before it to return to")
    switch(trial.before)
    # What failed is no release to go back to by hand.
    if trial.earlier:
        point(PREVIOUS, f"releases/{trial.earlier}")
    else:
        PREVIOUS.unlink(missing_ok=True)
    install_units(trial.before)
    TRIAL.unlink()
    restart()
    discard(trial.release)
    again = _problem(trial.expected)
    state = f"and is not well either: {again}" if again else "and is well"
    raise _told(f"{trial.release} was not well: {problem}. {trial.before} runs again, {state}")


def _problem(expected: list[str]) -> str:
    problem = wait_steady(expected, within_s=READY_WITHIN_S, steady_s=STEADY_S, most_restarts=MOST_RESTARTS)
    return problem or _unheard(expected)


def _unheard(expected: list[str]) -> str:
    """Who is not well by what it says on the bus; READY alone does not tell that its messages arrive."""
    try:
        command = [str(CURRENT / "bin/flora-monitor"), "health", "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120.0, check=False)
    except subprocess.TimeoutExpired:
        return "flora-monitor health does not end"
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    if not lines:
        return f"the bus does not answer ({done.stderr.strip()[-200:]})"
    unwell = [line for line in lines if line["service"] in expected and line["state"] in UNWELL]
    return "; ".join(f"{line['service']} {line['state']} {line['reason']}".strip() for line in unwell)


def _tell(text: str) -> None:
    write_if_other(OUTCOME, f"{text}\n".encode())
    say(text)


def _told(text: str) -> Failed:
    write_if_other(OUTCOME, f"{text}\n".encode())
    return Failed(text)


def still_well() -> str:
    """For a release that was installed before: who of those that run is not well; empty where all are."""
    return _problem(ready_now())
