"""Small procedures, one for each kind of stage, and the closed forms that they are held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mbsgen.procedure.differentiation import adjoint, jacobian
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.patterns import General, Pattern, Symmetric, Tree
from mbsgen.procedure.procedure import Computation, Procedure
from mbsgen.procedure.repeat import Gather, Repeat
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.solve import Block, Factor, Solve
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.interpreter import Numbers
from mbsgen.tape.ports import Function
from mbsgen.tape.types import LITERALS, Sparsity, Tape
from mbsgen.targets.contract import Family

TREE = Tree(((), (0,), (0,), (0, 2)))
PATTERNS: dict[str, Pattern] = {"tree": TREE, "symmetric": Symmetric(4), "general": General(4)}
SINGULAR = 7  # the status of factors that fail
X = Wire("x", Sparsity.dense(3))


def straight() -> Procedure:
    """Return y = (x0 sin(x1) + x2, 1/x2)."""
    builder = Builder()
    x = builder.vector("x", 3)
    builder.output_dense("y", [[x[0] * builder.sin(x[1]) + x[2]], [builder.number(1.0) / x[2]]])
    return Procedure(Function("straight"), (X,), (Straight(builder.build("all")),), (Wire("y", Sparsity.dense(2)),))


def entries_of(pattern: Pattern, x: Sequence[Scalar], builder: Builder) -> dict[tuple[int, int], Scalar]:
    """Write a matrix that depends on x: definite for a tree, of diagonal entries that vanish for a symmetric one."""
    if isinstance(pattern, Tree):
        pairs = [(k, i) for k, row in enumerate(pattern.ancestors) for i in row]
        diagonal = {(k, k): builder.number(4.0 + k) + x[k % 3] for k in range(4)}
        return diagonal | {(k, i): builder.sin(x[(k + i) % 3]) for k, i in pairs}
    places = [(i, j) for i in range(4) for j in range(4) if i != j]
    entries = {(i, j): x[(i + 2 * j) % 3] * builder.number(1.0 + i + j * j) for i, j in places}
    if isinstance(pattern, Symmetric):
        return {(i, j): value for (i, j), value in entries.items() if i > j} | {(0, 0): builder.cos(x[1])}
    return entries | {(2, 2): builder.cos(x[1])}


def solve(pattern: Pattern) -> Procedure:
    """Return y = (X00 X10, X31) of A(x) X = -B(x), B of two columns."""
    sheet = Sheet()
    x = sheet.take(X)
    entries = entries_of(pattern, x, sheet.builder)
    matrix = Wire("A", Sparsity.of(4, 4, entries))
    sheet.give(matrix, [entries[place] for place in matrix.sparsity.entries])
    right = {(0, 0): x[0], (0, 2): x[1] * x[2], (1, 1): x[2], (1, 3): x[0] * x[0]}
    B = Wire("B", Sparsity.of(2, 4, right))
    sheet.give(B, [right[place] for place in B.sparsity.entries])
    factor = Factor("A", matrix, pattern, SINGULAR)
    first, second = Wire("X0", Sparsity.dense(4)), Wire("X1", Sparsity.of(4, 1, [(3, 0)]))
    solved = Solve("solved", pattern, factor.gives, B, (Block(first, 0), Block(second, 1)), negated=True)
    last = Sheet()
    X0, X1 = last.take(first), last.take(second)
    y = Wire("y", Sparsity.dense(2))
    last.give(y, [X0[0] * X0[1], X1[0]])
    stages = (Straight(sheet.finish("before")), factor, solved, Straight(last.finish("after")))
    return Procedure(Function(f"solve_{type(pattern).__name__.lower()}"), (X,), stages, (y, first))


def repeat() -> Procedure:
    """Return z[i] = sin(a[i]) x2, w[i] = a[i]^2 / x2 with a = (x0, x1, x0): a map that fails with 5 for small x2."""
    builder = Builder()
    (a,) = builder.vector("a", 1)
    x = builder.vector("x", 3)
    builder.guard(x[2], builder.number(1.0), 16.0, 5)
    builder.output_dense("z", [[builder.sin(a) * x[2]], [a * a / x[2]]])
    stage = Repeat(builder.build("each"), "each", 3, (Gather("a", X, ((0,), (1,), (0,))),))
    return Procedure(Function("repeat"), (X,), (stage,), stage.gives)


LENGTHS = (1.0, 4.0, 2.5, 3.0)  # of crank, coupler, rocker and base: Grashof's condition holds


def four_bar_residual() -> Tape:
    """Write the closure of a four-bar, and its Jacobian by the angles of coupler and rocker.

    a cos q + b cos y0 - c cos y1 - d = 0, and the same with sines without d.
    """
    builder = Builder()
    (q,), y, lengths = builder.vector("q", 1), builder.vector("y", 2), builder.vector("lengths", 4)
    a, b, c, d = lengths
    sines = [builder.sin(angle) for angle in (q, *y)]
    cosines = [builder.cos(angle) for angle in (q, *y)]
    along = a * cosines[0] + b * cosines[1] - c * cosines[2] - d
    builder.output_dense("g", [[along], [a * sines[0] + b * sines[1] - c * sines[2]]])
    builder.output_dense("J", [[-(b * sines[1]), c * sines[2]], [b * cosines[1], -(c * cosines[2])]])
    return builder.build("closure")


Q, LINKS, START = Wire("q", Sparsity.dense(1)), Wire("lengths", Sparsity.dense(4)), Wire("start", Sparsity.dense(2))
OPEN = 3  # the status of a loop that cannot be closed


def four_bar() -> Procedure:
    """Solve a four-bar for the angles of coupler and rocker, by Newton's method."""
    y = Wire("angles", Sparsity.dense(2))
    stage = Newton("closure", four_bar_residual(), "y", START, y, General(2), OPEN)
    return Procedure(Function("four_bar"), (Q, LINKS, START), (stage,), (y,))


