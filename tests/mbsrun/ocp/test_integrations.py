"""Integrators read anywhere, grids, and mirror images: polynomials of forces, and a mechanism by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.grid import Grid, divide, split
from mbsrun.ocp.ground.integrators import SECOND_ORDER, build
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing import mirror

Array = NDArray[np.float64]
SCHEMES = [(Family.RADAU, 3), (Family.LEGENDRE, 2), (Family.LOBATTO, 4), (Family.RADAU, 1)]


@pytest.mark.parametrize(("scheme", "steps"), [*itertools.product(SCHEMES, (1, 2, 3))])
@pytest.mark.parametrize("name", ["collocation", SECOND_ORDER])
def test_polynomial_accelerations_are_integrated_once_and_twice(
    name: Any, scheme: tuple[Family, int], steps: int
) -> None:
    """Of the degree of the stages of a step; coordinates of one less, unless they are integrals of velocities."""
    family, degree = scheme
    found = build(name, schemes.build(family, degree), steps)
    assert len(found.stages.c) == steps * degree
    for p in range(degree):
        a = Polynomial(np.eye(degree)[p]) + 0.5
        z, once = a(found.stages.c), a.integ()
        for reading in (found.stages, found.points, found.ends, found.closed):
            assert reading.W @ z == pytest.approx(a(reading.c), abs=1e-12)
            assert reading.V @ z == pytest.approx(once(reading.c), abs=1e-13)
            if p < degree - 1 or name == SECOND_ORDER:
                assert reading.P @ z == pytest.approx(a.integ(2)(reading.c), abs=1e-13)
    assert found.ends.c == pytest.approx([0.0, 1.0])
    last = found.closed.c[-1]
    assert last == pytest.approx(1.0)
    assert found.points.c == pytest.approx(schemes.build(family, degree).points)
    is_stage = np.isclose(found.closed.c[found.first_point], found.points.c[0])
    assert is_stage


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_the_classical_method_has_simpsons_weights(steps: int) -> None:
    """Cubic accelerations give velocities exactly at the end, parabolic ones coordinates; between, to their order."""
    found = build("rk4", schemes.build(Family.RADAU, 2), steps)
    c = found.stages.c
    assert c == pytest.approx([(k + x) / steps for k in range(steps) for x in (0, 0.5, 0.5, 1)])
    for p in range(4):
        assert found.ends.V[1] @ c**p == pytest.approx(1 / (p + 1))
        if p < 3:
            assert found.ends.P[1] @ c**p == pytest.approx(1 / (p + 1) / (p + 2))
        if p < 2:
            assert found.points.V @ c**p == pytest.approx(found.points.c ** (p + 1) / (p + 1))
            assert found.points.W @ c**p == pytest.approx(found.points.c**p)
    assert found.ends.V[0].tolist() == [0.0] * 4 * steps
    first = found.stages.V[:4, :4] * steps
    assert first.tolist() == [[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]]


def test_grids_have_lengths_times_and_places() -> None:
    """Equal intervals, or fractions of the horizon, whose last point is exactly its end."""
    equal, own = Grid(4), Grid(3, (0.2, 0.5, 0.3))
    assert (equal.is_equal, own.is_equal) == (True, False)
    assert equal.lengths(2.0).tolist() == [0.5] * 4
    assert own.lengths(2.0) == pytest.approx([0.4, 1.0, 0.6])
    assert equal.mesh(2.0).tolist() == [0, 0.5, 1, 1.5, 2]
    assert own.mesh(2.0) == pytest.approx([0, 0.4, 1.4, 2.0])
    assert Grid(10, (0.1,) * 10).mesh(0.3)[-1] == 0.3
    points = np.array([0.25, 1.0])
    assert own.times(2.0, points)[1] == pytest.approx(np.array([[0.1, 0.4], [0.65, 1.4], [1.55, 2.0]]))
    assert own.places(points) == pytest.approx(np.array([[0.05, 0.2], [0.325, 0.7], [0.775, 1.0]]))
    assert equal.places(points).tolist() == [[(k + x) / 4 for x in (0.25, 1.0)] for k in range(4)]
    assert split(np.array([0.4, 0.6]), np.array([2, 1])) == pytest.approx([0.2, 0.2, 0.6])
    assert divide(np.array([0.5, 0.5])) is None
    assert divide(np.array([1.0, 3.0])) == (0.25, 0.75)


class Crane:
    """A boom that turns about z and is raised about y, as it is seen from x."""

    def __init__(self, *, lean: float = 0.0, fails: bool = False) -> None:
        self.lean, self.fails = lean, fails
        frames = (SimpleNamespace(name="other", sensor=True), SimpleNamespace(name="joint", sensor=False),
                  SimpleNamespace(name="tip", sensor=True))  # fmt: skip
        self.manifest = SimpleNamespace(
            coordinates=(1, 2), actuated=(1,), driven=(), dependent=(), wrenches=(), frames=frames
        )

    def __call__(self, name: str, **x: Array) -> dict[str, Array]:
        if self.fails:
            raise MbsError
        (a, b) = x["q"].T
        if name == "impl":
            (c, d), (e, f) = x["qd"].T, x["qdd"].T
            return {"Phi": np.stack((e * np.cos(b) ** 2 - c * d, f + np.cos(b) * c**2 - x["u"][:, 0]), axis=1)}
        tip = np.stack((np.cos(a) * np.cos(b), np.sin(a) * np.cos(b) + self.lean, np.sin(b)), axis=1)
        return {"position": np.stack((0 * tip + 1, tip), axis=2)}


PLAIN: Any = SimpleNamespace(every_state=(), controls=(), unknowns=(), wrenches=(), has_quaternions=False)


def test_the_mirror_image_turns_the_boom_the_other_way() -> None:
    crane: Any = Crane()
    assert mirror.find_mirror(PLAIN, crane, "tip") == (-1, 1)
    for leaning, seen in ((1e-11, True), (1e-6, False)):
        other: Any = Crane(lean=leaning)
        assert bool(mirror.find_mirror(PLAIN, other, "tip")) is seen
    broken: Any = Crane(fails=True)
    assert mirror.find_mirror(PLAIN, broken, "tip") == ()


def test_no_image_is_looked_for_where_it_might_be_wrong() -> None:
    crane: Any = Crane()
    for part in ("every_state", "controls", "unknowns", "wrenches", "has_quaternions"):
        assert mirror.find_mirror(SimpleNamespace(**{**vars(PLAIN), part: (1,)}), crane, "tip") == ()  # type: ignore[arg-type]
    for part in ("driven", "dependent", "wrenches"):
        other: Any = Crane()
        setattr(other.manifest, part, (0,))
        assert mirror.find_mirror(PLAIN, other, "tip") == ()
    many: Any = Crane()
    many.manifest.coordinates = (0,) * 11
    assert mirror.find_mirror(PLAIN, many, "tip") == ()


def test_an_image_has_the_signs_of_coordinates_and_forces() -> None:
    rng = np.random.default_rng(0)
    motion = Trajectory(
        t=np.array([0.0, 1.0]), q=rng.normal(size=(2, 2)), qd=rng.normal(size=(2, 2)), u=rng.normal(size=(1, 1)),
        point_t=np.array([[0.5]]), **{x: rng.normal(size=(1, 1, 2)) for x in ("point_q", "point_qd", "point_qdd")},
    )  # fmt: skip
    manifest: Any = SimpleNamespace(actuated=(0,))
    found = mirror.reflect(motion, (-1, 1), manifest)
    for name in ("q", "qd", "point_q", "point_qd", "point_qdd"):
        assert getattr(found, name) == pytest.approx(getattr(motion, name) * [-1, 1])
    assert found.u == pytest.approx(-motion.u)
    assert found.point_u.shape == (1, 1, 0)
    given = mirror.reflect(replace(motion, point_u=np.array([[[3.0]]])), (-1, 1), manifest)
    assert given.point_u.tolist() == [[[-3.0]]]
