"""Results that are found once for the same objects, which do not change: the checks of a problem in a solve."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Memory(Generic[T]):
    """Results by the objects that they belong to, while the first of these lives; equal objects are not the same."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, ...], tuple[tuple[weakref.ref[object], ...], T]] = {}

    def knows(self, *objects: object) -> bool:
        """Return whether there is a result for some objects."""
        references, _ = self._known.get(tuple(map(id, objects)), ((), None))
        return bool(references) and all(own() is other for own, other in zip(references, objects, strict=True))

    def find(self, find: Callable[[], T], *objects: object) -> T:
        """Return the result for some objects; find it where it is not known. An exception is not remembered."""
        key = tuple(map(id, objects))
        if self.knows(*objects):
            return self._known[key][1]
        found = find()
        first = weakref.ref(objects[0], lambda _: self._known.pop(key, None))
        self._known[key] = ((first, *map(weakref.ref, objects[1:])), found)
        return found
