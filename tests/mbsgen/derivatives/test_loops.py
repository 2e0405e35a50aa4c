"""Derivatives of mechanisms with loops: all ways of writing them agree, with Taylor's series, and with Pinocchio.

Nothing here needs closed poses: the equations of motion, with multipliers, hold at open ones too.
"""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from functools import cache
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.derivatives import implicit, kernels, recursion
from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import differentiable
from mbsgen.formulations import coupling
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.model.tree import Tree
from mbsgen.roles import Role
from mbsgen.tape.interpreter import DECIMALS, FLOATS, evaluate, fifty_digits, run
from mbsgen.tape.passes import keep_results
from mbsgen.tape.types import Tape
from mbsgen.verification.geometry import dot
from tests.mbsgen.derivatives.evaluation import EXACTLY, arguments, assert_same, matrix
from tests.mbsgen.formulations.agreement import FEW
from tests.mbsgen.formulations.closed_mechanisms import make, read
from tests.random_trees import Pinocchio, floats

Array = NDArray[np.float64]
Numbers = dict[str, list[Decimal]]

_HUNG = """
name: hung
gravity: [0.3, 0, -9.81]
parameters:
  L: {value: 0.6, kind: differentiated}
  m: {value: 2.0, kind: differentiated}
bodies:
  - {name: plate, joint: {type: free}, mass: m, com: [0.01, 0, 0], inertia: [0.03, 0.04, 0.06]}
  - {name: arm, joint: {name: q1, type: revolute, axis: y, position: [0.4, 0, 0], damping: 0.2}, mass: 1.0,
     com: [0.05, 0, 0.1], inertia: [0.01, 0.01, 0.002]}
wrenches:
  - {name: wind, body: plate, position: [0.1, 0, 0], frame: base, force: input, moment: [0.1, 0.2, 0.3]}
loops:
  - {name: foot, type: universal, axis: x, axis2: y, from: {body: plate, position: [0.3, 0, 0]},
     to: {body: arm, position: [0, 0, 0.25]}}
  - {name: strut, type: rod, from: {body: plate, position: [-0.2, 0.2, 0]},
     to: {body: base, position: [-0.3, 0.2, -0.3]}, length: L}
assembly: {plate.z: 0.25}
"""
WRITERS = MappingProxyType(
    {
        "jac": implicit.jacobian,
        "lin": implicit.linearisation,
        "adj1": implicit.adjoint,
        "jac_adj1": implicit.adjoint_jacobian,
    }
)


@cache
def tree_of(name: str) -> Tree:
    return read(_HUNG) if name == "hung" else make(name)


@cache
def dynamics(name: str) -> Dynamics:
    return Dynamics(tree_of(name), FEW)


@cache
def write_implicit(name: str, form: str, kept: str = "") -> tuple[Tape, dict[str, Tape]]:
    """Write the accelerations, or one of their results, and the derivatives by the implicit function theorem."""
    own = dynamics(name)
    whole = FUNCTIONS[form].build(tree_of(name), FEW)
    whole = keep_results(whole, [kept]) if kept else whole
    given = own.differentiate(whole)
    parts = given._residual, given.wrt, given._constraints  # type: ignore[attr-defined]
    return whole, {order: write(whole, *parts) for order, write in WRITERS.items()}


@pytest.mark.parametrize("name", ["spatial_rod", "slider_crank", "driven"])
def test_the_equations_give_what_differentiated_tapes_give(name: str) -> None:
    tape, found = write_implicit(name, "exp1")
    plain = kernels.differentiate(tape, differentiable(tape))
    orders = ("jac", "lin", "adj1") if name == "driven" else WRITERS
    for order in orders:
        expected = getattr(plain, order)
        assert_same(found[order], expected, 1e-30)
        assert found[order].inputs == expected.inputs
        assert [(o.port, o.sparsity.rows) for o in found[order].outputs] == [
            (o.port, o.sparsity.rows) for o in expected.outputs
        ]


@pytest.mark.parametrize("name", ["spatial", "geared", "driven"])
def test_recursions_give_what_differentiated_tapes_give(name: str) -> None:
    """The inertial part by mechanics, and the forces of multipliers by tape, in trees with couplings too."""
    tree = tree_of(name)
    tape = FUNCTIONS["impl"].build(tree, FEW)
    expected = kernels.differentiate(tape, differentiable(tape))
    for write, other in ((recursion.expansion, expected.lin), (recursion.adjoint_jacobian, expected.jac_adj1)):
        found = coupling.couple(write(tree.uncoupled, FEW), tree) if tree.couplings else write(tree, FEW)
        assert_same(found, other, EXACTLY if name == "geared" else 1e-13)
        assert found.inputs == other.inputs


