"""The functions that acados asks of a model, made of tapes: under its names, with its arguments.

    x = (q, qd), xdot = (qd, qdd), u = u, no z, t unused, p = run-time parameters, then differentiated ones, then w

    impl_dae_*      0 = f(x, xdot, u, p) = (xdot_q - qd, Phi(q, qd, xdot_qd, u, w))
    expl_*          xdot = f(x, u, p) = (qd, qdd(q, qd, u, w))

Names, arguments and results are those of acados' own generator (`casadi_function_generation.py`, 2025): with the prefix
of a model called `arm`, the C functions are arm_impl_dae_fun and so on. Their integers are ints, whatever `casadi_int`
is elsewhere. Matrices are dense. Each function computes run-time parameters anew, as acados may change them at every
stage.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice

from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.replay import replay, replay_guards
from mbsgen.tape.types import Sparsity, Tape
from mbsgen.targets.contract import Family

Block = dict[tuple[int, int], Scalar]  # by (row, column), from 0
Found = Mapping[str, Block]  # the results of a tape

RESIDUAL, EXPLICIT = "impl", ("exp1", "exp2")  # the kernels that the functions are made of
MEANINGS = {
    "x": "q, then qd",
    "xdot": "its rate",
    "t": "time: not used",
    "z": "algebraic variables: there are none",
    "p": "run-time parameters, then differentiated ones, then the external forces w",
    "multiplier": "weights of the residuals",
    "Sx": "sensitivity of x to the initial state",
    "Sp": "sensitivity of x to u",
    "lambdaX": "weights of the rates",
    "f_impl": "the residuals",
    "f_expl": "the rates",
    "vdeX": "the rate of Sx",
    "vdeP": "the rate of Sp",
    "adj": "gradient of the weighted rates by x, then u",
    "HESS": "second derivatives of the weighted residuals by x, xdot, z, u",
}
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


def write_acados(tapes: Mapping[str, Tape], explicit: str, *, timed: bool = True) -> tuple[Family, ...]:
    """Write what can be made of the kernels in `tapes`, by their names: `impl`, and `explicit`: "exp1" or "exp2".

    First derivatives are made of their `lin_` and `adj1_` kernels, second of `jac_adj1_impl`. Implicit functions have
    an argument t where they are `timed`, as acados asks for since its version 0.3.
    """
    return tuple(
        Family(tape, title=f"for acados: {_TITLES[tape.name]}", meanings=MEANINGS, integer="int")
        for tape in (*_write_implicit(tapes, timed=timed), *_write_explicit(tapes, explicit))
    )


def _write_implicit(tapes: Mapping[str, Tape], *, timed: bool) -> Iterator[Tape]:
    value, lin, second = (tapes.get(name) for name in (RESIDUAL, f"lin_{RESIDUAL}", f"jac_adj1_{RESIDUAL}"))
    if value:
        yield _Implicit(value, timed=timed).write("fun", ["fun"])
    if lin:
        yield _Implicit(lin, timed=timed).write("fun_jac_x_xdot_z", ["fun", "x", "xdot", "z"])
        yield _Implicit(lin, timed=timed).write("fun_jac_x_xdot_u_z", ["fun", "x", "xdot", "u", "z"])
        yield _Implicit(lin, timed=timed).write("fun_jac_x_xdot_u", ["fun", "x", "xdot", "u"])
        yield _Implicit(lin, timed=timed).write("jac_x_xdot_u_z", ["x", "xdot", "u", "z"])
    if second:
        yield _Implicit(second, timed=timed, weighted=True).write("hess", ["hess"])


def _write_explicit(tapes: Mapping[str, Tape], name: str) -> Iterator[Tape]:
    value, lin, adj1 = (tapes.get(kernel) for kernel in (name, f"lin_{name}", f"adj1_{name}"))
    if value:
        yield _write_rates(value)
    if lin:
        yield _write_sensitivities(lin)
    if adj1:
        yield _write_adjoint(adj1)


class _Implicit:
    """A function of x, xdot, u, z, t, p, without t unless it is timed, and with weights before t if it is weighted."""

    def __init__(self, tape: Tape, *, timed: bool, weighted: bool = False) -> None:
        self.builder = builder = Builder()
        n = self.n = tape.input("q").sparsity.rows
        x, self.xdot = builder.vector("x", 2 * n), builder.vector("xdot", 2 * n)
        self.u = builder.vector("u", _size(tape, "u"))
        builder.vector("z", 0)
        weights = builder.vector("multiplier", 2 * n) if weighted else []
        if timed:
            builder.vector("t", 1)
        self.qd = x[n:]
        given = {"q": x[:n], "qd": x[n:], "qdd": self.xdot[n:], "u": self.u, **_read_p(tape, builder)}
        self.found = _call(tape, builder, given | {"adj_Phi": weights[n:]})

    def write(self, name: str, results: Sequence[str]) -> Tape:
        """Write the function that gives the named results."""
        n, m, builder = self.n, len(self.u), self.builder
        one = builder.number(1.0)
        below = partial(_shift, row=n)  # Phi is the lower half of f
        for result in results:
            match result:
                case "fun":
                    Phi = self.found["Phi"]
                    rows = [self.xdot[i] - self.qd[i] for i in range(n)] + [Phi[i, 0] for i in range(n)]
                    builder.output_dense("f_impl", [[row] for row in rows])
                case "x":
                    slopes = {(i, n + i): -one for i in range(n)} | below(self.jac("q")) | below(self.jac("qd"), col=n)
                    _write_dense(builder, "jac_x", 2 * n, 2 * n, slopes)
                case "xdot":
                    slopes = {(i, i): one for i in range(n)} | below(self.jac("qdd"), col=n)
                    _write_dense(builder, "jac_xdot", 2 * n, 2 * n, slopes)
                case "u":
                    _write_dense(builder, "jac_u", 2 * n, m, below(self.jac("u")))
                case "z":
                    _write_dense(builder, "jac_z", 2 * n, 0, {})
                case "hess":
                    _write_dense(builder, "HESS", 4 * n + m, 4 * n + m, self.hessian())
        return builder.build(f"impl_dae_{name}")

    def jac(self, name: str) -> Block:
        """Give the Jacobian of Phi by an input."""
        return self.found.get(f"jac_Phi_{name}", {})

    def hessian(self) -> Block:
        """Put the blocks of second derivatives in the order x, xdot, z, u."""
        n = self.n
        places = {"q": 0, "qd": n, "qdd": 3 * n, "u": 4 * n}
        entries: Block = {}
        for a, row in places.items():
            for b, col in places.items():
                entries |= _shift(self.found.get(f"jac_adj_{a}_{b}", {}), row=row, col=col)
        return entries


def _write_rates(tape: Tape) -> Tape:
    builder = Builder()
    n = tape.input("q").sparsity.rows
    x, u = builder.vector("x", 2 * n), builder.vector("u", _size(tape, "u"))
    found = _call(tape, builder, {"q": x[:n], "qd": x[n:], "u": u, **_read_p(tape, builder)})
    builder.output_dense("f_expl", [[rate] for rate in _rates(found, x[n:])])
    return builder.build("expl_ode_fun")


def _write_sensitivities(tape: Tape) -> Tape:
    builder = Builder()
    n, m = tape.input("q").sparsity.rows, _size(tape, "u")
    x = builder.vector("x", 2 * n)
    Sx, Sp = (_read_matrix(builder, name, 2 * n, cols) for name, cols in (("Sx", 2 * n), ("Sp", m)))
    u = builder.vector("u", m)
    found = _call(tape, builder, {"q": x[:n], "qd": x[n:], "u": u, **_read_p(tape, builder)})
    slopes = found.get("jac_qdd_q", {}) | _shift(found.get("jac_qdd_qd", {}), col=n)
    by_u = found.get("jac_qdd_u", {})
    builder.output_dense("f_expl", [[rate] for rate in _rates(found, x[n:])])
    for name, S, cols, direct in (("vdeX", Sx, 2 * n, {}), ("vdeP", Sp, m, by_u)):
        rates = {(i, c): S[n + i, c] for i in range(n) for c in range(cols)}
        for c in range(cols):
            for i in range(n):
                terms = [slopes[i, k] * S[k, c] for k in range(2 * n) if (i, k) in slopes]
                rates[n + i, c] = _sum(builder, [*terms, *([direct[i, c]] if (i, c) in direct else [])])
        _write_dense(builder, name, 2 * n, cols, rates)
    return builder.build("expl_vde_forw")


def _write_adjoint(tape: Tape) -> Tape:
    builder = Builder()
    n, m = tape.input("q").sparsity.rows, _size(tape, "u")
    x, weights, u = (builder.vector(name, size) for name, size in (("x", 2 * n), ("lambdaX", 2 * n), ("u", m)))
    given = {"q": x[:n], "qd": x[n:], "u": u, **_read_p(tape, builder), "adj_qdd": weights[n:]}
    found = _call(tape, builder, given)

    def gradient(name: str, size: int) -> list[Scalar]:
        block = found.get(f"adj_{name}", {})
        return [block.get((i, 0), builder.zero) for i in range(size)]

    by_qd = [own + weight for own, weight in zip(gradient("qd", n), weights[:n], strict=True)]
    builder.output_dense("adj", [[entry] for entry in (*gradient("q", n), *by_qd, *gradient("u", m))])
    return builder.build("expl_vde_adj")


def _size(tape: Tape, name: str) -> int:
    return next((i.sparsity.rows for i in tape.inputs if i.name == name), 0)


def _read_p(tape: Tape, builder: Builder) -> dict[str, list[Scalar]]:
    """Declare acados' p, the last input, and part it."""
    sizes = {name: _size(tape, name) for name in ("p", "theta", "w")}
    p = iter(builder.vector("p", sum(sizes.values())))
    return {name: list(islice(p, size)) for name, size in sizes.items()}


