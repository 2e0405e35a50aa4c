"""Random mechanisms with loops: the generator's equations against `free_bodies`, where all bodies are free.

A tree is drawn as in `mechanisms`, and loops, constraints and driven joints that hold at a drawn pose are added to it.
The generator assembles the mechanism; this program closes it again, near that pose, at other numbers. There all
functions are compared, in 50 digits.
"""

from __future__ import annotations

import ast
import copy
import math
import random
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbsgen.assembly import assemble
from mbsgen.errors import MbsError
from mbsgen.families import write_families
from mbsgen.formulations.catalogue import FUNCTIONS, list_results
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.scene import read_scene, stage
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import build_parametric
from mbsgen.procedure.procedure import Computation, as_procedure, evaluate
from mbsgen.request import Options, merge
from mbsgen.tape import interpreter
from mbsgen.verification.verify import verify
from tests.fuzz import mechanisms
from tests.fuzz.absolute import Absolute
from tests.fuzz.forces import draw_inputs, order_inputs
from tests.fuzz.free_bodies import FreeBodies, OpenLoopError, Solution
from tests.fuzz.kinematics import DECIMALS, FLOATS, Array, Motion, Values, fifty_digits
from tests.fuzz.mechanisms import CHOICES, Mechanism, Tally

CUTS = ("rod", "ball", "hinge", "universal", "cylindrical", "prismatic", "planar", "solid")
PARAMETRIC = ("runtime", "zeros")  # every number is a run-time parameter, and changed
THIN = ([0, 0, 0], ["m*l**2/12", "m*l**2/12", 0])
WORDS = {"ball": "spherical", "hinge": "revolute", "solid": "fixed"}
ROUNDING = 1e-10  # of the largest entry: the generator's constants are rounded, and conditions are at most some 1000
REGULAR = 0.03  # the least singular value of J, relative to the largest, of a pose that is drawn
ATTEMPTS = 12  # at a loop that restricts the motion regularly
SUMS = 0.4  # of the equations, linear ones of three joints
NEAR = 0.1  # how far coordinates are from the assembled pose where functions are compared
SMALL = 0.01  # how far from closed poses coordinates are that are to be closed
WITH_DERIVATIVES = 25
NOT_COMPARED = ("condition", "jacobian", "frames", "rates")  # functions of the tree alone


# -- mechanisms -------------------------------------------------------------------------------------------------------


def draw(seed: int) -> Mechanism:
    """Draw a mechanism. Its loops hold at the pose that the file gives; some equations may be missing."""
    mechanism = mechanisms.draw(seed)
    numbers = "given" if mechanism.numbers == "approximate" else mechanism.numbers
    for attempt in range(ATTEMPTS):
        with_loops = _Loops(mechanism.model, mechanism.scene, f"{seed} loops {attempt}").model
        if any(with_loops.get(key) for key in ("loops", "constraints", "driven")):
            break
    return replace(mechanism, model=with_loops, numbers=numbers, tolerance=0.0)