# -- Taylor's series in 50 digits -------------------------------------------------------------------------------------


def draw(tape: Tape, seed: int) -> Numbers:
    return {name: list(map(Decimal, values)) for name, values in arguments(tape, seed).items()}


def along(
    values: Mapping[str, list[Decimal]], way: Mapping[str, list[Decimal]], h: Decimal
) -> dict[str, list[Decimal]]:
    moved = {name: [a + h * b for a, b in zip(values[name], way[name], strict=True)] for name in way}
    return {**values, **moved}


def apply(tape: Tape, found: Numbers, way: Numbers) -> Numbers:
    """Multiply the blocks of a Jacobian by a direction, by the ports of results."""
    total: dict[str, list[Decimal]] = {}
    for o in tape.outputs:
        if o.port.role is Role.DERIVATIVE and o.port.by.name in way:
            column = total.setdefault(o.port.of.name, [Decimal(0)] * o.sparsity.rows)
            for (r, c), value in zip(o.sparsity.entries, found[o.name], strict=True):
                column[r] += value * way[o.port.by.name][c]
    return total


def slopes(rests: list[Decimal]) -> list[float]:
    """Return the powers of h of rests at steps that are ten times smaller each."""
    return [float((a / b).log10()) for a, b in pairwise(rests)]


@pytest.mark.parametrize(
    ("name", "form"),
    [
        *((x, "exp1") for x in ("four_bar", "spatial", "geared", "driven", "hung")),
        ("four_bar", "exp2"),
        ("geared", "exp2"),
    ],
)
def test_taylors_rests_are_quadratic_and_cubic(name: str, form: str) -> None:
    """f(x + h d) - f - h J d falls with h^2, and lam^T f less its first two terms with h^3."""
    tape, found = write_implicit(name, form)
    steps = [Decimal(10) ** -k for k in (7, 8, 9)]
    with fifty_digits():
        at, way = draw(found["adj1"], 1), draw(tape, 2)
        way = {n: x for n, x in way.items() if n in differentiable(tape)}
        value = {i.name: at[i.name] for i in tape.inputs}
        here, linear = (evaluate(x, value, DECIMALS) for x in (tape, found["lin"]))
        first = apply(found["lin"], linear, way)
        for o in tape.outputs:
            assert here[o.name] == pytest.approx(linear[o.name], rel=Decimal("1e-40"))
        gradient, curved = (evaluate(found[order], at, DECIMALS) for order in ("adj1", "jac_adj1"))
        second = apply(found["jac_adj1"], curved, way)
        slope = sum(dot(gradient[f"adj_{x}"], way[x]) for x in way)
        bend = sum(dot(second[f"adj_{x}"], way[x]) for x in way)
        quadratic, cubic = [], []
        for h in steps:
            there = evaluate(tape, along(value, way, h), DECIMALS)
            gains = {n: [b - a for a, b in zip(here[n], there[n], strict=True)] for n in here}
            quadratic.append(max(abs(g - h * j) for n in here for g, j in zip(gains[n], first[n], strict=True)))
            whole = sum(dot(at[f"adj_{n}"], gains[n]) for n in here)
            cubic.append(abs(whole - h * slope - h * h / 2 * bend))
    assert slopes(quadratic) == pytest.approx([2, 2], abs=1e-3)
    assert slopes(cubic) == pytest.approx([3, 3], abs=1e-3)


def test_adjoints_of_the_jacobians_rows_are_the_jacobians_columns() -> None:
    """The blocks by the weights of results are the transposed Jacobian."""
    tape, found = write_implicit("driven", "exp1")
    at = arguments(found["adj1"], 3)
    jac, jac_adj1 = (evaluate(found[x], {i.name: at[i.name] for i in found[x].inputs}) for x in ("jac", "jac_adj1"))
    for result in ("qdd", "lam", "tau"):
        for x in differentiable(tape):
            block = matrix(found["jac_adj1"], f"jac_adj_{x}_adj_{result}", jac_adj1)
            expected = matrix(found["jac"], f"jac_{result}_{x}", jac)
            assert pytest.approx(expected, rel=1e-12, abs=1e-12 * np.abs(expected).max(initial=1.0)) == block.T


