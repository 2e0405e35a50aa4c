"""Random links between two phases: drawn, and their rows as this program reads them.

A link carries states over, by expressions or as they are, and may change velocities by an impact. Impulses follow from
the mass matrix and from the sensor's velocities at unit speeds, by one linear system:

    [M  -J'] [qd+ - qd-]   [          0           ]
    [J   0 ] [    L    ] = [-J qd- - e (J qd-)_n n]
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.fuzz import own_delays
from tests.fuzz.formulas import Formula, draw_quantity
from tests.fuzz.own_mechanism import Known
from tests.fuzz.own_sections import Demand, Sections
from tests.fuzz.problem_drawing import Data
from tests.fuzz.problem_names import Mechanical, spell

Array = NDArray[np.float64]

AXES = "xyz"
LIMITS = (-1.3, 1.7)
WEIGHT = 0.37
LEAST = 0.05  # the least singular value, relative, of the velocities of a contact
POINT = "hand"  # the sensor that hits, and the wrench there in the model of impacts
HIT = "hit.yaml"  # the model of impacts


class Linking:
    """Draws the links between phases; `plant` has an open force at the sensor."""

    def __init__(self, own: Mechanical, plant: Any, pick: random.Random) -> None:
        self.own, self.plant, self.pick = own, plant, pick

    def draw(self, source: Data, target: Data) -> Data:
        """Draw a link from the end of a phase to the start of another one."""
        link: Data = {"from": source["name"], "to": target["name"]}
        names = [f"q_{spell(x)}" for x in self.own.positions] + [f"qd_{spell(x)}" for x in self.own.velocities]
        names += [f"x_{POINT}", f"vz_{POINT}", "T", *(f"u_{spell(x)}" for x in self.own.inputs)]
        sides = [f"{side}_{name}" for side in ("end", "start") for name in names]
        if self.pick.random() < 0.5 and (axes := self.find_axes()):
            link["impact"] = self.impact(axes)
            sides += [f"j{axis}_{POINT}" for axis in axes] * 3
        link["conditions"] = [{"expression": draw_quantity(self.pick, sides), "range": [*LIMITS]}]
        link["cost"] = [{"expression": draw_quantity(self.pick, sides), "weight": WEIGHT}]
        given: Data = {x: None for x in target.get("states", {}) if x not in source.get("states", {})}
        link["map"] = given | self.carry()
        return link

    def carry(self) -> Data:
        """Draw linear expressions that carry coordinates over."""
        found: Data = {}
        for name in self.own.positions:
            if self.pick.random() < 0.25:
                other, factor = self.pick.choice(self.own.positions), round(self.pick.uniform(-1.2, 1.2), 2)
                found[name] = Formula(("-", ("*", factor, spell(other)), round(self.pick.uniform(-0.5, 0.5), 2)))
        return found

    def find_axes(self) -> str:
        """Choose axes along which the sensor moves independently."""
        rng = np.random.default_rng(self.pick.randrange(2**32))
        q = rng.uniform(-0.4, 0.4, (4, len(self.own.positions)))
        J = measure_slopes(self.plant, q)
        chosen = ""
        for axis in self.pick.sample(AXES, 3):
            every = [AXES.index(x) for x in chosen + axis]
            sizes = np.linalg.svd(J[:, every], compute_uv=False)
            if len(every) <= J.shape[2] and (sizes[:, -1] > LEAST * (1 + sizes[:, 0])).all():
                chosen += axis
        return "".join(sorted(chosen[: self.pick.randint(1, 3)]))

    def impact(self, axes: str) -> Data:
        """Draw an impact along some axes."""
        contact: Data = {"sensor": POINT, "wrench": POINT, "axes": axes, "normal": self.pick.choice([*axes, None])}
        if contact["normal"] is not None and len(axes) > 1 and self.pick.random() < 0.6:
            contact["friction"] = 0.8
        return {"model": HIT, "contacts": [contact], "restitution": self.pick.choice([0, 0.4])}


def measure_slopes(plant: Any, q: Array) -> Array:
    """Return the velocities of the sensor (places, 3, joints) at unit speeds of each joint."""
    i = [frame.name for frame in plant.manifest.frames if frame.sensor].index(POINT)
    n = len(plant.manifest.coordinates)
    every = [plant("motion", q=q, qd=np.tile(np.eye(n)[k], (len(q), 1)))["v"][:, :, i] for k in range(n)]
    return np.stack(every, axis=2)


@dataclass(frozen=True)
class Impulse:
    """Velocities after an impact, and its impulses by axis."""

    qd: Array
    L: dict[str, float]


def strike(plant: Any, impact: Data, q: Array, qd: Array) -> Impulse:
    """Find an impact's impulses from its momentum and the velocities of its contact."""
    (contact,) = impact["contacts"]
    axes, n = contact["axes"], len(qd)
    J = measure_slopes(plant, q[None])[0, [AXES.index(x) for x in axes]]
    state = {"q": q[None], "qd": 0 * qd[None]}
    M = plant("semi", **_fill(plant, "semi", state))["M"].reshape(n, n)
    back = [impact["restitution"] if x == contact["normal"] else 0.0 for x in axes]
    wanted = -(1 + np.array(back)) * (J @ qd)
    whole = np.block([[M, -J.T], [J, np.zeros((len(axes), len(axes)))]])
    found = np.linalg.solve(whole, np.concatenate((np.zeros(n), wanted)))
    return Impulse(qd + found[:n], dict(zip(axes, found[n:].tolist(), strict=True)))