class _Loops:
    """Adds loops to a model, one by one."""

    def __init__(self, model: dict[str, Any], scene: dict[str, Any], seed: str) -> None:
        self.model, self.scene = copy.deepcopy(model), scene
        for body in self.model["bodies"]:
            if body["inertia"] in THIN:  # many a joint would move nothing
                body["inertia"] = [0.05, 0.08, 0.06]
        self.source = random.Random(seed)
        self.sums = random.Random(f"{seed} sums")  # so that they do not change the rest of the mechanism
        names = {name: x["value"] if isinstance(x, dict) else x for name, x in model["parameters"].items()}
        self.parameters = {name: x for name, x in names.items() if not isinstance(x, str)}
        program = self._program(self.model)
        self.joints = [x for x in program.names_of_velocities if x in dict(program.elementary())]
        self.q = {name: round(self.source.uniform(-1, 1), 3) for name in program.names_of_coordinates}
        own = [name.rpartition(".")[0] for name in self.q if name.endswith(".qw")]
        for name in self.q:
            if name.rpartition(".")[0] in own:
                self.q[name] = float(name.endswith("w"))  # the assembly starts there
        moved = program.move(program.fill(self.q), *[self._still(program)] * 2)
        self.bodies = moved.bodies
        self.seats = {name: program.climb(moved, node)[0] for name, node in moved.nodes.items()}
        self._add()

    def _program(self, model: Mapping[str, Any]) -> FreeBodies:
        return FreeBodies(model, self.parameters, FLOATS, self.scene)

    def _still(self, program: FreeBodies) -> Values:
        return dict.fromkeys(program.velocities(), 0.0)

    def _add(self) -> None:
        pick = self.source
        for k in range(pick.choice([0, 1, 1, 1, 2])):
            self._try("loops", lambda k=k: self._loop(f"c{k}"))
        for k in range(pick.choice([0, 0, 0, 1])):
            self._try("constraints", lambda k=k: self._constraint(f"e{k}"))
        if pick.random() < 0.3:
            settings = {name: x for name, x in self._program(self.model).elementary() if "name" in x or "actuated" in x}
            choice = [name for name in self.joints if name in settings]
            self._try("driven", lambda: pick.choice(choice) if choice else None)
            for name in self.model.get("driven", ()):
                settings[name]["actuated"] = False
        if any(key in self.model for key in ("loops", "constraints")):
            used = {name: x + round(pick.uniform(-0.02, 0.02), 3) for name, x in self.q.items() if name in self.joints}
            self.model["assembly"] = used

    def _try(self, section: str, make: Callable[[], Any]) -> None:
        """Add an entry to a section, which all motions that are left feel, and which leaves some."""
        for _ in range(ATTEMPTS):
            added = make()
            if added is None:
                continue
            model = self.model | {section: [*self.model.get(section, []), added]}
            J = self._restrict(model)
            singular = np.linalg.svd(J, compute_uv=False) if J.size else np.zeros(1)
            if len(J) < J.shape[1] and singular.min() > REGULAR * max(1.0, singular.max()):
                self.model = model
                return

    def _restrict(self, model: Mapping[str, Any]) -> Array:
        program = self._program(model)
        J = program.jacobian(self.q)[1]
        driven = [program.names_of_velocities.index(name) for name in model.get("driven", ())]
        return np.concatenate([J, np.eye(J.shape[1])[driven]])

    def _loop(self, name: str) -> dict[str, Any] | None:
        pick = self.source
        one, other = pick.sample([*self.bodies], 2)
        if self.seats[one] == self.seats[other]:
            return None
        cut, draw_place = pick.choice(CUTS), mechanisms._Draw(pick.randrange(10**6))
        loop: dict[str, Any] = {"name": name, "type": WORDS[cut] if cut in WORDS and pick.random() < 0.3 else cut}
        loop["from"] = {"body": one, **draw_place.place()}
        if cut == "cylindrical" and (thread := random.Random(repr(loop))).random() < 0.5:
            cut = loop["type"] = "helical"
            loop["pitch"] = thread.choice([-0.3, 0.2, 0.5])
        axis = draw_place.axis() if cut not in ("rod", "ball", "solid") else "z"
        loop |= {"axis": axis} if axis != "z" else {}
        axis2 = pick.choice(["x", "y", "-z", [0, 1, 1], [1, 1, -1]]) if cut == "universal" else axis
        loop |= {"axis2": axis2} if cut == "universal" and axis2 != "x" else {}
        program = self._program(self.model)
        first = program.place(self.bodies[one], loop["from"])
        e, e2 = program.direction(axis), program.direction(axis2)
        if cut == "universal" and abs(e @ e2) > 0.9:
            return None
        place, R = self._move_freely(cut, first, e, e2, loop.get("pitch", 0.0))
        if cut == "rod":
            length = float(np.linalg.norm(place - first.p))
            if length < 0.1:
                return None
            loop["length"] = length
        body = self.bodies[other]
        loop["to"] = {"body": other, "position": [float(x) for x in body.R.T @ (place - body.p)]}
        loop["to"]["orientation"] = write_turns(body.R.T @ R)
        return loop

    def _move_freely(self, cut: str, first: Motion, e: Array, e2: Array, pitch: float) -> tuple[Array, Array]:
        """Return an origin and axes of the second frame that a cut allows."""
        pick, along, angle = self.source, first.R @ e, self.source.uniform(-1, 1)
        turn = turn_about(along, angle)
        anywhere = turn_about(np.array([pick.gauss(0, 1) for _ in range(3)]), pick.uniform(-2, 2))
        shift = np.array([pick.uniform(-0.5, 0.5) for _ in range(3)])
        match cut:
            case "rod":
                return first.p + 1.5 * shift, anywhere
            case "ball":
                return first.p, anywhere
            case "hinge":
                return first.p, turn @ first.R
            case "universal":  # the angle between axes stays when both turn, each about its own
                second = turn @ first.R
                return first.p, turn_about(second @ e2, pick.uniform(-1, 1)) @ second
            case "cylindrical":
                return first.p + along * shift[0], turn @ first.R
            case "helical":
                return first.p + pitch * angle * along / np.linalg.norm(along), turn @ first.R
            case "prismatic":
                return first.p + along * shift[0], first.R
            case "planar":
                return first.p + np.cross(along, shift), turn @ first.R
        return first.p, first.R

    def _constraint(self, name: str) -> dict[str, Any] | None:
        pick = self.source
        plain = [x for x in self.joints if x.isidentifier()]
        if len(plain) < 2:
            return None
        a, b = pick.sample(plain, 2)
        equation = pick.choice(
            [f"sin({a}) + l*{b}**2", f"{a} - k*{b}/2", f"exp({a}/2)*cos({b})", f"{a}*{b} + atan({a} - 2*{b})"]
        )
        if len(plain) > 2 and self.sums.random() < SUMS:
            c = self.sums.choice([x for x in plain if x not in (a, b)])
            equation = self.sums.choice([f"{a} - k*{b}/2 + {c}/3", f"{a} + {b} - 2*{c}", f"l*{a} - {b}/3 - {c}"])
        here = mechanisms.value_of(equation, {**self.parameters, **self.q})
        return {"name": name, "equation": f"{equation} - {here!r}".replace("- -", "+ ")}


