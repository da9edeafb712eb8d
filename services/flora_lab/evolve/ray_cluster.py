"""The connection to a Ray cluster: found, checked, quiet, and closed again whatever happens."""

from __future__ import annotations

import contextlib
import importlib
import io
import logging
import os
import re
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Any, Final, Self

from flora_common.errors import BadInput
from flora_lab.evolve import ray_node, ray_work
from flora_lab.evolve.ray_calls import HOW_TO, Calls, ray_module
from flora_lab.worker_process import WorkerLost

LOCAL, AUTO = "local", "auto"
_ANSWER_S: Final = 10.0
"""How long a cluster may take to answer. Ray itself would try for five minutes, and then end the process."""
_CHECK_S: Final = 120.0
"""How long a node may take to start a process and look at its versions."""
_ADDRESS: Final = re.compile(r"(ray://)?(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):([0-9]{1,5})")


@dataclass(frozen=True, slots=True)
class Node:
    """A machine of the cluster.

    Attributes:
        key: Ray's name for it.
        name: people's name for it.
        cpus: that Ray may use there.
    """

    key: str
    name: str
    cpus: int


class RayCluster:
    """A connection; a context manager, at whose end it is closed.

    Args:
        address: ``local`` for a cluster of this machine alone, that ends with the connection; ``auto`` for the one that
            this machine is a node of; ``HOST:PORT`` of a head that this machine is a node of; or ``ray://HOST:PORT``.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._ray: Any = None
        self._calls: Calls | None = None
        self._sigterm = _Sigterm()
        self._after = contextlib.ExitStack()

    def __enter__(self) -> Self:
        """Connect.

        Raises:
            BadInput: Ray is not installed, nobody answers, or a node has other versions than this machine.
        """
        self._ray = ray_module()
        check_address(self.address)
        with contextlib.ExitStack() as undo:
            # Ray tells of lost nodes on stdout, whatever its settings, where --json has its place.
            undo.enter_context(contextlib.redirect_stdout(io.StringIO()))
            undo.callback(signal.signal, signal.SIGTERM, signal.getsignal(signal.SIGTERM))
            undo.callback(self._ray.shutdown)
            self._sigterm.handler = signal.getsignal(signal.SIGTERM)
            self._connect()
            # in place of Ray's own
            signal.signal(signal.SIGTERM, self._sigterm)
            self._calls = Calls(ray_node.versions())
            self._check_nodes()
            self._after = undo.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._after.close()

    @property
    def calls(self) -> Calls:
        """Calls of functions on the nodes; only while connected."""
        assert self._calls is not None
        return self._calls

    def nodes(self) -> list[Node]:
        """Those that are there now.

        Raises:
            WorkerLost: the cluster does not answer any more.
        """
        try:
            found = self._ray.nodes()
        except (self._ray.exceptions.RayError, ConnectionError) as problem:
            raise self._gone(problem) from problem
        return [
            Node(node["NodeID"], f"{node['NodeManagerHostname']} ({node['NodeManagerAddress']})", _cpus(node))
            for node in found
            if node["Alive"]
        ]

    def first_done(self, references: Sequence[Any], *, wait_s: float) -> list[Any]:
        """Those calls that are done, after waiting for the first one.

        Raises:
            WorkerLost: the cluster does not answer any more.
        """
        try:
            with self._sigterm.told():
                if not self._ray.wait(list(references), num_returns=1, timeout=wait_s)[0]:
                    return []
                done: list[Any] = self._ray.wait(list(references), num_returns=len(references), timeout=0)[0]
        except (self._ray.exceptions.RayError, ConnectionError) as problem:
            raise self._gone(problem) from problem
        return done

    def cancel(self, references: Sequence[Any]) -> None:
        """End calls that nobody waits for any more."""
        with contextlib.suppress(self._ray.exceptions.RayError, ConnectionError):
            for reference in references:
                self._ray.cancel(reference, force=True)

    def _connect(self) -> None:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
        if self.address == LOCAL:
            # else Ray sends figures about this machine to its makers
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            options |= {"num_cpus": len(os.sched_getaffinity(0)), "include_dashboard": False}
        elif self.address != AUTO:
            self._check_answers()
        try:
            with warnings.catch_warnings(action="ignore"):
                self._ray.init(address=self.address, **options)
        except (self._ray.exceptions.RayError, OSError, RuntimeError, ValueError) as problem:
            told = " ".join(str(problem).split())[:300]
            raise BadInput(
                f"--cluster {self.address}: cannot be joined ({told}); if it asks for a token, see {HOW_TO}"
            ) from problem

    def _check_answers(self) -> None:
        grpc = importlib.import_module("grpc")
        if os.environ.get("RAY_USE_TLS", "0") not in {"", "0"}:
            return
        channel = grpc.insecure_channel(self.address.removeprefix("ray://"))
        try:
            grpc.channel_ready_future(channel).result(timeout=_ANSWER_S)
        except grpc.FutureTimeoutError as problem:
            raise BadInput(
                f"--cluster {self.address}: no Ray cluster answers there within {_ANSWER_S:g} s; look at `ray status` "
                "on its head, and at the firewall"
            ) from problem
        finally:
            channel.close()

    def _check_nodes(self) -> None:
        """Whether flora is the same on all nodes that work.

        Raises:
            BadInput: it is not; or there is no node to work on.
        """
        nodes = [node for node in self.nodes() if node.cpus > 0]
        if not nodes:
            raise BadInput(
                f"--cluster {self.address}: no node of it has a CPU to work with; start one with `ray start`"
            )
        sent = {self.calls.submit(ray_work.NOTHING, node=node.key): node for node in nodes}
        answered, silent = self._ray.wait(list(sent), num_returns=len(sent), timeout=_CHECK_S)
        if silent:
            raise BadInput(
                f"--cluster {self.address}: node {sent[silent[0]].name} has not started to work within {_CHECK_S:g} s"
            )
        for reference in answered:
            # a node that has left meanwhile is none that works
            with contextlib.suppress(WorkerLost):
                self.calls.result(reference)

    def _gone(self, problem: BaseException) -> WorkerLost:
        return WorkerLost(f"--cluster {self.address}: the cluster does not answer any more ({str(problem)[:160]})")


class _Sigterm:
    """A handler that does what the one before it did, and remembers how that ended: Ray's waiting forgets it.

    Attributes:
        handler: the one before.
    """

    def __init__(self) -> None:
        self.handler: Any = None
        self._end: SystemExit | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        try:
            if callable(self.handler):
                self.handler(number, frame)
            elif self.handler == signal.SIG_DFL:
                sys.exit(128 + number)
        except SystemExit as end:
            self._end = end
            raise

    @contextlib.contextmanager
    def told(self) -> Iterator[None]:
        """Within the block the handler's own exit status counts."""
        try:
            yield
        except SystemExit as end:
            raise self._end or end from None


def check_address(address: str) -> None:
    """Whether it can be the address of a cluster.

    Raises:
        BadInput: it cannot.
    """
    found = _ADDRESS.fullmatch(address)
    if address not in {LOCAL, AUTO} and not (found and 0 < int(found.group(3)) < 65536):
        raise BadInput(
            f"--cluster {address[:60]}: no address of a Ray cluster; it is local, auto, HOST:PORT or ray://HOST:10001"
        )


def _cpus(node: dict[str, Any]) -> int:
    return int(node["Resources"].get("CPU", 0.0))
