"""The comparisons of the check program: the kernels of a model that must agree, by comparisons of `mbs_check.h`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import REFERENCE
from mbsgen.procedure.procedure import Computation
from mbsgen.roles import Order
from mbsgen.tape.ports import Port
from mbsgen.targets.contract import Family

DIFFERENCES = "mbs_check_jacobian"


@dataclass(frozen=True)
class Comparison:
    """A call of the check program."""

    function: str
    kernels: tuple[str, ...]


def compare(families: Sequence[Family], *, only_driven: bool, has_loops: bool = False) -> tuple[Comparison, ...]:
    """List the comparisons for a model's functions; only_driven: no force but u acts in the joints.

    At random poses, the equations of loops may nearly depend on each other. Differences err there by too much, and
    derivatives are compared with results in 50 digits instead.
    """
    plain = [family.value for family in families if not family.is_precise]  # second parts would be drawn as the first
    functions = [function for function in plain if function.function.order is Order.VALUE]
    between = _compare_functions(functions, only_driven=only_driven)
    derivatives = (c for family in families for c in _compare_derivatives(family))
    return (*(c for c in derivatives if not (has_loops and c.function == DIFFERENCES)), *between)


def _compare_functions(functions: Sequence[Computation], *, only_driven: bool) -> Iterator[Comparison]:
    """Compare the forms of the equations of motion with the reference, and each other; and places of sensors.

    The check program reads results by position, so functions with other results are left out. The bias c is the
    residual at rest only without forces that act besides u.
    """

    def list_giving(*results: Port) -> list[str]:
        return [f.name for f in functions if tuple(o.port for o in f.outputs) == results]

    residuals, accelerations = list_giving(ports.RESIDUAL), list_giving(ports.ACCELERATIONS)
    terms = list_giving(ports.MASS_MATRIX, ports.BIAS) if REFERENCE in residuals else []
    poses = [*list_giving(ports.ORIGINS, ports.ROTATIONS), *list_giving(ports.ORIGINS)]
    if REFERENCE in residuals:
        yield from (Comparison("mbs_check_equal", (name, REFERENCE)) for name in residuals if name != REFERENCE)
        yield from (Comparison("mbs_check_mass_matrix", (name, REFERENCE)) for name in terms)
        yield from (Comparison("mbs_check_accelerations", (name, REFERENCE)) for name in accelerations)
    forms = [f.name for f in functions if f.outputs[0].port == ports.ACCELERATIONS]  # with multipliers, too
    yield from (Comparison("mbs_check_same_accelerations", (forms[0], name)) for name in forms[1:])
    for sensors in list_giving(ports.POSITION):
        yield from (Comparison("mbs_check_tail", (sensors, frames)) for frames in poses)
    if only_driven:
        yield from (Comparison("mbs_check_bias", (name, REFERENCE)) for name in terms)


def _compare_derivatives(family: Family) -> Iterator[Comparison]:
    value, jac, adj1, jac_adj1 = family.value, family.jac, family.adj1, family.jac_adj1
    if any(o.port == ports.CLOSED for o in value.outputs):  # loops do not close at the numbers that are drawn
        return
    if jac:
        yield Comparison(DIFFERENCES, (value.name, jac.name))
    if jac and adj1:
        yield Comparison("mbs_check_adjoint", (value.name, jac.name, adj1.name))
    if adj1 and jac_adj1:
        yield Comparison(DIFFERENCES, (adj1.name, jac_adj1.name))