def turn_about(axis: Array, angle: float) -> Array:
    """Return a rotation about an axis of any length (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def write_turns(R: Array) -> list[dict[str, Any]]:
    """Write a rotation as turns about x, y and z, in turn."""
    angles = math.atan2(-R[1, 2], R[2, 2]), math.asin(max(-1.0, min(1.0, R[0, 2]))), math.atan2(-R[0, 1], R[0, 0])
    return [{"axis": axis, "angle": float(angle)} for axis, angle in zip("xyz", angles, strict=True) if angle]


# -- comparison -------------------------------------------------------------------------------------------------------


def examine(mechanism: Mechanism, seed: int = 0, *, derivatives: bool = False) -> str:
    """Compare a mechanism at a random state; return what differs, or nothing. Raises MbsError where it is refused."""
    tree, tapes = write_tapes(mechanism, derivatives=derivatives)
    if mechanism.numbers in PARAMETRIC:
        mechanism = mechanisms.change_numbers(mechanism, tree, seed)
    with fifty_digits():
        return Comparison(mechanism, tree, tapes, seed).run()


def write_tapes(mechanism: Mechanism, *, derivatives: bool = False) -> tuple[Tree, Mapping[str, Computation]]:
    """Read a mechanism, assemble it, and write its functions; verify their derivatives where these are asked for."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "fuzz.scene.yaml"
        scene.write_text(yaml.safe_dump(mechanism.scene or {"motion": True}, sort_keys=False))
        whole = mechanisms.read(mechanism, Path(folder))
        staged = read_scene(scene, whole, list_results())
    if mechanism.numbers in PARAMETRIC:
        tree = assemble(build_parametric(whole, staged, zeros=mechanism.numbers == "zeros"))
    else:
        tree = assemble(build_tree(stage(whole, staged)))
    if not tree.is_constrained:
        raise OpenLoopError("nothing was found that leaves it a freedom")
    names = tuple(name for name, entry in FUNCTIONS.items() if all(need.holds(tree) for need in entry.needs))
    functions = None if derivatives else tuple(x for x in names if x not in NOT_COMPARED)
    options = Options(
        reductions=CHOICES[mechanism.reductions], functions=functions, derivatives=2 if derivatives else 0
    )
    families = write_families(tree, merge(options, staged))
    if derivatives:
        verify(tree, families, still=not staged.motion)
    return tree, {family.value.name: family.value for family in families}


