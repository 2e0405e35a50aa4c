"""Derivatives, evaluated: dense matrices of results, differences in 50 digits, and comparisons of two tapes."""

from __future__ import annotations

import numpy as np

from mbsgen.derivatives.kernels import Derivatives
from mbsgen.model.tree import Tree
from mbsgen.procedure import procedure
from mbsgen.procedure.procedure import Computation
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape
from tests.random_trees import Pinocchio


def matrix(tape: Tape, name: str, values: dict[str, list]) -> np.ndarray:
    """Expand an output to a full matrix."""
    pattern = tape.output(name).sparsity
    full = np.zeros((pattern.rows, pattern.cols), dtype=object)
    for place, value in zip(pattern.entries, values[name], strict=True):
        full[place] = value
    return full.astype(float)


def arguments(tape: Tape, seed: int) -> dict[str, list[float]]:
    rng = np.random.default_rng(seed)
    return {i.name: list(rng.uniform(-1.5, 1.5, i.sparsity.nnz)) for i in tape.inputs}


def differences(tape: Tape, at: dict[str, list[float]], output: str, source: str) -> np.ndarray:
    """Differentiate in 50 digits by central differences of step 1e-15: exact to far below rounding."""
    pattern, given, columns = tape.output(output).sparsity, tape.input(source).sparsity, []
    for k in range(given.nnz):
        ends = []
        for sign in (1, -1):
            moved = {name: list(map(DIGITS.literal, v)) for name, v in at.items()}
            moved[source][k] += sign * DIGITS.literal(1e-15)
            ends.append(evaluate(tape, moved, DIGITS)[output])
        columns.append([(a - b) / DIGITS.literal(2e-15) for a, b in zip(*ends, strict=True)])
    full = np.zeros((pattern.rows * pattern.cols, given.rows * given.cols))
    for (i, j), column in zip(given.entries, columns, strict=True):
        for (r, c), value in zip(pattern.entries, column, strict=True):
            full[r + c * pattern.rows, i + j * given.rows] = float(value)
    return full


EXACTLY, TO_ROUNDING = 1e-38, 1e-13  # the latter where rotations are given as doubles, and not quite orthogonal


def all_of(found: Derivatives) -> tuple[Tape, ...]:
    return found.jac, found.lin, found.adj1, found.jac_adj1


def assert_same(found: Tape, expected: Tape, tolerance: float) -> None:
    """Demand the same results, of 50 digits; what only one of two patterns holds must vanish."""
    at = arguments(expected, 5)
    a, b = entries(found, at), entries(expected, at)
    size = max(map(abs, b.values()))
    assert all(abs(a.get(place, 0) - b.get(place, 0)) <= tolerance * size for place in a.keys() | b.keys())


def entries(tape: Tape, at: dict[str, list[float]]) -> dict[tuple[str, int, int], object]:
    """Evaluate every nonzero of a tape in 50 digits."""
    values = evaluate(tape, {i.name: [DIGITS.literal(x) for x in at[i.name]] for i in tape.inputs}, DIGITS)
    return {
        (o.name, *place): value
        for o in tape.outputs
        for place, value in zip(o.sparsity.entries, values[o.name], strict=True)
    }


def assert_pinocchios(tree: Tree, jac: Computation, seed: int) -> None:
    """Compare a Jacobian of accelerations with computeABADerivatives, scaled by the condition of M."""
    at = arguments(jac, seed)
    values = procedure.evaluate(jac, at)
    q, qd = np.array(at["q"]), np.array(at["qd"])
    actuated = [k for k, body in enumerate(tree.bodies) if body.joint.actuated]
    forces = np.zeros(len(tree.bodies))
    forces[actuated] = at["u"]
    peer = Pinocchio(tree)
    by_q, by_qd, by_force = peer.acceleration_derivatives(q, qd, forces)
    condition = np.linalg.cond(peer.mass_matrix(q))
    for source, expected in (("q", by_q), ("qd", by_qd), ("u", by_force[:, actuated])):
        error = np.abs(matrix(jac, f"jac_qdd_{source}", values) - expected).max()
        assert error <= 1e-14 * condition * np.abs(expected).max()
