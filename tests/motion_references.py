"""Motions of the community's benchmarks to 25 digits; `python -m tests.motion_references [NAME ...]` writes them.

Each motion is computed twice, by two methods, on equations that no part of the engine has written, in 50 digits. One
method is Gragg's midpoint rule, extrapolated to order 24, mostly on the equations of motion in the base's frame
(`Chain`): M and h are sums over bodies, with the Jacobians of their centres of mass. The other one is a quadrature of
the energy (`tests.loop_references`), or Gauss's collocation of order 24, on closed forms where there are any. The file
`reference/motions.json` keeps the end of each motion, and the largest difference of both.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from flint import arb, arb_mat, ctx
from mpmath import mp, mpf

from tests import loop_references

FILE = Path(__file__).parent / "reference" / "motions.json"
BITS, WRITTEN = 170, 25

Vector = list[Any]
Rhs = Callable[[Vector], Vector]


# --- methods ------------------------------------------------------------------------------------------------------


def extrapolate(rhs: Rhs, start: Vector, span: Any, steps: int, columns: int = 12) -> Vector:
    """Return the state at the end of a span: Gragg's midpoint rule, extrapolated to order 2 columns."""
    y, h = list(start), arb(span) / steps
    counts = [2 * (k + 1) for k in range(columns)]
    for _ in range(steps):
        first, rows = rhs(y), []
        for n in counts:
            step = h / n
            before, now = y, [a + step * b for a, b in zip(y, first, strict=True)]
            for _ in range(n - 1):
                before, now = now, [a + 2 * step * b for a, b in zip(before, rhs(_centre(now)), strict=True)]
            after = [a + 2 * step * b for a, b in zip(before, rhs(_centre(now)), strict=True)]
            rows.append([(a + 2 * b + c) / 4 for a, b, c in zip(before, now, after, strict=True)])
        for j in range(1, columns):  # Neville's scheme
            ratios = [arb(counts[k] ** 2) / counts[k - j] ** 2 - 1 for k in range(j, columns)]
            rows = [
                [q + (q - p) / ratio for p, q in zip(*pair, strict=True)]
                for pair, ratio in zip(pairwise(rows), ratios, strict=True)
            ]
        y = _centre(rows[0])
    return y


def collocate(rhs: Rhs, start: Vector, span: Any, steps: int, stages: int = 12, solved: str = "1e-40") -> Vector:
    """Return the state at the end of a span, by Gauss's collocation; its equations are solved by repetition."""
    A = _gauss(stages)
    weights = [arb.legendre_p_root(stages, stages - 1 - k, weight=True)[1] / 2 for k in range(stages)]
    y, h = list(start), arb(span) / steps
    for _ in range(steps):
        K = [rhs(y)] * stages
        for _ in range(200):
            inner = [
                [a + h * _dot(row, column) for a, column in zip(y, zip(*K, strict=True), strict=True)] for row in A
            ]
            new = [rhs(_centre(state)) for state in inner]
            change = max(
                abs(a - b).mid() for old, row in zip(K, new, strict=True) for a, b in zip(old, row, strict=True)
            )
            K = new
            if h * change < arb(solved):
                break
        else:
            raise ArithmeticError("the equations of a step are not solved; take more steps")
        y = _centre([a + h * _dot(weights, column) for a, column in zip(y, zip(*K, strict=True), strict=True)])
    return y


def _gauss(stages: int) -> list[Vector]:
    """Return the coefficients of Gauss's collocation."""
    nodes = [(1 + arb.legendre_p_root(stages, stages - 1 - k)) / 2 for k in range(stages)]
    powers = arb_mat([[x**k for x in nodes] for k in range(stages)])
    right = arb_mat([[x ** (k + 1) / (k + 1) for x in nodes] for k in range(stages)])
    return powers.solve(right).transpose().tolist()


def _centre(values: Vector) -> Vector:
    """Return the middles of intervals: their radii, which would grow from step to step, are left out."""
    return [x.mid() for x in values]


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def _solve(matrix: list[Vector], right: Vector) -> Vector:
    solution = arb_mat([_centre(row) for row in matrix]).solve(arb_mat([[x.mid()] for x in right]))
    return [row[0] for row in solution.tolist()]


# --- vectors ------------------------------------------------------------------------------------------------------

ZERO = [arb(0)] * 3
UNIT = {"x": [arb(1), arb(0), arb(0)], "y": [arb(0), arb(1), arb(0)], "z": [arb(0), arb(0), arb(1)]}
IDENTITY = [UNIT["x"], UNIT["y"], UNIT["z"]]


def _cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _add(*vectors: Vector) -> Vector:
    return [sum(entries[1:], entries[0]) for entries in zip(*vectors, strict=True)]


def _scale(x: Any, a: Vector) -> Vector:
    return [x * y for y in a]


def _apply(matrix: list[Vector], a: Vector) -> Vector:
    return [row[0] * a[0] + row[1] * a[1] + row[2] * a[2] for row in matrix]


def _multiply(a: list[Vector], b: list[Vector]) -> list[Vector]:
    columns = list(zip(*b, strict=True))
    return [[row[0] * c[0] + row[1] * c[1] + row[2] * c[2] for c in columns] for row in a]


