"""The Tape: a straight-line program with typed inputs and outputs; an immutable value.

Values are numbered: first the nonzeros of the inputs in order, then the literals, then one per operation. An operation
uses earlier values only (single assignment).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

from mpmath import MPContext, mpf

from mbsgen.errors import TapeError
from mbsgen.roles import Role
from mbsgen.tape.ports import Function, Port

LITERALS = MPContext()  # literals are kept to 60 digits and rounded once, in the target
LITERALS.dps = 60


class Op(Enum):
    """Operations, with the number of their operands."""

    ADD = ("+", 2)
    SUB = ("-", 2)
    MUL = ("*", 2)
    DIV = ("/", 2)
    NEG = ("neg", 1)
    SQRT = ("sqrt", 1)
    SIN = ("sin", 1)
    COS = ("cos", 1)
    TAN = ("tan", 1)
    ASIN = ("asin", 1)
    ACOS = ("acos", 1)
    ATAN = ("atan", 1)
    ATAN2 = ("atan2", 2)
    EXP = ("exp", 1)
    LOG = ("log", 1)
    TANH = ("tanh", 1)
    ABS = ("fabs", 1)
    SIGN = ("sign", 1)  # -1, 0 or 1: used as the derivative of |x|, 0 where there is none

    def __init__(self, _: str, arity: int) -> None:
        self.arity = arity  # not a property: it is read for every operation of a tape, many times over
        self._shown = super().__repr__()

    def __repr__(self) -> str:  # it is hashed for every operation
        return self._shown

    __hash__ = object.__hash__  # members are singletons; Enum's own hash is slower


# Python 3.11 finds a member by its class ten times slower than a name, and these are compared for every operation.
ADD, SUB, MUL, DIV, NEG = Op.ADD, Op.SUB, Op.MUL, Op.DIV, Op.NEG

_WRITTEN_BY_SIGNS = frozenset({ADD, SUB, MUL, DIV, NEG})
FUNCTIONS: tuple[Op, ...] = tuple(op for op in Op if op not in _WRITTEN_BY_SIGNS)
ODD = frozenset({Op.SIN, Op.TAN, Op.ASIN, Op.ATAN, Op.TANH, Op.SIGN})  # f(-x) = -f(x)
EVEN = frozenset({Op.COS, Op.ABS})  # f(-x) = f(x)


@dataclass(frozen=True)
class Sparsity:
    """The nonzero pattern of a matrix in compressed columns, CasADi's order: rows strictly increase in a column."""

    rows: int
    cols: int
    colind: tuple[int, ...]
    row: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.colind) != self.cols + 1 or self.colind[0] != 0 or self.colind[-1] != len(self.row):
            raise TapeError(
                f"column pointers {self.colind} do not fit {self.cols} columns and {len(self.row)} nonzeros"
            )
        for start, stop in pairwise(self.colind):
            column = self.row[start:stop]
            if any(not 0 <= r < self.rows for r in column) or any(a >= b for a, b in pairwise(column)):
                raise TapeError(f"rows {column} of a column must lie in 0..{self.rows - 1} and strictly increase")

    @staticmethod
    def dense(rows: int, cols: int = 1) -> Sparsity:
        """Make the full pattern of a rows x cols matrix."""
        return Sparsity(
            rows,
            cols,
            tuple(range(0, rows * cols + 1, rows)) if rows else (0,) * (cols + 1),
            tuple(range(rows)) * cols,
        )

    @staticmethod
    def of(rows: int, cols: int, entries: Iterable[tuple[int, int]]) -> Sparsity:
        """Make the pattern that holds the given (row, column) entries."""
        ordered = sorted({(c, r) for r, c in entries})
        colind = [0] * (cols + 1)
        for c, _ in ordered:
            colind[c + 1] += 1
        for c in range(cols):
            colind[c + 1] += colind[c]
        return Sparsity(rows, cols, tuple(colind), tuple(r for _, r in ordered))

    @property
    def nnz(self) -> int:
        """Count the nonzeros."""
        return len(self.row)

    @property
    def is_dense(self) -> bool:
        """Return whether every entry is a nonzero."""
        return self.nnz == self.rows * self.cols

    @cached_property
    def entries(self) -> tuple[tuple[int, int], ...]:
        """List the (row, column) of each nonzero, in storage order."""
        return tuple((self.row[k], c) for c in range(self.cols) for k in range(self.colind[c], self.colind[c + 1]))


