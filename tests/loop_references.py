"""Motions of the loop benchmarks to 20 digits and more; `python -m tests.loop_references` writes them to reference/.

No program of the engine takes part. A mechanism with one freedom x that starts with the energy E moves by

    m(x) xd^2 / 2 + V(x) = E,    t = integral of dx sqrt(m / (2 (E - V)))

with m and V in closed form; a substitution takes the root out of the integrand where the motion starts or turns.

- Andrews' mechanism: x = beta. F is on the crank; E, G and H follow by intersections of circles (dyads). The
  energy E - V contains the work of the motor, torque (beta - beta0).
- Bricard's: its joints 1, 3, 5 turn by phi and 2, 4, 6 by psi, with sin(phi) + sin(psi) + sin(phi) sin(psi) = 0.
- The flyball governor: slider s and rods alpha, of equal angles; the shaft keeps its angular momentum. Stiff: Radau IIA
  of order 15 with 64 bits of mantissa.
- The double pendulum: angles from the vertical, extrapolated midpoint rule (Gragg) of order 24.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import mp, mpc, mpf
from numpy.typing import NDArray

FOLDER = Path(__file__).parent / "reference"
DIGITS = 40
WRITTEN = 30  # digits

Long = NDArray[np.longdouble]


# --- Andrews ------------------------------------------------------------------------------------------------------


class Andrews:
    """The mechanism as a function of beta; points are complex numbers."""

    START = "-0.0617138900142764496358948458001"
    ANGLES = (
        "beta",
        "theta",
        "gamma",
        "phi",
        "delta",
        "omega",
        "epsilon",
    )  # as the Test Set for IVP Solvers orders them

    def __init__(self) -> None:
        """Read the data as decimal numbers."""
        m = "0.04325 0.00365 0.02373 0.00706 0.07050 0.00706 0.05498"
        inertia = "2.194e-6 4.410e-7 5.255e-6 5.667e-7 1.169e-5 5.667e-7 1.912e-5"
        self.m, self.I = (tuple(map(mpf, text.split())) for text in (m, inertia))
        self.A, self.B = mpc("-0.06934", "-0.00227"), mpc("-0.03635", "0.03273")
        self.C = mpc("0.014", "0.072")
        self.torque, self.stiffness, self.slack = mpf("0.033"), mpf(4530), mpf("0.07785")
        self.start = mpf(self.START)
        self.at_start = self.potential(self.start)

    def points(self, beta: Any) -> tuple[Any, Any, Any, Any]:
        """Return F, E, G and H."""
        F = mpf("0.007") * mp.expj(beta)
        E = _intersect(F, mpf("0.028"), self.B, mpf("0.035"), 1)
        G = _intersect(self.A, mpf("0.04"), E, mpf("0.02"), 1)
        H = _intersect(self.A, mpf("0.04"), E, mpf("0.02"), -1)
        return F, E, G, H

    def directions(self, beta: Any) -> tuple[Any, ...]:
        """Return the x axes of the bodies K1 to K7, as unit complex numbers."""
        F, E, G, H = self.points(beta)
        e1, e2, e3 = mp.expj(beta), (F - E) / mpf("0.028"), 1j * (E - self.B) / mpf("0.035")
        e5, e4 = (G - self.A) / mpf("0.04"), 1j * (E - G) / mpf("0.02")
        e7, e6 = 1j * (H - self.A) / mpf("0.04"), (E - H) / mpf("0.02")
        return e1, e2, e3, e4, e5, e6, e7

    def rates(self, beta: Any) -> tuple[Any, ...]:
        """Return the angular velocities of K1 to K7 for a unit rate of beta."""
        F, E, G, H = self.points(beta)
        w2, w3 = _turn(1j * F, E - F, self.B, E)
        Ed = 1j * w3 * (E - self.B)
        w4, w5 = _turn(Ed, G - E, self.A, G)
        w6, w7 = _turn(Ed, H - E, self.A, H)
        return mpf(1), w2, w3, w4, w5, w6, w7

    def inertia(self, beta: Any) -> Any:
        """Return m(beta)."""
        F, E, _, _ = self.points(beta)
        e, w = self.directions(beta), self.rates(beta)
        Ed = 1j * w[2] * (E - self.B)
        velocities = (
            1j * mpf("0.00092") * e[0],
            1j * F - 1j * w[1] * mpf("0.0115") * e[1],
            1j * w[2] * mpc("0.01043", "-0.01874") * e[2],
            Ed + 1j * w[3] * mpc(0, "0.01421") * e[3],
            1j * w[4] * mpc("0.02308", "0.00916") * e[4],
            Ed - 1j * w[5] * mpf("0.01421") * e[5],
            1j * w[6] * mpc("-0.00449", "-0.01228") * e[6],
        )
        return sum(m * abs(v) ** 2 + I * x**2 for m, I, v, x in zip(self.m, self.I, velocities, w, strict=True))

    def potential(self, beta: Any) -> Any:
        """Return the energy of the spring."""
        D = self.B + mpc("0.02", "-0.018") * self.directions(beta)[2]
        return self.stiffness * (abs(D - self.C) - self.slack) ** 2 / 2

    def rate(self, beta: Any) -> Any:
        """Return the rate of beta, which starts at rest."""
        work = self.torque * (beta - self.start) + self.at_start - self.potential(beta)
        return mp.sqrt(2 * work / self.inertia(beta))

    def angles(self, beta: Any) -> tuple[Any, ...]:
        """Return the joints' angles; all but beta and theta stay within half a turn."""
        _, e2, e3, e4, e5, e6, e7 = self.directions(beta)
        gamma, delta, epsilon = mp.arg(e3), mp.arg(e5), mp.arg(e7)
        return beta, mp.arg(e2) - beta, gamma, mp.arg(e4 / e5), delta, mp.arg(e6 / e7), epsilon

    def speeds(self, beta: Any) -> tuple[Any, ...]:
        """Return the rates of the joints' angles."""
        _, w2, w3, w4, w5, w6, w7 = (self.rate(beta) * w for w in self.rates(beta))
        betad = self.rate(beta)
        return betad, w2 - betad, w3, w4 - w5, w5, w6 - w7, w7


