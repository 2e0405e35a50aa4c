"""Random problem files for a mechanism: the sections of `docs/problem.md`, and recordings.

A problem is data with formulas in it. Numbers are such that a motion of a short time from the drawn start is near.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

from tests.fuzz.formulas import Formula, draw, draw_drive, draw_quantity
from tests.fuzz.own_recordings import draw_recording, draw_track
from tests.fuzz.problem_names import Mechanical, spell

Data = dict[str, Any]

RECORDED = 0.3  # of problems
DELAYED = 0.25  # of problems with a given horizon
SHORT = 0.09  # of an interval [s], about


class Drawing:
    """Draws one problem."""

    def __init__(self, mechanism: Mechanical, seed: int | str) -> None:
        self.own, self.pick = mechanism, random.Random(f"{seed} problem")
        self.recording = random.Random(f"{seed} recording")
        self.data: Data = {}
        self.is_standard = True
        self.is_free = False  # the horizon

    def number(self, low: float, high: float) -> float:
        return round(self.pick.uniform(low, high), 3)

    def chance(self, share: float) -> bool:
        return self.pick.random() < share

    def some(self, names: Sequence[str], share: float) -> list[str]:
        return [name for name in names if self.chance(share)]

    def limits(self, low: float = -3.0, high: float = 3.0) -> list[float | None]:
        """Draw a range about 0, which may be open on one side."""
        first, second = self.number(low, low / 3), self.number(high / 3, high)
        return self.pick.choice([[first, second], [first, second], [None, second], [first, None]])

    def problem(self) -> Data:
        data, own = self.data, self.own
        data["model"] = "model.yaml"
        self.is_free = self.chance(0.35)
        self.draw_form()
        data["constants"] = {"c0": self.number(0.2, 1), "c1": "2*c0 - 0.3"}
        self.draw_time()
        self.draw_parameters()
        self.draw_drives()
        if self.is_standard:
            self.draw_added()
            self.draw_given()
        self.draw_bounds()
        self.draw_ends()
        self.draw_cost()
        data["constraints"] = [self.constraint(i) for i in range(self.pick.randint(0, 4))]
        if self.is_standard and self.chance(0.4):
            data["integrals"] = [
                {"expression": self.quantity(), "range": self.limits()} for _ in range(self.pick.randint(1, 2))
            ]
        if own.design and self.chance(0.2):
            data["solver"] = {"objective_scaling": 1}
        if self.recording.random() < RECORDED:
            self.draw_references()
        return data

    # -- names that expressions read ------------------------------------------------------------------------------

    def states(self) -> list[str]:
        """Name what does not jump: coordinates, velocities, sensors, states, time, constants, unknowns."""
        own = self.own
        names = [f"q_{spell(x)}" for x in own.positions] + [f"qd_{spell(x)}" for x in own.velocities]
        names += [f"{v}{axis}_{spell(x)}" for x in own.sensors for v in ("", "v") for axis in "xyz"]
        names += [*self.data.get("states", {}), *self.data.get("unknowns", {})]
        return [*names, "t", "T", "c0", "c1"]

    def jumping(self) -> list[str]:
        own = self.own
        moved = own.free if own.is_closed else own.velocities
        names = [f"u_{spell(x)}" for x in own.inputs] + [f"qdd_{spell(x)}" for x in moved]
        names += [f"tau_{spell(own.velocities[i])}" for i in own.driven]
        names += [f"{part[0]}{axis}_{spell(x)}" for x, part in own.wrenches for axis in "xyz"]
        return [*names, *(f"signal_{x}" for x in own.signals), *self.data.get("controls", {})]

    def quantity(self, *, jumps: bool | None = None) -> Formula:
        """Draw an expression of the motion."""
        jumps = self.chance(0.6) if jumps is None else jumps
        names = self.states()
        if jumps:
            names += self.jumping() * 2
        if self.chance(0.1):
            return draw(self.pick, names, 2, kinks=True)
        return draw_quantity(self.pick, names)

    # -- sections -------------------------------------------------------------------------------------------------

    def draw_form(self) -> None:
        pick, data, own = self.pick, self.data, self.own
        is_given = own.wrenches or own.signals or own.driven
        form = pick.choice(["standard"] if is_given else ["standard"] * 3 + ["integral"] + ["shooting"] * 2)
        self.is_standard = form == "standard"
        names = ["IMPL", "SEMI", "EXP1-O", "EXP1-A", "EXP2-O", "EXP2-A"]
        if own.is_closed:
            names = ["IMPL", "EXP1-O", "IMPL", "EXP1-A", "EXP1-O"]
            data["loops"] = "reduced"
        representation = pick.choice(names[:3] + names[4:5] if form == "shooting" else names)
        data |= {"scheme": pick.choice(["radau", "legendre"]), "degree": pick.choice([1, 2, 2, 3, 4])}
        data |= {"representation": representation}
        if form != "standard" or self.chance(0.3):
            data["form"] = form
        integrators = ["collocation"] * 3
        has_slopes = self.is_free or (form == "integral" and representation.endswith("-O"))
        if not own.turning and (self.is_standard or not has_slopes):
            integrators.append("second-order")
        if form == "shooting" and representation.endswith("-O"):
            integrators += ["rk4"] * 4
        data["integrator"] = pick.choice(integrators)
        if form == "shooting":
            data["steps"] = pick.choice([1, 1, 2, 3])

    def draw_time(self) -> None:
        pick, data = self.pick, self.data
        count = pick.randint(1, 4)
        data["intervals"] = count if self.chance(0.6) else [pick.choice([1, 1.5, 2, "c0 + 1"]) for _ in range(count)]
        T = round(count * SHORT * pick.uniform(0.6, 1.4), 3)
        data["horizon"] = {"guess": T, "range": [round(T / 3, 4), 3 * T]} if self.is_free else T
        self.count, self.T = count, T

    def draw_parameters(self) -> None:
        own, data, pick = self.own, self.data, self.pick
        given = {name: round(value * pick.uniform(0.8, 1.25), 4) for name, value in (*own.parameters, *own.design)}
        chosen = self.some([*given], 0.4)
        if chosen:
            data["parameters"] = {name: given[name] for name in chosen}
        unknowns: Data = {}
        if self.is_standard or self.chance(0.5):
            for name, value in own.design:
                if self.chance(0.3) and name not in chosen:
                    unknowns[name] = {"guess": value, "range": [round(0.5 * value, 4), pick.choice([None, 2 * value])]}
        if self.chance(0.3):
            unknowns["free"] = {"guess": 0.4} | ({"range": self.limits()} if self.chance(0.5) else {})
        if unknowns:
            data["unknowns"] = unknowns

    def draw_drives(self) -> None:
        """Draw the motions of driven joints."""
        own = self.own
        unknowns = [name for name in self.data.get("unknowns", {}) if name == "free"]
        drives = {}
        for i in own.driven:
            start = round(own.pose[own.positions.index(own.velocities[i])], 3)
            drives[own.velocities[i]] = draw_drive(self.pick, start, unknowns)
        if drives:
            self.data["driven"] = drives

    def draw_added(self) -> None:
        """Draw states, controls and the course of inputs."""
        pick, data, own = self.pick, self.data, self.own
        course = pick.choice(["constant", "constant", "linear", "polynomial"])
        inputs: Data = {"course": course}
        names = ["exc", "val"][: pick.choice([0, 0, 1, 1, 2])]
        mesh = self.delays()
        data["controls"] = {}
        for name in names:
            control: Data = {"guess": 0.1} | ({"range": self.limits()} if self.chance(0.7) else {})
            if self.chance(0.4):
                control["rate"] = pick.choice(
                    [{"weight": 0.3}, {"range": [-40, 50]}, {"range": [-40, None], "weight": 2}]
                )
            if mesh and self.chance(DELAYED):
                control["delay"] = pick.choice(mesh)
                if self.chance(0.7):
                    control["history"] = pick.choice(["free", 0.2])
            data["controls"][name] = control
        if mesh and own.inputs and self.chance(DELAYED):
            delayed = self.some(own.inputs, 0.7)
            if delayed:
                inputs["delay"] = {name: pick.choice(mesh) for name in delayed}
                inputs["history"] = {name: pick.choice(["free", 0.3, -0.1]) for name in self.some(delayed, 0.6)}
        data["inputs"] = inputs if len(inputs) > 1 or self.chance(0.3) else course
        data["states"] = {}
        for name in ["act", "sta"][: pick.choice([0, 0, 1, 1, 2])]:
            data["states"][name] = {}  # so that its rate may read it
        for state in data["states"].values():
            start = pick.choice([self.number(-0.5, 0.5), [-0.8, 0.9], None])
            state |= {"rate": self.quantity(), "start": start}
            state |= {"end": pick.choice([0.2, [None, 0.9], [-0.7, 0.9], None])}
            if self.chance(0.5):
                state["range"] = [-3, pick.choice([4, None])]

    def draw_references(self) -> None:
        """Draw a recording, and terms of the cost that read it."""
        cost = self.data["cost"]
        self.data["references"] = draw_recording(self.recording, self.T, is_free=self.is_free)
        cost["track"], running = draw_track(self.recording, self.own, self.states())
        cost["running"] += running

    def delays(self) -> list[float]:
        """List the times of inner mesh points, where the horizon is given."""
        if self.is_free or self.count < 2 or not isinstance(self.data["intervals"], int):
            return []
        return [self.T * k / self.count for k in range(1, self.count)]

    def draw_given(self) -> None:
        """Draw inputs, wrenches and signals by expressions; each reads earlier ones alone."""
        own, data, pick = self.own, self.data, self.pick
        delayed = data["inputs"].get("delay", {}) if isinstance(data["inputs"], dict) else {}
        states = [name for name in self.states() if name not in ("c1",)] + [*data["controls"]]
        self.readable = states

        def read() -> Formula:
            return draw_quantity(pick, self.readable, 1)

        chosen = [name for name in self.some(own.inputs, 0.2) if name not in delayed]
        if chosen:
            data["forces"] = {}
            for name in chosen:
                data["forces"][name] = read()
                self.readable = [*self.readable, f"u_{spell(name)}"]
        for name, part in own.wrenches:
            found = data.setdefault("wrenches", {}).setdefault(name, {})
            found[part] = [self.component(read) for _ in "xyz"]
        signals = {name: self.component(read) for name in own.signals}
        if signals:
            data["signals"] = signals

    def component(self, read: Any) -> Any:
        return self.pick.choice([read(), read(), 0.3, 0, {"range": self.limits(), "guess": 0.2}, {}])

    def draw_bounds(self) -> None:
        own, pick = self.own, self.pick
        bounds: Data = {}
        plain = [x for x in own.positions if x not in own.turning]
        coordinates = {name: self.limits() for name in self.some([] if own.is_closed else plain, 0.5)}
        if own.is_closed:
            near = {x: round(own.pose[own.positions.index(x)], 3) for x in self.some(plain, 0.4)}
            coordinates = {x: [value - 1.5, value + 2] for x, value in near.items()}
        if own.driven and self.chance(0.5):
            bounds["tau"] = {own.velocities[own.driven[0]]: self.limits(-40, 40)}
        if coordinates:
            bounds["coordinates"] = coordinates
        for key, names, share in (("velocities", own.velocities, 0.4), ("inputs", own.inputs, 0.5)):
            if self.chance(share):
                bounds[key] = (
                    self.limits(-6, 6) if self.chance(0.4) else {x: self.limits(-6, 6) for x in self.some(names, 0.6)}
                )
        open_inputs = [x for x in own.inputs if x not in self.data.get("forces", {})]
        if self.chance(0.3) and open_inputs:
            every = not self.data.get("forces") and self.chance(0.4)
            bounds["input_rates"] = (
                [-60, pick.choice([None, 50])] if every else {x: [-60, 70] for x in self.some(open_inputs, 0.6)}
            )
        if bounds:
            self.data["bounds"] = bounds

    def draw_ends(self) -> None:
        own, pick = self.own, self.pick
        pose: Data = {x: self.pick.choice([self.number(-0.5, 0.5), "c0/3"]) for x in self.some(own.settled, 0.6)}
        if own.is_closed:
            pose = {x: round(own.pose[own.positions.index(x)] + self.number(-0.1, 0.1), 4) for x in own.settled}
        for x in self.some(own.settled, 0.15):
            pose[x] = None
        joints = sorted({x.rpartition(".")[0] for x in own.turning})
        for joint in joints:
            kind = pick.choice(["neutral", "given", "free"])
            if kind != "neutral":
                pose |= {f"{joint}.q{x}": None if kind == "free" else self.number(-1, 1) for x in "xyz"}
                pose[f"{joint}.qw"] = None if kind == "free" else 1
        start: Data = {"pose": pose}
        if self.chance(0.8):
            start["velocity"] = {x: pick.choice([self.number(-0.8, 0.8), None]) for x in self.some(own.free, 0.5)}
        self.data["start"] = start
        end: Data = {}
        if own.sensors and self.chance(0.4):
            one = pick.choice(own.sensors)
            where = {x: self.number(-0.5, 0.5) for x in pick.choice(["x", "xy", "yz", "xyz"])}
            end["sensors"] = {one: pick.choice([where, {"radius": 0.5, "azimuth": "pi/3", "height": "c0"}])}
        if own.sensors and self.chance(0.2):
            end["sensor_velocities"] = {pick.choice(own.sensors): dict.fromkeys(pick.choice(["x", "yz", "xyz"]), 0.1)}
        if self.chance(0.4):
            end["pose"] = {x: self.number(-0.6, 0.6) for x in self.some(own.settled, 0.4)}
            if own.is_closed:
                end["pose"] = {x: own.pose[own.positions.index(x)] for x in end["pose"]}
        for joint in joints:
            if self.chance(0.3):
                end.setdefault("pose", {}).update({f"{joint}.q{x}": self.number(-0.5, 0.5) for x in "xyz"})
                end["pose"][f"{joint}.qw"] = 1
        for key in ("velocity", "acceleration"):
            if self.chance(0.3):
                end[key] = pick.choice(["zero", {x: self.number(-0.5, 0.5) for x in self.some(own.free, 0.5)}])
        if end:
            self.data["end"] = end

    def draw_cost(self) -> None:
        pick, data = self.pick, self.data
        cost: Data = {}
        course = data.get("inputs", "constant")
        course = course if isinstance(course, str) else course["course"]
        if self.own.inputs and self.chance(0.6):
            cost["inputs"] = pick.choice([1, 0.3, "c0"])
        if self.own.inputs and self.chance(0.3):
            cost["input_rates"] = pick.choice([0.01, 0.2])
        cost["running"] = [self.term() for _ in range(pick.randint(0, 2))]
        cost["terminal"] = [self.term() for _ in range(pick.randint(0, 2))]
        if self.chance(0.2):
            largest: Data = {"expression": self.quantity(), "weight": 0.7, "name": "peak"}
            cost["largest"] = [largest | ({"absolute": True} if self.chance(0.5) else {})]
        if not any(cost.values()):
            cost["terminal"] = [self.term()]
        data["cost"] = cost

    def term(self) -> Data:
        return {"expression": self.quantity()} | (
            {"weight": self.pick.choice([2, 0.5, "c1"])} if self.chance(0.7) else {}
        )

    def constraint(self, i: int) -> Data:
        pick = self.pick
        at = pick.choice(["path", "path", "start", "end"])
        part: Data = {"expression": self.quantity(), "range": self.limits()}
        if at != "path" or self.chance(0.3):
            part["at"] = at
        if self.chance(0.25) and (self.is_standard or at != "path"):
            part["soft"] = pick.choice([3, {"linear": 2, "quadratic": 1.5, "name": f"soft_{i}"}, {"quadratic": 4}])
        return part
