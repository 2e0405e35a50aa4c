"""The functions of a model for acados, made from tapes: under its names, with its arguments.

    x = (q, qd), xdot = (qd, qdd), u = u, no z, t unused, p = run-time parameters, then differentiated ones, then w

    impl_dae_*      0 = f(x, xdot, u, p) = (xdot_q - qd, Phi(q, qd, xdot_qd, u, w))
    expl_*          xdot = f(x, u, p) = (qd, qdd(q, qd, u, w))

Names, arguments and results agree with acados' own generator (`casadi_function_generation.py`, 2025): for a model with
the prefix `arm`, the C functions are arm_impl_dae_fun and so on. Their integers are ints, whatever `casadi_int` is
elsewhere. Matrices are dense. Each function computes with run-time parameters anew, as acados may change them at every
stage.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice

from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS, REFERENCE
from mbsgen.request import OptionError
from mbsgen.roles import Order, Role
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count
from mbsgen.tape.ports import Function, Port, adjoint_port, derivative_port
from mbsgen.tape.replay import replay, replay_guards
from mbsgen.tape.types import Sparsity, Tape
from mbsgen.targets.contract import Family

Block = dict[tuple[int, int], Scalar]  # by (row, column), from 0
Found = Mapping[Port, Block]  # the results of a tape
Given = Mapping[Role, Sequence[Scalar]]  # the inputs of a tape

X = Port("x", Role.ARGUMENT, meaning="q, then qd")
XDOT = Port("xdot", Role.ARGUMENT, meaning="its rate")
T = Port("t", Role.ARGUMENT, meaning="time: not used")
Z = Port("z", Role.ARGUMENT, meaning="algebraic variables: there are none")
P = Port("p", Role.ARGUMENT, meaning="run-time parameters, then differentiated ones, then the external forces w")
U = Port("u", Role.FORCE)
MULTIPLIER = Port("multiplier", Role.ARGUMENT, meaning="weights of the residuals")
SX = Port("Sx", Role.ARGUMENT, meaning="sensitivity of x to the initial state")
SP = Port("Sp", Role.ARGUMENT, meaning="sensitivity of x to u")
LAMBDA_X = Port("lambdaX", Role.ARGUMENT, meaning="weights of the rates")
F_IMPL = Port("f_impl", Role.RESULT, meaning="the residuals")
F_EXPL = Port("f_expl", Role.RESULT, meaning="the rates")
VDE_X = Port("vdeX", Role.RESULT, meaning="the rate of Sx")
VDE_P = Port("vdeP", Role.RESULT, meaning="the rate of Sp")
ADJ = Port("adj", Role.RESULT, meaning="gradient of the weighted rates by x, then u")
HESS = Port("HESS", Role.RESULT, meaning="second derivatives of the weighted residuals by x, xdot, z, u")
_LOOPS = (Role.MULTIPLIER, Role.DRIVING_FORCE, Role.CLOSURE)  # arguments of mechanisms with loops
_TITLES = {
    "impl_dae_fun": "residuals",
    "impl_dae_fun_jac_x_xdot_z": "residuals and Jacobians",
    "impl_dae_fun_jac_x_xdot_u_z": "residuals and Jacobians",
    "impl_dae_fun_jac_x_xdot_u": "residuals and Jacobians",
    "impl_dae_jac_x_xdot_u_z": "Jacobians of the residuals",
    "impl_dae_hess": "second derivatives of the residuals",
    "expl_ode_fun": "rates",
    "expl_vde_forw": "rates with forward sensitivities",
    "expl_vde_adj": "adjoint sensitivities of the rates",
}


def add_acados(families: Sequence[Family], *, timed: bool = True) -> tuple[Family, ...]:
    """Write the functions that can be made from the residual and the cheapest function that computes accelerations.

    Raises OptionError where there is neither, where a joint has a quaternion, or where loops are closed.
    """
    tapes = {tape.function: tape for family in families for tape in family.tapes}
    known = [Function(name) for name, entry in FUNCTIONS.items() if ports.ACCELERATIONS in entry.results]
    explicit = [function for function in known if function in tapes]
    residual = Function(REFERENCE)
    if residual not in tapes and not explicit:
        forms = " or ".join(function.name for function in known)
        raise OptionError(f"acados: its functions are made of {residual.name}, {forms}; name one")
    taken = [i.port.role for tape in tapes.values() for i in tape.inputs]
    given = [o.port.role for tape in tapes.values() for o in tape.outputs]
    if not {*taken, *given}.isdisjoint(_LOOPS):
        raise OptionError(
            "acados: its integrators would let closed loops drift apart, and move no driven joints; leave acados out"
        )
    dynamics = [tape for tape in tapes.values() if tape.function in (residual, *explicit)]
    if any(_size(tape, Role.COORDINATE) != tape.outputs[0].sparsity.rows for tape in dynamics):
        raise OptionError(
            "acados: q and qd must have the same size, but a joint with a quaternion has more coordinates than "
            "velocities; give the joint turns in a row, or leave acados out"
        )

    def measure(function: Function) -> int:
        return count(tapes.get(function.to(Order.LINEARISATION), tapes[function])).paper

    return write_acados(tapes, residual, min(explicit, key=measure, default=None), timed=timed)


def write_acados(
    tapes: Mapping[Function, Tape], residual: Function, explicit: Function | None, *, timed: bool = True
) -> tuple[Family, ...]:
    """Write the functions that can be made from a residual and from a function that computes accelerations.

    First derivatives use their linearisations and the adjoint, second derivatives the adjoint's Jacobian. Implicit
    functions have an argument t where they are `timed`, as acados requires since its version 0.3.
    """
    return tuple(
        Family(tape, title=f"for acados: {_TITLES[tape.name]}", integer="int")
        for tape in (
            *_write_implicit(tapes, residual, timed=timed),
            *(_write_explicit(tapes, explicit) if explicit else ()),
        )
    )


def _write_implicit(tapes: Mapping[Function, Tape], residual: Function, *, timed: bool) -> Iterator[Tape]:
    value, lin, second = (
        tapes.get(residual.to(order)) for order in (Order.VALUE, Order.LINEARISATION, Order.ADJOINT_JACOBIAN)
    )
    if value:
        yield _Implicit(value, timed=timed).write("fun", ["fun"])
    if lin:
        yield _Implicit(lin, timed=timed).write("fun_jac_x_xdot_z", ["fun", "x", "xdot", "z"])
        yield _Implicit(lin, timed=timed).write("fun_jac_x_xdot_u_z", ["fun", "x", "xdot", "u", "z"])
        yield _Implicit(lin, timed=timed).write("fun_jac_x_xdot_u", ["fun", "x", "xdot", "u"])
        yield _Implicit(lin, timed=timed).write("jac_x_xdot_u_z", ["x", "xdot", "u", "z"])
    if second:
        yield _Implicit(second, timed=timed, weighted=True).write("hess", ["hess"])


def _write_explicit(tapes: Mapping[Function, Tape], explicit: Function) -> Iterator[Tape]:
    value, lin, adj1 = (tapes.get(explicit.to(order)) for order in (Order.VALUE, Order.LINEARISATION, Order.ADJOINT))
    if value:
        yield _write_rates(value)
    if lin:
        yield _write_sensitivities(lin)
    if adj1:
        yield _write_adjoint(adj1)


class _Implicit:
    """A function of x, xdot, u, z, t, p: t only if timed, weights before t if weighted."""

    def __init__(self, tape: Tape, *, timed: bool, weighted: bool = False) -> None:
        self.builder = builder = Builder()
        n = self.n = _size(tape, Role.COORDINATE)
        x, self.xdot = builder.vector(X, 2 * n), builder.vector(XDOT, 2 * n)
        self.u = builder.vector(U, _size(tape, Role.FORCE))
        builder.vector(Z, 0)
        weights = builder.vector(MULTIPLIER, 2 * n) if weighted else []
        if timed:
            builder.vector(T, 1)
        self.qd = x[n:]
        given = {Role.ACCELERATION: self.xdot[n:], Role.SEED: weights[n:]}
        self.found = _call(tape, builder, _split_state(x, n) | given | {Role.FORCE: self.u} | _read_p(tape, builder))

    def write(self, name: str, results: Sequence[str]) -> Tape:
        """Write the function with the named results."""
        n, m, builder = self.n, len(self.u), self.builder
        one = builder.number(1.0)
        below = partial(_shift, row=n)  # Phi is the lower half of f
        for result in results:
            match result:
                case "fun":
                    Phi = self.found[ports.RESIDUAL]
                    rows = [self.xdot[i] - self.qd[i] for i in range(n)] + [Phi[i, 0] for i in range(n)]
                    builder.output_dense(F_IMPL, [[row] for row in rows])
                case "x":
                    slopes = {(i, n + i): -one for i in range(n)} | below(self.jac(ports.COORDINATES))
                    slopes |= below(self.jac(ports.VELOCITIES), col=n)
                    _write_dense(builder, "jac_x", 2 * n, 2 * n, slopes)
                case "xdot":
                    slopes = {(i, i): one for i in range(n)} | below(self.jac(ports.ACCELERATIONS), col=n)
                    _write_dense(builder, "jac_xdot", 2 * n, 2 * n, slopes)
                case "u":
                    _write_dense(builder, "jac_u", 2 * n, m, below(self.jac(ports.FORCES)))
                case "z":
                    _write_dense(builder, "jac_z", 2 * n, 0, {})
                case "hess":
                    _write_dense(builder, HESS, 4 * n + m, 4 * n + m, self.hessian())
        return builder.build(f"impl_dae_{name}")

    def jac(self, by: Port) -> Block:
        """Return the Jacobian of Phi by an input."""
        return self.found.get(derivative_port(ports.RESIDUAL, by), {})

    def hessian(self) -> Block:
        """Arrange the blocks of second derivatives in the order x, xdot, z, u."""
        n = self.n
        places = {ports.COORDINATES: 0, ports.VELOCITIES: n, ports.ACCELERATIONS: 3 * n, ports.FORCES: 4 * n}
        entries: Block = {}
        for a, row in places.items():
            for b, col in places.items():
                entries |= _shift(self.found.get(derivative_port(adjoint_port(a), b), {}), row=row, col=col)
        return entries


def _write_rates(tape: Tape) -> Tape:
    builder = Builder()
    n = _size(tape, Role.COORDINATE)
    x, u = builder.vector(X, 2 * n), builder.vector(U, _size(tape, Role.FORCE))
    found = _call(tape, builder, _split_state(x, n) | {Role.FORCE: u} | _read_p(tape, builder))
    builder.output_dense(F_EXPL, [[rate] for rate in _rates(found, x[n:])])
    return builder.build("expl_ode_fun")


def _write_sensitivities(tape: Tape) -> Tape:
    builder = Builder()
    n, m = _size(tape, Role.COORDINATE), _size(tape, Role.FORCE)
    x = builder.vector(X, 2 * n)
    Sx, Sp = (_read_matrix(builder, port, 2 * n, cols) for port, cols in ((SX, 2 * n), (SP, m)))
    u = builder.vector(U, m)
    found = _call(tape, builder, _split_state(x, n) | {Role.FORCE: u} | _read_p(tape, builder))
    by_q, by_qd, by_u = (
        found.get(derivative_port(ports.ACCELERATIONS, by), {})
        for by in (ports.COORDINATES, ports.VELOCITIES, ports.FORCES)
    )
    slopes = by_q | _shift(by_qd, col=n)
    builder.output_dense(F_EXPL, [[rate] for rate in _rates(found, x[n:])])
    for port, S, cols, direct in ((VDE_X, Sx, 2 * n, {}), (VDE_P, Sp, m, by_u)):
        rates = {(i, c): S[n + i, c] for i in range(n) for c in range(cols)}
        for c in range(cols):
            for i in range(n):
                terms = [slopes[i, k] * S[k, c] for k in range(2 * n) if (i, k) in slopes]
                rates[n + i, c] = _sum(builder, [*terms, *([direct[i, c]] if (i, c) in direct else [])])
        _write_dense(builder, port, 2 * n, cols, rates)
    return builder.build("expl_vde_forw")


def _write_adjoint(tape: Tape) -> Tape:
    builder = Builder()
    n, m = _size(tape, Role.COORDINATE), _size(tape, Role.FORCE)
    x, weights, u = (builder.vector(port, size) for port, size in ((X, 2 * n), (LAMBDA_X, 2 * n), (U, m)))
    given = {Role.FORCE: u, Role.SEED: weights[n:]}
    found = _call(tape, builder, _split_state(x, n) | given | _read_p(tape, builder))

    def gradient(by: Port, size: int) -> list[Scalar]:
        block = found.get(adjoint_port(by), {})
        return [block.get((i, 0), builder.zero) for i in range(size)]

    by_qd = [own + weight for own, weight in zip(gradient(ports.VELOCITIES, n), weights[:n], strict=True)]
    builder.output_dense(
        ADJ, [[entry] for entry in (*gradient(ports.COORDINATES, n), *by_qd, *gradient(ports.FORCES, m))]
    )
    return builder.build("expl_vde_adj")


def _size(tape: Tape, role: Role) -> int:
    given = tape.holding(role)
    return given.sparsity.rows if given else 0


def _split_state(x: Sequence[Scalar], n: int) -> dict[Role, Sequence[Scalar]]:
    return {Role.COORDINATE: x[:n], Role.VELOCITY: x[n:]}


def _read_p(tape: Tape, builder: Builder) -> dict[Role, Sequence[Scalar]]:
    """Declare acados' p, the last input, and split it."""
    sizes = {role: _size(tape, role) for role in (Role.PARAMETER, Role.DESIGN, Role.WRENCH)}
    p = iter(builder.vector(P, sum(sizes.values())))
    return {role: list(islice(p, size)) for role, size in sizes.items()}