def _turn(axis: Vector, angle: Any) -> list[Vector]:
    """Return the rotation about an axis, by Rodrigues' formula."""
    s, c = angle.sin_cos()
    x, y, z = axis
    v = 1 - c
    return [
        [c + v * x * x, v * x * y - s * z, v * x * z + s * y],
        [v * x * y + s * z, c + v * y * y, v * y * z - s * x],
        [v * x * z - s * y, v * y * z + s * x, c + v * z * z],
    ]


def read_vector(text: str) -> Vector:
    """Return a vector of decimal numbers."""
    return [arb(x) for x in text.split()]


# --- any tree of bodies, in the base's frame ----------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """A body: its joint turns about an axis, or slides along it; frames are parallel where coordinates are 0."""

    parent: int  # from 0; -1 is the base
    axis: Vector
    place: Vector  # of the joint, in the parent's frame
    mass: Any
    com: Vector
    inertia: list[Vector]  # about the centre of mass
    slides: bool = False


@dataclass(frozen=True)
class Tie:
    """A spring without mass from a point of a part to a fixed point."""

    part: int
    point: Vector
    anchor: Vector
    stiffness: Any
    slack: Any


@dataclass(frozen=True)
class Pin:
    """Two points of parts (-1: the base) that stay together along some axes of the base."""

    first: tuple[int, Vector]
    second: tuple[int, Vector]
    along: tuple[int, ...] = (0, 1)


@dataclass(frozen=True)
class Wheel:
    """A part that rolls on the plane z = 0 about an axis, with a sharp edge."""

    part: int
    axis: Vector
    radius: Any


@dataclass
class _State:
    """A part that moves: origin, axes as columns, angular velocity; accelerations are those where qdd = 0."""

    origin: Vector
    R: list[Vector]
    omega: Vector
    alpha: Vector
    acceleration: Vector
    joints: tuple[int, ...]


