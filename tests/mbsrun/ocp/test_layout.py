"""Where a motion lies among the variables: each variable once, and polynomials read back at every place.

A polynomial motion is put into the variables by their meaning; whatever is read off them is its value there.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mbsrun.ocp.ground import integrators, schemes
from mbsrun.ocp.ground.grid import Grid
from mbsrun.ocp.ground.program import Column
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.transcription.layout import (
    Entries,
    ExtraSizes,
    Layout,
    Motions,
    Places,
    at_closed,
    at_mesh,
    at_points,
    at_stages,
    lay_out,
    spread,
)

Array = NDArray[np.float64]

PLAIN = Motions(2, (0, 1), (0, 1), (0, 1), (0, 1))
LOOPED = Motions(3, (0, 2), (0, 1, 2), (0, 2), (0, 2), multipliers=2, corrections=4)
REDUCED = Motions(3, (0, 2), (0, 1, 2), (0, 2), (0, 2))  # the loops give q1 and its velocity
DRIVEN = Motions(3, (0, 2), (0, 1, 2), (0, 2), (0, 1, 2), driven=(1,), driven_places=(1,))
ADDED = ExtraSizes(states=2, controls=1, given=(1,), wrenches=2)
GRIDS = (Grid(3), Grid(3, (0.2, 0.5, 0.3)))
HORIZON = 2.0


def number(motions: Motions = PLAIN, grid: Grid = GRIDS[0], m: int = 3, stages: int = 2, **given: bool | int) -> Layout:
    usual = {"has_states": True, "has_slopes": False, "has_accelerations": True, "horizon_is_free": False}
    return lay_out(motions, m, grid, stages, added=ADDED, **(usual | given))  # type: ignore[arg-type]


def list_own(layout: Layout) -> list[NDArray[np.int64]]:
    """List all parts of a layout that share no variable."""
    extras = layout.extras
    return [
        layout.mesh, extras.states, layout.nodes, extras.nodes, layout.slopes, layout.accelerations, layout.multipliers,
        layout.corrections, layout.drives, layout.driving, layout.shifts, layout.inputs, layout.point_inputs,
        extras.controls, extras.point_controls, extras.forces, extras.wrenches, layout.horizons, layout.unknowns,
    ]  # fmt: skip


@pytest.mark.parametrize("motions", [PLAIN, LOOPED, REDUCED, DRIVEN])
def test_every_variable_has_one_place(motions: Motions) -> None:
    """Interval by interval; a free horizon and unknown numbers come last."""
    for states, slopes, accelerations, free, constant, unknowns, closed in product(
        (True, False), (True, False), (True, False), (True, False), (True, False), (0, 2), (0, 3)
    ):
        layout = number(
            motions, has_states=states, has_slopes=slopes, has_accelerations=accelerations, horizon_is_free=free,
            has_constant_inputs=constant, unknowns=unknowns, closed=closed,
        )  # fmt: skip
        parts = list_own(layout)
        assert sorted(np.concatenate([part.ravel() for part in parts]).tolist()) == list(range(layout.size))
        assert [*layout.horizons, *layout.unknowns] == list(range(layout.size - free - unknowns, layout.size))
        spans = [np.concatenate([part[k].ravel() for part in parts[2:17]]) for k in range(3)]
        for k, span in enumerate(spans):
            assert layout.mesh[k].max() < span.min()
            assert span.max() < layout.mesh[k + 1].min()
        assert layout.every_input.shape == (3, (2 + 1) * (1 if constant else 2))
        assert layout.list_inputs().size == 3 * 2 * (1 if constant else 2)
        assert [part.shape[-1] for part in (layout.slopes, layout.accelerations)] == [
            len(motions.carried) * slopes, len(motions.independent) * accelerations
        ]  # fmt: skip
        assert layout.shifts.shape == (3, closed, len(motions.found))
        assert not layout.design.size


def test_the_first_stage_may_be_the_start_of_its_interval() -> None:
    layout = number(begins_interval=True)
    extras = layout.extras
    assert layout.points[:, 0].tolist() == layout.mesh[:-1].tolist()
    assert layout.points[:, 1].tolist() == layout.nodes[:, 1].tolist()
    assert extras.point_states[:, 0].tolist() == extras.states[:-1].tolist()
    assert extras.point_states[:, 1].tolist() == extras.nodes[:, 1].tolist()
    other = number()
    assert other.points.tolist() == other.nodes.tolist()


def test_accelerations_of_driven_joints_stand_between_the_others() -> None:
    """Those of a form without accelerations are left out, too."""
    layout = number(DRIVEN)
    for k, part in enumerate((layout.accelerations[:, :, 0], layout.drives[:, :, 0], layout.accelerations[:, :, 1])):
        assert layout.every_acceleration[:, :, k].tolist() == part.tolist()
    assert number(DRIVEN, has_accelerations=False).every_acceleration.shape == (3, 2, 0)
    alone = Motions(1, (), (0,), (), (0,), driven=(0,), driven_places=(0,))
    layout = number(alone, has_accelerations=False)
    assert layout.every_acceleration.tolist() == layout.drives.tolist()
    assert number().every_acceleration.shape == (3, 2, 2)


def test_parts_of_a_motion_by_their_numbers() -> None:
    assert (DRIVEN.carried, DRIVEN.found, DRIVEN.driven_states) == ([0, 2, 3, 5], [1, 4], [1, 4])
    assert (REDUCED.is_reduced, DRIVEN.is_reduced, PLAIN.is_reduced) == (True, False, False)
    sliding = Motions(4, (0, 1, 2, 3), (0, 2, 4), (2, 4), (4, 2))
    assert (sliding.carried_velocities, sliding.moved_velocities, sliding.carried) == (
        [1, 2],
        [2, 1],
        [0, 1, 2, 3, 5, 6],
    )


def value(column: Column, x: Array) -> Array:
    """Return a part of the variables at every place, (places, size)."""
    return x[column].T if isinstance(column, np.ndarray) else column.evaluate(x)


class Course:
    """Polynomials of time: coordinates, inputs, wrenches and added states; they fill the variables of a layout."""

    def __init__(self, rng: np.random.Generator, degree: int, count: int = 2) -> None:
        self.q = [Polynomial(rng.standard_normal(degree + 1)) for _ in range(count)]
        self.u = [Polynomial(rng.standard_normal(2)) for _ in range(3)]
        self.w = [Polynomial(rng.standard_normal(2)) for _ in range(2)]

    def fill(self, layout: Layout, integrator: integrators.Integrator) -> Array:
        """Put values where a layout has them; constant inputs are values in the middle of an interval."""
        x = np.full(layout.size, np.nan)
        mesh, stages = layout.grid.mesh(HORIZON), layout.grid.places(integrator.stages.c) * HORIZON
        for i, q in enumerate(self.q):
            x[layout.mesh[:, i]] = q(mesh)
            x[layout.mesh[:, len(self.q) + i]] = q.deriv()(mesh)
            if layout.points.size:
                x[layout.points[:, :, i]] = q(stages)
                x[layout.points[:, :, len(self.q) + i]] = q.deriv()(stages)
            if layout.accelerations.size:
                x[layout.accelerations[:, :, i]] = q.deriv(2)(stages)
            if layout.slopes.size:
                h = layout.grid.lengths(HORIZON)[:, None]
                x[layout.slopes[:, :, i]] = h * q.deriv()(stages)
                x[layout.slopes[:, :, len(self.q) + i]] = h * q.deriv(2)(stages)
        for k, i in enumerate(layout.extras.free):
            if layout.point_inputs.size:
                x[layout.point_inputs[:, :, k]] = self.u[i](stages)
            else:
                x[layout.inputs[:, k]] = self.u[i]((mesh[1:] + mesh[:-1]) / 2)
        x[layout.extras.forces[:, :, 0]] = self.u[1](stages)
        for i, w in enumerate(self.w):
            x[layout.extras.wrenches[:, :, i]] = w(stages)
        x[layout.extras.states] = mesh[:, None] * [1.0, 2.0]
        x[layout.extras.point_states] = stages[:, :, None] * [1.0, 2.0]
        return x


def check(course: Course, layout: Layout, places: Places, x: Array, t: Array, *, held: bool = True) -> None:
    """Compare all that is read at places with the polynomials at their times."""
    assert places.s * HORIZON == pytest.approx(t)
    mesh = layout.grid.mesh(HORIZON)
    middle = ((mesh[1:] + mesh[:-1]) / 2)[places.interval]
    q = np.stack([q(t) for q in course.q], axis=1)
    qd = np.stack([q.deriv()(t) for q in course.q], axis=1)
    assert value(places.q, x) == pytest.approx(q, abs=1e-11)
    assert value(places.qd, x) == pytest.approx(qd, abs=1e-11)
    assert value(places.yd, x) == pytest.approx(qd, abs=1e-11)
    given = [course.u[i](middle if held and i != 1 else t) for i in range(3)]
    assert value(places.u, x) == pytest.approx(np.stack(given, axis=1), abs=1e-11)
    assert value(places.w, x) == pytest.approx(np.stack([w(t) for w in course.w], axis=1), abs=1e-11)
    qdd = value(places.qdd, x)
    if qdd.size:
        assert qdd == pytest.approx(np.stack([q.deriv(2)(t) for q in course.q], axis=1), abs=1e-10)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize(("name", "has_states"), [("collocation", True), ("second-order", False)])
@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_a_polynomial_motion_is_read_back_everywhere(
    grid: Grid, name: str, has_states: bool, family: Family, rng: np.random.Generator
) -> None:
    """Of one degree more than there are points: accelerations are polynomials through the stages."""
    integrator = integrators.build(name, schemes.build(family, 2), 1)
    h, course = grid.lengths(HORIZON), Course(rng, 3)
    for constant in (True, False):
        layout = number(PLAIN, grid, has_states=has_states, has_constant_inputs=constant, closed=3)
        x = course.fill(layout, integrator)
        stages = (grid.places(integrator.stages.c) * HORIZON).ravel()
        for places in (at_stages(layout, integrator, h), at_points(layout, integrator, h)):
            check(course, layout, places, x, stages, held=constant)
            assert value(places.states, x) == pytest.approx(stages[:, None] * [1.0, 2.0])
            some = places.restrict(np.array([4, 1]))
            check(course, layout, some, x, stages[[4, 1]], held=constant)
            assert (some.interval.tolist(), some.stage.tolist()) == ([2, 0], [2, 0])
        if not has_states:
            closed = (grid.places(integrator.closed.c) * HORIZON).ravel()
            check(course, layout, at_closed(layout, integrator, h), x, closed, held=constant)
        mesh = at_mesh(layout, integrator, [0, 1, 3])
        check(course, layout, mesh, x, grid.mesh(HORIZON)[[0, 1, 3]], held=constant)
        assert (mesh.interval.tolist(), mesh.stage.tolist(), mesh.lam.size) == ([0, 0, 2], [0, 1, 3], 0)


@pytest.mark.parametrize("grid", GRIDS)
def test_a_motion_is_read_off_its_slopes(grid: Grid, rng: np.random.Generator) -> None:
    """Of the degree of the points, as the integrals of polynomials through the slopes."""
    integrator = integrators.build("collocation", schemes.build(Family.RADAU, 3), 1)
    course = Course(rng, 3)
    layout = number(PLAIN, grid, stages=3, has_states=False, has_slopes=True)
    x, stages = course.fill(layout, integrator), (grid.places(integrator.stages.c) * HORIZON).ravel()
    check(course, layout, at_stages(layout, integrator, grid.lengths(HORIZON)), x, stages)


@pytest.mark.parametrize("given", [0, 1, 2])
def test_what_loops_give_is_the_start_of_an_interval_and_a_shift(given: int, rng: np.random.Generator) -> None:
    """One coordinate and its velocity at each closed place; the others are integrals."""
    own = tuple(i for i in range(3) if i != given)
    motions = Motions(3, own, (0, 1, 2), own, own)
    integrator = integrators.build("second-order", schemes.build(Family.RADAU, 2), 1)
    for grid in GRIDS:
        count = len(integrator.closed.c)
        layout = number(motions, grid, has_states=False, closed=count)
        x = rng.standard_normal(layout.size)
        places = at_closed(layout, integrator, grid.lengths(HORIZON))
        starts = np.repeat(layout.mesh[:-1], count, axis=0)
        q, qd = value(places.q, x), value(places.qd, x)
        assert q[:, given] == pytest.approx(x[starts[:, given]] + x[layout.shifts[:, :, 0].ravel()])
        assert qd[:, given] == pytest.approx(x[starts[:, 3 + given]] + x[layout.shifts[:, :, 1].ravel()])
        h = np.repeat(grid.lengths(HORIZON), count)
        V = np.tile(integrator.closed.V, (3, 1))
        for k, entry in enumerate(own):
            a = x[np.repeat(layout.accelerations[:, :, k], count, axis=0)]
            assert qd[:, entry] == pytest.approx(x[starts[:, 3 + entry]] + h * (V * a).sum(axis=1))


def test_coefficients_are_spread_over_entries_alike(rng: np.random.Generator) -> None:
    c, x = rng.standard_normal((2, 3)), rng.standard_normal((3, 4))
    assert spread(c, 4) @ x.ravel() == pytest.approx(c @ x)


def test_entries_of_one_place_are_summed_and_zeros_left_out() -> None:
    entries = Entries()
    entries.put([0, 1], [2, 2], [1.5, 0.0])
    entries.put(0, [2, 1], 2.0)
    matrix = entries.matrix((2, 3))
    assert matrix.toarray().tolist() == [[0.0, 2.0, 3.5], [0.0, 0.0, 0.0]]
    assert matrix.nnz == 2
