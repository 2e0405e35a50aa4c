"""A tape that calls every function that a tape can call: the ground of the tests of how targets call them."""

from __future__ import annotations

from mbsgen.roles import Role
from mbsgen.tape.ports import Function, Port
from mbsgen.tape.types import FUNCTIONS, Input, Op, Output, Sparsity, Tape


def functions_tape() -> Tape:
    """Write f (one entry for each of FUNCTIONS) of x (2): of x0 where the argument must be positive, else of x1."""
    operands = {Op.SQRT: (0, -1), Op.LOG: (0, -1), Op.ATAN2: (1, 0)}
    operations = tuple((op, *operands.get(op, (1, -1))) for op in FUNCTIONS)
    values = tuple(range(2, 2 + len(operations)))
    result = Output(Port("f", Role.RESULT), Sparsity.dense(len(values)), values)
    return Tape(Function("impl"), (Input(Port("x", Role.ARGUMENT), Sparsity.dense(2)),), (), operations, (result,))
