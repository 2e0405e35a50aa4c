"""Ports: an argument's name, role and meaning; and functions: which one, differentiated how often.

A port has no pattern: an input or an output of a tape is a port with its pattern. So a port stays equal whatever a
pass finds to be zero, and the ports of derivatives are made from the ports of the function alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.roles import Axis, Order, Role, name_adjoint, name_derivative, name_kernel


@dataclass(frozen=True)
class Port:
    """An argument of a function, apart from its shape.

    A seed has `of`, the result that it weights. An adjoint has `by`, the input that the weighted sum is differentiated
    by. A derivative has both.
    """

    name: str
    role: Role
    rows: Axis | None = None  # None: entries without a name
    cols: Axis | None = None  # None: a column, unless the port is a derivative
    unit: str = ""
    meaning: str = ""  # for readers of the generated code
    of: Port | None = None
    by: Port | None = None

    @property
    def is_matrix(self) -> bool:
        """Return whether the argument is a matrix even where it has one column."""
        return self.role is Role.DERIVATIVE or self.cols is not None

    @property
    def note(self) -> str:
        """Describe the argument, with its unit; empty where it has no description."""
        return ", ".join(text for text in (self.meaning, self.unit) if text)


@dataclass(frozen=True)
class Function:
    """One kernel: a function by its own name, and the order of its derivative."""

    base: str
    order: Order = Order.VALUE

    @property
    def name(self) -> str:
        """Name the kernel."""
        return name_kernel(self.base, self.order)

    def to(self, order: Order) -> Function:
        """Return the kernel of another order of the same function."""
        return Function(self.base, order)


def derivative_port(of: Port, by: Port) -> Port:
    """Make the port of d of / d by; rows and columns are entries of the two."""
    return Port(name_derivative(of.name, by.name), Role.DERIVATIVE, _entries(of), _entries(by), of=of, by=by)


def seed_port(of: Port) -> Port:
    """Make the port of the weights of a result."""
    return Port(name_adjoint(of.name), Role.SEED, of.rows, of.cols, of=of)


def adjoint_port(by: Port) -> Port:
    """Make the port of the derivative of the weighted results by an input."""
    return Port(name_adjoint(by.name), Role.ADJOINT, by.rows, by.cols, by=by)


def is_of(port: Port, role: Role) -> bool:
    """Return whether a port has a role, or is a derivative of or by one that has it."""
    return port.role is role or any(is_of(x, role) for x in (port.of, port.by) if x)


def _entries(port: Port) -> Axis | None:
    """Return the meaning of all entries of a port; a matrix, laid out in one column, has none."""
    return port.rows if port.cols is None else None
