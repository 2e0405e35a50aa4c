"""Model -> Tree: bodies in order, and every joint about or along a positive coordinate axis of its body.

A body whose joint has another axis gets a frame of its own: the author's, turned by a constant rotation C with
a = C e_k. Its centre of mass, inertia, sensors and the joints it carries are written anew in that frame; sensors keep
the pose that their author gave them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sympy import Expr, Integer, Symbol

from mbsgen.expressions import Algebra, Expression, evaluate
from mbsgen.model import model, tree
from mbsgen.model.model import BASE, Model
from mbsgen.model.symbols import round_number, symbolic, to_double, total
from mbsgen.model.topology import sort_bodies
from mbsgen.model.tree import Kind, Matrix, Parameter, Tree, Vector

ZERO, ONE = Integer(0), Integer(1)
IDENTITY: Matrix = ((ONE, ZERO, ZERO), (ZERO, ONE, ZERO), (ZERO, ZERO, ONE))


def build_tree(description: Model) -> Tree:
    """Make the Tree of a checked model."""
    parameters, reader = _read_parameters(description)
    turned = {BASE: IDENTITY}  # C of each body: its axes in the Tree, in the author's frame
    numbers = {BASE: 0}
    bodies = []
    for number, i in enumerate(sort_bodies(description), 1):
        body = description.bodies[i]
        axis, own = align(reader.direction(body.joint.axis))
        bodies.append(_make_body(body, axis, own, turned[body.parent], numbers[body.parent], reader))
        turned[body.name], numbers[body.name] = own, number
    sensors = [
        tree.Sensor(
            name=frame.name,
            body=numbers[frame.body],
            position=_express(reader.vector(frame.placement.position), turned[frame.body]),
            orientation=_product(_transpose(turned[frame.body]), reader.rotation(frame.placement)),
        )
        for frame in description.frames
    ]
    gravity = reader.vector(description.gravity)
    return Tree(description.name, gravity, parameters, tuple(bodies), tuple(sensors))


def with_runtime_numbers(original: Tree) -> Tree:
    """Make every number of gravity and bodies a parameter at run time, and every parameter one.

    Zeros and orientations stay. An expression over parameters stays that expression; any other number becomes a
    parameter of its own, named after its place, such as `hand.mass` or `hand.inertia.xy`. Tensors stay symmetric.
    """
    parameters = {p.name: replace(p, kind=Kind.RUNTIME) for p in original.parameters}

    def release(name: str, number: Expr) -> Expr:
        if number.free_symbols or number.is_zero:
            return number
        parameters[name] = Parameter(name, Symbol(name), to_double(number), Kind.RUNTIME)
        return parameters[name].symbol

    def release_vector(name: str, vector: Vector) -> Vector:
        x, y, z = (release(f"{name}.{axis}", number) for axis, number in zip("xyz", vector, strict=True))
        return x, y, z

    def release_tensor(name: str, tensor: Matrix) -> Matrix:
        upper = {(i, j): release(f"{name}.{'xyz'[i]}{'xyz'[j]}", tensor[i][j]) for i in range(3) for j in range(i, 3)}
        return _symmetric(upper)

    gravity = release_vector("gravity", original.gravity)
    bodies = tuple(
        replace(
            body,
            position=release_vector(f"{body.name}.position", body.position),
            mass=release(f"{body.name}.mass", body.mass),
            com=release_vector(f"{body.name}.com", body.com),
            inertia=release_tensor(f"{body.name}.inertia", body.inertia),
        )
        for body in original.bodies
    )
    return replace(original, gravity=gravity, parameters=tuple(parameters.values()), bodies=bodies)


def align(direction: Vector) -> tuple[int, Matrix]:
    """Find the coordinate axis k nearest to a direction of numbers, and a rotation C with C e_k along it.

    C is the identity for +x, +y, +z and a half turn for -x, -y, -z; else the smallest turn from there (Rodrigues).
    """
    size = max(abs(component) for component in direction)
    k = next(i for i in range(3) if abs(direction[i]) == size)
    near = IDENTITY if direction[k] > 0 else _HALF_TURNS[k]
    scaled = [component / size for component in direction]
    length = _NUMBERS.functions["sqrt"](total(component * component for component in scaled))
    u = [component / length for component in scaled]
    i, j = (k + 1) % 3, (k + 2) % 3
    if u[i] == u[j] == 0:
        return k, near
    sign = near[k][k]  # the turn is from e = sign e_k to u, about v = e x u, by the angle of cosine c
    v = {i: -sign * u[j], j: sign * u[i], k: ZERO}
    c = sign * u[k]
    cross = {(i, j): ZERO, (j, k): -v[i], (k, i): -v[j], (j, i): ZERO, (k, j): v[i], (i, k): v[j]}
    squared = total(x * x for x in v.values())
    turn = [
        [
            total((cross[r, s], v[r] * v[s] / (1 + c))) if r != s else total((ONE, (v[r] * v[r] - squared) / (1 + c)))
            for s in range(3)
        ]
        for r in range(3)
    ]
    return k, _product(_matrix(turn), near)


_NUMBERS = symbolic({})
_HALF_TURNS: tuple[Matrix, ...] = tuple(  # about z, x, x: they turn x, y, z round
    ((Integer(x), ZERO, ZERO), (ZERO, Integer(y), ZERO), (ZERO, ZERO, Integer(z)))
    for x, y, z in ((-1, -1, 1), (1, -1, -1), (1, -1, -1))
)


@dataclass(frozen=True)
class _Reader:
    """Reads expressions of a model as SymPy expressions."""

    algebra: Algebra[Expr]
    symbols: Mapping[str, Expr]  # parameters; a constant 0 is structural
    values: Mapping[str, Expr]  # where a number is wanted: constants by their values

    def number(self, expression: Expression) -> Expr:
        """Read a length, mass or inertia over symbols."""
        return evaluate(expression, self.symbols, self.algebra)

    def vector(self, triple: model.Triple) -> Vector:
        """Read three numbers."""
        x, y, z = map(self.number, triple)
        return x, y, z

    def matrix(self, rows: tuple[model.Triple, ...]) -> Matrix:
        """Read nine numbers."""
        return _matrix([self.vector(row) for row in rows])

    def direction(self, triple: model.Triple) -> Vector:
        """Read the components of an axis, which are constant."""
        x, y, z = (evaluate(component, self.values, self.algebra) for component in triple)
        return x, y, z

    def limit(self, expression: Expression | None) -> float | None:
        """Read a limit of a joint, which is constant."""
        return None if expression is None else to_double(evaluate(expression, self.values, self.algebra))

    def rotation(self, placement: model.Placement) -> Matrix:
        """Read an orientation; constants enter by value, so that a quarter turn has its zeros."""
        product = IDENTITY
        for step in placement.orientation:
            angle = evaluate(step.angle, self.values, self.algebra)
            sine, cosine = (self.algebra.functions[name](angle) for name in ("sin", "cos"))
            rows = [[ONE if r == s == step.axis else ZERO for s in range(3)] for r in range(3)]
            j, k = (step.axis + 1) % 3, (step.axis + 2) % 3
            rows[j][j] = rows[k][k] = cosine
            rows[j][k], rows[k][j] = -sine, sine
            product = _product(product, _matrix(rows))
        return product


def _read_parameters(description: Model) -> tuple[tuple[Parameter, ...], _Reader]:
    symbols: dict[str, Expr] = {}
    values: dict[str, Expr] = {}
    known: dict[str, Expr] = {}
    parameters = []
    for parameter in description.parameters:
        value = round_number(evaluate(parameter.value, known, _NUMBERS))
        symbol = Symbol(parameter.name)
        parameters.append(Parameter(parameter.name, symbol, to_double(value), parameter.kind))
        is_constant = parameter.kind is Kind.CONSTANT
        known[parameter.name] = value
        symbols[parameter.name] = ZERO if is_constant and value == 0 else symbol
        values[parameter.name] = value if is_constant else symbol
    constants = {Symbol(p.name): known[p.name] for p in parameters if p.kind is Kind.CONSTANT}
    return tuple(parameters), _Reader(symbolic(constants), symbols, values)


def _make_body(body: model.Body, axis: int, own: Matrix, carrier: Matrix, parent: int, reader: _Reader) -> tree.Body:
    placement = body.joint.placement
    return tree.Body(
        name=body.name,
        parent=parent,
        joint=tree.Joint(
            name=body.joint.name,
            motion=body.joint.motion,
            axis=axis,
            actuated=body.joint.actuated,
            lower=reader.limit(body.joint.lower),
            upper=reader.limit(body.joint.upper),
        ),
        position=_express(reader.vector(placement.position), carrier),
        orientation=_product(_product(_transpose(carrier), reader.rotation(placement)), own),
        mass=reader.number(body.mass),
        com=_express(reader.vector(body.com), own),
        inertia=_express_tensor(reader.matrix(body.inertia.rows), own),
    )


def _express(v: Vector, C: Matrix) -> Vector:
    """Write a vector in the axes that are the columns of C: C^T v."""
    x, y, z = (total(C[k][i] * v[k] for k in range(3)) for i in range(3))
    return x, y, z


def _express_tensor(tensor: Matrix, C: Matrix) -> Matrix:
    """Write a symmetric tensor in the axes that are the columns of C: C^T T C."""
    pairs = [(k, l) for k in range(3) for l in range(3)]
    entries = {(i, j): total(C[k][i] * C[l][j] * tensor[k][l] for k, l in pairs) for i in range(3) for j in range(i, 3)}
    return _symmetric(entries)


def _symmetric(upper: Mapping[tuple[int, int], Expr]) -> Matrix:
    return _matrix([[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])


def _product(A: Matrix, B: Matrix) -> Matrix:
    return _matrix([[total(A[i][k] * B[k][j] for k in range(3)) for j in range(3)] for i in range(3)])


def _transpose(A: Matrix) -> Matrix:
    return _matrix([[A[k][i] for k in range(3)] for i in range(3)])


def _matrix(rows: Sequence[Sequence[Expr]]) -> Matrix:
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (a, b, c), (d, e, f), (g, h, i)