class Comparison:
    """The tapes of a tree beside the independent program, at one open state and one closed state."""

    def __init__(self, mechanism: Mechanism, tree: Tree, tapes: Mapping[str, Computation], seed: int) -> None:
        self.mechanism, self.tree, self.tapes = mechanism, tree, tapes
        self.source = np.random.default_rng(seed)
        model = express_rules(mechanism, tree)
        numbers = (model, mechanism.parameters, DECIMALS)
        self.program = FreeBodies(*numbers, mechanism.scene)
        self.power = Absolute(*numbers, gravity=mechanism.scene.get("gravity", True))
        self.names = [joint.name for joint in tree.joints]
        self.order = [self.program.names_of_velocities.index(name) for name in self.names]
        assert tree.closure is not None
        self.closure = tree.closure
        self.driven = [tree.bodies[k - 1].joint.name for k in tree.driven]
        self.moves = 1.0 if mechanism.scene.get("motion", True) else 0.0
        self.u = {j.name: float(self.source.uniform(-3, 3)) for j in tree.joints if j.actuated}
        self.w = draw_inputs(mechanism.model, self.source)
        self.faults: list[str] = []

    def run(self) -> str:
        """Return what differs, and by which part of its size."""
        size = len(self.names)
        q = dict(zip(self.tree.coordinates, self.source.uniform(-1.5, 1.5, len(self.tree.coordinates)), strict=True))
        self._compare_open(q, *(self._draw(size) * Decimal(x) for x in (2 * self.moves, 3)))
        q, qd = self._close()
        self._compare_motion(q, qd)
        return ", ".join(self.faults)

    def _draw(self, size: int) -> Array:
        return DECIMALS.array(self.source.uniform(-1, 1, size))

    def _close(self) -> tuple[dict[str, Any], Array]:
        """Find a closed state near the assembled pose: independent coordinates are changed, all others follow."""
        program = self.program
        q = dict(zip(self.tree.coordinates, self.closure.pose, strict=True))
        step = DECIMALS.array(np.zeros(len(self.names)))
        step[[self.order[k] for k in self.closure.independent]] = self._draw(len(self.closure.independent)) * Decimal(
            NEAR
        )
        q = program.close(program.advance(program.close(q), step))
        J = program.jacobian(q)[1]
        return q, program.make_consistent(J, self._draw(len(self.names)) * Decimal(2 * self.moves))

    # -- an open state ------------------------------------------------------------------------------------------------

    def _compare_open(self, q: Mapping[str, Any], qd: Array, qdd: Array) -> None:
        """Compare what holds at any state: closures and their rates, and the equations of motion with forces."""
        lam, tau = self._draw(len(self.closure.kept)), self._draw(len(self.driven))
        at = {"q": q, "qd": qd, "qdd": qdd, "lam": lam, "tau": tau}
        found = self.program.close_over(q, self._by_name(qd), self._by_name(qdd))
        kept = list(self.closure.kept)
        J = found.J[kept][:, self.order]
        if "loops" in self.tapes:
            jacobian = self._evaluate("loop_jacobian", at)
            self._judge("loops", self._evaluate("loops", at)["gap"], found.h[kept])
            self._judge("loop_rates", self._evaluate("loop_rates", at)["hd"], found.hd[kept])
            self._judge("loop_accelerations", self._evaluate("loop_accelerations", at)["hdd"], found.hdd[kept])
            self._judge("loop_jacobian", jacobian["J"], J)
            self._judge("gamma", jacobian["gamma"], found.gamma[kept])
            self._judge("loop_forces", self._evaluate("loop_forces", at)["Q"], lam @ J)
        Phi, size = self._residual(q, qd, qdd)
        Phi -= lam @ J
        for name, force in zip(self.driven, tau, strict=True):
            Phi[self.names.index(name)] -= force
        for name in ("impl", "semi_res"):
            self._judge(name, self._evaluate(name, at)["Phi"], Phi, size)
        still, _ = self._residual(q, qd, qdd * 0, forces=False)
        semi = self._evaluate("semi", at)
        self._judge("c", semi["c"], still, size)
        self._judge("M", semi["M"] @ qdd, self._residual(q, qd, qdd, forces=False)[0] - still, size)
        self._judge("M", semi["M"], semi["M"].T)
        kinetic = self._power(q, qd, qdd).kinetic
        self._judge(
            "kinetic", self._evaluate("energy", at)["kinetic"], DECIMALS.array([kinetic]), float(kinetic) + 1e-3
        )

    def _residual(self, q: Mapping[str, Any], qd: Array, qdd: Array, *, forces: bool = True) -> tuple[Array, float]:
        """Return Phi - Q of the tree by virtual power, and the size of its terms."""
        found = self._power(q, qd, qdd)
        Q = self._fold(found.Q) + DECIMALS.array([self.u.get(name, 0.0) for name in self.names])
        Phi = self._fold(found.Phi)
        size = max(float(found.size), float(abs(Q).max(initial=0)), 1e-3)
        return (Phi - Q if forces else Phi), size

    def _power(self, q: Mapping[str, Any], qd: Array, qdd: Array) -> Any:
        rates, accelerations = (self.program.fill_rates(self._by_name(x)) for x in (qd, qdd))
        return self.power.run(self.program.fill(q), rates, accelerations, self.w)

    def _fold(self, forces: Mapping[str, Any]) -> Array:
        return self.program.fold(forces)[self.order]

    # -- a closed state -----------------------------------------------------------------------------------------------

    def _compare_motion(self, q: Mapping[str, Any], qd: Array) -> None:
        """Compare what holds at closed states: accelerations and forces of loops, and all that is reduced."""
        rates = dict(zip(self.program.names_of_velocities, qd, strict=True))
        own = DECIMALS.array([rates[name] for name in self.names])
        drive = {name: float(x) for name, x in zip(self.driven, self._draw(len(self.driven)), strict=True)}
        solved = self.program.solve(q, rates, self.u, self.w, drive, self.closure.kept)
        wanted = DECIMALS.array([solved.qdd[name] for name in self.names])
        tau = DECIMALS.array([solved.tau[name] for name in self.driven])
        at = {"q": q, "qd": own, "a": DECIMALS.array([*drive.values()])}
        for name in ("exp1", "exp2"):
            found = self._evaluate(name, at)
            self._judge(f"{name}: qdd", found["qdd"], wanted)
            if len(self.closure.kept):
                self._judge(f"{name}: lam", found["lam"], solved.lam, self._size(solved))
            if self.driven:
                self._judge(f"{name}: tau", found["tau"], tau, self._size(solved))
        if "impl_red" in self.tapes:
            self._compare_reduced(q, own, at, solved)
        self._compare_closing(q, own, at)
        self._check_choice(q)

    def _compare_reduced(self, q: Mapping[str, Any], qd: Array, at: Mapping[str, Any], solved: Solution) -> None:
        """Compare the reduced forms, by Z: the joint velocities of unit independent velocities."""
        free, kept = list(self.closure.independent), list(self.closure.kept)
        found = self.program.close_over(q, self._by_name(qd), self._by_name(qd * 0))
        J, gamma = found.J[kept][:, self.order], found.gamma[kept]
        unit = DECIMALS.array(np.eye(len(free)))
        Z = np.column_stack([self._complete(J, column, gamma * 0) for column in unit] or [qd[:, None][:, :0]])
        ydd, tau = self._draw(len(free)), self._draw(len(self.driven))
        net, size = self._residual(q, qd, self._complete(J, ydd, -gamma))
        residual = net @ Z
        for name, force in zip(self.driven, tau, strict=True):
            residual[free.index(self.names.index(name))] -= force
        given = {**at, "yd": qd[free], "ydd": ydd, "tau": tau}
        size *= max(1.0, float(abs(Z).max(initial=0)))
        self._judge("impl_red", self._evaluate("impl_red", given)["Phi"], residual, size)
        still, _ = self._residual(q, qd, self._complete(J, ydd * 0, -gamma), forces=False)
        moving, _ = self._residual(q, qd, self._complete(J, ydd, -gamma), forces=False)
        semi = self._evaluate("semi_red", given)
        self._judge("semi_red: c", semi["c"], still @ Z, size)
        M = semi["M"].reshape(len(free), len(free))
        self._judge("semi_red: M", M @ ydd, (moving - still) @ Z, size)
        self._judge("semi_red: M", M, M.T)
        wanted = DECIMALS.array([solved.qdd[self.names[k]] for k in free])
        self._judge("exp1_red: ydd", self._evaluate("exp1_red", given)["ydd"], wanted)
        if self.driven:
            tau = DECIMALS.array([solved.tau[name] for name in self.driven])
            self._judge("exp1_red: tau", self._evaluate("exp1_red", given)["tau"], tau, self._size(solved))

    def _compare_closing(self, q: Mapping[str, Any], qd: Array, at: Mapping[str, Any]) -> None:
        """Compare the functions that close loops and project states on closed ones."""
        if "close" not in self.tapes:
            return
        program, free = self.program, list(self.closure.independent)
        found = program.close_over(q, self._by_name(qd), self._by_name(qd * 0))
        kept = list(self.closure.kept)
        J, gamma = found.J[kept][:, self.order], found.gamma[kept]
        given = {**at, "yd": self._draw(len(free)) * Decimal(self.moves), "ydd": self._draw(len(free))}
        rates = self._complete(J, given["yd"], gamma * 0)
        self._judge("close_rates", self._evaluate("close_rates", given)["qd"], rates)
        moving = program.close_over(q, self._by_name(rates), self._by_name(rates * 0)).gamma[kept]
        accelerations = self._complete(J, given["ydd"], -moving)
        self._judge("close_accelerations", self._evaluate("close_accelerations", given)["qdd"], accelerations)
        step = self._draw(len(self.names)) * Decimal(SMALL)
        step[free] = DECIMALS.array(np.zeros(len(free)))
        off = {**at, "q": self._advance(q, step)}
        closed = dict(zip(self.tree.coordinates, self._evaluate("close", off)["closed"], strict=True))
        self._judge("close: h", program.jacobian(closed)[0], DECIMALS.array(np.zeros(len(found.h))))
        if not self.tree.quaternions:
            order = self.tree.coordinates
            self._judge("close", DECIMALS.array([closed[x] for x in order]), DECIMALS.array([q[x] for x in order]))
        self._check_projection(q, qd, at)

    def _advance(self, q: Mapping[str, Any], step: Array) -> dict[str, Any]:
        own = self._by_name(step)
        return self.program.advance(dict(q), [own[name] for name in self.program.names_of_velocities])

    def _check_projection(self, q: Mapping[str, Any], qd: Array, at: Mapping[str, Any]) -> None:
        """Check that projections close loops, and that what they change is W^-1 JT times multipliers."""
        program, kept = self.program, list(self.closure.kept)
        free = [k for k, name in enumerate(self.names) if name not in self.driven]
        start = self._advance(q, self._draw(len(self.names)) * Decimal(SMALL))
        rates = qd + self._draw(len(qd))
        for name in ("project", "project_plain"):
            found = self._evaluate(name, {**at, "q": start, "qd": rates})
            closed, velocities = dict(zip(self.tree.coordinates, found["closed"], strict=True)), found["closed_qd"]
            h, J = program.jacobian(closed)
            J = J[:, self.order]
            self._judge(f"{name}: h", h, h * 0)
            self._judge(f"{name}: hd", J @ velocities, h * 0)
            changes = [(closed, rates - velocities)]
            if not self.tree.quaternions:
                order = self.tree.coordinates
                changes.append((start, DECIMALS.array([start[x] - closed[x] for x in order])))
            for place, change in changes:
                J = program.jacobian(place)[1][kept][:, self.order].astype(float)[:, free]
                M = self._evaluate("semi", {**at, "q": place})["M"].reshape(len(self.names), -1).astype(float)
                W = np.eye(len(self.names)) if name == "project_plain" else M
                forces = (W @ change.astype(float))[free]
                lam = np.linalg.lstsq(J.T, forces, rcond=None)[0]
                rest = DECIMALS.array(forces - J.T @ lam)
                self._judge(f"{name}: change", rest, rest * 0, max(1e-3, float(np.abs(forces).max(initial=0))))

    def _complete(self, J: Array, y: Array, right: Array) -> Array:
        """Return entries of all joints by the independent ones: J x = right."""
        free, rest = list(self.closure.independent), list(self.closure.dependent)
        found = DECIMALS.array(np.zeros(len(self.names)))
        found[free] = y
        inverse = DECIMALS.array(np.linalg.inv(J[:, rest].astype(float)))
        for _ in range(6):
            found[rest] = found[rest] + inverse @ (right - J @ found)
        return found

    def accelerate(self, q: Mapping[str, Any], qd: Array, drive: Mapping[str, float]) -> Array:
        """Return what exp1 gives for a state without forces of joints; velocities are in the program's order."""
        rates = dict(zip(self.program.names_of_velocities, qd, strict=True))
        own = DECIMALS.array([rates[name] for name in self.names])
        given, self.u = self.u, dict.fromkeys(self.u, 0.0)
        at = {"q": q, "qd": own, "a": DECIMALS.array([drive[name] for name in self.driven])}
        found = dict(zip(self.names, self._evaluate("exp1", at)["qdd"], strict=True))
        self.u = given
        return DECIMALS.array([found[name] for name in self.program.names_of_velocities])

    def _size(self, solved: Solution) -> float:
        return max(1e-3, *(abs(float(x)) for x in (*solved.lam, *solved.tau.values())))

    def _check_choice(self, q: Mapping[str, Any]) -> None:
        """Check that the kept equations are all that count, and determine the dependent coordinates."""
        J = self.program.jacobian(q)[1][:, self.order].astype(float)
        kept, dependent = list(self.closure.kept), list(self.closure.dependent)
        if len(kept) != np.linalg.matrix_rank(J, tol=1e-9):
            self.faults.append(f"{len(kept)} equations are kept, and the rank is {np.linalg.matrix_rank(J, tol=1e-9)}")
        if dependent and np.linalg.cond(J[np.ix_(kept, dependent)]) > 1e8:
            self.faults.append("the kept equations do not determine the dependent coordinates")

    # -- evaluation ---------------------------------------------------------------------------------------------------

    def _by_name(self, values: Sequence[Any] | Array) -> dict[str, Any]:
        return dict(zip(self.names, values, strict=True))

    def _judge(self, name: str, found: Array, wanted: Array, size: float | None = None) -> None:
        if found.shape != wanted.shape:
            self.faults.append(f"{name} has the shape {found.shape}, not {wanted.shape}")
            return
        scale = max(1.0, float(abs(wanted).max(initial=0))) if size is None else size
        off = float(abs(found - wanted).max(initial=0)) / scale
        if not off <= ROUNDING:
            self.faults.append(f"{name} by {off:.1e}")

    def _evaluate(self, name: str, at: Mapping[str, Any]) -> dict[str, Array]:
        """Evaluate a tape; results are dense."""
        function = as_procedure(self.tapes[name])
        given = {i.name: [DECIMALS.make(x) for x in self._input(i.name, at)] for i in function.inputs if i.name != "h"}
        if any(i.name == "h" for i in function.inputs):
            p = [Decimal(x) for x in self._parameters(Kind.RUNTIME)]
            setup = self.tapes.get("setup")  # else no function depends on the parameters
            given["h"] = [] if setup is None else evaluate(setup, {"p": p}, interpreter.DECIMALS)["h"]
        values = evaluate(function, given, interpreter.DECIMALS)
        return {o.name: _spread(o.sparsity, values[o.name]) for o in function.outputs}

    def _input(self, name: str, at: Mapping[str, Any]) -> Sequence[Any]:
        match name:
            case "q":
                return [at["q"][x] for x in self.tree.coordinates]
            case "u":
                return list(self.u.values())
            case "theta" | "p":
                return self._parameters(Kind.DIFFERENTIATED if name == "theta" else Kind.RUNTIME)
            case "w":
                return order_inputs(self.tree, self.w)
        return list(at[name])

    def _parameters(self, kind: Kind) -> list[float]:
        return [self.mechanism.parameters.get(x.name, x.value) for x in self.tree.parameters if x.kind is kind]


