"""Simulated plants inside of compiled loops: what every kind of them can do, and how a loop calls it.

A kind of plants is a ``NamedTuple`` of arrays with the methods of :class:`Plants`, marked with :func:`jit_methods`.
numba takes a named tuple apart into its fields and knows its class, so that one loop, written once, is compiled for
each kind with its own methods. A new law is a module with such a class, and a line in
:mod:`flora_lab.evolve.plants_kinds`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final, Protocol, TypeVar

import numpy as np
from numba import types
from numba.extending import overload_method

from flora_common.arrays import Array

ClassT = TypeVar("ClassT")

_overload: Any = overload_method
_method: Callable[[str], Callable[[Callable[..., Any]], Callable[..., Any]]] = functools.partial(
    _overload, types.NamedTuple, jit_options={"error_model": "numpy", "nogil": True}, strict=False
)
"""Not strict, so that a method may say the types of its arguments."""


_JITTED: Final[set[type[Any]]] = set()


def jit_methods(plants: type[ClassT]) -> type[ClassT]:
    """Let compiled code call the methods of a ``NamedTuple`` of plants."""
    _JITTED.add(plants)
    return plants


class Plants(Protocol):
    """Rows of plants of one kind, of which the first so many are in use. Methods must compile.

    Each is called once for many plants: numba counts references to all arrays of a tuple at every call, which takes
    longer than to compute a stem.
    """

    def points(self, rows: int, out: Array) -> None:
        """The stems of the first ``rows`` plants.

        Args:
            rows: how many are in use.
            out: shape (rows or more, 10, 2), cm, written.
        """

    def advance(self, rows: int, is_right: Array, step: int) -> None:
        """Let five minutes pass for the first ``rows`` plants. What comes of a plant does not depend on its row.

        Args:
            rows: how many are in use.
            is_right: which lamp shines on each; it is full on, the other dark.
            step: number of the step, from 0.
        """

    def copy_rows(self, sources: Array, targets: Array, count: int) -> None:
        """Make the plants in the first ``count`` rows of ``targets`` those in ``sources``, one after the other."""


def room(first: Array, rows: int) -> Array:
    """An array of so many rows, of which only the first is filled, by the single row of ``first``.

    Memory that is never written costs nothing: rows that no plant comes to stand in are only an address.
    """
    made = np.empty((rows, *first.shape[1:]), dtype=first.dtype)
    made[0] = first[0]
    return made


def _own(plants: Any, name: str) -> Callable[..., None] | None:
    """The class's own method, which numba compiles; None where it is none of ours."""
    return getattr(plants.instance_class, name) if plants.instance_class in _JITTED else None


@_method("points")
def _points(self: Any, rows: Any, out: Any) -> Callable[..., None] | None:
    return _own(self, "points")


@_method("advance")
def _advance(self: Any, rows: Any, is_right: Any, step: Any) -> Callable[..., None] | None:
    return _own(self, "advance")


@_method("copy_rows")
def _copy_rows(self: Any, sources: Any, targets: Any, count: Any) -> Callable[..., None] | None:
    return _own(self, "copy_rows")
