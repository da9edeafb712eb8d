"""Functions of flora that are called on the nodes of a Ray cluster.

All that goes over is bytes and numbers, so that any node can unpack it and say what it lacks. Bytes that are unpickled
come from flora on a machine of the same cluster, whose members run each other's code anyway.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, Final

from flora_common.errors import BadInput
from flora_lab.evolve import ray_node
from flora_lab.worker_process import WorkerLost

RETRIES: Final = 3
"""How often Ray itself does a call anew whose node or process was lost."""
HOW_TO: Final = "docs/how-to/evolve-on-many-machines.md"


def ray_module() -> Any:
    """Ray.

    Raises:
        BadInput: it is not installed.
    """
    try:
        return importlib.import_module("ray")
    except ImportError as problem:
        raise BadInput(
            f"--cluster needs Ray, which is not installed here ({str(problem)[:100]}); "
            "install flora with the extra `cluster`: make setup EXTRAS=rig,lab,cluster,dev"
        ) from problem


class Calls:
    """Calls of functions on nodes.

    Args:
        wanted: versions that the nodes must have, of :func:`flora_lab.evolve.ray_node.versions`.
    """

    def __init__(self, wanted: Mapping[str, str]) -> None:
        self._ray = ray_module()
        self.wanted = dict(wanted)
        self._ray.cloudpickle.register_pickle_by_value(ray_node)
        self._call = self._ray.remote(ray_node.call)

    def submit(self, target: str, *arguments: Any, node: str | None = None) -> Any:
        """Have a function called, on a CPU of its own wherever there is one.

        Args:
            target: ``module:function``.
            arguments: bytes, numbers, and references to what :meth:`put` has put.
            node: call it on this node, at once, and nowhere else.

        Returns:
            A reference for :meth:`result`.
        """
        options: dict[str, Any] = {"num_cpus": 1, "max_retries": RETRIES}
        if node is not None:
            affinity = importlib.import_module("ray.util.scheduling_strategies").NodeAffinitySchedulingStrategy
            options = {"num_cpus": 0, "max_retries": 0, "scheduling_strategy": affinity(node, soft=False)}
        return self._call.options(**options).remote(self.wanted, target, *arguments)

    def put(self, data: bytes) -> Any:
        """Put bytes into the cluster's memory, from where every node takes them once."""
        return self._ray.put(data)

    def result(self, reference: Any) -> Any:
        """Wait for a call's result.

        Raises:
            WorkerLost: its node or process was lost, as often as Ray does it anew.
            BadInput: the node has another version of something.
        """
        try:
            what, value = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError:
            raise
        except (self._ray.exceptions.RayError, ConnectionError) as problem:
            raise WorkerLost(f"the cluster has lost a piece of work ({_first_line(problem)})") from problem
        if what == ray_node.DIFFERS:
            machine, name, version = value
            raise BadInput(
                f"the cluster's node {machine}: {name} is {version} there and {self.wanted[name]} here; "
                f"all machines need the same ({HOW_TO})"
            )
        return value


def _first_line(problem: BaseException) -> str:
    lines = str(problem).strip().splitlines()
    return lines[0][:160] if lines else type(problem).__name__
