"""Who is asked, and who failed: the words in which the core and the succession talk to each other."""

from __future__ import annotations

from dataclasses import dataclass

from flora_controller.steering import Steering


@dataclass(frozen=True, slots=True)
class Lineup:
    """Who is asked.

    Attributes:
        steering: its decision shines.
        before: what is returned to, in this order; where there is none, ``steering`` stays whatever it does.
        shadow: asked beside it; None for none.
        shadow_ticks: how many the shadow has to answer before it steers.
    """

    steering: Steering
    before: tuple[Steering, ...] = ()
    shadow: Steering | None = None
    shadow_ticks: int = 0


@dataclass(frozen=True, slots=True)
class Failure:
    """A controller that must not go on.

    Attributes:
        name, sha256: which.
        reason: in a clause.
        in_shadow: it never shone.
    """

    name: str
    sha256: str
    reason: str
    in_shadow: bool

    @property
    def when(self) -> str:
        """When it failed, and why."""
        return f"{'in its shadow time' if self.in_shadow else 'while it steered'}: {self.reason}"

    def __str__(self) -> str:
        return f"gave up `{self.name}` {self.when}"


def identity_of(steering: Steering) -> str:
    """Names a rule; a file of the same name with other content is another one."""
    return f"{steering.name} {steering.sha256}".strip()
