"""Constants of a program as variables: what reads parameters by number reads variables behind the others instead.

So the derivatives of rows and costs by constants, and the mixed second derivatives, are columns of the exact Jacobian
and Hessian. Weights stay parameters: cost and gradient are linear in them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from mbsrun.ocp.ground.functions import Formula
from mbsrun.ocp.ground.program import Block, Matrix, Program


def lift_constants(program: Program) -> Program:
    """Return the program with its constants as its last variables."""
    count, first = program.constants, program.variables
    weights = len(program.H)

    def lift(block: Block) -> Block:
        if not block.parameters.size:
            return block
        function = block.function
        assert isinstance(function, Formula), "formulas alone read parameters"
        assert function.parameters is not None, "the block says so"
        assert block.parameters.min() >= weights, "formulas read constants, and no weights"
        column = np.repeat((block.parameters - weights + first)[:, None], block.places, axis=1)
        inputs = (*function.inputs, function.parameters)
        lifted = replace(function, inputs=inputs, parameters=None)
        none = np.zeros(0, dtype=np.int64)
        return replace(block, function=lifted, columns=(*block.columns, column), parameters=none)

    size = first + count
    return replace(
        program,
        A=Matrix(sparse.hstack([program.A, sparse.csc_array((program.constraints, count))])),
        H=tuple(Matrix(sparse.csc_array(sparse.block_diag([H, sparse.csc_array((count, count))]))) for H in program.H),
        blocks=tuple(map(lift, program.blocks)),
        costs=tuple(map(lift, program.costs)),
        constants=0,
        stages=None,
        chain=None,
    ) if size > first else program  # fmt: skip