@dataclass(frozen=True)
class Chain:
    """A mechanism; its equations of motion are M qdd + h = J' lam, J qdd + bias = 0."""

    parts: Sequence[Part]
    gravity: Vector
    pins: Sequence[Pin] = ()
    wheels: Sequence[Wheel] = ()
    ties: Sequence[Tie] = ()
    torques: dict[int, Any] = field(default_factory=dict)

    def __call__(self, y: Vector) -> Vector:
        """Return the derivative of (q, qd)."""
        n = len(self.parts)
        q, qd = y[:n], y[n:]
        M, h, states, axes = self.form(q, qd)
        rows = [*self._close(states, axes), *self._roll(states, axes)]
        if not rows:
            return [*qd, *_solve(M, [-x for x in h])]
        J = [row for row, _ in rows]
        m = len(rows)
        matrix = [[*M[i], *(J[k][i] for k in range(m))] for i in range(n)] + [[*row, *[arb(0)] * m] for row in J]
        return [*qd, *_solve(matrix, [-x for x in h] + [-bias for _, bias in rows])[:n]]

    def form(self, q: Vector, qd: Vector) -> tuple[list[Vector], Vector, list[_State], list[tuple[Vector, Vector]]]:
        """Return M, h, how parts move, and the axes and points of all joints."""
        states, axes = self._move(q, qd)
        n = len(self.parts)
        M = [[arb(0)] * n for _ in range(n)]
        h = [-self.torques.get(k, arb(0)) for k in range(n)]
        for part, state in zip(self.parts, states, strict=True):
            if part.mass == 0:
                continue
            arm = _apply(state.R, part.com)
            place = _add(state.origin, arm)
            I = _multiply(_multiply(state.R, part.inertia), [list(x) for x in zip(*state.R, strict=True)])
            force = _scale(part.mass, _add(self._accelerate(state, arm), _scale(-1, self.gravity)))
            moment = _add(_apply(I, state.alpha), _cross(state.omega, _apply(I, state.omega)))
            columns = {j: self._column(j, axes, place) for j in state.joints}
            turned = {j: _apply(I, w) for j, (_, w) in columns.items()}
            for j, (v, w) in columns.items():
                h[j] += _dot(v, force) + _dot(w, moment)
                for k, (other, _) in columns.items():
                    if k <= j:
                        M[j][k] += part.mass * _dot(v, other) + _dot(w, turned[k])
        for tie in self.ties:
            state = states[tie.part]
            place = _add(state.origin, _apply(state.R, tie.point))
            way = _add(place, _scale(-1, tie.anchor))
            length = _dot(way, way).sqrt()
            pull = _scale(tie.stiffness * (1 - tie.slack / length), way)
            for j in state.joints:
                h[j] += _dot(self._column(j, axes, place)[0], pull)
        for j in range(n):
            for k in range(j):
                M[k][j] = M[j][k]
        return M, h, states, axes

    def _move(self, q: Vector, qd: Vector) -> tuple[list[_State], list[tuple[Vector, Vector]]]:
        base = _State(ZERO, IDENTITY, ZERO, ZERO, ZERO, ())
        states: list[_State] = []
        axes = []
        for k, part in enumerate(self.parts):
            below = base if part.parent < 0 else states[part.parent]
            axis = _apply(below.R, part.axis)
            spin = _cross(below.omega, axis)
            slide = _scale(q[k], axis) if part.slides else ZERO
            arm = _add(_apply(below.R, part.place), slide)
            origin = _add(below.origin, arm)
            acceleration = self._accelerate(below, arm)
            R, omega, alpha = below.R, below.omega, below.alpha
            if part.slides:
                acceleration = _add(acceleration, _scale(2 * qd[k], spin))
            else:
                R, omega = _multiply(R, _turn(part.axis, q[k])), _add(omega, _scale(qd[k], axis))
                alpha = _add(alpha, _scale(qd[k], spin))
            states.append(_State(origin, R, omega, alpha, acceleration, (*below.joints, k)))
            axes.append((axis, origin))
        return states, axes

    @staticmethod
    def _accelerate(state: _State, arm: Vector) -> Vector:
        turning = _cross(state.omega, _cross(state.omega, arm))
        return _add(state.acceleration, _cross(state.alpha, arm), turning)

    def _column(self, joint: int, axes: list[tuple[Vector, Vector]], place: Vector) -> tuple[Vector, Vector]:
        """Return the velocity of a point, and the angular velocity, for a unit rate of a joint."""
        axis, origin = axes[joint]
        if self.parts[joint].slides:
            return axis, ZERO
        return _cross(axis, _add(place, _scale(-1, origin))), axis

    def _close(self, states: list[_State], axes: list[tuple[Vector, Vector]]) -> list[tuple[Vector, Any]]:
        rows = []
        for pin in self.pins:
            ends = []
            for number, point in (pin.first, pin.second):
                row: list[Vector] = [ZERO] * len(self.parts)
                bias = ZERO
                if number >= 0:
                    state = states[number]
                    arm = _apply(state.R, point)
                    bias = self._accelerate(state, arm)
                    for j in state.joints:
                        row[j] = self._column(j, axes, _add(state.origin, arm))[0]
                ends.append((row, bias))
            (a, p), (b, r) = ends
            rows += [([u[i] - v[i] for u, v in zip(a, b, strict=True)], p[i] - r[i]) for i in pin.along]
        return rows

    def _roll(self, states: list[_State], axes: list[tuple[Vector, Vector]]) -> list[tuple[Vector, Any]]:
        """Return the rows of v + omega x r d = 0: the point of the wheel that touches the plane is at rest."""
        rows = []
        for wheel in self.wheels:
            state = states[wheel.part]
            a = _apply(state.R, wheel.axis)
            ad = _cross(state.omega, a)
            u, ud = _add(_scale(a[2], a), _scale(-1, UNIT["z"])), _add(_scale(ad[2], a), _scale(a[2], ad))
            size = _dot(u, u).sqrt()
            d = _scale(1 / size, u)
            dd = _scale(1 / size, _add(ud, _scale(-_dot(d, ud), d)))
            arm, rate = _scale(wheel.radius, d), _scale(wheel.radius, dd)
            bias = _add(state.acceleration, _cross(state.alpha, arm), _cross(state.omega, rate))
            columns = [
                self._column(j, axes, _add(state.origin, arm))[0] if j in state.joints else ZERO
                for j in range(len(self.parts))
            ]
            rows += [([column[i] for column in columns], bias[i]) for i in range(3)]
        return rows


def reduce(chain: Chain, follow: Callable[[Any], tuple[Vector, Vector, Vector]]) -> Rhs:
    """Return the derivative of (x, xd) of a mechanism with one freedom, of which all q are functions.

    `follow` returns q, dq/dx and its derivative by x.
    """

    def rhs(y: Vector) -> Vector:
        q, N, slope = follow(y[0])
        M, h, _, _ = chain.form(q, _scale(y[1], N))
        load = _add([_dot(row, slope) * y[1] ** 2 for row in M], h)
        return [y[1], -_dot(N, load) / _dot(N, [_dot(row, N) for row in M])]

    return rhs


# --- the mechanisms -----------------------------------------------------------------------------------------------


def _diagonal(text: str) -> list[Vector]:
    return [[x if i == j else arb(0) for j in range(3)] for i, x in enumerate(read_vector(text))]


def _rod(parent: int, place: Vector, way: Vector, mass: Any = None) -> Part:
    """Return a thin rod of a given way from joint to tip that turns about z."""
    mass = arb(1) if mass is None else mass
    square = _dot(way, way)
    inertia = [[mass * (square * int(i == j) - way[i] * way[j]) / 12 for j in range(3)] for i in range(3)]
    return Part(parent, UNIT["z"], place, mass, _scale(arb("0.5"), way), inertia)


def make_pendulum() -> Chain:
    """Return A01: a point of 1 kg on 1 m; the angle is 0 where it hangs."""
    point = [arb(0), arb(-1), arb(0)]
    return Chain([Part(-1, UNIT["z"], ZERO, arb(1), point, [ZERO] * 3)], read_vector("0 -9.81 0"))


