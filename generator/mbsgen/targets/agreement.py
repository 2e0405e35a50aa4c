"""What the check program compares: which kernels of a model must agree, and by which comparison of `mbs_check.h`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mbsgen.targets.contract import Family


@dataclass(frozen=True)
class Comparison:
    """A call of the check program."""

    function: str
    kernels: tuple[str, ...]


# Between functions of one model, where it has both. The bias c of `semi` is the residual only without forces that act
# besides u.
_RELATIONS = (
    Comparison("mbs_check_equal", ("semi_res", "impl")),
    Comparison("mbs_check_mass_matrix", ("semi", "impl")),
    Comparison("mbs_check_accelerations", ("exp1", "impl")),
    Comparison("mbs_check_accelerations", ("exp2", "impl")),
    Comparison("mbs_check_same_accelerations", ("exp1", "exp2")),
    Comparison("mbs_check_tail", ("sensors", "frames")),
)
_WITHOUT_OTHER_FORCES = (Comparison("mbs_check_bias", ("semi", "impl")),)


def compare(families: Sequence[Family], *, only_driven: bool) -> tuple[Comparison, ...]:
    """List the comparisons for a model's functions; only_driven: no force but u acts in the joints."""
    relations = _RELATIONS + (_WITHOUT_OTHER_FORCES if only_driven else ())
    present = {family.value.name for family in families}
    between = tuple(relation for relation in relations if present.issuperset(relation.kernels))
    return (*(c for family in families for c in _compare_derivatives(family)), *between)


def _compare_derivatives(family: Family) -> Iterator[Comparison]:
    value, jac, adj1, jac_adj1 = family.value, family.jac, family.adj1, family.jac_adj1
    if jac:
        yield Comparison("mbs_check_jacobian", (value.name, jac.name))
    if jac and adj1:
        yield Comparison("mbs_check_adjoint", (value.name, jac.name, adj1.name))
    if adj1 and jac_adj1:
        yield Comparison("mbs_check_jacobian", (adj1.name, jac_adj1.name))
