"""Expressions of a motion: what they may speak of, and how they become functions that a program applies.

    t, T                                          time, horizon
    q_NAME, qd_NAME, qdd_NAME                     of a coordinate: value, velocity, acceleration
    u_NAME                                        of an actuated coordinate: input
    x_NAME, y_NAME, z_NAME, vx_NAME, ...          of a sensor: position and velocity in the base frame

where dots and spaces of a name are written _, and q has names of its own where there are quaternions (q_trunk_qx); and
the constants of the problem, which are parameters of the program. Units are SI. An expression is read by the white list
of `mbsgen.expressions`; its derivatives are CasADi's, through the kernels that sensors and accelerations take.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from mbsgen.expressions import FUNCTIONS, Algebra, evaluate, names, parse
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Representation
from mbsrun.quantities import Quantity, list_quantities

_SYMBOLS: Algebra[ca.SX] = Algebra(
    number=ca.SX,
    constants={"pi": ca.SX(ca.pi)},
    negate=operator.neg,
    operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
    power=operator.pow,
    functions={"abs": ca.fabs} | {name: getattr(ca, name) for name in FUNCTIONS if name != "abs"},
)

__all__ = ["Formula", "Quantity", "formulate", "list_quantities"]


@dataclass(frozen=True)
class Formula:
    """Some expressions as one function; its inputs are those of q, qd, qdd, u, T, constants, s that they need.

    s is the time over the horizon.
    """

    function: ca.Function
    inputs: tuple[str, ...]


def formulate(
    texts: Sequence[str],
    constants: Sequence[str],
    plant: Plant,
    representation: Representation,
    horizon: float | None,
) -> Formula:
    """Turn expressions into a function of the variables of a representation.

    `horizon` is None where it is a variable. Raises ExpressionError for an expression that cannot be read.
    """
    manifest = plant.manifest
    known = list_quantities(manifest)
    n, m, sensors = len(manifest.coordinates), len(manifest.actuated), sum(f.sensor for f in manifest.frames)
    sizes = {"q": len(manifest.positions), "qd": n, "qdd": n, "u": m}
    sizes |= {"position": 3 * sensors, "v": 3 * sensors, "T": 1, "s": 1}
    symbols = {kind: ca.SX.sym(kind, size) for kind, size in sizes.items()}
    symbols["constants"] = ca.SX.sym("constants", len(constants))
    if horizon is not None:
        symbols["T"] = ca.SX(horizon)
    symbols["t"] = symbols["s"] * symbols["T"]
    values = {name: symbols[quantity.kind][quantity.index] for name, quantity in known.items()}
    values |= {name: symbols["constants"][i] for i, name in enumerate(constants)}
    expressions = [parse(text) for text in texts]
    results = ca.vertcat(*(evaluate(expression, values, _SYMBOLS) for expression in expressions))
    order = [k for k in ("q", "qd", "qdd", "u", "position", "v", "T", "constants", "s") if symbols[k].is_valid_input()]
    used = _used(order, [values[name] for expression in expressions for name in names(expression)], symbols) or ["s"]
    plain = ca.Function("formula", [symbols[kind] for kind in used], [results], used, ["value"], _options(used))
    return _composed(plain, used, sizes, plant, representation)


def _used(order: Sequence[str], read: Sequence[ca.SX], symbols: Mapping[str, ca.SX]) -> list[str]:
    """Keep of the inputs those that are read."""
    together = ca.vertcat(*read)
    return [kind for kind in order if symbols[kind].numel() and ca.depends_on(together, symbols[kind])]


def _options(inputs: Sequence[str]) -> dict[str, list[bool]]:
    """Name the inputs that are variables: by the others nothing is differentiated."""
    return {"is_diff_in": [kind not in ("constants", "s") for kind in inputs]}


def _composed(
    plain: ca.Function, used: Sequence[str], sizes: Mapping[str, int], plant: Plant, representation: Representation
) -> Formula:
    """Put kernels in the place of what is no variable: sensors, and accelerations of an ODE."""
    made = {"position": ("q",), "v": ("q", "qd")} | ({"qdd": ("q", "qd", "u")} if representation.is_ode else {})
    if not set(made) & set(used):
        return Formula(plain, tuple(used))
    needed = {part for kind in used for part in made.get(kind, (kind,))}
    inputs: list[str] = [k for k in ("q", "qd", "qdd", "u", "T", "constants", "s") if k in needed]
    given = {k: ca.MX.sym(k, plain.size1_in(k) if k in used else sizes[k]) for k in inputs}
    values = dict(given)
    if "position" in used:
        values["position"] = ca.vec(plant.casadi("sensors")(given["q"]))
    if "v" in used:
        values["v"] = ca.vec(plant.casadi("motion")(q=given["q"], qd=given["qd"])["v"])
    if "qdd" in used and "qdd" not in given:
        values["qdd"] = plant.casadi(representation.kernel)(given["q"], given["qd"], given["u"])
    result = plain.call([values[kind] for kind in used])[0]
    function = ca.Function("formula", list(given.values()), [result], inputs, ["value"], _options(inputs))
    return Formula(function, tuple(inputs))
