"""Random stages with the structure of a robot arm: collocation points whose states and accelerations are inner."""

from __future__ import annotations

import numpy as np

from tests.csrc.stages import INFINITE, Array, Quadratic

# Points and derivatives of the polynomial through the first state and the states at Radau's points, by these
POINTS = {
    2: np.array([1 / 3, 1.0]),
    4: np.array([0.08858795951270395, 0.40946686444073473, 0.7876594617608471, 1.0]),
}


def derivatives(points: Array) -> Array:
    """Row i: derivative at point i of the Lagrange polynomials of 0 and the points."""
    nodes = np.concatenate([[0.0], points])
    powers = np.vander(nodes, increasing=True)
    slopes = np.array([[i * t ** (i - 1) if i else 0.0 for i in range(len(nodes))] for t in points])
    return slopes @ np.linalg.inv(powers)


def arm(rng: np.random.Generator, intervals: int, joints: int = 6, inputs: int = 4, count: int = 4) -> Quadratic:
    """Linear equations of motion A q + B qd + M qdd = C u at each point, with numbers that change along the horizon."""
    h, D = 1.0 / intervals, derivatives(POINTS[count])
    n, nx = 3 * joints * count, 2 * joints
    size = nx + n + inputs
    H, q, F, b, E, e, G, lower, upper = [], [], [], [], [], [], [], [], []
    end = np.concatenate([np.ones(joints), np.zeros(joints)])

    def place(point: int, what: int) -> slice:
        """Columns of q, qd or qdd of a point; of the first state at point -1."""
        at = nx + 3 * joints * point + what * joints if point >= 0 else what * joints
        return slice(at, at + joints)

    for _ in range(intervals):
        rows, cost = np.zeros((n, size)), np.zeros((size, size))
        for i in range(count):
            motion, rate, speed = (
                slice(3 * joints * i + m * joints, 3 * joints * i + (m + 1) * joints) for m in range(3)
            )
            root = rng.standard_normal((joints, joints)) / 3
            rows[motion, place(i, 0)] = 3 * rng.standard_normal((joints, joints))
            rows[motion, place(i, 1)] = rng.standard_normal((joints, joints))
            rows[motion, place(i, 2)] = root @ root.T + np.eye(joints)
            rows[motion, size - inputs :] = -rng.standard_normal((joints, inputs))
            for j in range(-1, count):
                rows[rate, place(j, 0)] += D[i, j + 1] * np.eye(joints)
                rows[speed, place(j, 1)] += D[i, j + 1] * np.eye(joints)
            rows[rate, place(i, 1)] -= h * np.eye(joints)
            rows[speed, place(i, 2)] -= h * np.eye(joints)
            block = rng.standard_normal((3 * joints, 3 * joints)) / 5
            block[joints:, 2 * joints :] = block[2 * joints :, joints:] = 0
            at = slice(nx + 3 * joints * i, nx + 3 * joints * (i + 1))
            cost[at, at] = h * np.tril(block + block.T) + h * np.eye(3 * joints)
            cost[at, at] += np.tril(cost[at, at], -1).T
        cost[size - inputs :, size - inputs :] = h * np.eye(inputs)
        least = np.linalg.eigvalsh(cost[nx:, nx:]).min()
        H.append(cost + np.diag(np.where(np.arange(size) >= nx, max(0.1 * h - least, 0.0), 0.0)))
        q.append(np.zeros(size))
        last = np.zeros((nx, size))
        last[:joints, place(count - 1, 0)] = last[joints:, place(count - 1, 1)] = np.eye(joints)
        F.append(last)
        b.append(np.zeros(nx))
        E.append(rows)
        e.append(np.zeros(n))
        G.append(np.zeros((0, size)))
        lower.append(np.concatenate([np.full(nx + n, -INFINITE), np.full(inputs, -40.0)]))
        upper.append(-lower[-1])
    lower[0][:nx] = upper[0][:nx] = 0.0
    H.append(np.zeros((nx, nx)))
    q.append(np.zeros(nx))
    F.append(np.zeros((0, nx)))
    b.append(np.zeros(0))
    E.append(np.eye(nx)[: min(2 * inputs, nx)])
    e.append(-end[: min(2 * inputs, nx)] / 10)
    G.append(np.zeros((0, nx)))
    lower.append(np.full(nx, -INFINITE))
    upper.append(np.full(nx, INFINITE))
    bounds = np.concatenate(lower), np.concatenate(upper)
    sizes = [(nx, n + inputs, n, 0)] * intervals + [(nx, 0, len(E[-1]), 0)]
    inner = [n] * intervals + [0]
    return Quadratic(
        sizes,
        H,
        q,
        F,
        b,
        E,
        e,
        G,
        *bounds,
        np.zeros(0),
        np.zeros(0),
        np.zeros(len(bounds[0])),
        inner=inner,
        sparse=True,
    )