def express_rules(mechanism: Mechanism, tree: Tree) -> dict[str, Any]:
    """Replace linear constraints that a tree does not have by rules of followers, for joints without coordinates."""
    model = copy.deepcopy(mechanism.model)
    program = FreeBodies(model, mechanism.parameters, FLOATS, mechanism.scene)
    settings = dict(program.elementary())
    kept = {constraint.name for constraint in tree.constraints}
    gone = [x for x in model.get("constraints", ()) if x["name"] not in kept]
    if not gone:
        return model
    model["constraints"] = [x for x in model["constraints"] if x["name"] in kept]
    names = sorted({x for constraint in gone for x in _names_of(constraint["equation"]) if x in settings})
    free = [x for x in names if x in program.names_of_velocities and x not in tree.coordinates]
    others = [x for x in names if x not in free]

    def value(equation: str, moved: str = "") -> float:
        at = {x: float(x == moved) for x in names}
        return float(mechanisms.value_of(equation, {**mechanism.parameters, **at}))

    start = np.array([value(x["equation"]) for x in gone])
    slopes = {name: np.array([value(x["equation"], name) for x in gone]) - start for name in names}
    right = np.column_stack([*(-slopes[x] for x in others), -start])
    rules, *_ = np.linalg.lstsq(np.column_stack([slopes[x] for x in free]), right, rcond=None)
    for name, row in zip(free, rules.tolist(), strict=True):
        ratios = {x: ratio for x, ratio in zip(others, row, strict=False) if ratio}
        first, *_ = ratios
        more = {x: ratio for x, ratio in ratios.items() if x != first}
        settings[name]["follows"] = {"joint": first, "ratio": ratios[first], "offset": row[-1], "more": more}
    return model