def make_four_bars() -> Chain:
    """Return A02 with two four-bars: uprights 0, 2, 4 and levels 1, 3 of 1 m and 1 kg."""
    up, level = UNIT["y"], UNIT["x"]
    place = [ZERO, up, UNIT["x"], up, _scale(2, UNIT["x"])]
    parts = [_rod(p, at, way) for p, at, way in zip((-1, 0, -1, 2, -1), place, (up, level) * 2 + (up,), strict=True)]
    return Chain(parts, read_vector("0 -9.81 0"))


def make_andrews() -> Chain:
    """Return A03: bodies K1, K2, K3, K5, K4, K7, K6 with angles beta, theta, gamma, delta, phi, epsilon, omega."""
    z = UNIT["z"]

    def part(parent: int, place: str, mass: str, com: str, inertia: str) -> Part:
        I = [ZERO, ZERO, [arb(0), arb(0), arb(inertia)]]
        return Part(parent, z, read_vector(place), arb(mass), read_vector(com), I)

    A, B = "-0.06934 -0.00227 0", "-0.03635 0.03273 0"
    parts = [
        part(-1, "0 0 0", "0.04325", "0.00092 0 0", "2.194e-6"),  # K1: to F
        part(0, "0.007 0 0", "0.00365", "-0.0115 0 0", "4.410e-7"),  # K2: from F back to E
        part(-1, B, "0.02373", "0.01043 -0.01874 0", "5.255e-6"),  # K3: E at (0, -0.035)
        part(-1, A, "0.07050", "0.02308 0.00916 0", "1.169e-5"),  # K5: to G
        part(3, "0.04 0 0", "0.00706", "0 -0.00579 0", "5.667e-7"),  # K4: from G back to E
        part(-1, A, "0.05498", "-0.00449 -0.01228 0", "1.912e-5"),  # K7: H at (0, -0.04)
        part(5, "0 -0.04 0", "0.00706", "0.00579 0 0", "5.667e-7"),  # K6: from H back to E
    ]
    E = read_vector("0 -0.035 0")
    pins = [
        Pin((1, read_vector("-0.028 0 0")), (2, E)),
        Pin((4, read_vector("0 -0.02 0")), (2, E)),
        Pin((6, read_vector("0.02 0 0")), (2, E)),
    ]
    tie = Tie(2, read_vector("0.02 -0.018 0"), read_vector("0.014 0.072 0"), arb(4530), arb("0.07785"))
    return Chain(parts, ZERO, pins, ties=[tie], torques={0: arb("0.033")})


def make_bricard() -> Chain:
    """Return A04, with the loop open: five rods with square sections, each along an edge of a cube at first."""
    thin, long = arb("0.02") / 12, arb("1.01") / 12
    parts = []
    for k, (axis, rod) in enumerate(zip("yzxyz", loop_references.Bricard.RODS, strict=True)):
        place = ZERO if k == 0 else [arb(x) for x in loop_references.Bricard.RODS[k - 1]]
        inertia = [[(thin if rod[i] else long) if i == j else arb(0) for j in range(3)] for i in range(3)]
        parts.append(Part(k - 1, UNIT[axis], place, arb(1), [arb(x) / 2 for x in rod], inertia))
    return Chain(parts, read_vector("0 -9.81 0"))


def follow_bricard(phi: Any) -> tuple[Vector, Vector, Vector]:
    """Return the angles of all joints, by sin(psi) = -sin(phi) / (1 + sin(phi)), and two derivatives."""
    s, c = phi.sin_cos()
    sine, first = -s / (1 + s), -c / (1 + s) ** 2
    second = s / (1 + s) ** 2 + 2 * c**2 / (1 + s) ** 3
    cosine = (1 - sine**2).sqrt()
    slope = first / cosine
    bend = (second + sine * slope**2) / cosine
    one, zero = arb(1), arb(0)
    pairs = ((phi, sine.asin()), (one, slope), (zero, bend))
    return tuple([a, b, a, b, a] for a, b in pairs)  # type: ignore[return-value]


CRANK, LENGTH = "0.15", "0.30"
CRANK_MASS, ROD_MASS, SLIDER_MASS = "0.36", "0.151104", "0.075552"
CRANK_INERTIA, ROD_INERTIA = "0.002727", "0.0045339259"


def make_slider_crank() -> Chain:
    """Return the slider-crank of the Test Set for IVP Solvers with a rigid rod, let go instead of driven."""

    def flat(text: str) -> list[Vector]:
        return [ZERO, ZERO, [arb(0), arb(0), arb(text)]]

    half, whole = arb("0.5"), UNIT["x"]
    first, second = _scale(arb(CRANK), whole), _scale(arb(LENGTH), whole)
    parts = [
        Part(-1, UNIT["z"], ZERO, arb(CRANK_MASS), _scale(half, first), flat(CRANK_INERTIA)),
        Part(0, UNIT["z"], first, arb(ROD_MASS), _scale(half, second), flat(ROD_INERTIA)),
        Part(-1, UNIT["x"], ZERO, arb(SLIDER_MASS), ZERO, [ZERO] * 3, slides=True),
    ]
    return Chain(parts, ZERO, [Pin((1, second), (2, ZERO))])


