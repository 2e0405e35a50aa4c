"""Steps whose length follows a tolerance: the integrators of scipy, on y = (q, qd).

Implicit ones are given the Jacobian of the generated kernels. That of stiff motions decides how long an explicit step
may be; where it does, that is told: an explicit method spends its steps on staying stable then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import BDF, DOP853, LSODA, RK45, Radau

from mbsrun.kernel import KernelError
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.explicit import SINGULAR
from mbsrun.simulation.methods import METHODS
from mbsrun.simulation.motion import Chunk, Halt, HaltError, Settings

Array = NDArray[np.float64]

STEPS = 128  # handed on at a time
SOLVERS: Mapping[str, Any] = MappingProxyType(
    {"dop853": DOP853, "rk45": RK45, "lsoda": LSODA, "radau": Radau, "bdf": BDF}
)


def integrate(
    dynamics: Dynamics, piece: Piece, q: Array, qd: Array, settings: Settings, allowance: Allowance
) -> Iterator[Chunk]:
    """Go through a piece; hand on what was reached.

    Raises HaltError where a kernel or the integrator gives up, or the allowance is used up.
    """
    n, effort = dynamics.places, dynamics.effort
    times, states, pictures = [piece.start], [np.concatenate((q, qd))], []
    try:
        solver = _make_solver(dynamics, piece, states[0], settings)
        attempts = getattr(solver, "n_stages", None) if settings.method in ("dop853", "rk45") else None
        if attempts is None:
            effort.rejected = None
        while solver.status == "running":
            allowance.spend()
            before = solver.nfev
            _step(solver, dynamics)
            if solver.t == times[-1]:
                raise _give_up(dynamics, solver, "the step has become too short to advance the time")
            tried = 1 if attempts is None else (solver.nfev - before) // attempts
            effort.rejected = None if effort.rejected is None else effort.rejected + tried - 1
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
        halt = Halt(times[-1], error.joint, SINGULAR, "start elsewhere, or keep away from this configuration")
        raise HaltError(halt) from None
    if pictures:
        yield _gather(times, states, pictures, n)


def find_stability(dynamics: Dynamics, q: Array, qd: Array, v: Array) -> tuple[float, str]:
    """Give how fast the fastest motion near a state decays [1/s], 0 where none does, and the joint that it moves most.

    That is the most negative real part of an eigenvalue of the Jacobian of (qd, qdd).
    """
    matrix = np.block([[*dynamics.rate_slopes(q, qd)], [*dynamics.slopes(q, qd, v)]])
    if not np.isfinite(matrix).all():
        return 0.0, dynamics.kernels.manifest.coordinates[0].name
    values, vectors = np.linalg.eig(matrix)
    fastest = int(values.real.argmin())
    joint = int(np.abs(vectors[dynamics.places :, fastest]).argmax())
    return max(0.0, float(-values[fastest].real)), dynamics.kernels.manifest.coordinates[joint].name


def is_explicit(method: str) -> bool:
    """Tell whether stiffness limits a method's steps."""
    return METHODS[method].stability is not None


def _make_solver(dynamics: Dynamics, piece: Piece, state: Array, settings: Settings) -> Any:
    n = dynamics.places
    held = piece.at(piece.start) if piece.is_constant else None

    def rate(t: float, y: Array) -> Array:
        v = piece.at(t, y[:n], y[n:]) if held is None else held
        return np.concatenate((dynamics.rates(y[:n], y[n:]), dynamics.accelerations(y[:n], y[n:], v)))

    def jacobian(t: float, y: Array) -> Array:
        q, qd = y[:n], y[n:]
        return np.block([[*dynamics.rate_slopes(q, qd)], [*dynamics.slopes(q, qd, piece.at(t))]])

    options: dict[str, Any] = {"rtol": settings.rtol, "atol": settings.atol}
    if settings.method in ("radau", "bdf", "lsoda") and piece.law is None:  # else by differences, feedback and all
        options["jac"] = jacobian
    return SOLVERS[settings.method](rate, piece.start, state, piece.end, **options)


def _step(solver: Any, dynamics: Dynamics) -> None:
    """Take one step; what runs away, or cannot be resolved, ends in a HaltError."""
    with np.errstate(all="ignore"):
        message = solver.step() if np.isfinite(solver.y).all() else "the motion runs away: its numbers overflow"
    if solver.status == "failed" or message:
        raise _give_up(dynamics, solver, str(message).lower().rstrip("."))


def _give_up(dynamics: Dynamics, solver: Any, finding: str) -> HaltError:
    speeds = np.abs(np.nan_to_num(solver.y[dynamics.places :], nan=np.inf))
    joint = dynamics.kernels.manifest.coordinates[int(speeds.argmax())].name
    return HaltError(Halt(float(solver.t), joint, finding, "loosen the tolerance, or look for what is singular there"))


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
