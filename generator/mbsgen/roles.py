"""Roles of arguments, orders of derivatives, and the names that follow from both.

A function y = f(x) of the catalogue has the order `value`. Of its derivatives, with weights lambda of the results,

    jacobian            dy/dx
    adjoint             (dy/dx)T lambda
    adjoint_jacobian    d((dy/dx)T lambda)/dx, the Hessian of lambdaT y, and by lambda
    linearisation       y and dy/dx

are generated. Generator and solver decide by roles and orders. Names are made here, and taken apart
nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from functools import lru_cache


class Role(Enum):
    """The part that an argument plays in a function."""

    COORDINATE = "coordinate"  # q
    VELOCITY = "velocity"  # qd
    ACCELERATION = "acceleration"  # qdd, as an input or as a result
    FORCE = "force"  # u, the forces of the actuated joints
    WRENCH = "wrench"  # w, components of external wrenches, and other numbers that forces read
    PARAMETER = "parameter"  # p, run-time parameters
    DESIGN = "design"  # theta, differentiated parameters
    SETUP = "setup"  # h, computed from the run-time parameters by a separate function
    ARGUMENT = "argument"  # any other input
    RESIDUAL = "residual"  # Phi - Q, which vanishes along a motion
    MASS_MATRIX = "mass_matrix"  # M of M qdd + c = Q
    BIAS = "bias"  # c of M qdd + c = Q
    MULTIPLIER = "multiplier"  # lambda, the forces of loops and constraints
    DRIVE = "drive"  # the accelerations of driven joints, which are given
    DRIVING_FORCE = "driving_force"  # tau, the forces that this takes
    CLOSURE = "closure"  # h, which vanishes where loops are closed
    CLOSURE_RATE = "closure_rate"  # J qd, its time derivative
    CLOSURE_ACCELERATION = "closure_acceleration"  # J qdd + Jd qd, the second one
    CLOSURE_JACOBIAN = "closure_jacobian"  # J
    RATE = "rate"  # time derivatives of q
    CONDITION = "condition"  # the factor by which a solution loses digits
    RESULT = "result"  # any other result
    REMAINDER = "remainder"  # the second part of a number in double-double, which is the sum of two
    SEED = "seed"  # the weights of a result, of which the adjoint is the sum
    ADJOINT = "adjoint"  # the derivative of the weighted sum of all results, by an input
    DERIVATIVE = "derivative"  # a block of a Jacobian

    @property
    def is_differentiated(self) -> bool:
        """Return whether a function is differentiated by an input of this role."""
        return self not in (Role.PARAMETER, Role.SETUP)


# Functions that are written only where they are named: few uses need them, and each use of them knows its name.
ON_REQUEST = (
    "accelerations",
    "attitudes",
    "lengths",
    "stretches",
    "tensions",
    "contact_forces",
    "reactions",
    "regressor",
)

# The numbers of a body by which forces are linear: mass [kg], first moment [kg m], and the tensor [kg m2] about the
# origin of the body's frame, along its axes.
MOMENTS = ("m", "Sx", "Sy", "Sz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")


# A name for the quicker form of the accelerations.
QUICKEST = "exp"
ACCELERATING = ("exp1", "exp2")
# Operations of EXP2, relative to EXP1's, from which on it takes longer: in its two passes along the tree each joint
# waits for the one before it, and in EXP1 more operations are independent of each other. By times of 25 mechanisms.
WAITING = 0.9


def choose_quickest(flops: Mapping[str, int]) -> str:
    """Return which of the given forms of the accelerations is the quickest, by their flops."""
    return min(flops, key=lambda name: (flops[name] / (WAITING if name == "exp2" else 1), ACCELERATING.index(name)))


class Axis(Enum):
    """The meaning of the entries along one side of an argument."""

    COORDINATES = "coordinates"  # the entries of q
    VELOCITIES = "velocities"  # the joints: the entries of qd
    FORCES = "forces"  # the actuated joints
    COMPONENTS = "components"  # of the open wrenches
    PARAMETERS = "parameters"  # run-time parameters
    DESIGN = "design"  # differentiated parameters
    SENSORS = "sensors"  # one entry or more for each sensor
    CONTACTS = "contacts"  # the points of contact
    RIGID = "rigid"  # the points of rigid contacts
    MEETINGS = "meetings"  # the pairs of solids in rigid contact
    CONSTRAINTS = "constraints"  # the equations of loops and constraints, independent ones
    INDEPENDENT = "independent"  # the velocities that determine all others
    DRIVEN = "driven"  # the joints whose accelerations are given
    FRAMES = "frames"  # one entry or more for each body, then for each sensor
    BODIES = "bodies"  # the bodies, by the joints that carry them, followers included
    ELEMENTS = "elements"  # springs and cables
    MOMENTS = "moments"  # ten for each body, in the order of the bodies, followers included


class Order(Enum):
    """The order of differentiation of a kernel; the value of a member is the one that a manifest holds."""

    VALUE = "value"
    JACOBIAN = "jacobian"
    ADJOINT = "adjoint"
    ADJOINT_JACOBIAN = "adjoint_jacobian"
    LINEARISATION = "linearisation"

    @property
    def prefix(self) -> str:
        """Return the beginning of the names of kernels of this order."""
        return _PREFIXES[self]

    @property
    def derivatives(self) -> tuple[Order, ...]:
        """List this order, and the orders of the kernels that CasADi looks for beside one of it."""
        adjoint = (Order.ADJOINT, Order.ADJOINT_JACOBIAN)
        return {Order.VALUE: FAMILY, Order.ADJOINT: adjoint}.get(self, (self,))


_PREFIXES = {
    Order.VALUE: "",
    Order.JACOBIAN: "jac_",
    Order.ADJOINT: "adj1_",
    Order.ADJOINT_JACOBIAN: "jac_adj1_",
    Order.LINEARISATION: "lin_",
}
RESERVED = (
    *(prefix for prefix in _PREFIXES.values() if prefix),
    "fwd1_",
)  # of no function's own name; CasADi looks for all but one
# One function to CasADi, which looks for the derivatives beside the value.
FAMILY = (Order.VALUE, Order.JACOBIAN, Order.ADJOINT, Order.ADJOINT_JACOBIAN)


def name_kernel(base: str, order: Order) -> str:
    """Name the kernel of a function of an order, as in `jac_impl`."""
    return order.prefix + base


def name_precise(name: str) -> str:
    """Name the kernel in double-double arithmetic that computes what another one does, as in `dd_impl`."""
    return f"dd_{name}"


def name_low(name: str) -> str:
    """Name the second part of an argument of such a kernel, as in `low_q`."""
    return f"low_{name}"


@lru_cache(maxsize=1024)  # it is asked at every call of a kernel
def split_kernel(name: str) -> tuple[str, Order]:
    """Return the function and the order of a kernel that is asked for by name, before it is generated."""
    orders = sorted(_PREFIXES, key=lambda order: -len(order.prefix))
    order = next(order for order in orders if name.startswith(order.prefix))
    return name[len(order.prefix) :], order


def name_derivative(of: str, by: str) -> str:
    """Name the block of a Jacobian, as in `jac_Phi_q`."""
    return f"jac_{of}_{by}"


def name_adjoint(of: str) -> str:
    """Name the adjoint of an input or the weights of a result, as in `adj_q` and `adj_Phi`."""
    return f"adj_{of}"


def name_unneeded(result: str) -> str:
    """Name the place of a result among the inputs of a derivative, as in `out_Phi`; CasADi has one for each."""
    return f"out_{result}"