def _names_of(equation: str) -> set[str]:
    return {node.id for node in ast.walk(ast.parse(equation)) if isinstance(node, ast.Name)}


def _spread(sparsity: Any, values: Sequence[Any]) -> Array:
    """Return a dense array of the nonzeros of a result: a matrix, or a vector where it has one column."""
    dense = DECIMALS.array(np.zeros((sparsity.rows, sparsity.cols)))
    for (r, c), value in zip(sparsity.entries, values, strict=True):
        dense[r, c] = value
    return dense[:, 0] if sparsity.cols == 1 else dense


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine mechanisms from a seed on; one in WITH_DERIVATIVES with its derivatives."""

    def examine_one(number: int) -> tuple[str, Callable[[], Mechanism]]:
        mechanism = draw(number)
        found = examine(mechanism, number, derivatives=number % WITH_DERIVATIVES == 0)
        return found, lambda: mechanism

    return tally_up(range(seed, seed + count), examine_one, keep, show)


def tally_up(
    numbers: Sequence[int],
    examine_one: Callable[[int], tuple[str, Callable[[], Mechanism]]],
    keep: Path | None,
    show: Callable[[int, Tally], None],
) -> Tally:
    """Examine mechanisms by their numbers; keep the files of the mechanisms that disagree."""
    tally = Tally()
    for number in numbers:
        try:
            finding, mechanism = examine_one(number)
        except MbsError as error:
            tally.refused.append((number, str(error).splitlines()[0]))
        except (OpenLoopError, ZeroDivisionError) as error:
            tally.refused.append((number, f"the independent program: {error}"))
        except Exception as error:
            tally.findings.append((number, f"{type(error).__name__}: {error}"))
        else:
            if not finding:
                tally.agreed += 1
            else:
                tally.findings.append((number, finding))
                if keep is not None:
                    mechanisms.keep_file(keep, number, finding, mechanism())
        show(number, tally)
    return tally
