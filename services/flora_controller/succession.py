"""Which controller steers after which: the configured one, those that were offered, one in shadow, and the way back.

The configured controller is the base. What is offered over the bus and accepted goes before it, maybe after a time in
shadow; what fails is given up for the one behind it, at last for the base. What the operator does by hand counts most:
when the configuration names another controller, or its file is replaced, that one steers and nothing offered does.

What must survive a restart lies on the :class:`~flora_controller.shelf.Shelf`. No clock is read here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from flora_common.controller_file import LoadedController, parse_controller
from flora_common.errors import BadController, StoreError
from flora_common.messages import ControllerAnswer, ControllerChunk, ControllerOffer
from flora_common.messages.catalogue import OfferStage
from flora_common.messages.envelope import as_sentence
from flora_controller.acceptance import Acceptance
from flora_controller.evolved import Evolved
from flora_controller.lineup import Failure, Lineup, identity_of
from flora_controller.offers import Assembly
from flora_controller.shelf import Entry, GivenUp, Shelf, ShelfRecord
from flora_controller.steering import Steering

MOST_REFUSALS: Final = 16
"""Offers whose refusal is remembered, so that it is said again when it was lost on the way."""
BY_HAND: Final = "the operator put another controller in its place"


class Source(Protocol):
    """Where the configured controller comes from."""

    @property
    def steering(self) -> Steering: ...

    def poll(self) -> bool:
        """True where another one has taken over since the last look."""


class Succession:
    """Takes offers, and keeps the order of controllers.

    Args:
        source: of the configured controller.
        shelf: where accepted files are kept.
        acceptance: what a file must pass.
        shadow_ticks: the least that this rig asks of any offer.
        say: publishes an answer.

    Attributes:
        trouble: why something could not be kept or used; empty while all is well.
    """

    def __init__(
        self,
        source: Source,
        shelf: Shelf,
        acceptance: Acceptance,
        *,
        shadow_ticks: int,
        say: Callable[[ControllerAnswer], None],
    ) -> None:
        self._source = source
        self._shelf = shelf
        self._acceptance = acceptance
        self._least_shadow_ticks = shadow_ticks
        self._say = say
        self._assembly = Assembly()
        self._loaded: dict[str, Evolved] = {}
        self._refused: dict[str, ControllerAnswer] = {}
        self._shadow_ticks_done = 0
        self._record, self.trouble = shelf.read(base=self._base)
        if self._record.base != self._base:
            self._end_offered()
        self._load_all()

    @property
    def note(self) -> str:
        """Why the last one was returned from; empty where nothing was since the last acceptance."""
        return self._record.note

    @property
    def lineup(self) -> Lineup:
        """Who is to be asked from now on."""
        line: list[Steering] = [self._loaded[entry.sha256] for entry in self._record.line]
        line.append(self._source.steering)
        candidate = self._record.candidate
        shadow = None if candidate is None else self._loaded[candidate.sha256]
        return Lineup(line[0], tuple(line[1:]), shadow, candidate.shadow_ticks if candidate else 0)

    def poll(self) -> bool:
        """Look at the configured file; True where it was replaced, and steers now."""
        if not self._source.poll():
            return False
        left = self._record
        self._end_offered()
        for entry in (*left.line[:1], *([left.candidate] if left.candidate else [])):
            self._say(self._answer(entry, "returned", BY_HAND))
        return True

    def _end_offered(self) -> None:
        self._keep(self._record.on_base(self._base, sorted(self._acceptance.last_accepted), BY_HAND))

    def after_tick(self, shadow_ticks: int, failures: Sequence[Failure] = ()) -> bool:
        """Draw the consequences of a tick, and of the start; True where the lineup has changed.

        Args:
            shadow_ticks: how many the one in shadow has answered.
            failures: who must not go on, the first one first.
        """
        self._shadow_ticks_done = shadow_ticks
        for failed in failures:
            self._give_up(failed)
        candidate = self._record.candidate
        if candidate is None or shadow_ticks < candidate.shadow_ticks:
            return bool(failures)
        self._keep(self._record.with_first(candidate))
        self._say(self._answer(candidate, "steering"))
        return True

    def _give_up(self, failed: Failure) -> None:
        record = self._record
        entry = next(e for e in (*record.line, record.candidate) if e is not None and e.sha256 == failed.sha256)
        self._keep(record.without(entry, failed.when, note=str(failed)))
        self._say(self._answer(entry, "returned", failed.when))

    # offers

    def on_offer(self, offer: ControllerOffer, now_s: float) -> None:
        """Hear an offer and answer it; the lineup changes with its last chunk at the earliest."""
        known = self._known(offer)
        if known is not None:
            self._say(known)
            return
        try:
            displaced = self._assembly.begin(offer, now_s)
        except BadController as problem:
            self._refuse(offer, str(problem))
            return
        if displaced is not None:
            self._refuse(displaced, f"`{offer.name}` was offered before all of this one had arrived")
        self._say(self._progress(offer))

    def on_chunk(self, chunk: ControllerChunk, now_s: float) -> bool:
        """Hear a chunk; True where it was the last one and the lineup has changed."""
        offer = self._assembly.offer
        if offer is None or not self._assembly.add(chunk, now_s) or self._assembly.missing:
            return False
        try:
            self._accept(self._assembly.take(), offer)
        except (BadController, StoreError) as problem:
            self._refuse(offer, str(problem))
            return False
        except OSError as problem:
            self._refuse(offer, f"it cannot be kept: {problem}")
            return False
        return True

    def on_time(self, now_s: float) -> None:
        """Give up an offer whose sender is gone."""
        gone = self._assembly.expire(now_s)
        if gone is not None:
            self._refuse(gone, "its sender fell silent before all had arrived; offer it again")

    def _accept(self, data: bytes, offer: ControllerOffer) -> None:
        loaded = parse_controller(data, where=offer.name)
        signer = self._acceptance.check(loaded, offered=True)
        self._shelf.put(loaded)
        self._acceptance.take(loaded, signer)
        ticks = max(offer.shadow_ticks, self._least_shadow_ticks)
        entry = Entry(loaded.sha256, offer.offer, loaded.file.name, ticks)
        before = self._record
        record = before.with_candidate(entry) if ticks else before.with_first(entry)
        self._shelf.write(record)
        self._record, self.trouble = record, ""
        self._loaded[entry.sha256] = self._evolved(loaded)
        self._shadow_ticks_done = 0
        if before.candidate is not None and before.candidate.sha256 != entry.sha256:
            self._say(self._answer(before.candidate, "returned", f"`{entry.name}` was offered before this one steered"))
        self._say(self._answer(entry, "shadowing" if ticks else "steering"))

    def _known(self, offer: ControllerOffer) -> ControllerAnswer | None:
        """The answer to an offer that was decided on, or whose file is here already."""
        refused = self._refused.get(offer.offer)
        if refused is not None:
            return refused
        record, entry = self._record, Entry(offer.sha256, offer.offer, offer.name)
        if self.lineup.steering.sha256 == offer.sha256:
            return self._answer(entry, "steering")
        if record.candidate is not None and record.candidate.sha256 == offer.sha256:
            return self._answer(entry, "shadowing")
        given_up = record.given_up_of(offer.sha256)
        if given_up is None:
            return None
        if given_up.offer == offer.offer:
            return self._answer(entry, "returned", given_up.reason)
        return self._answer(entry, "refused", _again(given_up))

    def _progress(self, offer: ControllerOffer) -> ControllerAnswer:
        entry = Entry(offer.sha256, offer.offer, offer.name)
        return self._answer(entry, "received", missing=self._assembly.missing)

    def _refuse(self, offer: ControllerOffer, why: str) -> None:
        answer = self._answer(Entry(offer.sha256, offer.offer, offer.name), "refused", why)
        while len(self._refused) >= MOST_REFUSALS:
            del self._refused[next(iter(self._refused))]
        self._refused[offer.offer] = answer
        self._say(answer)

    def _answer(
        self, entry: Entry, stage: OfferStage, reason: str = "", *, missing: tuple[int, ...] = ()
    ) -> ControllerAnswer:
        candidate = self._record.candidate
        left = 0
        if stage == "shadowing" and candidate is not None:
            left = max(0, candidate.shadow_ticks - self._shadow_ticks_done)
        return ControllerAnswer(
            offer=entry.offer,
            stage=stage,
            sha256=entry.sha256,
            missing=missing,
            shadow_ticks_left=left,
            steers=as_sentence(self.lineup.steering.name),
            reason=as_sentence(reason),
        )

    # what is kept

    @property
    def _base(self) -> str:
        return identity_of(self._source.steering)

    def _keep(self, record: ShelfRecord) -> None:
        """Go by this record; where the disk does not take it, that lasts until the next start, and is told."""
        self._record = record
        self._loaded = {sha256: loaded for sha256, loaded in self._loaded.items() if sha256 in record.named}
        try:
            self._shelf.write(record)
            self.trouble = ""
        except (StoreError, OSError) as problem:
            self.trouble = f"which controller steers cannot be written down: {problem}"

    def _load_all(self) -> None:
        """Load what the record names; what may not steer any more is left out, and told."""
        usable, problems = set[str](), []
        for sha256 in sorted(self._record.named):
            try:
                loaded = self._shelf.load(sha256)
                self._acceptance.check_kept(loaded, offered=True)
            except BadController as problem:
                problems.append(f"an accepted controller is left out: {problem}")
                continue
            usable.add(sha256)
            self._loaded[sha256] = self._evolved(loaded)
        if problems:
            self._record = self._record.only(usable)
            self.trouble = "; ".join(problems)

    def _evolved(self, loaded: LoadedController) -> Evolved:
        policy = self._acceptance.policy
        return Evolved(loaded, policy.target, policy.obstacle, loaded.file.name)


def _again(given_up: GivenUp) -> str:
    return f"this rig gave it up before, {given_up.reason}; sign it again to try it again"