def find_crank(time: Any) -> tuple[Any, Any]:
    """Return the angle of the crank, which starts with 150 rad/s at 0, and its rate: a quadrature of the energy."""
    l1, l2, m1, m2, m3 = map(mpf, (CRANK, LENGTH, CRANK_MASS, ROD_MASS, SLIDER_MASS))
    J1, J2 = mpf(CRANK_INERTIA) + m1 * l1**2 / 4, mpf(ROD_INERTIA)

    def inertia(phi: Any) -> Any:
        lean = -l1 * mp.cos(phi) / mp.sqrt(l2**2 - (l1 * mp.sin(phi)) ** 2)  # rate of the rod for a unit rate
        tip = 1j * l1 * mp.expj(phi)
        along = mp.expj(mp.asin(-l1 * mp.sin(phi) / l2))
        middle, end = tip + 1j * lean * l2 / 2 * along, tip + 1j * lean * l2 * along
        return J1 + J2 * lean**2 + m2 * abs(middle) ** 2 + m3 * abs(end) ** 2

    first, rule = inertia(mpf(0)), loop_references._legendre(40)

    def rate(phi: Any) -> Any:
        return 150 * mp.sqrt(first / inertia(phi))

    def wait(low: Any, high: Any) -> Any:
        middle, half = (low + high) / 2, (high - low) / 2
        return half * sum(w / rate(middle + half * x) for x, w in rule)

    t, phi, width = mpf(0), mpf(0), mp.pi / 24
    while t + (step := wait(phi, phi + width)) < time:
        t, phi = t + step, phi + width
    low = phi
    for _ in range(60):
        error = t + wait(low, phi) - time
        phi -= error * rate(phi)
        if abs(error) < mpf(10) ** (5 - mp.dps):
            return phi, rate(phi)
    raise ArithmeticError("Newton's method on the quadrature does not converge")


def make_top(mass: str, com: str, inertia: str, gravity: str) -> Chain:
    """Return a rigid body about a fixed point, by rotations about z, x and y."""
    light = [Part(k, UNIT[axis], ZERO, arb(0), ZERO, [ZERO] * 3) for k, axis in ((-1, "z"), (0, "x"))]
    body = Part(1, UNIT["y"], ZERO, arb(mass), read_vector(com), _diagonal(inertia))
    return Chain([*light, body], read_vector(gravity))


def turn_top(chain: Chain) -> Rhs:
    """Return Euler's and Poisson's equations of a top: the derivative of (R by rows, omega in the body's frame)."""
    body = chain.parts[2]
    square = _dot(body.com, body.com)
    I = [
        [body.inertia[i][j] + body.mass * (square * int(i == j) - body.com[i] * body.com[j]) for j in range(3)]
        for i in range(3)
    ]

    def rhs(y: Vector) -> Vector:
        R, omega = [y[0:3], y[3:6], y[6:9]], y[9:12]
        down = [_dot(column, chain.gravity) for column in zip(*R, strict=True)]
        moment = _add(_scale(body.mass, _cross(body.com, down)), _scale(-1, _cross(omega, _apply(I, omega))))
        # rows of R omega~: (R omega~)_i = R_i x omega
        return [*(x for row in R for x in _cross(row, omega)), *_solve(I, moment)]

    return rhs


def start_top(q: Vector, qd: Vector) -> Vector:
    """Return R and omega for angles about z, x and y."""
    turns = [_turn(UNIT[axis], x) for axis, x in zip("zxy", q, strict=True)]
    R = _multiply(_multiply(turns[0], turns[1]), turns[2])
    s, c = q[0].sin_cos()
    columns = [UNIT["z"], [c, s, arb(0)], [row[1] for row in R]]
    omega = _add(*(_scale(x, axis) for x, axis in zip(qd, columns, strict=True)))
    return [*(x for row in R for x in row), *(_dot(column, omega) for column in zip(*R, strict=True))]


def read_top(y: Vector, near: Vector) -> Vector:
    """Return angles about z, x, y, whole turns as in `near`, and their rates."""
    R = [y[0:3], y[3:6], y[6:9]]
    angles = [arb.atan2(-R[0][1], R[1][1]), R[2][1].asin(), arb.atan2(-R[2][0], R[2][2])]
    turns = [round(float((a - b) / (2 * arb.pi()))) for a, b in zip(near, angles, strict=False)]
    angles = [x + 2 * arb.pi() * n for x, n in zip(angles, turns, strict=True)]
    (s, c), omega = angles[0].sin_cos(), _apply(R, y[9:12])
    spin = (c * omega[1] - s * omega[0]) / angles[1].cos()
    return _centre([*angles, omega[2] - spin * angles[1].sin(), c * omega[0] + s * omega[1], spin])


def make_rods(count: int) -> Chain:
    """Return a chain of rods of 1 m and 1 kg that turn about z; at 0 they lie along x."""
    x = UNIT["x"]
    return Chain([_rod(k - 1, x if k else ZERO, x) for k in range(count)], read_vector("0 -9.81 0"))