def _intersect(first: Any, a: Any, second: Any, b: Any, side: int) -> Any:
    """Return the point at distances a and b from two points; seen from the first, it lies to the left if side is 1."""
    way = second - first
    c = abs(way)
    along = (a**2 - b**2 + c**2) / (2 * c)
    return first + way / c * (along + 1j * side * mp.sqrt(a**2 - along**2))


def _turn(velocity: Any, arm: Any, pivot: Any, point: Any) -> tuple[Any, Any]:
    """Return u and v of velocity + i u arm = i v (point - pivot)."""
    a, b, c = 1j * arm, -1j * (point - pivot), -velocity
    determinant = a.real * b.imag - a.imag * b.real
    return (c.real * b.imag - c.imag * b.real) / determinant, (a.real * c.imag - a.imag * c.real) / determinant


def find_beta(model: Andrews, time: Any, nodes: int = 40, width: Any = None) -> Any:
    """Return beta at a time, by Newton's method on the quadrature, panel by panel in s = sqrt(beta - beta0)."""
    rule, width = _legendre(nodes), mpf("0.2") if width is None else width

    def pass_panel(low: Any, high: Any) -> Any:
        middle, half = (low + high) / 2, (high - low) / 2
        places = ((middle + half * x, w) for x, w in rule)
        return half * sum(w * 2 * s / model.rate(model.start + s**2) for s, w in places)

    t, beta = mpf(0), mpf(0)  # beta counts from beta0
    while True:
        step = pass_panel(mp.sqrt(beta), mp.sqrt(beta + width))
        if t + step > time:
            break
        t, beta = t + step, beta + width
    low, found = mp.sqrt(beta), beta + width / 2
    for _ in range(60):
        error = t + pass_panel(low, mp.sqrt(found)) - time
        found -= error * model.rate(model.start + found)
        if abs(error) < mpf(10) ** (5 - mp.dps) * time:
            return model.start + found
    raise ArithmeticError("Newton's method on the quadrature does not converge")


