"""Whether a controller file may steer this rig's plant: who signed it, how old it is, and what it was evolved for.

Two ways lead to a rig. A file that the operator's configuration names may be unsigned, as ``trust`` says. One that is
offered over the bus comes from anybody, and needs the signature of a trusted key whatever ``trust`` says.

A key's files are ordered by their ``serial``. What a rig has accepted from a key it remembers, on the disk, before the
file steers; from then on that key's older files are refused, so that nobody can bring a bad one back by sending it
again. The very file that was accepted last is no older file and never too old: a restart changes nothing.

Pure: the time, and how the serials are kept, are handed in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Final, Literal

from flora_common.controller_file import LoadedController
from flora_common.errors import BadController, StoreError
from flora_common.runs import ObstacleSection, TargetSection
from flora_common.shapes import Obstacle, Target
from flora_common.signing import PublicKey, signer_of
from flora_controller.serials import Accepted, Serials

Trust = Literal["required", "if-signed", "none"]
"""Of files that the configuration names: signed by a trusted key, the same unless unsigned, or not looked at."""
TaskRule = Literal["same", "target", "any"]
"""What a file's task must have in common with the run: target and obstacle, the target, nothing."""

TASK_TOLERANCE_CM: Final = 1.0
"""Half the radius of the paper's target: a task that differs by less is the same, measured anew."""


@dataclass(frozen=True, slots=True)
class Policy:
    """What a rig asks of a controller file.

    Attributes:
        trust: of files that the configuration names.
        task: what must fit the run.
        target, obstacle: of the run; None where it has none.
        keys: the trusted ones, by their short names.
    """

    trust: Trust = "if-signed"
    task: TaskRule = "same"
    target: Target | None = None
    obstacle: Obstacle | None = None
    keys: Mapping[str, PublicKey] = field(default_factory=dict)