@dataclass(frozen=True)
class Input:
    """A port with its pattern; its nonzeros are values of the tape."""

    port: Port
    sparsity: Sparsity

    @property
    def name(self) -> str:
        """Name the input."""
        return self.port.name


@dataclass(frozen=True)
class Output:
    """A port with its pattern, and the value of each nonzero, in storage order."""

    port: Port
    sparsity: Sparsity
    values: tuple[int, ...]

    @property
    def name(self) -> str:
        """Name the output."""
        return self.port.name


LARGEST_THRESHOLD = 3.0e-5  # float32 has few digits, so less is required: two are left where a pivot just passes


@dataclass(frozen=True)
class Guard:
    """A pivot that must stand out of rounding: value > threshold * scale; else the kernel fails at `joint`.

    The threshold is tolerance * epsilon, at most LARGEST_THRESHOLD, with the epsilon of the number type in use. A
    kernel that fails stores no result.
    """

    value: int
    scale: int
    tolerance: float
    joint: int  # from 1
    negated: bool = False  # the tape holds the pivot with its sign changed
    early: bool = False  # it guards a division by parameters, and is tested where these are set: in `setup`


Operation = tuple[Op, int, int]  # (op, first operand, second operand or -1)


@dataclass(frozen=True)
class Tape:
    """A straight-line program. Its invariants are checked at construction."""

    function: Function
    inputs: tuple[Input, ...]
    literals: tuple[mpf, ...]
    operations: tuple[Operation, ...]
    outputs: tuple[Output, ...]
    guards: tuple[Guard, ...] = ()  # in the order in which they are tested
    labels: Mapping[int, str] = field(default_factory=lambda: MappingProxyType({}))  # a field's name for a value

    def __post_init__(self) -> None:
        first = self.first_operation
        for value, (op, a, b) in enumerate(self.operations, first):
            if not (0 <= a < value and (0 <= b < value if op.arity == 2 else b == -1)):
                operands = (a, b)[: op.arity]
                raise TapeError(
                    f"{self.name}: value {value} = {op.name}{operands} uses a value that does not precede it"
                )
        for output in self.outputs:
            if len(output.values) != output.sparsity.nnz:
                raise TapeError(
                    f"{self.name}: {output.name} has {output.sparsity.nnz} nonzeros, {len(output.values)} values"
                )
            if any(not 0 <= x < first + len(self.operations) for x in output.values):
                raise TapeError(f"{self.name}: {output.name} refers to a value that does not exist")
        for guard in self.guards:
            if any(not 0 <= x < first + len(self.operations) for x in (guard.value, guard.scale)):
                raise TapeError(f"{self.name}: the guard of joint {guard.joint} refers to a value that does not exist")
        for names in ([i.name for i in self.inputs], [o.name for o in self.outputs]):
            if len(set(names)) != len(names):
                raise TapeError(f"{self.name}: names repeat: {names}")

    @property
    def name(self) -> str:
        """Name the kernel."""
        return self.function.name

    @cached_property  # it is read for most operations of a tape
    def first_literal(self) -> int:
        """Number the first literal: the count of input nonzeros."""
        return sum(i.sparsity.nnz for i in self.inputs)

    @cached_property
    def first_operation(self) -> int:
        """Number the first value that an operation computes."""
        return self.first_literal + len(self.literals)

    def is_pivot(self, guard: Guard) -> bool:
        """Return whether a guard's value is computed; a guard on a literal demands that an estimate is small."""
        return guard.value >= self.first_operation or guard.value < self.first_literal

    def input(self, name: str) -> Input:
        """Look an input up by name."""
        return next(i for i in self.inputs if i.name == name)

    def output(self, name: str) -> Output:
        """Look an output up by name."""
        return next(o for o in self.outputs if o.name == name)

    def holding(self, role: Role) -> Input | None:
        """Return the input of a role, if there is one."""
        return next((i for i in self.inputs if i.port.role is role), None)

    def giving(self, role: Role) -> Output | None:
        """Return the first output of a role, if there is one."""
        return next((o for o in self.outputs if o.port.role is role), None)