def _legendre(nodes: int) -> list[tuple[Any, Any]]:
    """Return abscissas and weights of Gauss's rule on [-1, 1]."""
    rule = []
    for k in range(nodes):
        x = mp.cos(mp.pi * (k + mpf("0.75")) / (nodes + mpf("0.5")))
        for _ in range(100):
            p, before = _legendre_value(nodes, x)
            slope = nodes * (x * p - before) / (x**2 - 1)
            x -= p / slope
            if abs(p / slope) < mpf(10) ** (3 - mp.dps):
                break
        rule.append((x, 2 / ((1 - x**2) * slope**2)))
    return rule


def _legendre_value(degree: int, x: Any) -> tuple[Any, Any]:
    before, p = mpf(1), x
    for k in range(2, degree + 1):
        before, p = p, ((2 * k - 1) * x * p - (k - 1) * before) / k
    return p, before


# --- Bricard ------------------------------------------------------------------------------------------------------


class Bricard:
    """Five rods of 1 m and 1 kg with a section of 0.1 m, as a function of phi, the angle of joints 1, 3 and 5.

    At rest at phi = 0; the potential energy is the same at phi = pi, where the motion turns.
    """

    AXES = (1, 2, 0, 1, 2)  # of the joints, in the frame of the rod
    RODS = ((1, 0, 0), (0, -1, 0), (0, 0, 1), (-1, 0, 0), (0, 1, 0))
    GRAVITY = "9.81"

    def other(self, phi: Any) -> tuple[Any, Any]:
        """Return psi and its derivative by phi: psi stays between -pi/6 and 0."""
        sine = -mp.sin(phi) / (1 + mp.sin(phi))
        return mp.asin(sine), -mp.cos(phi) / ((1 + mp.sin(phi)) ** 2 * mp.sqrt(1 - sine**2))

    def angles(self, phi: Any) -> tuple[Any, ...]:
        """Return the joints' angles."""
        psi, _ = self.other(phi)
        return phi, psi, phi, psi, phi

    def energies(self, phi: Any) -> tuple[Any, Any]:
        """Return m(phi) and the potential energy."""
        psi, slope = self.other(phi)
        thin, long = mpf("0.02") / 12, (1 + mpf("0.01")) / 12
        axes = [[mpf(int(i == j)) for j in range(3)] for i in range(3)]  # columns: of the rod
        velocity, omega = [mpf(0)] * 3, [mpf(0)] * 3
        height, inertia, potential = mpf(0), mpf(0), mpf(0)
        for k, (axis, rod) in enumerate(zip(self.AXES, self.RODS, strict=True)):
            angle, rate = ((phi, mpf(1)), (psi, slope))[k % 2]
            direction = [axes[i][axis] for i in range(3)]
            omega = [w + rate * x for w, x in zip(omega, direction, strict=True)]
            axes = _rotate(axes, axis, angle)
            way = [sum(axes[i][j] * rod[j] for j in range(3)) for i in range(3)]
            turned = _cross(omega, way)
            middle = [v + x / 2 for v, x in zip(velocity, turned, strict=True)]
            along = sum(w * x for w, x in zip(omega, way, strict=True))
            square = sum(w * w for w in omega)
            inertia += sum(v * v for v in middle) + thin * along**2 + long * (square - along**2)
            potential += mpf(self.GRAVITY) * (height + way[1] / 2)
            velocity, height = [v + x for v, x in zip(velocity, turned, strict=True)], height + way[1]
        return inertia, potential

    def slowness(self, s: Any) -> Any:
        """Return dt/ds for phi = (1 - cos(s)) pi/2; s = 0 and pi, where the motion turns, are to be left out."""
        inertia, potential = self.energies(mp.pi / 2 * (1 - mp.cos(s)))
        _, start = self.energies(mpf(0))
        return mp.pi / 2 * mp.sin(s) * mp.sqrt(inertia / (2 * (start - potential)))


