"""Exciting motions: a mechanism -> the periodic motion within limits from which unknown numbers are determined best.

Joints move by finite Fourier series that begin and end at rest (J. Swevers et al., IEEE Trans. Robotics and Automation
13, 1997):

    q_i(t) = c_i + sum over h of a_ih sin(h w t) + b_ih cos(h w t),    w = 2 pi/T,    qd(0) = qdd(0) = 0

The information of the base parameters is M = sum over times of AT W A, with the rows A of an identification. Columns
are in units of their sizes at random states. One of

    D: log det M        A: -log tr M^-1        E: the least eigenvalue, as -log (tr M^-p)^(1/p), p = 8
    C: -log e' M^-1 e, with the unit vector e of one number

is the largest within the limits of coordinates, velocities and torques. Limits are logarithmic barriers, continued by
parabolas beyond them (J. Hauser, A. Saccon, CDC 2006), so that any start will do. Gradients are exact, by the adjoint
of the kernel `regressor`, and L-BFGS makes the steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from mbsgen.manifest import Manifest
from mbsgen.roles import MOMENTS
from mbsrun.external import Mechanism, load
from mbsrun.identification.equations import SampledMotion, Samples, Setting, write_rows
from mbsrun.identification.identify import EXTENT, prepare, say_nothing
from mbsrun.identification.settings import (
    ARMATURE,
    DAMPING,
    DEFAULT,
    FALL,
    FRICTION,
    INERTIA,
    STRIBECK,
    IdentificationError,
    Settings,
)
from mbsrun.identification.structure import Structure, draw_states, find_structure, list_ranges
from mbsrun.identification.unknowns import Unknown, list_unknowns
from mbsrun.models import is_model, read_numbers

Array = NDArray[np.float64]
Report = Callable[[str, int, int], None]

CRITERIA = ("D", "E", "A", "C")
POWER = 8  # of the sum that stands for the least eigenvalue
BARRIERS = (1.0, 0.2, 0.04)  # weights of the barriers, one after the other
STEPS = 150  # of L-BFGS for each
EDGE = 0.02  # of a limit, times the weight, from which on a barrier is a parabola
MARGIN = 0.02  # of limits, for times between the samples
ROOM = 3  # margins that are tried, each twice the one before
FINE = 10  # times between two samples at which limits are checked
SPARE = 1e-9  # of a limit: rounding
SMALL = 0.3  # of the room to the limits: the amplitudes of starts


@dataclass(frozen=True)
class Wishes:
    """The choices of an exciting motion."""

    duration: float = 10.0  # of the period [s]
    harmonics: int = 5
    criterion: str = CRITERIA[0]
    samples: int = 200  # of a period, at which motions are judged
    starts: int = 4
    seed: int = 0
    speed: float = 2.0  # of joints without a limit [rad/s; half of it in m/s]
    step: float = 0.01  # between two times of the result [s]
    number: str = ""  # of criterion C: the base parameter that is to be surest


MODEST = Wishes()


@dataclass(frozen=True, eq=False)
class Excitation(SampledMotion):
    """An exciting motion."""

    model: str
    u: Array  # (K, m): torques with the model's numbers
    coefficients: Array  # (n, 2 harmonics + 1): c, a, b
    duration: float  # of the period [s]
    criterion: str
    value: float  # of the criterion
    before: float  # of the best start
    condition: float  # of the base parameters' columns, each of length 1
    names: tuple[str, ...]  # of the base parameters
    deviations: Array  # of the base parameters, for noise of 1 N m and one sample in each second
    shares: dict[str, float]  # the largest part of each limit that is used

    def write_expression(self, i: int) -> str:
        """Write the motion of a joint as an expression of the time t."""
        c, *rest = (f"{x:.12g}" for x in self.coefficients[i])
        half, w = len(rest) // 2, 2 * np.pi / self.duration
        waves = [(rest[h], f"sin({(h + 1) * w:.15g}*t)") for h in range(half)]
        waves += [(rest[half + h], f"cos({(h + 1) * w:.15g}*t)") for h in range(half)]
        return " + ".join([f"({c})", *(f"({a})*{wave}" for a, wave in waves)])


def excite(
    model: str | Path,
    settings: Settings = DEFAULT,
    wishes: Wishes = MODEST,
    *,
    report: Report = say_nothing,
) -> Excitation:
    """Design a motion that determines the unknown numbers of a model file.

    Rows of torques have the weights of `settings.noise`, or else of the model's `max_force`.
    Raises IdentificationError for mechanisms with loops, quaternions or joints without a drive, and where no motion is
    within the limits.
    """
    path = Path(model)
    _check(path, settings, wishes)
    report("generating the regressor", 0, wishes.starts + len(BARRIERS))
    mechanism = load(path, extent=EXTENT).with_parameters(**settings.parameters)
    numbers = read_numbers(path, settings.parameters)
    manifest = mechanism.manifest
    _check_mechanism(manifest)
    unknowns = list_unknowns(manifest, numbers, settings)
    setting = prepare(mechanism, numbers, settings)
    structure = find_structure(setting, unknowns)
    _check_number(structure, wishes)
    design = _Design.of(setting, structure, mechanism, wishes, settings.noise)
    for _ in range(ROOM):
        x = design.search(report)
        if max(design.find_shares(x).values()) <= 1 + SPARE:
            break
        design = replace(design, margin=2 * design.margin)
    return design.describe(x)


def _check(path: Path, settings: Settings, wishes: Wishes) -> None:
    if not is_model(path):
        raise IdentificationError(f"{path}: it holds code; give the model file")
    if wishes.criterion not in CRITERIA:
        raise IdentificationError(f"no criterion is named {wishes.criterion}; there are {', '.join(CRITERIA)}")
    if not (0 < wishes.step < wishes.duration and wishes.harmonics >= 2 and wishes.starts >= 1 and wishes.speed > 0):
        raise IdentificationError(
            "give a positive speed, a step shorter than the duration, one start and two harmonics at least"
        )
    if wrong := [f"noise of {name}" for name, x in settings.noise.items() if not x > 0]:
        raise IdentificationError(f"{', '.join(wrong)} must be positive; give a number above 0")
    if (wishes.criterion == "C") != bool(wishes.number):
        raise IdentificationError("criterion C is for one number, the others are for all; give C and a number together")
    if wishes.samples < 8 * wishes.harmonics:
        raise IdentificationError(f"give {8 * wishes.harmonics} samples at least, 8 for each harmonic")


def _check_number(structure: Structure, wishes: Wishes) -> None:
    if wishes.number and wishes.number not in structure.names:
        meant = ", ".join(structure.names)
        raise IdentificationError(f"no base parameter is named {wishes.number}; there are {meant}")


def _check_mechanism(manifest: Manifest) -> None:
    kinds = {"loops": manifest.loops, "quaternions": manifest.quaternions, "driven joints": manifest.driven}
    if found := [kind for kind, some in kinds.items() if some]:
        raise IdentificationError(
            f"{manifest.model} has {' and '.join(found)}, for which no motion is designed; compare recorded motions by "
            "the deviations of mbsrun identify"
        )
    passive = [c.name for c in manifest.coordinates if not c.actuated]
    if passive:
        raise IdentificationError(
            f"joints without a drive cannot follow a motion: {', '.join(passive)}; lock them, or make them actuated"
        )


@dataclass(frozen=True, eq=False)
class _Design:
    """The problem: x, (n, free coefficients), are coordinates of series that begin at rest."""

    setting: Setting
    structure: Structure
    mechanism: Mechanism
    wishes: Wishes
    low: Array  # (n,)
    high: Array
    speeds: Array  # (n,), of velocities
    forces: Array  # (m,); infinite where the model has no limit
    scales: Array  # (base,): lengths of columns at random states
    weights: Array  # (rows,): of information
    rest: Array  # (2 harmonics + 1, free): the series that begin at rest
    pattern: Array  # of the regressor's entries
    margin: float = MARGIN

    @staticmethod
    def of(
        setting: Setting,
        structure: Structure,
        mechanism: Mechanism,
        wishes: Wishes,
        noise: Mapping[str, float] | None = None,
    ) -> _Design:
        manifest = setting.manifest
        low, high = list_ranges(setting)
        limits = [c.max_speed or wishes.speed * (1.0 if c.unit == "rad" else 0.5) for c in manifest.coordinates]
        forces = np.array([manifest.coordinates[i].max_force or np.inf for i in manifest.actuated])
        states = draw_states(setting, 100, wishes.seed)
        A, _ = write_rows(setting, states, structure.unknowns, np.full(len(low), FALL))
        names = list(setting.rows)
        sizes = {manifest.coordinates[i].name: f for i, f in zip(manifest.actuated, forces.tolist(), strict=True)}
        finite = [(noise or {}).get(name, sizes.get(name, np.inf)) for name in names]
        weights = np.array([1 / f**2 if np.isfinite(f) else 1.0 for f in finite])
        own = A[:, :, list(structure.kept)] * np.sqrt(weights)[:, None]
        h = np.arange(1, wishes.harmonics + 1)
        conditions = np.zeros((2, 2 * wishes.harmonics + 1))
        conditions[0, 1 : wishes.harmonics + 1], conditions[1, wishes.harmonics + 1 :] = h, h**2
        return _Design(
            setting,
            structure,
            mechanism,
            wishes,
            low,
            high,
            np.array(limits),
            forces,
            np.sqrt((own**2).mean(axis=0).sum(axis=0)),
            weights,
            null_space(conditions),
            _find_pattern(mechanism),
        )

    def list_waves(self, t: Array) -> tuple[Array, Array, Array]:
        """Return the series and their derivatives at some times, (K, free) each."""
        h = np.arange(1, self.wishes.harmonics + 1)
        w = 2 * np.pi / self.wishes.duration * h
        s, c, one = np.sin(np.outer(t, w)), np.cos(np.outer(t, w)), np.ones((len(t), 1))
        zero = np.zeros_like(one)
        waves = (one, s, c), (zero, w * c, -w * s), (zero, -w * w * s, -w * w * c)
        q, qd, qdd = (np.hstack(wave) @ self.rest for wave in waves)
        return q, qd, qdd

    @property
    def times(self) -> Array:
        """Return the times at which motions are judged."""
        return np.arange(self.wishes.samples) * self.wishes.duration / self.wishes.samples

    def move(self, x: Array, t: Array) -> Samples:
        """Return the motion."""
        q, qd, qdd = (wave @ x.T for wave in self.list_waves(t))
        manifest = self.setting.manifest
        zero = np.zeros((len(t), len(manifest.actuated)))
        return Samples(t, q, qd, qdd, "", np.zeros((len(t), manifest.open_entries)), zero, zero)

    def write(self, samples: Samples) -> Array:
        """Return the rows, with weights, of base parameters in units of their sizes, (K, rows, base)."""
        falls = np.full(samples.qd.shape[1], FALL)
        A, _ = write_rows(self.setting, samples, self.structure.unknowns, falls)
        return np.asarray(A[:, :, list(self.structure.kept)] * np.sqrt(self.weights)[:, None] / self.scales)

    def judge(self, A: Array) -> tuple[float, Array]:
        """Return the negative criterion of rows, and its derivatives by them."""
        M = np.einsum("kri,krj->ij", A, A) / len(A)
        values, V = np.linalg.eigh(M)
        values = np.maximum(values, 1e-14 * values[-1])
        if self.wishes.number:
            k = self.structure.names.index(self.wishes.number)
            v = V @ (V[k] / values)
            return float(np.log(v[k])), np.asarray(-2 * (A @ v)[..., None] * v / (v[k] * len(A)))
        if self.wishes.criterion == "D":
            cost, slopes = -float(np.log(values).sum()), -1 / values
        else:
            p = 1 if self.wishes.criterion == "A" else POWER
            small = values / values[0]
            total = float((small**-p).sum())
            cost = float(np.log(total)) / p - float(np.log(values[0]))
            slopes = -(small ** -(p + 1)) / total / values[0]
        return cost, np.asarray(2 * A @ ((V * slopes) @ V.T) / len(A))

    def evaluate(self, x: Array, mu: float) -> tuple[float, Array]:
        """Return the cost with barriers, and its gradient by x, as vectors."""
        waves = self.list_waves(self.times)
        samples = self.move(x.reshape(self.low.size, -1), self.times)
        A = self.write(samples)
        cost, by_rows = self.judge(A)
        slopes = self._pull_rows(samples, by_rows)
        more, pulled = self._add_barriers(samples, mu)
        gradient = sum((wave.T @ (a + b)).T for wave, a, b in zip(waves, slopes, pulled, strict=True))
        return cost + more, np.asarray(gradient).ravel()

    def _pull_rows(self, samples: Samples, by_rows: Array) -> list[Array]:
        """Return the derivatives by q, qd and qdd, (K, n) each, from the derivatives by weighted rows."""
        n, count = samples.qd.shape[1], len(samples.t)
        by_columns = np.zeros((count, n, len(self.structure.kept)))
        by_columns[:, list(self.setting.open)] = by_rows * np.sqrt(self.weights)[:, None] / self.scales
        unknowns = [self.structure.unknowns[k] for k in self.structure.kept]
        seeds = np.zeros((count, n, len(MOMENTS) * sum(not frame.sensor for frame in self.setting.manifest.frames)))
        slopes = [np.zeros((count, n)) for _ in range(3)]
        for k, x in enumerate(unknowns):
            if x.kind == INERTIA:
                own = slice(len(MOMENTS) * x.body, len(MOMENTS) * (x.body + 1))
                seeds[:, :, own] += by_columns[:, :, k, None] * np.array(x.column)
            else:
                self._pull_joint(x, samples, by_columns[:, x.joint, k], slopes)
        if any(x.kind == INERTIA for x in unknowns):
            state: dict[str, Any] = {"q": samples.q, "qd": samples.qd, "qdd": samples.qdd}
            found = self.mechanism("adj1_regressor", **state, adj_Y=seeds * self.pattern)
            for k, name in enumerate(state):
                slopes[k] += found[f"adj_{name}"].reshape(count, n)
        return slopes

    def _pull_joint(self, x: Unknown, samples: Samples, by: Array, slopes: Sequence[Array]) -> None:
        """Add the derivatives of a joint's column."""
        v, speed = samples.qd[:, x.joint], self.setting.speeds[x.joint]
        step = np.tanh(v / speed)
        if x.kind == ARMATURE:
            slopes[2][:, x.joint] += by
        elif x.kind == DAMPING:
            slopes[1][:, x.joint] += by
        elif x.kind == FRICTION:
            slopes[1][:, x.joint] += by * (1 - step**2) / speed
        elif x.kind == STRIBECK:
            fall = np.exp(-((v / FALL) ** 2))
            slopes[1][:, x.joint] += by * fall * ((1 - step**2) / speed - 2 * v / FALL**2 * step)

    def _add_barriers(self, samples: Samples, mu: float) -> tuple[float, list[Array]]:
        """Return the barriers of all limits, and their derivatives by q, qd and qdd."""
        size, count = (self.high - self.low) / 2, len(samples.t)
        many = len(self.scales) if self.wishes.criterion == "D" else 1  # as the cost grows with them
        weight, less = mu * many / count, 1 - self.margin
        total, slopes = 0.0, [np.zeros_like(samples.q) for _ in range(3)]
        middle = (self.high + self.low) / 2
        for sign in (1, -1):
            value, slope = _limit(less - sign * (samples.q - middle) / size, EDGE * mu)
            total += weight * float(value.sum())
            slopes[0] -= weight * sign * slope / size
            value, slope = _limit(less - sign * samples.qd / self.speeds, EDGE * mu)
            total += weight * float(value.sum())
            slopes[1] -= weight * sign * slope / self.speeds
        limited = np.flatnonzero(np.isfinite(self.forces))
        if limited.size:
            u, joints = self.find_torques(samples), [self.setting.manifest.actuated[k] for k in limited]
            by_force = np.zeros((count, samples.qd.shape[1]))
            for sign in (1, -1):
                value, slope = _limit(less - sign * u[:, limited] / self.forces[limited], EDGE * mu)
                total += weight * float(value.sum())
                by_force[:, joints] -= weight * sign * slope / self.forces[limited]
            given = _give(self.mechanism, "adj1_impl", samples, by_force)
            found = self.mechanism("adj1_impl", **given)
            for k, name in enumerate(("q", "qd", "qdd")):
                slopes[k] += found[f"adj_{name}"].reshape(slopes[k].shape)
        return total, slopes

    def find_torques(self, samples: Samples) -> Array:
        """Return the torques of actuated joints with the model's numbers, (K, m)."""
        Phi = self.mechanism("impl", **_give(self.mechanism, "impl", samples, None))["Phi"]
        return np.asarray(Phi.reshape(len(samples.t), -1)[:, list(self.setting.manifest.actuated)])

    def search(self, report: Report) -> Array:
        """Return the coordinates of the best motion. Raises IdentificationError where limits leave none."""
        from scipy.optimize import minimize

        rng, best, steps = np.random.default_rng(self.wishes.seed), None, self.wishes.starts + len(BARRIERS)

        def descend(x: Array, mu: float) -> tuple[float, Array]:
            ends: Any = {"maxiter": STEPS, "maxcor": 20}
            found: Any = minimize(self.evaluate, x.ravel(), (mu,), jac=True, method="L-BFGS-B", options=ends)
            return float(found.fun), np.asarray(found.x).reshape(x.shape)

        for k in range(self.wishes.starts):
            report("searching starts", k, steps)
            tried = descend(self.draw(rng), BARRIERS[0])
            best = tried if best is None or tried[0] < best[0] else best
        assert best is not None, "there is a start"
        x = best[1]
        for k, mu in enumerate(BARRIERS[1:]):
            report("moving towards limits", self.wishes.starts + k, steps)
            x = descend(x, mu)[1]
        return x

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw a motion about the middle of the limits."""
        x = rng.normal(size=(self.low.size, self.rest.shape[1]))
        wave, fast, _ = self.list_waves(self.times)
        mean = np.linalg.lstsq(self.rest, np.eye(self.rest.shape[0])[0], rcond=None)[0]
        x -= np.outer(x @ self.rest[0], mean) / (self.rest[0] @ mean)
        reach, quick = np.abs(wave @ x.T).max(axis=0), np.abs(fast @ x.T).max(axis=0)
        x *= SMALL * np.minimum((self.high - self.low) / 2 / reach, self.speeds / quick)[:, None]
        return np.asarray(x + np.outer((self.high + self.low) / 2, mean) / (self.rest[0] @ mean))

    def find_shares(self, x: Array) -> dict[str, float]:
        """Return the largest part of each limit that a motion uses, also between the samples."""
        count = self.wishes.samples * FINE
        samples = self.move(x, np.arange(count) * self.wishes.duration / count)
        names, middle = [c.name for c in self.setting.manifest.coordinates], (self.high + self.low) / 2
        places = np.abs(samples.q - middle).max(axis=0) / ((self.high - self.low) / 2)
        found = {f"q[{name}]": float(v) for name, v in zip(names, places, strict=True)}
        fast = np.abs(samples.qd).max(axis=0) / self.speeds
        found |= {f"qd[{name}]": float(v) for name, v in zip(names, fast, strict=True)}
        for k, i in enumerate(self.setting.manifest.actuated):
            if np.isfinite(self.forces[k]):
                found[f"u[{names[i]}]"] = float(np.abs(self.find_torques(samples)[:, k]).max() / self.forces[k])
        return found

    def describe(self, x: Array) -> Excitation:
        """Describe a motion. Raises IdentificationError where it breaks a limit."""
        shares = self.find_shares(x)
        broken = [f"{name} by {100 * (v - 1):.2g} %" for name, v in shares.items() if v > 1 + SPARE]
        if broken:
            raise IdentificationError(
                f"no motion was found within the limits: {', '.join(broken)}; give a longer duration, more starts, or "
                "wider limits"
            )
        A = self.write(self.move(x, self.times))
        first = self.draw(np.random.default_rng(self.wishes.seed))
        own = A.reshape(-1, A.shape[2])
        values = np.linalg.svd(own / np.linalg.norm(own, axis=0), compute_uv=False)
        plain = own / np.sqrt(np.tile(self.weights, len(A)))[:, None] * self.scales
        information = plain.T @ plain * self.wishes.duration / len(A)
        count = round(self.wishes.duration / self.wishes.step)
        samples = self.move(x, np.linspace(0, self.wishes.duration, count + 1))
        return Excitation(
            model=self.setting.manifest.model,
            t=samples.t,
            q=samples.q,
            qd=samples.qd,
            qdd=samples.qdd,
            u=self.find_torques(samples),
            coefficients=x @ self.rest.T,
            duration=self.wishes.duration,
            criterion=self.wishes.criterion,
            value=-self.judge(A)[0],
            before=-self.judge(self.write(self.move(first, self.times)))[0],
            condition=float(values[0] / values[-1]),
            names=self.structure.names,
            deviations=np.sqrt(np.diag(np.linalg.inv(information))),
            shares=shares,
        )


def _limit(room: Array, edge: float) -> tuple[Array, Array]:
    """Return the barrier of the room that is left to a limit, and its derivative; a parabola from an edge on."""
    near = room < edge
    inner = np.where(near, edge, room)
    s = (room - 2 * edge) / edge
    value = np.where(near, 0.5 * (s * s - 1) - np.log(edge), -np.log(inner))
    return value, np.where(near, s / edge, -1 / inner)


def _give(mechanism: Mechanism, name: str, samples: Samples, seed: Array | None) -> dict[str, Any]:
    """Return the inputs of the residual, or of its adjoint with the weights of Phi."""
    given = {"q": samples.q, "qd": samples.qd, "qdd": samples.qdd, "u": samples.u, "w": samples.w}
    if seed is not None:
        given["adj_Phi"] = seed
    wanted = [argument.name for argument in mechanism.describe(name).inputs]
    return {key: value for key, value in given.items() if key in wanted}


def _find_pattern(mechanism: Mechanism) -> Array:
    """Return ones where the regressor has entries, and zeros elsewhere."""
    (argument,) = (a for a in mechanism.describe("adj1_regressor").inputs if a.name == "adj_Y")
    if argument.row is None or argument.colind is None:
        return np.ones((argument.rows, argument.cols))
    pattern = np.zeros((argument.rows, argument.cols))
    pattern[list(argument.row), np.repeat(np.arange(argument.cols), np.diff(argument.colind))] = 1
    return pattern
