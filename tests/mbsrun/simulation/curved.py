"""A mechanism of polynomials with points of contact, in complex numbers too: exact derivatives by complex steps.

Nothing in it is a real mechanism, so that no term of a derivative is 0 by chance: there are more coordinates than
velocities, inertia and Jacobians of points depend on all coordinates, and normals turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.drive import Piece
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.contacts import Mode, State

Array = NDArray[Any]  # real or complex

N, NQ, POINTS = 6, 7, 3
TINY = 1e-30


def slope(function: Callable[[Array], Array], x: Array) -> Array:
    """Differentiate a function by its argument, by complex steps; the new index is the last one."""
    return np.stack([np.imag(function(x + 1j * TINY * row)) / TINY for row in np.eye(len(x))], axis=-1)


@dataclass(frozen=True, eq=False)
class Shape:
    """The coefficients of all polynomials."""

    rng: np.random.Generator
    friction: tuple[float, ...] = (0.4, 0.3, 0.0)

    def __post_init__(self) -> None:
        draw = self.rng.standard_normal
        sizes: dict[str, tuple[int, ...]] = {
            "clearance": (POINTS,), "direction": (POINTS, 3), "slide": (POINTS, 3, N), "mass": (N, N),
            "rate": (NQ, N), "bias": (N,),
        }  # fmt: skip
        terms = {name: (draw(s), 0.3 * draw((*s, NQ)), 0.2 * draw((*s, NQ, NQ))) for name, s in sizes.items()}
        object.__setattr__(self, "terms", terms)
        object.__setattr__(self, "damping", 0.3 * draw((N, N, N)))
        object.__setattr__(self, "inputs", draw((N, 2)))

    def read(self, name: str, q: Array) -> Array:
        """Evaluate a polynomial."""
        a, b, c = self.terms[name]  # type: ignore[attr-defined]
        return np.asarray(a + b @ q + c @ q @ q)

    def turn(self, name: str, q: Array) -> Array:
        """Differentiate a polynomial."""
        _, b, c = self.terms[name]  # type: ignore[attr-defined]
        return np.asarray(b + c @ q + c.swapaxes(-1, -2) @ q)

    def normal(self, q: Array) -> Array:
        """Return unit normals, (P, 3)."""
        u = self.read("direction", q)
        return np.asarray(u / np.sqrt((u * u).sum(axis=1, keepdims=True)))

    def turn_normal(self, q: Array) -> Array:
        """Differentiate the unit normals, (P, 3, nq)."""
        u, n, du = self.read("direction", q), self.normal(q), self.turn("direction", q)
        across = du - n[:, :, None] * np.einsum("pi,piq->pq", n, du)[:, None]
        return np.asarray(across / np.sqrt((u * u).sum(axis=1))[:, None, None])

    def mass(self, q: Array) -> Array:
        """Return the mass matrix."""
        root = 0.2 * self.read("mass", q)
        return np.asarray(2 * np.eye(N) + root @ root.T)

    def residual(self, q: Array, qd: Array, qdd: Array, v: Array) -> Array:
        """Return M qdd + c - B v."""
        drag = np.einsum("ijk,j,k->i", self.damping, qd, qd)  # type: ignore[attr-defined]
        return np.asarray(self.mass(q) @ qdd + self.read("bias", q) + drag - self.inputs @ v)  # type: ignore[attr-defined]


@dataclass(frozen=True, eq=False)
class Kernels:
    """The kernels of points, for batches of states."""

    shape: Shape

    @property
    def manifest(self) -> Any:
        """Return the contacts."""
        rigid = [
            SimpleNamespace(
                name=f"p{k}", restitution=0.0, coefficient=mu, hold=0.0, is_stop=k == 1, stop=f"p{k}", is_coupling=False
            )
            for k, mu in enumerate(self.shape.friction)
        ]
        return SimpleNamespace(rigid=rigid, inputs=("a", "b"), owners=())

    def __call__(self, name: str, q: Array) -> dict[str, Array]:
        s = self.shape
        if name == "touching":
            return {
                "clearance": np.array([s.read("clearance", x) for x in q]),
                "direction": np.array([s.normal(x).T for x in q]),
                "slide": np.array([s.read("slide", x).reshape(-1, N) for x in q]),
            }
        return {
            "jac_clearance_q": np.array([s.turn("clearance", x) for x in q]),
            "jac_direction_q": np.array([s.turn_normal(x).reshape(-1, NQ) for x in q]),
            "jac_slide_q": np.array([s.turn("slide", x).transpose(2, 0, 1, 3).reshape(-1, NQ) for x in q]),
        }


@dataclass(frozen=True)
class Curved:
    """The functions of a mechanism that fields of derivatives call."""

    kernels: Any
    formulation: Any = Formulation.SEMI
    effort: Any = field(default_factory=SimpleNamespace)
    size: int = N
    places: int = NQ

    def rates(self, q: Array, qd: Array) -> Array:
        """Return E(q) qd."""
        return np.array([self.kernels.shape.read("rate", x) @ w for x, w in zip(q, qd, strict=True)])

    def rate_slopes(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Differentiate them."""
        s = self.kernels.shape
        by_q = [np.einsum("anq,n->aq", s.turn("rate", x), w) for x, w in zip(q, qd, strict=True)]
        return np.array(by_q), np.array([s.read("rate", x) for x in q])

    def mass_matrix(self, q: Array, _qd: Array, _v: Array) -> Array:
        """Return mass matrices."""
        return np.array([self.kernels.shape.mass(x) for x in q])

    def residual(self, q: Array, qd: Array, qdd: Array, v: Array, _lam: Array | None = None) -> Array:
        """Return residuals."""
        return np.array([self.kernels.shape.residual(*x) for x in zip(q, qd, qdd, v, strict=True)])

    def solve(self, M: Array, right: Array) -> Array:
        """Return M^-1 right."""
        return np.asarray(np.linalg.solve(M, right[..., None])[..., 0])

    def stiffnesses(self, q: Array, qd: Array, qdd: Array, v: Array, _lam: Array | None = None) -> tuple[Array, ...]:
        """Differentiate residuals."""
        s, states = self.kernels.shape, list(zip(q, qd, qdd, v, strict=True))
        return (
            np.array([slope(lambda x, y=y: s.residual(x, *y[1:]), y[0]) for y in states]),  # type: ignore[misc]
            np.array([slope(lambda x, y=y: s.residual(y[0], x, *y[2:]), y[1]) for y in states]),  # type: ignore[misc]
            np.array([s.mass(y[0]) for y in states]),
        )


