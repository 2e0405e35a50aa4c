"""A drawn problem as this program reads it: a random motion of its mechanism, and the values of names along it.

The reading follows `docs/problem.md`. Starts and given inputs are not kept, so that the conditions on them have values
that show whether they are there. Equations of motion hold.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.fuzz.formulas import Formula
from tests.fuzz.kinematics import FLOATS, value_of
from tests.fuzz.own_mechanism import Acceleration, Known, Mechanism
from tests.fuzz.own_motion import Interval, Law, Motion, Parts, Rates, chain, find_points
from tests.fuzz.problem_drawing import Data
from tests.fuzz.problem_names import Mechanical, spell

Array = NDArray[np.float64]


class Problem:
    """The data of a problem, read for a mechanism; `plant` are its kernels, at the problem's parameters."""

    def __init__(self, data: Data, own: Mechanical, plant: Any, seed: int | str) -> None:
        self.data, self.own = data, own
        self.pick = random.Random(f"{seed} motion")
        self.constants: dict[str, float] = {}
        for name, value in data["constants"].items():
            self.constants[name] = self.number(value)
        lengths = data["intervals"]
        relative = np.array([self.number(x) for x in lengths] if isinstance(lengths, list) else [1.0] * lengths)
        self.fractions = relative / relative.sum()
        self.nodes = find_points(data["scheme"], data["degree"])
        self.is_ode = data["representation"].endswith("-O")
        inputs = data.get("inputs", "constant")
        self.inputs: Data = {"course": inputs} if isinstance(inputs, str) else inputs
        self.course = self.inputs["course"]
        self.forces: dict[str, Formula] = data.get("forces", {})
        self.lifted = [x for x in own.inputs if x not in self.forces and self.has_lifted_rate(x)]
        controls = data.get("controls", {})
        polynomial, linear = self.course == "polynomial", self.course == "linear"
        self.lifted_controls = [x for x, part in controls.items() if linear or (polynomial and "rate" in part)]
        self.unknowns = {name: self.near(self.number(x["guess"])) for name, x in data.get("unknowns", {}).items()}
        self.slacks: list[str] = []  # along the path
        for name in self.list_slacks():
            self.unknowns[name] = abs(self.near(0.5))
        if "largest" in data["cost"]:
            self.unknowns |= {part["name"]: self.near(0.5) for part in data["cost"]["largest"]}
        horizon = data["horizon"]
        self.is_free = isinstance(horizon, dict)
        self.T = horizon["guess"] * self.pick.uniform(0.8, 1.2) if isinstance(horizon, dict) else float(horizon)
        values = {name: self.number(x) for name, x in data.get("parameters", {}).items()}
        design = [name for name, _ in own.design]
        self.design = [name for name in self.unknowns if name in design]
        self.plant = plant.with_parameters(**values, **{name: self.unknowns[name] for name in self.design})
        numbers = {**self.constants, **self.unknowns, "T": self.T}
        self.mechanism = Mechanism(own, self.plant, data.get("driven", {}), numbers)

    def number(self, value: Any) -> float:
        return float(value_of(value, self.constants, FLOATS))

    def near(self, value: float) -> float:
        return value + self.pick.uniform(-0.1, 0.1) * (1 + abs(value))

    def has_lifted_rate(self, name: str) -> bool:
        """Return whether an input is a state: where it is linear, or a polynomial with a rate."""
        rates = self.data.get("bounds", {}).get("input_rates", {})
        has_rate = isinstance(rates, list) or name in rates or "input_rates" in self.data["cost"]
        return self.course == "linear" or (self.course == "polynomial" and has_rate)

    def list_slacks(self) -> list[str]:
        """Return the slacks at ends, and collect the ones along the path."""
        found: list[str] = []
        for i, part in enumerate(self.data["constraints"]):
            if "soft" in part:
                (self.slacks if part.get("at", "path") == "path" else found).append(name_slack(i, part["soft"]))
        return found

    # -- the motion -----------------------------------------------------------------------------------------------

    def move(self) -> Motion:
        """Make a motion. Raises NoMotionError, and errors of kernels."""
        own, N, d = self.own, len(self.fractions), len(self.nodes)
        self.u = self.draw_inputs([x for x in own.inputs if x not in self.lifted and x not in self.forces])
        controls = [*self.data.get("controls", {})]
        rates = [f"rate_u_{spell(x)}" for x in self.lifted] + [f"rate_{x}" for x in self.lifted_controls]
        self.controls = self.draw_inputs([*(x for x in controls if x not in self.lifted_controls), *rates])
        self.controls |= {name: abs(x) for name, x in self.draw_inputs(self.slacks).items()}
        laws: dict[str, Formula] = {name: x["rate"] for name, x in self.data.get("states", {}).items()}
        laws |= {f"input_{spell(x)}": Formula(f"rate_u_{spell(x)}") for x in self.lifted}
        laws |= {x: Formula(f"rate_{x}") for x in self.lifted_controls}
        laws |= {f"@integral {i}": x["expression"] for i, x in enumerate(self.data.get("integrals", ()))}
        self.laws = laws
        self.free_w = self.draw_forces(N, d)
        start = (*self.draw_start(), np.array([self.draw_state(name) for name in laws]))
        method = self.data.get("integrator", "collocation")
        every = chain(
            self.law, start, (self.T * self.fractions).tolist(), self.nodes, method, self.data.get("steps", 1)
        )
        return self.collect(every)

    def draw_state(self, name: str) -> float:
        return 0.0 if name.startswith("@") else self.pick.uniform(-0.5, 0.5)

    def draw_inputs(self, names: list[str]) -> dict[str, Array]:
        """Draw inputs (N, d), which are constant over intervals or not."""
        N, d, found = len(self.fractions), len(self.nodes), {}
        for name in names:
            count = d if self.course == "polynomial" else 1
            values = np.array([[self.pick.uniform(-1.5, 1.5) for _ in range(count)] for _ in range(N)])
            found[name] = np.broadcast_to(values, (N, d)).copy()
        return found

    def draw_start(self) -> tuple[Array, Array]:
        """Draw a start near the given one; quaternions have length 1."""
        given, own = self.data["start"], self.own
        pose = dict(zip(own.positions, own.pose, strict=True))
        pose |= {x: self.number(value) for x, value in given["pose"].items() if value is not None}
        q = np.array([self.near(pose[x]) for x in own.positions])
        for first in self.mechanism.find_quaternions():
            q[first : first + 4] /= np.linalg.norm(q[first : first + 4])
        speeds = given.get("velocity", {})
        qd = np.array([self.near(self.number(speeds.get(x) or 0.0)) for x in own.velocities])
        return q[self.mechanism.carried_places], qd[self.mechanism.carried]

    def draw_forces(self, N: int, d: int) -> dict[str, Array]:
        """Draw the components of wrenches, and signals, that are unknown."""
        return {
            name: np.array([[self.pick.uniform(-1, 1) for _ in range(d)] for _ in range(N)])
            for name, part in self.list_components().items()
            if isinstance(part, dict)
        }

    def list_components(self) -> dict[str, Any]:
        """Return what the problem says about open components and signals, by their names in expressions."""
        found: dict[str, Any] = {}
        wrenches, signals = self.data.get("wrenches", {}), self.data.get("signals", {})
        for name, part in self.own.wrenches:
            for axis, value in zip("xyz", wrenches[name][part], strict=True):
                found[f"{part[0]}{axis}_{spell(name)}"] = value
        return found | {f"signal_{name}": signals[name] for name in self.own.signals}

    def law(self, k: int) -> Law:
        """Return the equations of motion in interval k."""

        def differentiate(c: Array, states: Parts) -> Rates:
            y, yd, further = states
            t = self.T * (self.fractions[:k].sum() + self.fractions[k] * c)
            q, qd = self.mechanism.expand(y, yd, t)
            known = self.know(q, qd) | dict(zip(self.laws, further.T, strict=True)) | {"t": t}
            for name, values in self.controls.items():
                known[name] = self.take(values[k], len(c))
            u, w = self.give(known, k)
            found = self.mechanism.accelerate(q, qd, u, w, self.mechanism.drive(t)[2])
            known |= self.name_accelerations(found)
            rates = [np.broadcast_to(x.evaluate(known), len(c)) for x in self.laws.values()]
            turned = self.mechanism.turn(q, qd)[:, self.mechanism.carried_places]
            moved = found.qdd[:, self.mechanism.carried]
            return Rates((turned, moved, np.array(rates).reshape(len(rates), len(c)).T))

        return differentiate

    def take(self, values: Array, count: int) -> Array:
        """Return the values of an interval at its points; in between, steps have constant ones."""
        return values if count == len(values) else np.full(count, values[0])

    def know(self, q: Array, qd: Array) -> Known:
        """Name what states give, and numbers of the problem."""
        numbers = {**self.constants, **self.unknowns, "T": self.T}
        return self.mechanism.know(q, qd) | {name: np.full(len(q), value) for name, value in numbers.items()}

    def give(self, known: Known, k: int) -> tuple[Array, Array]:
        """Name inputs and components of wrenches, each after the ones that it reads; return both."""
        own, count = self.own, len(known["t"])
        for name in own.inputs:
            if name in self.lifted:
                known[f"u_{spell(name)}"] = known[f"input_{spell(name)}"]
            elif name not in self.forces:
                known[f"u_{spell(name)}"] = self.take(self.u[name][k], count)
        for name, formula in self.forces.items():
            known[f"u_{spell(name)}"] = np.broadcast_to(formula.evaluate(known), count)
        names = []
        for name, part in self.list_components().items():
            names.append(name)
            match part:
                case Formula():
                    known[name] = np.broadcast_to(part.evaluate(known), count)
                case dict():
                    known[name] = self.free_w[name][k]
                case _:
                    known[name] = np.full(count, self.number(part))
        w = [known[name] for name in names]
        if len(self.plant.manifest.signals) > len(own.signals):
            w.append(known["t"])
        u = [known[f"u_{spell(name)}"] for name in own.inputs]
        return np.array(u).reshape(len(u), count).T, np.array(w).reshape(len(w), count).T

    def name_accelerations(self, found: Acceleration) -> Known:
        """Name accelerations, and forces of driven joints."""
        known = {f"qdd_{spell(x)}": found.qdd[:, i] for i, x in enumerate(self.own.velocities)}
        return known | {f"tau_{spell(self.own.velocities[i])}": found.tau[:, k] for k, i in enumerate(self.own.driven)}

    def collect(self, every: list[Interval]) -> Motion:
        """Read the motion at mesh points and collocation points."""
        N, d, own = len(every), len(self.nodes), self.mechanism
        starts = [x.state(0.0) for x in every] + [every[-1].state(1.0)]
        points = [[x.state(float(c)) for c in self.nodes] for x in every]
        mesh = [np.array([x[i] for x in starts]) for i in range(3)]
        inner = [np.array([[x[i] for x in row] for row in points]) for i in range(3)]
        t = self.T * np.concatenate(([0.0], np.cumsum(self.fractions)))
        point_t = t[:-1, None] + self.T * self.fractions[:, None] * self.nodes
        q, qd = own.expand(mesh[0], mesh[1], t)
        flat = own.expand(_flatten(inner[0]), _flatten(inner[1]), point_t.ravel())
        motion = Motion(
            T=self.T,
            t=t,
            point_t=point_t,
            nodes=self.nodes,
            q=q,
            qd=qd,
            point_q=flat[0].reshape(N, d, -1),
            point_qd=flat[1].reshape(N, d, -1),
            point_qdd=np.zeros((N, d, qd.shape[1])),
            end_qdd=np.array([every[0].acceleration(0.0), every[-1].acceleration(1.0)]),
            u=np.zeros((N, d, len(self.own.inputs))),
            w=np.zeros((N, d, 0)),
            tau=np.zeros((N, d, len(self.own.driven))),
            unknowns=self.unknowns,
            states={name: mesh[2][:, i] for i, name in enumerate(self.laws)},
            point_states={name: inner[2][:, :, i] for i, name in enumerate(self.laws)},
            controls=self.controls,
        )
        given = [self.give(self.know_points(motion, k), k) for k in range(N)]
        motion.u, motion.w = (np.array([x[i] for x in given]) for i in range(2))
        for k, interval in enumerate(every):
            a = own.drive(point_t[k])[2]
            found = own.accelerate(motion.point_q[k], motion.point_qd[k], motion.u[k], motion.w[k], a)
            motion.point_qdd[k], motion.tau[k] = found.qdd, found.tau
            if not self.is_ode:
                motion.point_qdd[k][:, own.carried] = [interval.acceleration(float(c)) for c in self.nodes]
        return motion

    def know_points(self, motion: Motion, k: int) -> Known:
        """Name states and controls at the points of interval k."""
        known = self.know(motion.point_q[k], motion.point_qd[k]) | {"t": motion.point_t[k]}
        known |= {name: x[k] for name, x in motion.point_states.items()}
        return known | {name: x[k] for name, x in motion.controls.items()}

    # -- names along it -------------------------------------------------------------------------------------------

    def at_points(self, motion: Motion) -> Known:
        """Name everything at the points of all intervals."""
        known = self.know(_flatten(motion.point_q), _flatten(motion.point_qd)) | {"t": motion.point_t.ravel()}
        known |= {name: x.ravel() for name, x in {**motion.point_states, **motion.controls}.items()}
        u, w = _flatten(motion.u), _flatten(motion.w)
        known |= {f"u_{spell(x)}": u[:, i] for i, x in enumerate(self.own.inputs)}
        known |= {name: w[:, i] for i, name in enumerate(self.list_components())}
        known |= self.recall(motion.point_t.ravel())
        return known | self.name_accelerations(Acceleration(_flatten(motion.point_qdd), _flatten(motion.tau)))

    def recall(self, t: Array) -> Known:
        """Name recorded values at some times."""
        return self.data["references"].name_values(t, self.T) if "references" in self.data else {}

    def at_mesh(self, motion: Motion, places: list[int]) -> Known:
        """Name what does not jump at some mesh points."""
        known = self.know(motion.q[places], motion.qd[places]) | {"t": motion.t[places]}
        known |= self.recall(motion.t[places])
        return known | {name: x[places] for name, x in motion.states.items()}

    def at_end(self, motion: Motion, which: int) -> Known:
        """Name everything at the start (0) or the end (1)."""
        known = self.at_mesh(motion, [-which])
        known |= {name: motion.at_end(x, which)[None] for name, x in motion.controls.items()}
        u, w, tau = (motion.at_end(x, which)[None] for x in (motion.u, motion.w, motion.tau))
        known |= {f"u_{spell(x)}": u[:, i] for i, x in enumerate(self.own.inputs)}
        known |= {name: w[:, i] for i, name in enumerate(self.list_components())}
        own = self.mechanism
        qdd = motion.at_end(motion.point_qdd, which)[None]
        if self.is_ode:
            a = qdd[:, list(self.own.driven)]
            qdd = own.accelerate(motion.q[[-which]], motion.qd[[-which]], u, w, a).qdd
        else:
            qdd[:, own.carried] = motion.end_qdd[which]
        return known | self.name_accelerations(Acceleration(qdd, tau))


def _flatten(points: Array) -> Array:
    """Put the points (N, d, ...) of all intervals in a row."""
    N, d, size = points.shape
    return points.reshape(N * d, size)


def name_slack(i: int, soft: Any) -> str:
    """Return the name of the slack of constraint i."""
    return str(soft.get("name", f"slack_{i}")) if isinstance(soft, Mapping) else f"slack_{i}"