def swing_rods(count: int) -> Rhs:
    """Return the equation of the chain in angles from x: sum of c_ij (cos(a_i - a_j) add_j + sin(a_i - a_j) ad_j^2)."""
    below = [arb(count - 1 - k) for k in range(count)]
    shares = [[below[max(i, j)] + (arb(1) / 3 if i == j else arb("0.5")) for j in range(count)] for i in range(count)]
    weights = [arb("9.81") * (below[k] + arb("0.5")) for k in range(count)]

    def rhs(y: Vector) -> Vector:
        a, ad = y[:count], y[count:]
        turned = [x.sin_cos() for x in a]
        square = [x * x for x in ad]
        M = [[arb(0)] * count for _ in range(count)]
        right = [-w * c for w, (_, c) in zip(weights, turned, strict=True)]
        for i, (s, c) in enumerate(turned):
            for j in range(i):
                S, C = turned[j]
                M[i][j] = M[j][i] = shares[i][j] * (c * C + s * S)
                sine = shares[i][j] * (s * C - c * S)
                right[i] -= sine * square[j]
                right[j] += sine * square[i]
            M[i][i] = shares[i][i]
        return [*ad, *_solve(M, right)]

    return rhs


def swing_governor(y: Vector) -> Vector:
    """Return the derivative of (turn, s, alpha, sd, alphad) of A05: Lagrange's equations of slider and rods.

    With the shaft's momentum p = C(alpha) omega, the rods feel p^2 C' / (2 C^2).
    """
    _, s, alpha, sd, ad = y
    rod, ball, slider, g, section = arb("0.3"), arb(5), arb(3), arb("9.81"), arb("1e-4")
    long, thin = rod * (1 + section) / 12, rod * section / 6

    def spin(sine: Any, cosine: Any) -> tuple[Any, Any]:
        near, far = arb("0.05") + cosine / 2, arb("0.05") + cosine
        each = long * cosine**2 + thin * sine**2 + rod * near**2 + ball * far**2
        slope = 2 * (thin - long) * sine * cosine - sine * (rod * near + 2 * ball * far)
        return thin + slider * arb("0.01") / 6 + 2 * each, 2 * slope

    momentum = 2 * arb.pi() * spin(arb("0.5"), arb(3).sqrt() / 2)[0]
    sine, cosine = alpha.sin_cos()
    C, slope = spin(sine, cosine)
    up = 1 - s
    length = (arb("0.25") + up * up - up * sine).sqrt()
    by_s, by_alpha = (sine / 2 - up) / length, -up * cosine / (2 * length)
    force = arb(800000) * (length - arb("0.5")) + arb(40000) * (by_s * sd + by_alpha * ad)
    sdd = -g - 2 * force * by_s / slider
    swing = 2 * (long + rod / 4 + ball)
    weight = 2 * g * (rod / 2 + ball) * cosine
    add = (weight - 2 * force * by_alpha + momentum**2 * slope / (2 * C * C)) / swing
    return [momentum / C, sd, ad, sdd, add]


def make_bicycle() -> Chain:
    """Return Whipple's bicycle with the numbers of Meijaard and others (2007); z points up, y to the left."""
    light = [ZERO] * 3
    turn, z = arb.pi() / 10, arb(0)
    axis = [-turn.sin(), z, turn.cos()]
    w, c, rear, front = arb("1.02"), arb("0.08"), arb("0.3"), arb("0.35")

    def inertia(text: str) -> list[Vector]:
        xx, yy, zz, xz = read_vector(text)
        return [[xx, z, xz], [z, yy, z], [xz, z, zz]]

    free = [Part(k - 1, UNIT[u], ZERO, z, ZERO, light, slides=k < 3) for k, u in enumerate("xyzzx")]
    frame = Part(4, UNIT["y"], ZERO, arb(85), [arb("0.3"), z, arb("0.9") - rear], inertia("9.2 11 2.8 -2.4"))
    steer = [w + c, z, -rear]
    parts = [
        *free,
        frame,
        Part(5, UNIT["y"], ZERO, arb(2), ZERO, _diagonal("0.0603 0.12 0.0603")),
        Part(5, axis, steer, arb(4), [arb("0.9") - w - c, z, arb("0.7")], inertia("0.05892 0.06 0.00708 0.00756")),
        Part(7, UNIT["y"], [-c, z, front], arb(3), ZERO, _diagonal("0.1405 0.28 0.1405")),
    ]
    wheels = [Wheel(6, UNIT["y"], rear), Wheel(8, UNIT["y"], front)]
    return Chain(parts, read_vector("0 0 -9.81"), wheels=wheels)


def ride(chain: Chain) -> tuple[Vector, Vector]:
    """Return the start of a ride at 4.6 m/s, upright and straight on, with a rate of roll of 0.5 rad/s."""
    zero = [arb(0)] * 9
    q = [*zero[:2], arb("0.3"), *zero[3:]]
    _, _, states, axes = chain.form(q, zero)
    J = [row for row, _ in chain._roll(states, axes)]
    given = {6: arb("4.6") / arb("0.3"), 4: arb("0.5"), 7: arb(0)}
    others = [k for k in range(9) if k not in given]
    right = [-sum((row[k] * x for k, x in given.items()), arb(0)) for row in J]
    found = dict(zip(others, _solve([[row[k] for k in others] for row in J], right), strict=True)) | given
    return q, _centre([found[k] for k in range(9)])


