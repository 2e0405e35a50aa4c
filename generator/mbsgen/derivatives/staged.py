"""Derivatives of functions that iterate, stage by stage: of solutions by the implicit function theorem."""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.procedure import differentiation
from mbsgen.procedure.procedure import Procedure
from mbsgen.roles import Role


@dataclass(frozen=True)
class StagedDerivatives:
    """The derivatives of a procedure by all inputs but parameters, as in `kernels.Derivatives`."""

    jac: Procedure
    lin: Procedure
    adj1: Procedure
    jac_adj1: Procedure | None

    @staticmethod
    def of(procedure: Procedure, order: int) -> StagedDerivatives:
        """Differentiate a procedure up to an order."""
        wrt = [wire.name for wire in procedure.inputs if wire.port.role.is_differentiated]
        jac, adj1 = differentiation.jacobian(procedure, wrt), differentiation.adjoint(procedure, wrt)
        lin = differentiation.jacobian(procedure, wrt, with_values=True)
        seeds = [wire.name for wire in adj1.inputs if wire.port.role is Role.SEED]
        return StagedDerivatives(jac, lin, adj1, differentiation.jacobian(adj1, (*wrt, *seeds)) if order > 1 else None)