def find_phi(model: Bricard, time: Any, panels: int = 8, nodes: int = 40) -> tuple[Any, Any, Any]:
    """Return phi, its rate, and the period of the motion."""
    rule = _legendre(nodes)

    def pass_panel(low: Any, high: Any) -> Any:
        middle, half = (low + high) / 2, (high - low) / 2
        return half * sum(w * model.slowness(middle + half * x) for x, w in rule)

    edges = [mp.pi * k / panels for k in range(panels + 1)]
    swing = [pass_panel(*pair) for pair in pairwise(edges)]
    period = 2 * sum(swing)
    rest = time - period * mp.floor(time / period)
    is_back = rest > period / 2
    rest = period - rest if is_back else rest
    k = next(k for k in range(panels) if sum(swing[: k + 1]) >= rest)
    s = (edges[k] + edges[k + 1]) / 2
    for _ in range(60):
        error = sum(swing[:k]) + pass_panel(edges[k], s) - rest
        s -= error / model.slowness(s)
        if abs(error) < mpf(10) ** (5 - mp.dps):
            rate = mp.pi / 2 * mp.sin(s) / model.slowness(s)
            return mp.pi / 2 * (1 - mp.cos(s)), -rate if is_back else rate, period
    raise ArithmeticError("Newton's method on the quadrature does not converge")


def _rotate(axes: Sequence[Sequence[Any]], axis: int, angle: Any) -> list[list[Any]]:
    """Turn axes, columns, about one of them."""
    j, k, c, s = (axis + 1) % 3, (axis + 2) % 3, mp.cos(angle), mp.sin(angle)
    turned = [list(row) for row in axes]
    for row, new in zip(axes, turned, strict=True):
        new[j], new[k] = c * row[j] + s * row[k], c * row[k] - s * row[j]
    return turned