def make(seed: int, friction: tuple[float, ...] = (0.4, 0.3, 0.0)) -> Any:
    """Draw a mechanism."""
    return Curved(Kernels(Shape(np.random.default_rng(seed), friction)))


def drive(t: Array) -> Array:
    """Return inputs over time, (K, 2)."""
    return np.stack((np.sin(3 * t), t**2), axis=1)


PIECE = Piece(0.0, 2.0, drive, False)


@dataclass(frozen=True, eq=False)
class Law:
    """The equations of a mode F(y, p) = 0, of motion or of an impact, as stated in `contacts`.

    y: accelerations or velocities after an impact, then of each closed point its force (3,) where it sticks, its
    normal force where it slips, its two tangential impulses where it sticks and leaves; p: q, velocities (before), and
    the impulses along the normals that leaving points are given.
    """

    shape: Shape
    mode: Mode
    v: Array = field(default_factory=lambda: np.zeros(2))
    restitution: Array | None = None  # (P,): of an impact

    def sticks(self, k: int) -> bool:
        """Return whether a point is held along the other side."""
        return self.mode.states[k] == State.STICK and self.shape.friction[k] > 0

    def forces(self, y: Array, p: Array) -> Array:
        """Return the forces on points, (P, 3)."""
        q, before, given = p[:NQ], p[NQ : NQ + N], p[NQ + N :]
        n, S = self.shape.normal(q), self.shape.read("slide", q)
        found, at = np.zeros((POINTS, 3), dtype=np.result_type(y, p)), N
        for k in self.mode.closed:
            is_leaving = k in self.mode.leaving
            if self.sticks(k):
                if is_leaving:
                    first, second = self.span(n[k])
                    found[k] = given[k] * n[k] + y[at] * first + y[at + 1] * second
                else:
                    found[k] = y[at : at + 3]
                at += 2 if is_leaving else 3
                continue
            v = S[k] @ (before if self.restitution is None else y[:N])
            slip = v - n[k] * (n[k] @ v)
            size = np.sqrt(slip @ slip)
            sign = -1.0 if np.real(slip) @ self.mode.ways[k] < 0 else 1.0
            way = sign * slip / size
            found[k] = (given[k] if is_leaving else y[at]) * (n[k] - self.shape.friction[k] * way)
            at += 0 if is_leaving else 1
        return found

    def span(self, n: Array) -> tuple[Array, Array]:
        """Return two directions across a normal."""
        first = np.cross(n, np.eye(3)[np.abs(np.real(n)).argmin()])
        first = first / np.sqrt(first @ first)
        return first, np.cross(n, first)

    def count(self) -> int:
        """Count the unknowns."""
        left = self.mode.leaving
        sizes = [3 - (k in left) if self.sticks(k) else 1 - (k in left) for k in self.mode.closed]
        return N + sum(sizes)

    def miss(self, y: Array, p: Array) -> Array:
        """Return what is missing to the equations."""
        q, before = p[:NQ], p[NQ : NQ + N]
        s, a, forces = self.shape, y[:N], self.forces(y, p)
        n, S = s.normal(q), s.read("slide", q)
        push = np.einsum("pin,pi->n", S, forces)
        rows: list[Array] = []
        if self.restitution is None:
            rates = s.read("rate", q) @ before
            drift = np.einsum("pinq,q,n->pi", s.turn("slide", q), rates, before)
            nd = s.turn_normal(q) @ rates
            top = s.residual(q, before, a, self.v) - push
            for k in self.mode.closed:
                end = S[k] @ a + drift[k]
                rows += [end] if self.sticks(k) else [(n[k] @ end + nd[k] @ (S[k] @ before))[None]]
            return np.concatenate((top, *rows))
        for k in self.mode.closed:
            after, speed = S[k] @ a, n[k] @ (S[k] @ before)
            if k in self.mode.leaving:
                rows += [np.array([t @ after for t in self.span(n[k])])] if self.sticks(k) else []
            elif self.sticks(k):
                rows.append(after + self.restitution[k] * speed * n[k])
            else:
                rows.append((n[k] @ after + self.restitution[k] * speed)[None])
        return np.concatenate((s.mass(q) @ (a - before) - push, *rows))

    def solve(self, p: Array, guess: Array) -> Array:
        """Solve by Newton's method."""
        y = guess
        for _ in range(50):
            step = np.linalg.solve(slope(lambda x: self.miss(x, p), y), self.miss(y, p))
            y = y - step
            if np.abs(step).max() < 1e-13 * (1 + np.abs(y).max()):
                return y
        raise AssertionError("Newton's method does not converge")

    def differentiate(self, y: Array, p: Array) -> tuple[Array, Array]:
        """Return the derivatives by p of y, and of the forces on points (P, 3, .)."""
        by_p = -np.linalg.solve(slope(lambda x: self.miss(x, p), y), slope(lambda x: self.miss(y, x), p))
        direct = slope(lambda x: self.forces(y, x), p)
        return by_p, direct + slope(lambda x: self.forces(x, p), y) @ by_p