def _read_matrix(builder: Builder, name: str, rows: int, cols: int) -> Block:
    places = [(r, c) for c in range(cols) for r in range(rows)]
    return dict(zip(places, builder.input(name, Sparsity.of(rows, cols, places)), strict=True))


def _call(tape: Tape, builder: Builder, given: Mapping[str, Sequence[Scalar]]) -> Found:
    """Compute a tape's results; its pivots stay guarded."""
    values = replay(tape, builder, given)
    replay_guards(tape, builder, values)
    return {
        o.name: {place: values[v] for place, v in zip(o.sparsity.entries, o.values, strict=True)} for o in tape.outputs
    }


def _rates(found: Found, qd: Sequence[Scalar]) -> list[Scalar]:
    return [*qd, *(found["qdd"][i, 0] for i in range(len(qd)))]


def _shift(block: Block, *, row: int = 0, col: int = 0) -> Block:
    return {(r + row, c + col): value for (r, c), value in block.items()}


def _sum(builder: Builder, terms: Iterable[Scalar]) -> Scalar:
    return sum(terms, start=builder.zero)


def _write_dense(builder: Builder, name: str, rows: int, cols: int, entries: Block) -> None:
    places = [(r, c) for c in range(cols) for r in range(rows)]
    builder.output(name, Sparsity.of(rows, cols, places), [entries.get(place, builder.zero) for place in places])