def _read_matrix(builder: Builder, port: Port, rows: int, cols: int) -> Block:
    places = [(r, c) for c in range(cols) for r in range(rows)]
    return dict(zip(places, builder.input(port, Sparsity.of(rows, cols, places)), strict=True))


def _call(tape: Tape, builder: Builder, given: Given) -> Found:
    """Compute a tape's results; its pivots stay guarded."""
    values = replay(tape, builder, {i.name: given[i.port.role] for i in tape.inputs})
    replay_guards(tape, builder, values)
    return {
        o.port: {place: values[v] for place, v in zip(o.sparsity.entries, o.values, strict=True)} for o in tape.outputs
    }


def _rates(found: Found, qd: Sequence[Scalar]) -> list[Scalar]:
    return [*qd, *(found[ports.ACCELERATIONS][i, 0] for i in range(len(qd)))]


def _shift(block: Block, *, row: int = 0, col: int = 0) -> Block:
    return {(r + row, c + col): value for (r, c), value in block.items()}


def _sum(builder: Builder, terms: Iterable[Scalar]) -> Scalar:
    return sum(terms, start=builder.zero)


def _write_dense(builder: Builder, port: Port | str, rows: int, cols: int, entries: Block) -> None:
    places = [(r, c) for c in range(cols) for r in range(rows)]
    builder.output(port, Sparsity.of(rows, cols, places), [entries.get(place, builder.zero) for place in places])
