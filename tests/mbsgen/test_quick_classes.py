"""Data classes that are made quickly do the same as the library's."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from mbsgen.quick_classes import quick_data_classes


def _make() -> SimpleNamespace:
    @dataclass(frozen=True)
    class Nothing:
        pass

    @dataclass(frozen=True)
    class One:
        x: object

    @dataclass(frozen=True)
    class Pair(One):
        y: object = 2
        hidden: object = field(default=0, repr=False)
        uncounted: object = field(default=0, compare=False)

    @dataclass(frozen=True, slots=True)
    class Slots:
        x: object
        y: object = ()

    @dataclass
    class Open:
        x: object
        y: list[object] = field(default_factory=list)

    @dataclass(order=True)
    class Ordered:
        x: object
        y: object

    @dataclass(slots=True, unsafe_hash=True)
    class Hashed:
        x: object

    class Below(Pair):
        z: object

    return SimpleNamespace(**{name: found for name, found in locals().items() if isinstance(found, type)})


PLAIN = _make()
with quick_data_classes():
    QUICK = _make()

Write = Callable[[SimpleNamespace], Any]
VALUES: tuple[Write, ...] = (
    lambda made: made.Nothing(),
    lambda made: made.One(1),
    lambda made: made.Pair(1),
    lambda made: made.Pair(1, (2,), 3, 4),
    lambda made: made.Pair(1, uncounted=7),
    lambda made: made.Pair(1, hidden=7),
    lambda made: made.Slots("a"),
    lambda made: made.Open(1),
    lambda made: made.Ordered(1, 2),
    lambda made: made.Ordered(1, 3),
    lambda made: made.Hashed(3),
    lambda made: made.Below(1),
)


def _try(act: Callable[..., Any], *given: object) -> object:
    """Return the result of an act, or its error."""
    try:
        return act(*given)
    except (AttributeError, TypeError) as error:
        return type(error), str(error)


@pytest.mark.parametrize("write", VALUES)
def test_values_are_shown_hashed_and_kept_as_the_library_does(write: Write) -> None:
    plain, quick = write(PLAIN), write(QUICK)
    assert repr(quick) == repr(plain)
    assert _try(hash, quick) == _try(hash, plain)
    assert quick == copy.copy(quick)
    assert quick.__eq__(1) is NotImplemented
    for name in ("x", "y", "z"):
        assert _try(setattr, quick, name, 5) == _try(setattr, plain, name, 5)
        assert _try(repr, quick) == _try(repr, plain)
        assert _try(delattr, quick, name) == _try(delattr, plain, name)


def test_values_are_equal_and_in_order_where_the_library_says_so() -> None:
    plain, quick = ([write(made) for write in VALUES] for made in (PLAIN, QUICK))
    for act in (lambda a, b: a == b, lambda a, b: a < b):
        assert [[_try(act, a, b) for b in quick] for a in quick] == [[_try(act, a, b) for b in plain] for a in plain]


def test_a_value_that_holds_itself_is_shown() -> None:
    for made in (PLAIN, QUICK):
        value = made.Open(1)
        value.y.append(value)
        assert repr(value).endswith("Open(x=1, y=[...])")


def test_methods_have_their_names() -> None:
    for name in ("__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__"):
        plain, quick = (vars(made.One)[name] for made in (PLAIN, QUICK))
        assert (quick.__name__, quick.__qualname__) == (plain.__name__, plain.__qualname__)


def test_the_library_is_as_before_afterwards() -> None:
    before = dict(vars(dataclasses))
    with pytest.raises(KeyError), quick_data_classes():
        raise KeyError
    assert vars(dataclasses) == before
