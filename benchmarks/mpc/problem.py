"""The task: a Panda goes from one pose towards another, between bounds of its states, accelerations and torques.

The inputs are accelerations, constant in a step h. So the dynamics are linear, and all solvers have them exactly:

    q+ = q + h qd + h^2/2 a,    qd+ = qd + h a

Torques follow from the residual of inverse dynamics, Phi(q, qd, a), the generated kernel `impl` without inputs:

    minimise  sum_{k<N} h/2 (W_q |q_k - q*|^2 + W_v |qd_k|^2 + W_a |a_k|^2) + 1/2 (E_q |q_N - q*|^2 + E_v |qd_N|^2)
    such that -tau <= Phi(q_k, qd_k, a_k) <= tau,  bounds of q and qd for k > 0, bounds of a

Bounds of q and qd are from Franka Emika's "FCI Documentation", robot limits of the Panda. Torques have 0.4 times,
and accelerations 4 times the bounds from there, so that torques limit the motion.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
JOINTS = 7
STATES = 2 * JOINTS


def _array(*values: float) -> Array:
    return np.array(values)


@dataclass(frozen=True)
class Task:
    """Horizon, weights, bounds and poses."""

    intervals: int = 20
    step: float = 0.02
    weights: tuple[float, float, float] = (10.0, 0.1, 1e-3)  # of q, qd, a
    end_weights: tuple[float, float] = (10.0, 1.0)  # of q, qd
    start: Array = field(default_factory=lambda: _array(0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398))
    target: Array = field(default_factory=lambda: _array(0.8, -0.3, -0.4, -1.8, 0.4, 1.9, 0.3))
    lower_q: Array = field(
        default_factory=lambda: _array(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973)
    )
    upper_q: Array = field(default_factory=lambda: _array(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973))
    speed: Array = field(default_factory=lambda: _array(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61))
    acceleration: Array = field(default_factory=lambda: 4 * _array(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0))
    torque: Array = field(default_factory=lambda: 0.4 * _array(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0))

    @property
    def lower_x(self) -> Array:
        """Return the lower bounds of (q, qd)."""
        return np.concatenate([self.lower_q, -self.speed])

    @property
    def upper_x(self) -> Array:
        """Return the upper bounds of (q, qd)."""
        return np.concatenate([self.upper_q, self.speed])

    @property
    def A(self) -> Array:
        """Return the matrix of the state in the dynamics."""
        return np.kron(np.array([[1.0, self.step], [0.0, 1.0]]), np.eye(JOINTS))

    @property
    def B(self) -> Array:
        """Return the matrix of the accelerations in the dynamics."""
        return np.kron(np.array([[self.step**2 / 2], [self.step]]), np.eye(JOINTS))

    def measure_error(self, found: Iterate, exact: Iterate) -> float:
        """Return the largest error of a state or of an acceleration, as a part of the range of its bounds."""
        states = np.abs(found.x - exact.x) / (self.upper_x - self.lower_x)
        accelerations = np.abs(found.a - exact.a) / (2 * self.acceleration)
        return float(max(states.max(), accelerations.max()))

    def cost(self, x: Array, a: Array) -> float:
        """Return the cost of N + 1 states and N accelerations."""
        gap = x - np.concatenate([self.target, np.zeros(JOINTS)])
        Q = np.repeat(self.weights[:2], JOINTS)
        E = np.repeat(self.end_weights, JOINTS)
        stages = float((gap[:-1] ** 2 * Q).sum() + self.weights[2] * (a**2).sum())
        return self.step / 2 * stages + float((gap[-1] ** 2 * E).sum()) / 2


@dataclass(frozen=True)
class Iterate:
    """N + 1 states and N accelerations, in rows."""

    x: Array
    a: Array


@dataclass(frozen=True)
class Answer:
    """The result of a solver, and its effort: seconds on one core, without ours."""

    status: str
    is_solved: bool
    iterations: int
    iterate: Iterate
    seconds: float


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the first accelerations, and their effort: seconds on one core."""

    matrix: Array  # by the first state, (7, 14)
    seconds: float
    gradient: Array  # of the sum of the accelerations by the first state, (14,)
    gradient_seconds: float


class Runner(Protocol):
    """A solver with its settings, made for a task: each one is an entry of the comparison."""

    name: str

    @property
    def settings(self) -> object:
        """Return its options, to be printed."""

    def prepare(self, start: Array, guess: Iterate, *, shifts: bool) -> None:
        """Keep a state of the robot and a guess; where it shifts, the multipliers of the solution before, too."""
        ...

    def solve(self) -> Answer:
        """Solve from the kept state and guess, the same ones each time."""
        ...


@dataclass(frozen=True)
class Latency:
    """Times of steps in real time [s], and the way of the robot."""

    prepare: Array
    feedback: Array
    idle: Array  # of loops that do nothing, for as long as the median of feedback
    x: Array  # states of the robot, and its accelerations, a row a step
    a: Array
    end: Array  # the last state

    def gap(self, task: Task) -> float:
        """Return the largest distance of a joint from the target at the end [rad]."""
        return float(np.abs(self.end[:JOINTS] - task.target).max())

    def cost(self, task: Task) -> float:
        """Return the cost of the way, by the weights of the task's steps."""
        gap = self.x - np.concatenate([task.target, np.zeros(JOINTS)])
        Q = np.repeat(task.weights[:2], JOINTS)
        return task.step / 2 * float((gap**2 * Q).sum() + task.weights[2] * (self.a**2).sum())


def wait(seconds: float, rounds: int) -> Array:
    """Do nothing for a time, again and again; return how long it took: what the machine itself is late by."""
    times = np.empty(rounds)
    for k in range(rounds):
        begin = now = time.perf_counter()
        while now - begin < seconds:
            now = time.perf_counter()
        times[k] = now - begin
    return times


def rest(task: Task) -> Iterate:
    """Return the guess of a cold start: at rest."""
    x = np.tile(np.concatenate([task.start, np.zeros(JOINTS)]), (task.intervals + 1, 1))
    return Iterate(x, np.zeros((task.intervals, JOINTS)))