# --- the file -----------------------------------------------------------------------------------------------------

GRAGG, GAUSS = "Gragg's rule of order 24, {} steps; {}", "Gauss's collocation of order 24, {} steps; {}"
FRAME, ENERGY = "sums over bodies in the base's frame", "quadrature of the energy"


@dataclass(frozen=True)
class Motion:
    """A start and an end, found twice: coordinates, then their rates, in the order of the model file."""

    span: str  # s
    methods: tuple[str, str]
    start: Vector
    ends: tuple[Vector, Vector]


def _convert(values: Sequence[Any]) -> Vector:
    """Return numbers of mpmath as middles of intervals."""
    return _centre([arb(mp.nstr(x, 45)) for x in values])


def _swing_pendulum() -> Motion:
    """A01: sin(q/2) = k cd(w t, k)."""
    start, span = [arb.pi() / 2, arb(0)], "10"
    with mp.workdps(45):
        k, w = mp.sqrt(mpf(1) / 2), mp.sqrt(mpf("9.81"))
        cn, dn, sn = (mp.ellipfun(name, w * mpf(span), k=k) for name in ("cn", "dn", "sn"))
        angle = 2 * mp.asin(k * cn / dn)
        rate = -2 * k * w * (1 - k**2) * sn / dn**2 / mp.cos(angle / 2)
        closed = _convert([angle, rate])
    steps = 100
    found = extrapolate(make_pendulum(), start, arb(span), steps)
    return Motion(span, (GRAGG.format(steps, FRAME), "Jacobi's functions"), start, (found, closed))


def _swing_bars() -> Motion:
    """A02 with two four-bars; all angles are +- the first, and only its equation is integrated."""
    span, steps, signs = "10", 200, [arb(x) for x in (1, -1, 1, -1, 1)]

    def expand(y: Vector) -> Vector:
        return [*_scale(y[0], signs), *_scale(y[1], signs)]

    rhs = reduce(make_four_bars(), lambda x: (_scale(x, signs), signs, [arb(0)] * 5))
    found = extrapolate(rhs, [arb(0), arb(-1)], arb(span), steps)
    with mp.workdps(45):
        closed = _convert([-x for x in loop_references.find_tilt(2, mpf(span))])
    methods = GRAGG.format(steps, FRAME), ENERGY
    return Motion(span, methods, expand([arb(0), arb(-1)]), (expand(found), expand(closed)))


def _squeeze() -> Motion:
    """A03, in the order beta, theta, gamma, delta, phi, epsilon, omega; all coordinates are integrated."""
    span, steps, model = "0.05", 200, loop_references.Andrews()
    order = [model.ANGLES.index(x) for x in ("beta", "theta", "gamma", "delta", "phi", "epsilon", "omega")]
    with mp.workdps(45):
        model = loop_references.Andrews()
        angles = model.angles(model.start)
        start = _convert([angles[k] for k in order]) + [arb(0)] * 7
        beta = loop_references.find_beta(model, mpf(span))
        closed = _convert([part[k] for part in (model.angles(beta), model.speeds(beta)) for k in order])
    found = extrapolate(make_andrews(), start, arb(span), steps)
    return Motion(span, (GRAGG.format(steps, FRAME), ENERGY), start, (found, closed))


def _swing_bricard() -> Motion:
    """A04; the angles are functions of the first, and only its equation is integrated."""
    span, steps, model = "10", 300, loop_references.Bricard()

    def expand(y: Vector) -> Vector:
        q, slope, _ = follow_bricard(y[0])
        return _centre([*q, *_scale(y[1], slope)])

    start = [arb(0), arb(0)]
    found = extrapolate(reduce(make_bricard(), follow_bricard), start, arb(span), steps)
    with mp.workdps(45):
        phi, rate, _ = loop_references.find_phi(model, mpf(span), 16)
        closed = _convert([phi, rate])
    return Motion(span, (GRAGG.format(steps, FRAME), ENERGY), expand(start), (expand(found), expand(closed)))


def _turn_governor() -> Motion:
    """A05, stiff: explicit steps are short, above all at first."""
    span, steps = "1", 1500
    start = [arb(0), arb("0.5"), arb.pi() / 6, arb(0), arb(0)]
    kept = json.loads((FILE.parent / "loops_flyball.json").read_text("utf-8"))["motion"][span]["state"]

    def expand(y: Vector) -> Vector:
        turn, s, alpha, sd, ad = y
        return [turn, s, alpha, alpha, swing_governor(y)[0], sd, ad, ad]

    found = extrapolate(swing_governor, start, arb("0.01"), 100)
    found = extrapolate(swing_governor, found, arb("0.99"), steps)
    other = [arb(kept[k]) for k in (4, 0, 2, 1, 3)]
    methods = GRAGG.format(steps, "Lagrange's equations"), "Radau IIA of order 15, 64 bits; forces on slider and rods"
    return Motion(span, methods, expand(start), (expand(found), expand(other)))