def saddle_point() -> Procedure:
    """Solve [[M, J^T], [J, 0]] (qdd, -lambda) = (f, g): M definite of 3 rows, J of 2."""
    triangle = Sparsity.of(3, 3, [(i, j) for i in range(3) for j in range(i + 1)])
    M, J = Wire("M", triangle), Wire("J", Sparsity.dense(2, 3))
    f, g = Wire("f", Sparsity.dense(3)), Wire("g", Sparsity.dense(2))
    sheet = Sheet()
    entries = sheet.place(M) | {(3 + r, c): value for (r, c), value in sheet.place(J).items()}
    matrix = Wire("K", Sparsity.of(5, 5, entries))
    sheet.give(matrix, [entries[place] for place in matrix.sparsity.entries])
    right = Wire("right", Sparsity.dense(1, 5))
    sheet.give(right, [*sheet.take(f), *sheet.take(g)])
    factor = Factor("K", matrix, Symmetric(5), SINGULAR)
    solution = Wire("solution", Sparsity.dense(5))
    solved = Solve("solved", Symmetric(5), factor.gives, right, (Block(solution, 0),))
    last = Sheet()
    values = last.take(solution)
    qdd, multipliers = Wire("qdd", Sparsity.dense(3)), Wire("multipliers", Sparsity.dense(2))
    last.give(qdd, values[:3])
    last.give(multipliers, [-value for value in values[3:]])
    stages = (Straight(sheet.finish("before")), factor, solved, Straight(last.finish("after")))
    return Procedure(Function("saddle_point"), (M, J, f, g), stages, (qdd, multipliers))


@dataclass(frozen=True)
class Example:
    """A procedure, a point at which it has results, and the inputs that it is differentiated by."""

    procedure: Procedure
    point: dict[str, list[float]]
    wrt: tuple[str, ...]


POINT = {"x": [0.7, 1.1, 1.4]}
CLOSED = {"q": [0.8], "lengths": [*LENGTHS], "start": [0.5, 1.5]}
SADDLE = {
    "M": [4.0, 0.3, 0.2, 5.0, 0.1, 3.0],
    "J": [1.0, 0.4, -0.3, 0.8, 0.2, -1.1],
    "f": [1.0, -2.0, 0.5],
    "g": [0.3, 0.6],
}
EXAMPLES = {
    "straight": Example(straight(), POINT, ("x",)),
    **{f"solve {name}": Example(solve(pattern), POINT, ("x",)) for name, pattern in PATTERNS.items()},
    "repeat": Example(repeat(), POINT, ("x",)),
    "newton": Example(four_bar(), CLOSED, ("q", "lengths")),
    "saddle point": Example(saddle_point(), SADDLE, ("M", "J", "f", "g")),
}


def convert(point: dict[str, list[float]], numbers: Numbers) -> dict[str, list[Any]]:
    """Take a point to another number type."""
    return {name: [numbers.literal(LITERALS.mpf(x)) for x in values] for name, values in point.items()}


def system(pattern: Pattern, width: int, *, transposed: bool = False, negated: bool = False) -> Procedure:
    """Return X of A X = B, of inputs A and B^T."""
    n = pattern.size
    entries = [(i, j) for i in range(n) for j in range(n) if not pattern.is_symmetric or i >= j]
    if isinstance(pattern, Tree):
        entries = [(k, i) for k, row in enumerate(pattern.ancestors) for i in (*row, k)]
    A, right = Wire("A", Sparsity.of(n, n, entries)), Wire("right", Sparsity.dense(width, n))
    factor, X = Factor("F", A, pattern, SINGULAR), Wire("X", Sparsity.dense(n, width))
    solve = Solve("S", pattern, factor.gives, right, (Block(X, 0),), negated=negated, transposed=transposed)
    return Procedure(Function("system"), (A, right), (factor, solve), (X,))


def derive(name: str) -> Family:
    """Write an example with its derivatives."""
    procedure, wrt = EXAMPLES[name].procedure, EXAMPLES[name].wrt
    back = adjoint(procedure, wrt)
    seeds = [wire.name for wire in back.inputs[len(procedure.inputs) :]]
    return Family(procedure, jacobian(procedure, wrt), back, jacobian(back, [*wrt, *seeds]))


FAMILIES = {name: derive(name) for name in EXAMPLES}


def complete(function: Computation, name: str) -> dict[str, list[float]]:
    """Return the point of an example, with weights of its results."""
    seeds = {i.name: [0.3 + 0.4 * k for k in range(i.sparsity.nnz)] for i in function.inputs}
    return {**seeds, **EXAMPLES[name].point}