def _cross(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


# --- four-bars ----------------------------------------------------------------------------------------------------


def find_tilt(bars: int, time: Any, nodes: int = 40, panels: int = 16) -> tuple[Any, Any]:
    """Return the angle of the upright rods of N four-bars from the vertical, and its rate; they turn on and on.

    m = (N + 1)/3 + N, V = g cos(angle) ((N + 1)/2 + N).
    """
    inertia, weight = mpf(bars + 1) / 3 + bars, mpf("9.81") * (mpf(bars + 1) / 2 + bars)
    rule = _legendre(nodes)

    def rate(angle: Any) -> Any:
        return mp.sqrt(1 + 2 * weight * (1 - mp.cos(angle)) / inertia)

    def pass_panel(low: Any, high: Any) -> Any:
        middle, half = (low + high) / 2, (high - low) / 2
        return half * sum(w / rate(middle + half * x) for x, w in rule)

    edges = [2 * mp.pi * k / panels for k in range(panels + 1)]
    turn = [pass_panel(*pair) for pair in pairwise(edges)]
    turns = mp.floor(time / sum(turn))
    rest = time - turns * sum(turn)
    k = next(k for k in range(panels) if sum(turn[: k + 1]) >= rest)
    angle = (edges[k] + edges[k + 1]) / 2
    for _ in range(60):
        error = sum(turn[:k]) + pass_panel(edges[k], angle) - rest
        angle -= error * rate(angle)
        if abs(error) < mpf(10) ** (5 - mp.dps):
            return 2 * mp.pi * turns + angle, rate(angle)
    raise ArithmeticError("Newton's method on the quadrature does not converge")


# --- the flyball governor -----------------------------------------------------------------------------------------


class Flyball:
    """The derivative of (s, sd, alpha, alphad, turn); massless springs, both rods alike."""

    START = ("0.5", "0", "0.523598775598298873077107230546583814", "0", "0")

    def __init__(self) -> None:
        """Compute masses and moments of inertia."""
        long, rod, ball, slider = np.longdouble, *map(np.longdouble, ("0.3", "5", "3"))
        self.stiffness, self.damping, self.slack = long(8e5), long(4e4), long("0.5")
        self.gravity, self.offset, self.slider = long("9.81"), long("0.05"), slider
        section = long("0.0001")
        self.thin = rod * section / 6
        self.long = rod * (1 + section) / 12
        self.rod, self.ball = rod, ball
        self.fixed = self.thin + slider * long("0.01") / 6
        self.swing = self.long + rod / 4 + ball
        alpha = long(self.START[2])
        self.momentum = self.spin(alpha) * 2 * long(str(mp.pi))

    def spin(self, alpha: Any) -> Any:
        """Return the moment of inertia about the shaft."""
        c, s = np.cos(alpha), np.sin(alpha)
        own = self.long * c**2 + self.thin * s**2
        return self.fixed + 2 * (own + self.rod * (self.offset + c / 2) ** 2 + self.ball * (self.offset + c) ** 2)

    def spin_slope(self, alpha: Any) -> Any:
        """Return the derivative of the moment of inertia by alpha."""
        c, s = np.cos(alpha), np.sin(alpha)
        arms = self.rod * (self.offset + c / 2) * s / 2 + self.ball * (self.offset + c) * s
        return 2 * (2 * (self.thin - self.long) * c * s - 2 * arms)

    def __call__(self, y: Long) -> Long:
        """Return the derivative of states, columns."""
        s, sd, alpha, alphad, _ = y
        c, sine = np.cos(alpha), np.sin(alpha)
        up = 1 - s
        length = np.sqrt(np.longdouble("0.25") + up**2 - up * sine)
        by_s, by_alpha = (sine - 2 * up) / (2 * length), -up * c / (2 * length)
        force = -self.stiffness * (length - self.slack) - self.damping * (by_s * sd + by_alpha * alphad)
        omega = self.momentum / self.spin(alpha)
        weight = self.gravity * (self.rod / 2 + self.ball) * c
        sdd = -self.gravity + 2 * force * by_s / self.slider
        alphadd = (force * by_alpha + weight + self.spin_slope(alpha) * omega**2 / 4) / self.swing
        return np.array([sd, sdd, alphad, alphadd, omega])


def integrate_stiff(
    rhs: Callable[[Long], Long], start: Long, steps: Sequence[tuple[float, int]], stages: int = 8
) -> list[Long]:
    """Return the states at the end of spans (length, number of steps), by Radau IIA of order 2 stages - 1."""
    A = _radau(stages)
    size, y, found = len(start), start, []
    for span, number in steps:
        h = np.longdouble(span) / number
        for _ in range(number):
            K = np.repeat(rhs(y[:, None]), stages, axis=1)
            slope = _differentiate(rhs, y)
            matrix = np.eye(size * stages, dtype=np.longdouble) - h * np.kron(A, slope)
            factors = _factorise(matrix)
            last = np.longdouble("inf")
            while True:  # until rounding keeps the steps from shrinking
                residual = rhs(y[:, None] + h * K @ A.T) - K
                step = _solve(factors, residual.T.ravel()).reshape(stages, size).T
                K, change = K + step, np.abs(h * step).max()
                if not 0 < change <= last / 2:
                    break
                last = change
            if not last < np.longdouble("1e-14"):
                raise ArithmeticError("Newton's method does not converge; take more steps")
            y = y + h * K @ A[-1]
        found.append(y)
    return found


def _radau(stages: int) -> Long:
    """Return the coefficients of Radau IIA."""
    with mp.workdps(40):
        before, p = [mpf(1)], [mpf(0), mpf(1)]  # Legendre polynomials by powers of x
        for k in range(2, stages + 1):
            shifted = [mpf(0), *((2 * k - 1) * c for c in p)]
            padded = before + [mpf(0)] * (len(shifted) - len(before))
            before, p = p, [(a - (k - 1) * b) / k for a, b in zip(shifted, padded, strict=True)]
        difference = [a - b for a, b in zip(p, [*before, mpf(0)], strict=True)]
        roots = sorted((1 + r) / 2 for r in mp.polyroots(difference[::-1], maxsteps=500, extraprec=400))
        c = [r.real for r in roots]
        powers = mp.matrix([[x**k for x in c] for k in range(stages)])
        A = [list(mp.lu_solve(powers, mp.matrix([x ** (k + 1) / (k + 1) for k in range(stages)]))) for x in c]
        return np.array([[np.longdouble(mp.nstr(a, 25)) for a in row] for row in A])


def _differentiate(rhs: Callable[[Long], Long], y: Long) -> Long:
    """Return the Jacobian by central differences; it serves Newton's method alone."""
    width = np.longdouble("1e-6")
    shift = width * np.eye(len(y), dtype=np.longdouble)
    return (rhs(y[:, None] + shift) - rhs(y[:, None] - shift)) / (2 * width)


def _factorise(matrix: Long) -> tuple[Long, list[int]]:
    """Return the LU factors with the rows' order; numpy's own solver has 53 bits."""
    lu, order = matrix.copy(), list(range(len(matrix)))
    for k in range(len(lu)):
        p = k + int(np.abs(lu[k:, k]).argmax())
        lu[[k, p]], order[k], order[p] = lu[[p, k]], order[p], order[k]
        lu[k + 1 :, k] /= lu[k, k]
        lu[k + 1 :, k + 1 :] -= np.outer(lu[k + 1 :, k], lu[k, k + 1 :])
    return lu, order


def _solve(factors: tuple[Long, list[int]], right: Long) -> Long:
    lu, order = factors
    x = right[order]
    for k in range(len(lu)):
        x[k] -= lu[k, :k] @ x[:k]
    for k in reversed(range(len(lu))):
        x[k] = (x[k] - lu[k, k + 1 :] @ x[k + 1 :]) / lu[k, k]
    return x


# --- the double pendulum ------------------------------------------------------------------------------------------


def swing_twice(y: Sequence[Any]) -> list[Any]:
    """Return the derivative of (a, b, ad, bd): angles from the vertical of two rods of 1 m with points of 1 kg."""
    a, b, ad, bd = y
    g, c, s = mpf("9.81"), mp.cos(a - b), mp.sin(a - b)
    first = -(bd**2) * s - 2 * g * mp.sin(a)  # 2 add + c bdd
    second = ad**2 * s - g * mp.sin(b)  # c add + bdd
    determinant = 2 - c**2
    return [ad, bd, (first - c * second) / determinant, (2 * second - c * first) / determinant]


def extrapolate(
    rhs: Callable[[Sequence[Any]], Sequence[Any]], start: Sequence[Any], span: Any, steps: int, columns: int = 12
) -> list[Any]:
    """Return the state at the end of a span: Gragg's midpoint rule, extrapolated to order 2 columns."""
    y, h = list(start), span / steps
    counts = [2 * (k + 1) for k in range(columns)]
    for _ in range(steps):
        table: list[list[Any]] = []
        for k, n in enumerate(counts):
            row = [_pass_midpoints(rhs, y, h, n)]
            for j in range(1, k + 1):
                ratio = mpf(n * n) / (counts[k - j] ** 2) - 1
                row.append([p + (p - q) / ratio for p, q in zip(row[-1], table[k - 1][j - 1], strict=True)])
            table.append(row)
        y = table[-1][-1]
    return y


def _pass_midpoints(rhs: Callable[[Sequence[Any]], Sequence[Any]], y: Sequence[Any], h: Any, n: int) -> list[Any]:
    step = h / n
    before, now = list(y), [a + step * b for a, b in zip(y, rhs(y), strict=True)]
    for _ in range(n - 1):
        before, now = now, [a + 2 * step * b for a, b in zip(before, rhs(now), strict=True)]
    after = [a + 2 * step * b for a, b in zip(before, rhs(now), strict=True)]
    return [(a + 2 * b + c) / 4 for a, b, c in zip(before, now, after, strict=True)]


# --- files --------------------------------------------------------------------------------------------------------


def write_references() -> dict[str, dict[str, Any]]:
    """Compute the content of all files, by name."""
    with mp.workdps(DIGITS):
        return {
            "loops_andrews": _refer_andrews(),
            "loops_bricard": _refer_bricard(),
            "loops_four_bars": _refer_four_bars(),
            "loops_flyball": _refer_flyball(),
            "loops_double_pendulum": _refer_double_pendulum(),
        }


def _refer_andrews() -> dict[str, Any]:
    model, motion = Andrews(), {}
    for time in ("0.01", "0.03", "0.05"):
        beta = find_beta(model, mpf(time))
        motion[time] = _print({"angles": model.angles(beta), "rates": model.speeds(beta)})
    return {
        "source": "quadrature of the energy over beta, in closed form; 40 points of Gauss in panels of 0.2 rad",
        "order": list(model.ANGLES),
        "motion": motion,
    }


def _refer_bricard() -> dict[str, Any]:
    model, motion, period = Bricard(), {}, mpf(0)
    for time in ("1", "2", "4", "8", "10"):
        phi, rate, period = find_phi(model, mpf(time), 16)
        psi, slope = model.other(phi)
        motion[time] = _print({"angles": (phi, psi), "rates": (rate, slope * rate)})
    return {
        "source": "quadrature of the energy over phi, in closed form; 40 points of Gauss in 16 panels",
        "order": ["q1 = q3 = q5", "q2 = q4"],
        "period": mp.nstr(period, WRITTEN),
        "motion": motion,
    }


def _refer_four_bars() -> dict[str, Any]:
    motion: dict[str, Any] = {}
    for bars in (1, 2, 40):
        motion[str(bars)] = {}
        for time in ("1", "5", "10", "20"):
            angle, rate = find_tilt(bars, mpf(time))
            place = mp.sin(angle), mp.cos(angle)
            velocity = rate * place[1], -rate * place[0]
            motion[str(bars)][time] = _print({"angle": (angle, rate), "place": place, "velocity": velocity})
    order = ["the angle of the upright rods, clockwise, and its rate", "x, y of B0", "its velocity"]
    return {"source": "quadrature of the energy over the angle of the rods", "order": order, "motion": motion}


def _refer_flyball() -> dict[str, Any]:
    model = Flyball()
    start = np.array([np.longdouble(x) for x in model.START])
    spans = [(0.01, 80), (0.99, 80), (1.0, 80), (3.0, 240), (5.0, 400)]
    found = integrate_stiff(model, start, spans)
    motion = {
        str(time): {"state": [np.format_float_positional(x, precision=17, trim="-") for x in y]}
        for time, y in zip(("1", "2", "5", "10"), found[1:], strict=True)
    }
    return {
        "source": "Radau IIA of order 15, 64 bits",
        "order": ["s", "sd", "alpha", "alphad", "turn"],
        "motion": motion,
    }


def _refer_double_pendulum() -> dict[str, Any]:
    y, motion = [mp.pi / 2, mp.pi / 2, mpf(0), mpf(0)], {}
    for time in ("1", "2", "3"):
        y = extrapolate(swing_twice, y, mpf(1), 20)
        motion[time] = {"state": _print({"state": y})["state"]}
    return {
        "source": "Gragg's midpoint rule, extrapolated to order 24, in 20 steps a second",
        "order": ["a", "b", "ad", "bd"],
        "motion": motion,
    }


def _print(values: dict[str, Sequence[Any]]) -> dict[str, list[str]]:
    return {name: [mp.nstr(x, WRITTEN) for x in row] for name, row in values.items()}


def main() -> None:
    """Write the files."""
    for name, content in write_references().items():
        (FOLDER / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
