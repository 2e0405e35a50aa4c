"""Data classes that are made quickly: their methods are closures, and are not compiled from text one by one.

A command imports some 400 data classes, and before Python 3.13 compiling their methods took a quarter of that time.
Only `__init__` is compiled here; the others do the same as the library's.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import attrgetter
from typing import Any

Method = Callable[..., Any]


@contextmanager
def quick_data_classes() -> Iterator[None]:
    """Make the data classes of modules that are imported within the context quickly, if the library lets us."""
    before = {name: getattr(dataclasses, name, None) for name in _MAKERS} if sys.version_info < (3, 13) else {}
    if None in before.values():  # another version, which then takes its time
        before = {}
    for name in before:
        setattr(dataclasses, name, _MAKERS[name])
    try:
        yield
    finally:
        for name, make in before.items():
            setattr(dataclasses, name, make)


def _make_repr(fields: Sequence[dataclasses.Field[Any]], globals: Any) -> Method:  # noqa: ARG001
    names = [field.name for field in fields]

    def __repr__(self: Any) -> str:  # noqa: N807
        shown = ", ".join([f"{name}={getattr(self, name)!r}" for name in names])
        return f"{self.__class__.__qualname__}({shown})"

    wrapped: Method = dataclasses._recursive_repr(__repr__)  # type: ignore[attr-defined]
    return wrapped


def _make_setters(cls: Any, fields: Sequence[dataclasses.Field[Any]], globals: Any) -> tuple[Method, Method]:  # noqa: ARG001
    names = frozenset(field.name for field in fields)

    def __setattr__(self: Any, name: str, value: Any) -> None:  # noqa: N807
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
        super(cls, self).__setattr__(name, value)

    def __delattr__(self: Any, name: str) -> None:  # noqa: N807
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
        super(cls, self).__delattr__(name)

    return __setattr__, __delattr__


def _make_comparison(name: str, op: str, self_tuple: str, other_tuple: str, globals: Any) -> Method:
    if op != "==":
        compiled: Method = _COMPARE(name, op, self_tuple, other_tuple, globals=globals)
        return compiled
    read = _read_all([part.removeprefix("self.") for part in self_tuple.strip("(),").split(",") if part])

    def __eq__(self: Any, other: Any) -> Any:  # noqa: N807
        return read(self) == read(other) if other.__class__ is self.__class__ else NotImplemented

    return __eq__


def _make_hash(fields: Sequence[dataclasses.Field[Any]], globals: Any) -> Method:  # noqa: ARG001
    read = _read_all([field.name for field in fields])

    def __hash__(self: Any) -> int:  # noqa: N807
        return hash(read(self))

    return __hash__


def _read_all(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Return a function that reads attributes as a tuple."""
    if len(names) > 1:
        return attrgetter(*names)
    return (lambda x: (getattr(x, names[0]),)) if names else lambda _: ()


_COMPARE: Method = getattr(dataclasses, "_cmp_fn", None) or (lambda *_, **__: None)
_MAKERS: dict[str, Method] = {
    "_repr_fn": _make_repr,
    "_frozen_get_del_attr": _make_setters,
    "_cmp_fn": _make_comparison,
    "_hash_fn": _make_hash,
}
