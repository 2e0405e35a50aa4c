"""Expressions of a motion as formulas that a program applies.

    t, T                                          time, horizon
    q_NAME, qd_NAME, qdd_NAME                     of a coordinate: value, velocity, acceleration
    u_NAME                                        of an actuated coordinate: input
    x_NAME, y_NAME, z_NAME, vx_NAME, ...          of a sensor: position and velocity in the base frame
    wx_NAME, ...; xx_NAME, xy_NAME, ..., zz_NAME  its angular velocity; its axes: xy is the y component of its x axis
    length_NAME                                   of a spring, cable or muscle
    fx_NAME, ..., mx_NAME, ...                    of a wrench that the model leaves open: its components
    tau_NAME                                      of a driven joint: the force that keeps it on its motion
    NAME                                          of a state or a control that the problem adds
    ref_NAME_COLUMN, known_NAME_COLUMN            of a reference: see `mbsrun.recordings.references`

where dots and spaces of a name are written _, and q has other names where there are quaternions (q_trunk_qx); and
the constants of the problem, which are parameters of the program. Units are SI. `mbsgen.expressions` reads an
expression by a white list. Sensors, and accelerations of an ODE, are no variables: kernels compute them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from mbsgen.expressions import (
    LONG,
    PRIMITIVES,
    Algebra,
    Call,
    Constant,
    Expression,
    Name,
    Negation,
    Number,
    Operation,
    Power,
    evaluate,
    names,
    parse,
)
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.functions import Formula, Input, KernelResult, SymbolicCall
from mbsrun.ocp.problem.problem import Symbolic
from mbsrun.ocp.transcription.layout import Motions
from mbsrun.quantities import SENSED, Added, Quantity, list_quantities, name_components

__all__ = ["Added", "Quantity", "formulate", "list_quantities"]

CONSTANTS = "constants"  # the kind of a problem's constants
TIME = "s"  # the kind of numbers that are given at each place: the time over the horizon, then references
_TIME_NAME = "@s"  # which no text can hold
_ORDER = ("q", "qd", "yd", "qdd", "u", "w", "a", "tau", "states", "controls", "T", "unknowns")  # of a formula's inputs


def _call(function: str, *arguments: Expression) -> Expression:
    return Call(function, arguments)


def _operate(symbol: str) -> Callable[[Expression, Expression], Expression]:
    return partial(Operation, symbol)  # type: ignore[arg-type]  # one of the four


_TREES: Algebra[Expression] = Algebra(
    number=Number,
    constants={"pi": Constant("pi")},
    negate=Negation,
    operations={symbol: _operate(symbol) for symbol in "+-*/"},
    power=Power,
    functions={name: partial(_call, name) for name in (*PRIMITIVES, *LONG)},
)


def formulate(
    texts: Sequence[str | Expression],
    constants: Sequence[str],
    manifest: Manifest,
    motions: Motions,
    accelerations: Mapping[str, KernelResult],
    horizon: float | None,
    added: Added | None = None,
    references: Sequence[str] = (),
    functions: Sequence[Symbolic] = (),
) -> Formula:
    """Turn expressions into a formula in the variables of a program.

    `accelerations` names the kernel that computes them where they are no variables. `horizon` is None where it is a
    variable. `references` are names of numbers that are given at each place, after the time. Expressions read
    `functions` by their names. Raises ExpressionError for an expression that cannot be read.
    """
    known = _list_known(list_quantities(manifest, added), motions)
    known |= {_TIME_NAME: (TIME, 0), **{name: (CONSTANTS, i) for i, name in enumerate(constants)}}
    known |= {name: (TIME, 1 + i) for i, name in enumerate(references)}
    computed = {
        **{kind: KernelResult(x.kernel, x.inputs, x.result) for kind, x in SENSED.items()},
        **accelerations,
    }
    expressions = [_read(text, known, horizon, [function.name for function in functions]) for text in texts]
    named = frozenset[str]().union(*map(names, expressions))
    calls = tuple(
        SymbolicCall(function.name, function.code, tuple(_read(name, known, horizon) for name in function.reads))
        for function in functions
        if function.name in named
    )
    every = [*expressions, *(argument for call in calls for argument in call.arguments)]
    read = {name: known[name] for expression in every for name in sorted(names(expression)) if name in known}
    kinds = {kind for kind, _ in read.values()}
    made = {kind: call for kind, call in computed.items() if kind in kinds}
    needed = (kinds - set(made)).union(*(call.inputs for call in made.values()))
    sizes = _count(manifest, motions, added or Added())
    inputs = tuple(Input(kind, sizes[kind]) for kind in _ORDER if kind in needed)
    return Formula(
        expressions=tuple(expressions),
        names=read,
        inputs=inputs,
        parameters=Input(CONSTANTS, len(constants)) if CONSTANTS in needed else None,
        data=Input(TIME, 1 + len(references)) if TIME in needed or not needed else None,
        computed=tuple(made.items()),
        calls=calls,
    )


def _read(
    text: str | Expression, known: Mapping[str, tuple[str, int]], horizon: float | None, functions: Sequence[str] = ()
) -> Expression:
    """Parse an expression; write the time as the horizon times its part, and a horizon that is given as a number."""
    T: Expression = Name("T") if horizon is None else Number(horizon)
    values: dict[str, Expression] = {name: Name(name) for name in (*known, *functions) if name != _TIME_NAME}
    values |= {"T": T, "t": Operation("*", Name(_TIME_NAME), T)}
    return evaluate(parse(text) if isinstance(text, str) else text, values, _TREES)


def _list_known(quantities: Mapping[str, Quantity], motions: Motions) -> dict[str, tuple[str, int]]:
    """List kind and index of each name; velocities and accelerations that are no variables have no name."""
    places = {"qd": motions.velocities, "qdd": motions.moved}
    known = {}
    for name, quantity in quantities.items():
        among = places.get(quantity.kind)
        if among is None:
            known[name] = (quantity.kind, quantity.index)
        elif quantity.index in among:
            known[name] = (quantity.kind, among.index(quantity.index))
    return known


def _count(manifest: Manifest, motions: Motions, added: Added) -> dict[str, int]:
    """Count the entries of each kind of variable."""
    return {
        "q": motions.nq,
        "qd": len(motions.velocities),
        "yd": len(motions.moved),
        "qdd": len(motions.moved),
        "u": len(manifest.actuated),
        "w": len(name_components(manifest)),
        "a": len(motions.driven),
        "tau": len(motions.driven),
        "states": len(added.states),
        "controls": len(added.controls),
        "unknowns": len(added.unknowns),
        "T": 1,
    }
