"""Implicit and multistep methods whose steps follow a tolerance: the integrators of SciPy, on y = (q, qd).

The embedded error estimate err of a step keeps |err_i| <= atol + rtol |y_i| in the root mean square: Hairer, Norsett,
Wanner, "Solving ordinary differential equations I", section II.4. Implicit methods take the Jacobian of the generated
kernels. An explicit method is stable while h |lambda| stays within its limit, for the eigenvalues lambda of that
Jacobian; a motion is stiff where this, and not accuracy, sets the length of its steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.integration.steps import describe_singularity, find_longest
from mbsrun.simulation.motion import Chunk, Halt, HaltError, Settings

Array = NDArray[np.float64]

STEPS = 128  # yielded at a time


LSODA, RADAU, BDF = "LSODA", "Radau", "BDF"  # classes of scipy.integrate


def integrate(
    stepper: str,
    dynamics: Dynamics,
    piece: Piece,
    q: Array,
    qd: Array,
    settings: Settings,
    allowance: Allowance,
) -> Iterator[Chunk]:
    """Go through a piece; yield the steps.

    Raises HaltError where a kernel or the integrator gives up, or the allowance is used up.
    """
    n, effort = dynamics.places, dynamics.effort
    times, states, pictures = [piece.start], [np.concatenate((q, qd))], []
    try:
        solver = _make_solver(stepper, dynamics, piece, states[0], settings)
        effort.rejected = None
        while solver.status == "running":
            allowance.spend()
            _step(solver, dynamics)
            if solver.t == times[-1]:
                raise _give_up(dynamics, solver, "the step became too short to advance the time")
            effort.steps += 1
            times.append(float(solver.t))
            states.append(solver.y.copy())
            pictures.append(solver.dense_output())
            if len(pictures) == STEPS:
                yield _gather(times, states, pictures, n)
                times, states, pictures = times[-1:], states[-1:], []
    except (KernelError, SingularError, HaltError, LimitError, DriveError) as error:
        if pictures:
            yield _gather(times, states, pictures, n)
        if isinstance(error, HaltError) or (isinstance(error, DriveError) and piece.law is None):
            raise
        if isinstance(error, LimitError | DriveError):
            raise HaltError(Halt(times[-1], None, error.finding, error.remedy)) from None
        raise HaltError(describe_singularity(error, times[-1])) from None
    if pictures:
        yield _gather(times, states, pictures, n)


def find_stability(dynamics: Dynamics, q: Array, qd: Array, v: Array) -> tuple[float, str]:
    """Return the rate [1/s] at which the fastest motion near a state decays, or 0, and the joint that it moves most.

    That is the most negative real part of an eigenvalue of the Jacobian of (qd, qdd).
    """
    matrix = np.block([[*dynamics.rate_slopes(q, qd)], [*dynamics.slopes(q, qd, v)]])
    if not np.isfinite(matrix).all():
        return 0.0, dynamics.kernels.manifest.coordinates[0].name
    values, vectors = np.linalg.eig(matrix)
    fastest = int(values.real.argmin())
    joint = int(np.abs(vectors[dynamics.places :, fastest]).argmax())
    return max(0.0, float(-values[fastest].real)), dynamics.kernels.manifest.coordinates[joint].name


def _make_solver(stepper: str, dynamics: Dynamics, piece: Piece, state: Array, settings: Settings) -> Any:
    n = dynamics.places
    held = piece.at(piece.start) if piece.is_constant else None

    def rate(t: float, y: Array) -> Array:
        v = piece.at(t, y[:n], y[n:]) if held is None else held
        return np.concatenate((dynamics.rates(y[:n], y[n:]), dynamics.accelerations(y[:n], y[n:], v)))

    def jacobian(t: float, y: Array) -> Array:
        q, qd = y[:n], y[n:]
        return np.block([[*dynamics.rate_slopes(q, qd)], [*dynamics.slopes(q, qd, piece.at(t))]])

    longest = find_longest(settings.duration, piece, dynamics.course)
    options: dict[str, Any] = {"rtol": settings.rtol, "atol": settings.atol, "max_step": longest}
    if piece.law is None:  # else by differences, feedback and all
        options["jac"] = jacobian
    from scipy import integrate as scipy_integrate  # takes long to load, and few motions need it

    return getattr(scipy_integrate, stepper)(rate, piece.start, state, piece.end, **options)


def _step(solver: Any, dynamics: Dynamics) -> None:
    """Take one step; a motion that diverges, or cannot be resolved, ends in a HaltError."""
    with np.errstate(all="ignore"):
        message = solver.step() if np.isfinite(solver.y).all() else "the motion diverges: its numbers overflow"
    if solver.status == "failed" or message:
        raise _give_up(dynamics, solver, str(message).lower().rstrip("."))


def _give_up(dynamics: Dynamics, solver: Any, finding: str) -> HaltError:
    speeds = np.abs(np.nan_to_num(solver.y[dynamics.places :], nan=np.inf))
    joint = dynamics.kernels.manifest.coordinates[int(speeds.argmax())].name
    return HaltError(Halt(float(solver.t), joint, finding, "loosen the tolerance, or look for a singularity there"))


def _gather(times: list[float], states: list[Array], pictures: list[Callable[[Array], Array]], n: int) -> Chunk:
    """Bundle steps, with the method's own interpolation between their ends."""

    def dense(t: Array, step: NDArray[np.intp]) -> tuple[Array, Array]:
        y = np.empty((len(t), len(states[0])))
        for k in np.unique(step):
            inside = step == k
            y[inside] = pictures[k](t[inside]).T
        return y[:, :n], y[:, n:]

    y = np.array(states)
    return Chunk(np.array(times), y[:, :n], y[:, n:], dense)
