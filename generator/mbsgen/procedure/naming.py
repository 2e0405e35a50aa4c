"""Names of wires and stages that a transformation adds: none of them is there before."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import count


class Names:
    """The names that are taken."""

    def __init__(self, taken: Iterable[str]) -> None:
        self._taken = set(taken)

    def take(self, names: Iterable[str]) -> None:
        """Take names that are fixed; their owner answers for it that they are free."""
        self._taken.update(names)

    def make(self, wanted: str) -> str:
        """Take a name: the requested one, or the first free one with a number."""
        name = next(n for k in count(1) if (n := wanted if k == 1 else f"{wanted}_{k}") not in self._taken)
        self._taken.add(name)
        return name