def _fill(plant: Any, kernel: str, given: dict[str, Array]) -> dict[str, Array]:
    """Add zeros for the forces that a kernel reads."""
    sizes = {x.name: x.rows for x in plant.describe(kernel).inputs if x.name in ("u", "w")}
    return given | {name: np.zeros((1, size)) for name, size in sizes.items()}


class Crossing:
    """A link along the motions of its phases; `plant` is the model of its impact, at the parameters of `before`."""

    def __init__(self, link: Data, before: Sections, after: Sections, plant: Any) -> None:
        self.link, self.before, self.after = link, before, after
        self.q, self.qd = before.motion.q[-1], before.motion.qd[-1]
        self.impulses: dict[str, float] = {}
        if "impact" in link:
            hit = strike(plant, link["impact"], self.q, self.qd)
            self.qd, self.impulses = hit.qd, hit.L
        self.known: Known = {f"end_{name}": value for name, value in before.last.items()}
        self.known |= {f"start_{name}": value for name, value in after.first.items()}
        self.known |= {f"j{axis}_{POINT}": np.array([x]) for axis, x in self.impulses.items()}

    @property
    def cost(self) -> float:
        """Return the link's terms of the cost."""
        return WEIGHT * float(self.link["cost"][0]["expression"].evaluate(self.known)[0])

    def list_demands(self) -> Iterator[Demand]:
        """List the limits of a link."""
        condition = self.link["conditions"][0]["expression"]
        yield Demand("the condition of the link", condition.evaluate(self.known), LIMITS)
        yield Demand("the distance of a state over the link", np.array(list(self._measure_distances())), (0.0, 0.0))
        yield from own_delays.list_demands(self.before, self.after)
        if "impact" in self.link:
            yield from self._limit_impulses(self.link["impact"]["contacts"][0])

    def _measure_distances(self) -> Iterator[float]:
        own, before, after = self.before.own, self.before.motion, self.after.motion
        q, qd = ({spell(x): y for x, y in zip(own.positions, part, strict=True)} for part in (self.q, self.qd))
        for i, name in enumerate(own.positions):
            formula = self.link["map"].get(name, Formula(spell(name)))
            rest = formula.evaluate(dict.fromkeys(q, 0.0))
            yield float(after.q[0, i] - formula.evaluate(q))
            yield float(after.qd[0, i] - (formula.evaluate(qd) - rest))
        apart = [x.state for x in own_delays.list_delayed(self.before, self.after) if x.differs]
        for name, values in after.states.items():
            if (
                name in before.states
                and name not in apart
                and name not in self.link["map"]
                and not name.startswith("@")
            ):
                yield float(values[0] - before.states[name][-1])

    def _limit_impulses(self, contact: Data) -> Iterator[Demand]:
        normal, L = contact["normal"], self.impulses
        if normal is None:
            return
        yield Demand("an impulse along the normal", np.array([L[normal]]), (0.0, np.inf))
        across: Sequence[float] = [x for axis, x in L.items() if axis != normal]
        if "friction" not in contact or not across:
            return
        most = contact["friction"] * L[normal]
        ways = [most + across[0], most - across[0]] if len(across) == 1 else [most**2 - sum(x**2 for x in across)]
        yield Demand("friction of an impulse", np.array(ways), (0.0, np.inf))