@pytest.mark.parametrize("kept", ["qdd", "lam", "tau"])
def test_a_scene_may_keep_one_result(kept: str) -> None:
    (_, found), (_, part) = write_implicit("driven", "exp1"), write_implicit("driven", "exp1", kept)
    at = arguments(found["jac"], 4)
    every, own = (evaluate(x["jac"], at) for x in (found, part))
    assert own == {name: values for name, values in every.items() if name.startswith(f"jac_{kept}_")}


# -- failures -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["exp1", "exp2"])
@pytest.mark.parametrize("name", ["geared", "driven"])
def test_pivots_of_derivatives_are_guarded_as_those_of_exp1_are(name: str, form: str) -> None:
    """Derivatives of both forms eliminate in M."""
    (tape, _), (_, found) = write_implicit(name, "exp1"), write_implicit(name, form)
    for derivative in found.values():
        assert [(g.joint, g.tolerance) for g in derivative.guards] == [(g.joint, g.tolerance) for g in tape.guards]


def test_a_lost_rank_is_the_status_of_the_loop() -> None:
    """With all bars in line, the loop's equations depend on each other: of three joints, loop 1 has the status 4."""
    tape, found = write_implicit("four_bar", "exp1")
    for function in (tape, *found.values()):
        for angle, expected in ((0.0, 4), (0.3, 0)):
            at = arguments(function, 1) | {"q": [0.0, angle, 0.0]}
            with np.errstate(all="ignore"):
                assert run(function, at, FLOATS, tested=True)[0] == expected


# -- Pinocchio --------------------------------------------------------------------------------------------------------


class ClosedPinocchio(Pinocchio):
    """The same tree in Pinocchio, with its balls as constraints of the relative acceleration of two points."""

    def __init__(self, tree: Tree) -> None:
        super().__init__(tree)
        pin = self._pin
        self._constraints, self._work = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for loop in tree.loops:
            ends = []
            for end in (loop.first, loop.second):
                number = self.order[end.body - 1] + 1 if end.body else 0
                ends += [number, pin.SE3(floats(tree, end.axes), floats(tree, end.position))]
            made = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, self.model, *ends, pin.ReferenceFrame.LOCAL)
            self._constraints.append(made)
            self._work.append(made.createData())
        pin.initConstraintDynamics(self.model, self.data, self._constraints, self._work)

    def accelerate(self, q: Array, qd: Array, forces: Array) -> Array:
        state = (self._theirs(x) for x in (q, qd, forces))
        found = self._pin.constraintDynamics(self.model, self.data, *state, self._constraints, self._work)
        return np.array(found)[self.order]


def test_derivatives_are_differences_of_pinocchios_accelerations() -> None:
    """Of lam^T qdd, first and second ones along a direction, by central differences with two steps (Richardson).

    Pinocchio's own derivatives of such loops (computeConstraintDynamicsDerivatives of 4.1) differ from its differences.
    """
    tree = tree_of("spatial")
    peer, (_, found) = ClosedPinocchio(tree), write_implicit("spatial", "exp1")
    at, way = arguments(found["adj1"], 5), arguments(found["adj1"], 6)
    at["adj_lam"] = [0.0] * 3
    driven = [k for k, body in enumerate(tree.bodies) if body.joint.actuated]

    def weigh(h: float) -> float:
        q, qd, u = (np.array(at[x]) + h * np.array(way[x]) for x in ("q", "qd", "u"))
        forces = np.zeros(len(tree.bodies))
        forces[driven] = u
        return float(np.array(at["adj_qdd"]) @ peer.accelerate(q, qd, forces))

    def refine(difference: Mapping[float, float]) -> float:
        (_, coarse), (_, fine) = sorted(difference.items(), reverse=True)
        return (4 * fine - coarse) / 3

    steps = (4e-3, 2e-3)
    first = refine({h: (weigh(h) - weigh(-h)) / (2 * h) for h in steps})
    second = refine({h: (weigh(h) - 2 * weigh(0.0) + weigh(-h)) / h**2 for h in steps})
    gradient, curved = (evaluate(found[x], at) for x in ("adj1", "jac_adj1"))
    own = sum(np.array(gradient[f"adj_{x}"]) @ way[x] for x in ("q", "qd", "u"))
    bend = sum(
        np.array(way[a]) @ matrix(found["jac_adj1"], f"jac_adj_{a}_{b}", curved) @ way[b]
        for a in ("q", "qd", "u")
        for b in ("q", "qd", "u")
    )
    assert own == pytest.approx(first, rel=1e-7)
    assert bend == pytest.approx(second, rel=1e-5)