class Acceptance:
    """Checks files against a policy and remembers which were accepted.

    Args:
        policy: what is asked.
        serials: what was accepted before this start; None where that cannot be known: nothing signed is then accepted.
        keep: writes the serials to the disk; raises StoreError or OSError where it cannot.
        utc: the time now, with time zone; None while the clock is not known to be right.
    """

    def __init__(
        self,
        policy: Policy,
        serials: Serials | None,
        *,
        keep: Callable[[Serials], None],
        utc: Callable[[], datetime | None],
    ) -> None:
        self.policy = policy
        self._serials = serials
        self._keep = keep
        self._utc = utc

    @property
    def last_accepted(self) -> frozenset[str]:
        """SHA-256 of the file that was accepted last, of each key: only these may be offered a second time."""
        return (
            frozenset(last.sha256 for last in self._serials.keys.values()) if self._serials is not None else frozenset()
        )

    def check(self, loaded: LoadedController, *, offered: bool) -> PublicKey | None:
        """Whether a file that comes from outside may steer. Changes nothing; :meth:`take` is the other half.

        Args:
            loaded: a file that could be read.
            offered: whether it came over the bus; else the configuration names it.

        Returns:
            The key that it is signed with; None for one without a signature that was looked at.

        Raises:
            BadController: it may not; one line that says why.
        """
        signer = self.check_kept(loaded, offered=offered)
        is_last = signer is not None and self._is_last(signer, loaded)
        if offered or not is_last:
            self._check_age(loaded)
        if signer is not None and not is_last:
            self._check_serial(signer, loaded)
        return signer

    def check_kept(self, loaded: LoadedController, *, offered: bool) -> PublicKey | None:
        """Whether a file that this rig accepted before, and kept, may steer again: as :meth:`check`, at any age."""
        signer = self._signer(loaded, offered=offered)
        self.check_fits(loaded)
        return signer

    def check_fits(self, loaded: LoadedController) -> None:
        """Whether the file's network can be fed in this run, and was evolved for its task.

        What the file or the run does not name does not differ: a run without an obstacle has none to touch.

        Raises:
            BadController: it cannot, or it was not.
        """
        policy, task = self.policy, loaded.file.task
        loaded.check_task(policy.target, policy.obstacle)
        other = f"controller `{loaded.file.name}` was evolved for another task, `{task.name}`"
        advice = 'evolve one for this run, or set [controller] task = "any"'
        if policy.task == "any":
            return
        if task.target and policy.target and not _same_target(task.target, policy.target):
            raise BadController(
                f"{other}, whose target is at ({task.target.x_cm:g}, {task.target.y_cm:g}) cm; {advice}"
            )
        if policy.task == "target" or policy.obstacle is None or not task.obstacles:
            return
        if not any(_same_obstacle(obstacle, policy.obstacle) for obstacle in task.obstacles):
            raise BadController(f'{other}, none of whose obstacles is this run\'s; {advice} or "target"')

    def take(self, loaded: LoadedController, signer: PublicKey | None) -> None:
        """Remember a file that was checked. To be called before it steers, and before it counts as accepted.

        Args:
            loaded: the file.
            signer: what :meth:`check` returned.

        Raises:
            StoreError: it cannot be remembered. It must not steer then: after a restart an older one could come back.
        """
        if signer is None or self._serials is None or self._is_last(signer, loaded):
            return
        serials = self._serials.with_(signer.id, Accepted(loaded.file.serial, loaded.sha256))
        try:
            self._keep(serials)
        except OSError as problem:
            raise StoreError(
                f"controller `{loaded.file.name}`: that it is accepted cannot be written down ({problem})"
            ) from problem
        self._serials = serials

    def _signer(self, loaded: LoadedController, *, offered: bool) -> PublicKey | None:
        trust = "required" if offered else self.policy.trust
        if trust == "none" or (trust == "if-signed" and loaded.file.signature is None):
            return None
        try:
            return signer_of(loaded, self.policy.keys)
        except BadController as problem:
            raise BadController(f"{problem}; {self._advice(offered=offered)}") from problem

    def _advice(self, *, offered: bool) -> str:
        if offered:
            return "what is offered over the bus must be signed by a key in [controller] keys_dir"
        return f'[controller] trust is "{self.policy.trust}", and trusted keys are those in keys_dir'

    def _is_last(self, signer: PublicKey, loaded: LoadedController) -> bool:
        last = self._serials.last(signer.id) if self._serials is not None else None
        return last is not None and last.sha256 == loaded.sha256

    def _check_serial(self, signer: PublicKey, loaded: LoadedController) -> None:
        name, serial = loaded.file.name, loaded.file.serial
        if self._serials is None:
            raise BadController(
                f"controller `{name}` may be an older one: this rig's record of serials is damaged (see its health)"
            )
        last = self._serials.last(signer.id)
        if last is not None and serial <= last.serial:
            raise BadController(
                f"controller `{name}` has serial {serial}, and one with serial {last.serial} was accepted from "
                f"{signer}; sign it again to go back to it"
            )

    def _check_age(self, loaded: LoadedController) -> None:
        expires, now = loaded.file.expires, self._utc()
        if expires is not None and now is not None and now >= expires:
            raise BadController(
                f"controller `{loaded.file.name}` expired at {expires:%Y-%m-%d %H:%M} UTC; sign it again if it is good"
            )


def _same_target(evolved_for: TargetSection, target: Target) -> bool:
    return _near((evolved_for.x_cm, evolved_for.y_cm), (target.x_cm, target.y_cm))


def _same_obstacle(evolved_for: ObstacleSection, obstacle: Obstacle) -> bool:
    return _near(
        (evolved_for.x_cm, evolved_for.y_cm, evolved_for.width_cm, evolved_for.height_cm),
        (obstacle.x_cm, obstacle.y_cm, obstacle.width_cm, obstacle.height_cm),
    )


def _near(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    return all(abs(a - b) <= TASK_TOLERANCE_CM for a, b in zip(first, second, strict=True))
