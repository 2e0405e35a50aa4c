"""Vectors and matrices of three dimensions over any ring: tape scalars, SymPy expressions, floats.

The operations are written out, so that the number type can save operations with zeros and ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar


class Ring(Protocol):
    """Numbers that add, subtract, multiply and change sign."""

    def __add__(self, other: Self, /) -> Self: ...
    def __sub__(self, other: Self, /) -> Self: ...
    def __mul__(self, other: Self, /) -> Self: ...
    def __neg__(self) -> Self: ...


T = TypeVar("T", bound=Ring)
U = TypeVar("U", bound=Ring)


@dataclass(slots=True, unsafe_hash=True)  # as if frozen: that would take three times as long to make
class Vector(Generic[T]):
    """Three components in one frame; nobody changes them."""

    x: T
    y: T
    z: T

    @staticmethod
    def of(components: Iterable[U]) -> Vector[U]:
        """Make a vector of three numbers."""
        x, y, z = components
        return Vector(x, y, z)

    def __iter__(self) -> Iterator[T]:
        return iter((self.x, self.y, self.z))

    def __getitem__(self, k: int) -> T:
        return self.x if k == 0 else self.y if k == 1 else (self.x, self.y, self.z)[k]

    def __add__(self, other: Vector[T]) -> Vector[T]:
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vector[T]) -> Vector[T]:
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self) -> Vector[T]:
        return Vector(-self.x, -self.y, -self.z)

    def scale(self, factor: T) -> Vector[T]:
        """Multiply by a number."""
        return Vector(self.x * factor, self.y * factor, self.z * factor)

    def dot(self, other: Vector[T]) -> T:
        """Form the scalar product."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: Vector[T]) -> Vector[T]:
        """Form the vector product."""
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def along(self, axis: int, amount: T) -> Vector[T]:
        """Add `amount` to one component: v + amount e_axis."""
        return Vector.of(c + amount if k == axis else c for k, c in enumerate(self))

    def map(self, function: Callable[[T], U]) -> Vector[U]:
        """Apply a function to each component."""
        return Vector(function(self.x), function(self.y), function(self.z))


@dataclass(slots=True, unsafe_hash=True)  # likewise
class Matrix(Generic[T]):
    """A 3 x 3 matrix, by rows."""

    rows: tuple[Vector[T], Vector[T], Vector[T]]

    @staticmethod
    def of(rows: Iterable[Iterable[U]]) -> Matrix[U]:
        """Make a matrix of three rows of three numbers."""
        a, b, c = rows
        return Matrix((Vector.of(a), Vector.of(b), Vector.of(c)))

    def __getitem__(self, index: tuple[int, int]) -> T:
        return self.rows[index[0]][index[1]]

    @property
    def transposed(self) -> Matrix[T]:
        """The transpose."""
        a, b, c = self.rows
        return Matrix((Vector(a.x, b.x, c.x), Vector(a.y, b.y, c.y), Vector(a.z, b.z, c.z)))

    def __add__(self, other: Matrix[T]) -> Matrix[T]:
        (a, b, c), (x, y, z) = self.rows, other.rows
        return Matrix((a + x, b + y, c + z))

    def __sub__(self, other: Matrix[T]) -> Matrix[T]:
        (a, b, c), (x, y, z) = self.rows, other.rows
        return Matrix((a - x, b - y, c - z))

    def __neg__(self) -> Matrix[T]:
        a, b, c = self.rows
        return Matrix((-a, -b, -c))

    def scale(self, factor: T) -> Matrix[T]:
        """Multiply by a number."""
        a, b, c = self.rows
        return Matrix((a.scale(factor), b.scale(factor), c.scale(factor)))

    def apply(self, v: Vector[T]) -> Vector[T]:
        """Multiply by a vector."""
        a, b, c = self.rows
        return Vector(a.dot(v), b.dot(v), c.dot(v))

    def times(self, other: Matrix[T]) -> Matrix[T]:
        """Multiply by a matrix."""
        x, y, z = other.transposed.rows
        a, b, c = (Vector(row.dot(x), row.dot(y), row.dot(z)) for row in self.rows)
        return Matrix((a, b, c))

    def column(self, k: int) -> Vector[T]:
        """Take a column."""
        a, b, c = self.rows
        return Vector(a[k], b[k], c[k])

    def map(self, function: Callable[[T], U]) -> Matrix[U]:
        """Apply a function to each entry."""
        return Matrix.of(row.map(function) for row in self.rows)


def outer(a: Vector[T], b: Vector[T]) -> Matrix[T]:
    """Form a bT."""
    return Matrix((b.scale(a.x), b.scale(a.y), b.scale(a.z)))
