"""The recordings that ship: motions in closed form, or simulated, with noise of a given seed.

python -m tests.recordings_made    writes them anew
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

FOLDER = Path(__file__).parents[1] / "models" / "recorded"
MARKERS = ("biceps", "elbow", "hand")
NOISE = 2e-3  # of each coordinate of a marker [m]
HIDDEN = (0.5, 0.56)  # when the hand is not seen [s]
UPPER, FORE = 0.32, 0.28


def swing(t: Array) -> tuple[Array, Array]:
    """Return shoulder and elbow of the arm, at rest at both ends of 1.2 s."""
    s = t / 1.2
    way = 10 * s**3 - 15 * s**4 + 6 * s**5
    return 0.2 + 1.1 * way, 0.3 + 0.9 * way + 0.35 * np.sin(np.pi * s) ** 4


def place_markers(shoulder: Array, elbow: Array) -> Array:
    """Place the markers of the arm, (K, 3, 3): by hand, in the plane of x and z."""
    nothing = np.zeros_like(shoulder)

    def turn(angle: Array, x: float, y: float, z: float) -> Array:
        """Turn a point about -y."""
        c, s = np.cos(angle), np.sin(angle)
        return np.stack((c * x - s * z, nothing + y, s * x + c * z), axis=-1)

    hinge = turn(shoulder, 0, 0, -UPPER)
    hand = hinge + turn(shoulder + elbow, 0, 0, -FORE)
    return np.stack((turn(shoulder, 0.04, 0, -0.6 * UPPER), turn(shoulder, 0, 0.05, -UPPER), hand), axis=1)


def make_markers() -> str:
    """Return the recording of the arm, as TRC in mm at 100 Hz."""
    t = np.arange(121) / 100
    places = place_markers(*swing(t)) + NOISE * np.random.default_rng(1).standard_normal((t.size, 3, 3))
    lines = [
        "PathFileType\t4\t(X/Y/Z)\tswing.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"100\t100\t{t.size}\t3\tmm\t100\t1\t{t.size}",
        "Frame#\tTime\t" + "\t\t\t".join(MARKERS) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i}" for i in (1, 2, 3) for axis in "XYZ"),
        "",
    ]
    for k, time in enumerate(t):
        cells = [f"{1000 * x:.3f}" for x in places[k].ravel()]
        if HIDDEN[0] < time < HIDDEN[1]:
            cells[6:] = [""] * 3
        lines.append("\t".join([str(k + 1), f"{time:.2f}", *cells]))
    return "\n".join(lines) + "\n"


INERTIA, FRICTION = 0.0123, 0.021  # of the pendulum that was recorded
ANGLE_NOISE = 0.5  # [deg]


def swing_pendulum(t: Array, inertia: float, friction: float, start: tuple[float, float]) -> Array:
    """Return the angles of a pendulum of 0.8 kg with its centre at 0.25 m, let go at a state: by scipy."""
    m, c, g = 0.8, 0.25, 9.81

    def rate(_: float, x: Array) -> list[float]:
        return [x[1], -(friction * x[1] + m * g * c * np.sin(x[0])) / (inertia + m * c**2)]

    found = solve_ivp(rate, (0.0, float(t[-1])), start, "DOP853", t_eval=t, rtol=1e-10, atol=1e-12)
    return np.asarray(found.y[0])


def make_swing() -> str:
    """Return the recording of the pendulum, as CSV in degrees at 100 Hz."""
    t = np.arange(401) / 100
    angle = np.degrees(swing_pendulum(t, INERTIA, FRICTION, (0.9, -0.4)))
    angle += ANGLE_NOISE * np.random.default_rng(2).standard_normal(t.size)
    return "t [s],angle [deg]\n" + "".join(f"{a:.2f},{b:.3f}\n" for a, b in zip(t, angle, strict=True))


# Of the arm that was recorded: moments about the joints, mass of the second link, length of the first, friction.
LINKS = {"J1": 0.31, "S1": 0.52, "J2": 0.082, "S2": 0.27, "m2": 1.4, "l": 0.4}
DAMPING, DRY = (0.12, 0.08), (0.35, 0.2)
SLOWNESS = 0.02  # of dry friction [rad/s]
READING, TORQUE_NOISE = 1e-4, 0.05  # of an angle [rad]; of a torque, relative to its root mean square


def move_links(t: Array) -> tuple[Array, Array, Array]:
    """Return angles, velocities and accelerations of the two links, (K, 2) each: five harmonics of 10 s."""
    rng = np.random.default_rng(5)
    q, qd, qdd = np.zeros((3, t.size, 2))
    for k in range(1, 6):
        w = 2 * np.pi * k / 10
        for a, wave in zip(rng.normal(size=(2, 2)), (0.0, np.pi / 2), strict=True):
            q += 0.5 * a * np.sin(w * t + wave)[:, None]
            qd += 0.5 * a * w * np.cos(w * t + wave)[:, None]
            qdd -= 0.5 * a * w**2 * np.sin(w * t + wave)[:, None]
    return q, qd, qdd


def find_torques(q: Array, qd: Array, qdd: Array) -> Array:
    """Return the torques of two links that hang and swing in a plane, (K, 2): the textbook's closed form."""
    J1, S1, J2, S2, m2, l, g = *LINKS.values(), 9.81
    (a, b), (v, w), (p, r) = q.T, qd.T, qdd.T
    c, s = np.cos(b), np.sin(b)
    fall = g * S2 * np.sin(a + b)
    first = (J1 + J2 + m2 * l**2 + 2 * l * S2 * c) * p + (J2 + l * S2 * c) * r - l * S2 * s * (2 * v * w + w**2)
    second = (J2 + l * S2 * c) * p + J2 * r + l * S2 * s * v**2
    torques = np.stack((first + g * (S1 + m2 * l) * np.sin(a) + fall, second + fall), axis=1)
    return np.asarray(torques + np.array(DAMPING) * qd + np.array(DRY) * np.tanh(qd / SLOWNESS))


def make_links() -> str:
    """Return the recording of the two links, as CSV at 50 Hz: angles and torques with noise."""
    t, rng = np.arange(501) / 50, np.random.default_rng(6)
    q, qd, qdd = move_links(t)
    u = find_torques(q, qd, qdd)
    q = q + READING * rng.standard_normal(q.shape)
    u = u + TORQUE_NOISE * np.sqrt(np.mean(u**2, axis=0)) * rng.standard_normal(u.shape)
    rows = (f"{a:.2f},{x[0]:.5f},{x[1]:.5f},{y[0]:.4f},{y[1]:.4f}\n" for a, x, y in zip(t, q, u, strict=True))
    return "t,shoulder,elbow,u[shoulder],u[elbow]\n" + "".join(rows)


FILES = {"swing.trc": make_markers, "pendulum.csv": make_swing, "two_link.csv": make_links}

if __name__ == "__main__":
    for name, make in FILES.items():
        (FOLDER / name).write_text(make(), "utf-8")