def _turn_crank() -> Motion:
    """The rigid slider-crank: crank, rod, slider; all coordinates are integrated."""
    span, steps = "0.1", 200

    def expand(y: Vector) -> Vector:
        phi, rate = y
        (s, c), ratio = phi.sin_cos(), arb(CRANK) / arb(LENGTH)
        lean = (-ratio * s).asin()
        lean_rate = -ratio * c * rate / lean.cos()
        place = arb(CRANK) * c + arb(LENGTH) * lean.cos()
        speed = -arb(CRANK) * s * rate - arb(LENGTH) * lean.sin() * lean_rate
        return _centre([phi, lean - phi, place, rate, lean_rate - rate, speed])

    start = expand([arb(0), arb(150)])
    found = extrapolate(make_slider_crank(), start, arb(span), steps)
    with mp.workdps(45):
        closed = _convert(find_crank(mpf(span)))
    return Motion(span, (GRAGG.format(steps, FRAME), ENERGY), start, (found, expand(closed)))


def _spin(chain: Chain, q: str, qd: str, span: str, steps: tuple[int, int]) -> Motion:
    start = read_vector(q), read_vector(qd)
    found = extrapolate(chain, [*start[0], *start[1]], arb(span), steps[0])
    other = read_top(collocate(turn_top(chain), start_top(*start), arb(span), steps[1]), found)
    methods = GRAGG.format(steps[0], FRAME), GAUSS.format(steps[1], "Euler's and Poisson's equations")
    return Motion(span, methods, [*start[0], *start[1]], (found, other))


def _spin_heavy() -> Motion:
    """The heavy top of Bruls, Cardona, Arnold (2012), without precession at first: theirs goes through the pole."""
    chain = make_top("15", "0 1 0", "0.234375 0.46875 0.234375", "0 0 -9.81")
    return _spin(chain, "0 0 0", "0 0 150", "1", (250, 250))


def _spin_free() -> Motion:
    """A free body near its middle axis, which turns over and over."""
    return _spin(make_top("1", "0 0 0", "1 3 2", "0 0 0"), "0 0.1 0", "2 0 -0.0665", "20", (200, 250))


def _swing_rods(count: int, span: str, steps: tuple[int, int]) -> Motion:
    start = [arb(0)] * (2 * count)

    def relate(y: Vector) -> Vector:
        halves = y[:count], y[count:]
        return _centre([x - (half[k - 1] if k else arb(0)) for half in halves for k, x in enumerate(half)])

    equation, told = swing_rods(count), "cosines and sines of differences"
    other = relate(collocate(equation, start, arb(span), steps[1]))
    found = extrapolate(make_rods(count), start, arb(span), steps[0])
    return Motion(span, (GRAGG.format(steps[0], FRAME), GAUSS.format(steps[1], told)), start, (found, other))


def _ride_bicycle() -> Motion:
    """Whipple's bicycle at 4.6 m/s, with a rate of roll of 0.5 rad/s at first."""
    chain, span, steps = make_bicycle(), "3", (60, 60)
    q, qd = ride(chain)
    start = [*q, *qd]
    ends = extrapolate(chain, start, arb(span), steps[0]), collocate(chain, start, arb(span), steps[1])
    return Motion(span, (GRAGG.format(steps[0], FRAME), GAUSS.format(steps[1], FRAME)), start, ends)


MOTIONS: dict[str, Callable[[], Motion]] = {
    "pendulum": _swing_pendulum,
    "four_bars": _swing_bars,
    "andrews": _squeeze,
    "bricard": _swing_bricard,
    "flyball": _turn_governor,
    "slider_crank": _turn_crank,
    "heavy_top": _spin_heavy,
    "free_top": _spin_free,
    "chain2": lambda: _swing_rods(2, "3", (250, 250)),
    "chain8": lambda: _swing_rods(8, "1.5", (100, 100)),
    "bicycle": _ride_bicycle,
}


def compare(first: Vector, second: Vector) -> Any:
    """Return the largest of |x - y| / (1 + |x|)."""
    return max((abs(x - y) / (1 + abs(x))).mid() for x, y in zip(first, second, strict=True))


def certify(name: str) -> dict[str, Any]:
    """Compute a motion twice. Raises ArithmeticError where both agree to less than 15 digits."""
    before, ctx.prec = ctx.prec, BITS
    try:
        motion = MOTIONS[name]()
        difference = compare(*motion.ends)
    finally:
        ctx.prec = before
    if not difference < 1e-15:
        raise ArithmeticError(f"{name}: both methods differ by {float(difference):.1e}; take more steps")
    written = [[x.str(WRITTEN, radius=False) for x in values] for values in (motion.start, motion.ends[0])]
    return {
        "span": motion.span,
        "methods": list(motion.methods),
        "difference": f"{float(difference):.0e}",
        "start": written[0],
        "end": written[1],
    }


def main(names: Sequence[str]) -> None:
    """Write the motions of the given names, or of all."""
    for name in names or MOTIONS:
        found = certify(name)
        content = (json.loads(FILE.read_text("utf-8")) if FILE.exists() else {}) | {name: found}
        kept = {key: content[key] for key in MOTIONS if key in content}
        FILE.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
