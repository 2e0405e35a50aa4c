"""Random mechanisms over everything that a model file can contain: the generator's equations against `absolute`.

A mechanism disagrees where a function differs from virtual power by more than rounding; refused mechanisms are counted
separately. The tapes are evaluated in 50 digits, so only the reference is rounded. Where every number is a run-time
parameter, all of them are changed, in the parameters and at their paths in the file. With a tolerance, the approximated
functions are compared with the exact ones, at states that the approximation has not used.
"""

from __future__ import annotations

import copy
import random
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbsgen.approximation.choice import approximate
from mbsgen.approximation.states import draw as draw_states
from mbsgen.errors import MbsError
from mbsgen.families import write_families
from mbsgen.formulations.catalogue import FUNCTIONS, list_results
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.scene import Scene, read_scene, stage
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import build_parametric, make
from mbsgen.request import Options, merge
from mbsgen.tape.interpreter import DECIMALS, evaluate, fifty_digits
from mbsgen.tape.types import Tape
from mbsgen.targets.languages import TARGETS
from mbsgen.verification.verify import VerificationError, verify
from tests.fuzz.absolute import Absolute, Array, Found
from tests.fuzz.forces import draw_inputs, order_inputs, spell
from tests.fuzz.forms import vary
from tests.fuzz.kinematics import value_of
from tests.number_paths import set_number

ROUNDING = 1e-10  # of the largest sum of magnitudes: some hundred products in float64, and matrices of three rotations
FEW = replace(ALL, trials=6)
CHOICES: Mapping[str, Reductions] = {
    "all": FEW,
    "searched": replace(ALL, trials=24),
    "none": replace(NONE, trials=1),
    "no regrouping": replace(FEW, regroup=False),
    "no shared frames": replace(FEW, share_frames=False),
    "no lumps": replace(FEW, lump=False),
    "lumps by parameters": replace(FEW, lump_runtime=True),
    "relative angles": replace(FEW, absolute=False),
    "one by one": replace(FEW, together=False),
    "no meeting": replace(FEW, meet=False),
    "sums as they come": replace(FEW, share=False, order=False),
}
WITH_DERIVATIVES = 50
WRITTEN = 10  # every tenth mechanism is written whole, with functions together and in several languages
SKEW = ([0.6, 0, 0.8], [1, -2, 0.5], [0, 1, 1])
NUMBERS = {"given": 16, "runtime": 2, "zeros": 2, "approximate": 1}  # what is done with the file's numbers, how often
STATES = 256  # at which an approximation is compared; it was measured at 4096
BEYOND = 1.25  # times the tolerance: the allowed error at states that were not measured
JOINED = ("impl", "semi", "semi_res", "exp1", "exp2", "energy", "power", "frames", "condition")
FUNCTIONS_COMPARED = ("impl", "semi", "semi_res", "exp1", "exp2", "energy", "power", "sensors", "motion")


@dataclass(frozen=True)
class Mechanism:
    """A model file and a scene file, as data; what their run-time parameters are set to; how it is written."""

    model: dict[str, Any]
    scene: dict[str, Any]
    parameters: Mapping[str, float]
    reductions: str
    numbers: str = "given"  # one of NUMBERS
    tolerance: float = 0.0


@dataclass
class Tally:
    """The findings of a search."""

    agreed: int = 0
    refused: list[tuple[int, str]] = field(default_factory=list)
    findings: list[tuple[int, str]] = field(default_factory=list)


def draw(seed: int) -> Mechanism:
    """Draw a mechanism."""
    return _Draw(seed).mechanism()


class _Draw:
    def __init__(self, seed: int) -> None:
        self.source, self.seed = random.Random(seed), seed
        self.more = random.Random(f"{seed} forces")  # so that forces do not change the rest of the mechanism
        self.boxes = random.Random(f"{seed} boxes")
        self.rules = random.Random(f"{seed} rules")
        self.hulls = random.Random(f"{seed} hulls")
        self.kinds = {name: self.source.choice(["constant", "runtime", "differentiated"]) for name in "mlak"}
        self.values = {"m": 1.7, "l": 0.6, "a": 0.35, "k": 2.5}
        self.bodies: list[dict[str, Any]] = []
        self.joints: list[str] = []  # that may be followed or locked

    def mechanism(self) -> Mechanism:
        pick = self.source
        for i in range(pick.randint(1, 5)):
            self.bodies.append(self.body(f"b{i}"))
        model: dict[str, Any] = {
            "name": f"fuzz{self.seed}",
            "gravity": self.gravity(),
            "parameters": {
                name: value if self.kinds[name] == "constant" else {"value": value, "kind": self.kinds[name]}
                for name, value in self.values.items()
            },
            "bodies": pick.sample(self.bodies, len(self.bodies)),
            "frames": [self.attachment(f"f{k}") for k in range(pick.randint(0, 2))],
            "wrenches": [self.wrench(f"w{k}") for k in range(pick.choice([0, 0, 1, 2]))],
        }
        if self.more.random() < 0.4:
            self.add_forces(model)
        free = [name for name, kind in self.kinds.items() if kind != "constant"]
        parameters = {
            name: value * pick.uniform(0.8, 1.2) if name in free else value for name, value in self.values.items()
        }
        scene: dict[str, Any] = {}
        if pick.random() < 0.3:
            count = pick.randint(0, max(0, len(self.joints) - 1))
            scene = {
                "locked": {name: pick.choice([0, 0.4, "pi/2", -0.7]) for name in pick.sample(self.joints, count)},
                "gravity": pick.random() < 0.7,
                "motion": pick.random() < 0.8,
            }
        reductions, numbers = pick.choice(list(CHOICES)), pick.choices([*NUMBERS], [*NUMBERS.values()])[0]
        tolerance = pick.choice([1e-3, 1e-2, 0.1]) if numbers == "approximate" else 0.0
        vary(model, random.Random(f"{self.seed} forms"))
        return Mechanism(model, scene, parameters, reductions, numbers, tolerance)

    def gravity(self) -> list[Any]:
        given = self.source.choice([[0, 0, -9.81], [0.5, -3.0, 2.0], [0, -9.81, 0], [0, 0, 0]])
        return given if self.rules.random() < 0.9 else ["0.3*l", 0, "-4*k"]

    def add_forces(self, model: dict[str, Any]) -> None:
        """Add force elements, contacts, and a wrench and a force law that read the state."""
        source, self.source = self.source, self.more
        pick = self.more
        model["frames"].append({**self.attachment("probe"), "sensor": pick.random() < 0.5})
        given = ["t", "sig", "act"] if pick.random() < 0.3 else []
        state = [*given, "x_probe", "z_probe", "vy_probe"]
        state += [f"{kind}_{spell(x)}" for x in self.joints for kind in ("q", "qd")]

        def law() -> str:
            a, b, c = (pick.choice(state) for _ in range(3))
            return pick.choice(
                [
                    f"-k*{a} + 0.3*{b}*{c}",
                    f"3*max({a}, {b}) - min({b}, 0.2)*l",
                    f"step({a}, 0.3)*{b}",
                    f"-k*softplus({a} - 0.2, 0.1)",
                    f"sin({a})*abs({b})",
                ]
            )

        if pick.random() < 0.6:
            wrench = {**self.wrench("read"), "force": [law(), 0, law()], "moment": [0, pick.choice([0, law()]), 1.5]}
            model["wrenches"].append(wrench)
        alone = [x for body in self.bodies for x in ([body["joint"]] if isinstance(body["joint"], dict) else [])]
        for joint in alone:
            if joint["type"] == "revolute" and pick.random() < 0.2:
                joint["force"] = f"{law()} - 0.1*q*qd"
        model["forces"] = [self.element(f"s{k}", law) for k in range(pick.choice([0, 1, 1, 2]))]
        model["contacts"] = [self.contact(f"c{k}") for k in range(pick.choice([0, 1, 1]))]
        model["signals"] = [name for name in ("sig", "act") if re.search(rf"\b{name}\b", repr(model))]
        self.source = source

    def element(self, name: str, law: Callable[[], str]) -> dict[str, Any]:
        pick = self.more
        ends = [
            {"body": x, "position": [self.number(-0.6, 0.6) for _ in "xyz"]}
            for x in pick.sample(["base", *(body["name"] for body in self.bodies)], 2)
        ]
        element: dict[str, Any] = {"name": name, "from": ends[0], "to": ends[1]}
        kinds = [
            {"stiffness": pick.choice([3.0, "k"])},
            {"stiffness": "k", "rest": 0.3, "damping": 0.7},
            {"force": f"-0.4*length*rate + {law()}"},
            {"type": "cable", "stiffness": 5.0, "rest": "l", "width": 0.2, "dissipation": 0.4},
            {"type": "cable", "stiffness": "k**2", "rest": 0.1, "width": 0.05, "force": "0.2/length"},
        ]
        return element | pick.choice(kinds)

    def contact(self, name: str) -> dict[str, Any]:
        pick = self.more
        first, second = pick.sample(["base", *(body["name"] for body in self.bodies)], 2)
        first, second = (second, first) if first == "base" else (first, second)
        shape = pick.choice(
            [{"radius": 0.2}, {"radius": "a"}, {}, {"size": [0.3, 0.2, "l"], "orientation": self.turns()}]
        )
        contact: dict[str, Any] = {"name": name, "body": first, "position": self.vector(), **shape}
        plane = {"body": second, "position": self.vector(), "normal": self.axis()}
        contact |= {} if pick.random() < 0.2 else {"plane": plane}
        contact |= {"stiffness": pick.choice([20.0, "10*k"]), "width": 0.3, "exponent": pick.choice([1, 1.5, 2, 2.5])}
        friction = {"friction": {"coefficient": 0.6, "speed": pick.choice([0.5, "l"])}, "dissipation": 0.4}
        contact |= {key: x for key, x in friction.items() if pick.random() < 0.6}
        if "size" not in contact and pick.random() < 0.5:
            given = contact.pop("plane", {"position": [0.3, 0, 0.4]})
            place = {key: x for key, x in given.items() if key != "normal" and x != "base"}
            contact["sphere"] = {**place, "radius": pick.choice([0.5, "l", "a/2"])}
            if self.boxes.random() < 0.5:
                del contact["sphere"]
                size = [self.boxes.choice([0.5, "l", "a/2"]) for _ in range(3)]
                turn = {"axis": self.boxes.choice("xyz"), "angle": self.boxes.choice(["pi/2", 0.4, "a"])}
                contact["box"] = {**place, "orientation": [turn][: self.boxes.randint(0, 1)], "size": size}
                if self.hulls.random() < 0.4:
                    del contact["box"]["size"]
                    contact["capsule"] = {**contact.pop("box"), "radius": 0.2, "length": self.hulls.choice([0.5, "l"])}
        elif self.hulls.random() < 0.4:
            contact.pop("size", None)
            own: list[dict[str, Any]] = [
                {"radius": "a/2", "points": [[0, 0, "-l/2"], [0.1, 0, "l/2"]]},
                {"radius": 0, "points": [[0.1, 0.2, 0], [-0.1, 0.2, 0.1], [0, -0.2, "a"]]},
                {"radius": 0.1, "wheel": {"radius": "a", "axis": self.hulls.choice(["x", [0, 1, 0.5]])}},
                {"radius": 0, "wheel": {"radius": 0.3, "length": self.hulls.choice([0.4, "l"])}},
            ]
            contact |= self.hulls.choice(own)
        return contact

    def number(self, low: float, high: float) -> float:
        return round(self.source.uniform(low, high), 3)

    def vector(self, size: float = 0.6) -> list[Any]:
        pick = self.source
        entry = [self.number(-size, size) for _ in range(3)]
        match pick.randrange(6):
            case 0:
                return [0, 0, 0]
            case 1 | 2:
                axis = pick.randrange(3)
                return [x if k == axis else 0 for k, x in enumerate(entry)]
            case 3:
                axis = pick.randrange(3)
                named = pick.choice(["l", "-l/2", "2*l", "l*sin(a)", "sqrt(l)"])
                return [named if k == axis else 0 for k in range(3)]
            case 4:
                axis = pick.randrange(3)
                return [0 if k == axis else x for k, x in enumerate(entry)]
        return entry

    def turns(self) -> list[dict[str, Any]]:
        pick = self.source
        angles = ["pi/2", "-pi/2", "pi", 0.4, -1.1, "a", "a/2", "2*a"]
        return [
            {"axis": pick.choice("xyz"), "angle": pick.choice(angles)} for _ in range(pick.choice([0, 0, 0, 1, 1, 2]))
        ]

    def place(self) -> dict[str, Any]:
        return {"position": self.vector(), "orientation": self.turns()}

    def body(self, name: str) -> dict[str, Any]:
        pick = self.source
        parents = ["base", *(b["name"] for b in self.bodies)]
        body: dict[str, Any] = {"name": name, "parent": pick.choice(parents[-2:] if pick.random() < 0.7 else parents)}
        body["joint"] = self.carrier(body)
        body["mass"] = pick.choice([self.number(0.5, 3), self.number(0.5, 3), "m", "2*m", "sqrt(m)", "m+1"])
        body["com"] = self.vector(0.3)
        thin, diagonal = ["m*l**2/12", "m*l**2/12", 0], [0.2, 0.3, 0.25]
        body["inertia"] = pick.choice([*[self.tensor()] * 3, *[diagonal] * 3, thin, [0, 0, 0]])
        return body

    def tensor(self) -> dict[str, float]:
        points = np.random.default_rng(self.source.randrange(10**6)).normal(size=(6, 3)) * 0.3
        tensor = sum((p @ p * np.eye(3) - np.outer(p, p) for p in points), np.zeros((3, 3)))
        return {f"{'xyz'[r]}{'xyz'[c]}": round(float(tensor[r, c]), 4) for r in range(3) for c in range(r, 3)}

    def carrier(self, body: dict[str, Any]) -> Any:
        pick, name = self.source, body["name"]
        kinds = (
            ["revolute"] * 8 + ["prismatic"] * 3 + ["ball"] * 3 + ["fixed", "cardan", "spherical", "planar", "chain"]
        )
        kinds += ["helical", "universal", "cylindrical", "plane"]
        kinds += ["free", "free", "floating"] if body["parent"] == "base" else []
        kind = pick.choice(kinds)
        match kind:
            case "revolute" | "prismatic":
                return self.elementary(name, kind)
            case "chain":
                return [self.elementary(f"{name}{k}", pick.choice(["revolute", "prismatic"])) for k in "uv"]
            case "cardan" | "spherical" | "floating":
                size = 2 if kind == "cardan" else 3
                order = "".join(pick.sample("xyz", size))
                axes = {f"r{x}": self.setting() for x in order}
                if kind == "floating":
                    return {"type": kind, **self.place(), "order": order, "axes": axes}
                self.joints += [f"{name}.{x}" for x in axes]
                return {"type": kind, **self.place(), "order": order, "axes": axes}
            case "helical":
                self.joints.append(name)
                pitch = {"pitch": pick.choice([0.1, -0.4, "0.3/pi", "l/2"]), "axis": self.axis()}
                return {"type": kind, **self.place(), **self.setting(), **pitch}
            case "universal":
                return {"type": kind, **self.place(), "axis": self.axis(), "axis2": [*pick.choice(SKEW)]}
            case "cylindrical":
                axis = pick.choice("xyz")
                self.joints += [f"{name}.r{axis}", f"{name}.{axis}"]
                axes = {label: self.setting() for label in (f"r{axis}", axis)}
                return {"type": kind, **self.place(), "axis": axis, "axes": axes}
            case "plane":
                return {
                    "type": "planar",
                    **self.place(),
                    "normal": [*pick.choice(SKEW)],
                    "actuated": pick.random() < 0.5,
                }
            case "planar":
                plane = pick.choice(["xy", "xz", "yz"])
                self.joints += [f"{name}.{x}" for x in plane]
                return {"type": kind, **self.place(), "plane": plane, "axes": {x: self.setting() for x in plane}}
        return {"type": kind, **self.place()} | ({"actuated": pick.random() < 0.5} if kind != "fixed" else {})

    def axis(self) -> Any:
        pick = self.source
        return pick.choice([*("x", "y", "z") * 3, "-x", "-y", "-z", [*pick.choice(SKEW)]])

    def elementary(self, name: str, kind: str) -> dict[str, Any]:
        pick = self.source
        joint = {"name": name, "type": kind, "axis": self.axis(), **self.place(), **self.setting()}
        if self.joints and pick.random() < 0.08:
            ratio = pick.choice([1, -1, 0.5, -2])
            joint["follows"] = {"joint": pick.choice(self.joints), "ratio": ratio, "offset": self.number(-1, 1)}
            if self.rules.random() < 0.5:
                joint["follows"] |= {"ratio": self.rules.choice(["k", "-l", "1 - m"]), "offset": "a - 0.2"}
            joint.pop("actuated", None)
        else:
            self.joints.append(name)
        return joint

    def setting(self) -> dict[str, Any]:
        pick = self.source
        offered = {
            "actuated": pick.random() < 0.6,
            "stiffness": pick.choice([3.0, "k", "k**2"]),
            "rest": 0.2,
            "damping": pick.choice([0.4, "k/5"]),
            "friction": {"torque": 0.8, "speed": pick.choice([0.3, "l"])},
            "force": pick.choice(["-3*q**3 + 0.1*qd", "k*sin(q)*qd", "exp(-q**2)"]),
            "armature": pick.choice([0.15, "k/10", "0.01*k**2"]),
        }
        chosen = {key: x for key, x in offered.items() if pick.random() < (0.5 if key == "actuated" else 0.12)}
        if "stiffness" not in chosen:
            chosen.pop("rest", None)
        return chosen

    def attachment(self, name: str) -> dict[str, Any]:
        return {"name": name, "body": self.source.choice(self.bodies)["name"], **self.place()}

    def wrench(self, name: str) -> dict[str, Any]:
        pick = self.source
        return {
            "name": name,
            "body": pick.choice(self.bodies)["name"],
            "position": self.vector(),
            "frame": pick.choice(["base", "body"]),
            "force": pick.choice(["input", [1.0, -2.0, 0.5], ["k", 0, 0]]),
            "moment": pick.choice(["input", [0, 0.3, -0.1], [0, 0, "k*l"]]),
        }


# -- comparison -------------------------------------------------------------------------------------------------------


def read(mechanism: Mechanism, folder: Path) -> Model:
    """Write the model file of a mechanism into a folder, and read it. Raises InputError where it is refused."""
    file = folder / "model.yaml"
    file.write_text(yaml.safe_dump(mechanism.model, sort_keys=False))
    return read_model(file)


def examine(
    mechanism: Mechanism,
    seed: int = 0,
    *,
    derivatives: bool = False,
    reference: type[Absolute] = Absolute,
    beyond: float = BEYOND,
) -> str:
    """Compare a mechanism at a random state; return what differs, or nothing. Raises MbsError where it is refused.

    `reference` computes the virtual power; an approximation may err by `beyond` times its tolerance.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "fuzz.scene.yaml"
        scene.write_text(yaml.safe_dump(mechanism.scene or {"motion": True}, sort_keys=False))
        whole = read(mechanism, Path(folder))
        told = read_scene(scene, whole, list_results())
    reductions = CHOICES[mechanism.reductions]
    tree = build_tree(stage(whole, told))
    if mechanism.numbers in ("runtime", "zeros"):
        tree = build_parametric(whole, told, zeros=mechanism.numbers == "zeros")
        mechanism = change_numbers(mechanism, tree, seed)
    functions = (
        None if derivatives else tuple(x for x in FUNCTIONS_COMPARED if tree.sensors or x not in ("sensors", "motion"))
    )
    options = Options(reductions=reductions, functions=functions, derivatives=2 if derivatives else 0)
    families = write_families(tree, merge(options, told))
    if derivatives:
        verify(tree, families, still=not told.motion)
    tapes = {family.value.name: family.value for family in families}
    with fifty_digits():
        found = _Comparison(mechanism, tree, tapes, seed, reference).run()
    return found or (compare_approximation(tree, mechanism, told, seed, beyond) if mechanism.tolerance else "")


def write(mechanism: Mechanism, seed: int) -> str:
    """Write a mechanism with a scene that joins functions and leaves results out, in languages that are drawn.

    Functions and derivatives are verified on the way; return what differs, or nothing. Raises MbsError where the scene
    is refused.
    """
    source = random.Random(f"{seed} scene")
    of_sensors = ("sensors", "motion") if mechanism.model["frames"] else ()
    parts = source.sample((*JOINED, *of_sensors), source.choice([2, 2, 3]))
    scene = mechanism.scene | {
        "functions": source.sample(["impl", "exp1", "exp2", *of_sensors[:1]], 2),
        "together": {"step": parts},
        "results": source.choice([{}, {"energy": ["kinetic"]}, {"energy": ["momentum", "potential"]}]),
        "motion": source.random() < 0.6,
        "derivatives": source.choice([0, 1, 1, 2]),
    }
    targets = tuple(target.name for target in TARGETS if source.random() < 0.3)
    with tempfile.TemporaryDirectory() as folder:
        read(mechanism, Path(folder))
        place = Path(folder) / "fuzz.scene.yaml"
        place.write_text(yaml.safe_dump(scene, sort_keys=False))
        options = Options(
            scene=place,
            targets=targets,
            runtime=mechanism.numbers == "runtime",
            count=False,
            reductions=CHOICES[mechanism.reductions],
        )
        try:
            make(Path(folder) / "model.yaml", options)
        except VerificationError as error:
            return f"{error}; scene {scene}, targets {targets}"
    return ""


def change_numbers(mechanism: Mechanism, tree: Tree, seed: int) -> Mechanism:
    """Change every run-time parameter of a tree, and the file at its path; numbers in a formula have no path."""
    source, model = random.Random(f"{seed} numbers"), copy.deepcopy(mechanism.model)
    values = dict(mechanism.parameters)
    for parameter in (p for p in tree.parameters if p.kind is Kind.RUNTIME):
        if re.search(r"^(?!wrenches).*\.force\.[0-9]+$|^constraints\.|^wrenches.*\.[xyz]\.[0-9]+$", parameter.name):
            continue
        drawn = parameter.value * source.uniform(0.9, 1.1) if parameter.value else source.uniform(0.0, 0.02)
        values[parameter.name] = drawn
        set_number(model, parameter.name, drawn)
    return replace(mechanism, model=model, parameters=values)


def compare_approximation(tree: Tree, mechanism: Mechanism, scene: Scene, seed: int, beyond: float) -> str:
    """Compare the approximated joint forces and M with the exact ones; return what differs by more than is claimed.

    An entry errs by its largest difference at the states, relative to its largest value; M_ij relative to the largest
    of sqrt(M_ii M_jj).
    """
    options = Options(reductions=CHOICES[mechanism.reductions], functions=("impl", "semi"), derivatives=0)
    found = approximate(tree, mechanism.tolerance, merge(options, scene))
    states = draw_states(tree, STATES, 4711 + seed, motion=scene.motion)
    n = len(tree.joints)
    exact, near = (_evaluate_floats(x, options.reductions, states) for x in (tree, found.tree))
    size = np.sqrt(np.abs(exact["M"]).max(axis=0).reshape(n, n).diagonal())
    limits = {"Phi": np.abs(exact["Phi"]).max(axis=0), "c": np.abs(exact["c"]).max(axis=0), "M": np.outer(size, size)}
    faults = []
    for name, limit in limits.items():
        off = np.abs(near[name] - exact[name]).max(axis=0)
        if not (off <= beyond * mechanism.tolerance * limit.ravel() + ROUNDING * limit.max()).all():
            faults.append(f"{name} errs by more than {mechanism.tolerance}")
    if not max(found.errors.values(), default=0.0) <= mechanism.tolerance:
        faults.append(f"an error of {max(found.errors.values())} is reported")
    return ", ".join(faults)


def _evaluate_floats(tree: Tree, reductions: Reductions, states: Mapping[str, Array]) -> dict[str, Array]:
    """Evaluate impl and semi at arrays of states, without inputs of joints: (states, entries); M dense, by columns."""
    given: dict[str, Any] = {name: list(columns.T) for name, columns in states.items()}
    given |= {
        name: [p.value for p in tree.parameters if p.kind is kind]
        for name, kind in (("p", Kind.RUNTIME), ("theta", Kind.DIFFERENTIATED))
    }
    given["u"] = [np.zeros(STATES)] * sum(joint.actuated for joint in tree.joints)
    results: dict[str, Array] = {}
    for function in ("impl", "semi"):
        tape = FUNCTIONS[function].build(tree, reductions)
        found = evaluate(tape, {i.name: given[i.name] for i in tape.inputs})
        for output in tape.outputs:
            dense = np.zeros((STATES, output.sparsity.rows * output.sparsity.cols))
            for (r, c), value in zip(output.sparsity.entries, found[output.name], strict=True):
                dense[:, r + c * output.sparsity.rows] = value
            results[output.name] = dense
    return results


class _Comparison:
    def __init__(
        self, mechanism: Mechanism, tree: Tree, tapes: Mapping[str, Tape], seed: int, reference: type[Absolute]
    ) -> None:
        self.mechanism, self.tree, self.tapes = mechanism, tree, tapes
        scene, source = mechanism.scene, np.random.default_rng(seed)
        self.absolute = reference(mechanism.model, mechanism.parameters, gravity=scene.get("gravity", True))
        self.names = [joint.name for joint in tree.joints]
        self.q = dict(zip(tree.coordinates, source.uniform(-1.5, 1.5, len(tree.coordinates)), strict=True))
        moves = 1.0 if scene.get("motion", True) else 0.0
        self.qd = dict(zip(self.names, moves * source.uniform(-2, 2, len(self.names)), strict=True))
        self.qdd = dict(zip(self.names, source.uniform(-3, 3, len(self.names)), strict=True))
        self.u = {j.name: float(source.uniform(-3, 3)) for j in tree.joints if j.actuated}
        self.w = draw_inputs(mechanism.model, source)
        self.couplings = {
            joint["name"]: joint["follows"]
            for body in mechanism.model["bodies"]
            for joint in (body["joint"] if isinstance(body["joint"], list) else [body["joint"]])
            if "follows" in joint
        }

    def run(self) -> str:
        faults = []
        for name, deviation in self._deviations():
            if not deviation <= ROUNDING:
                faults.append(f"{name} by {deviation:.1e}")
        return ", ".join(faults)

    def _deviations(self) -> list[tuple[str, float]]:
        still = self._reference(dict.fromkeys(self.names, 0.0))
        found, rows = self._reference(self.qdd), {}
        rows["Phi"] = self._rows(found)
        rows["c"] = self._rows(still)
        Q = self._fold(found.Q) + np.array([self.u.get(name, 0.0) for name in self.names])
        qdd = np.array([self.qdd[name] for name in self.names])
        size = max(found.size, still.size, float(np.abs(Q).max(initial=0.0)), 1e-3)
        semi = self._evaluate("semi")
        n = len(self.names)
        M = semi["M"].reshape(n, n, order="F")
        deviations = [
            ("impl", self._evaluate("impl")["Phi"] - (rows["Phi"] - Q)),
            ("semi_res", self._evaluate("semi_res")["Phi"] - (rows["Phi"] - Q)),
            ("M", M @ qdd - (rows["Phi"] - rows["c"])),
            ("M", M - M.T),
            ("c", semi["c"] - rows["c"]),
        ]
        relative = [(name, float(np.abs(x).max(initial=0.0)) / size) for name, x in deviations]
        for name in ("exp1", "exp2"):
            solved = self._reference(dict(zip(self.names, self._evaluate(name)["qdd"], strict=True)))
            rest = np.abs(self._rows(solved) - Q).max(initial=0.0)
            relative.append((name, float(rest) / max(size, solved.size)))
        return relative + self._energies(found, Q) + self._sensors(found)

    def _energies(self, found: Found, Q: Array) -> list[tuple[str, float]]:
        energy = self._evaluate("energy")
        other = {name: x * 0.7 + 0.1 for name, x in self.q.items()}
        fall = energy["potential"][0] - self._evaluate("energy", q=other)["potential"][0]
        expected = found.potential - self._reference(self.qdd, q=other).potential
        power = Q @ np.array([self.qd[name] for name in self.names]) + found.power
        size = float(np.abs(Q).sum()) + abs(found.power) + sum(np.abs(x).sum() for x in self.w.values()) + 10
        return [
            ("kinetic", abs(energy["kinetic"][0] - found.kinetic) / max(found.kinetic, 1e-3)),
            ("potential", abs(fall - expected) / max(abs(found.potential), 10)),
            ("power", abs(self._evaluate("power")["power"][0] - power) / size),
        ]

    def _sensors(self, found: Found) -> list[tuple[str, float]]:
        if "sensors" not in self.tapes:
            return []
        frames = [found.frames[s.name] for s in self.tree.sensors]
        pairs = [(self._evaluate("sensors")["position"], [f.p for f in frames])]
        motion = self._evaluate("motion") if "motion" in self.tapes else {}
        pairs += [
            (motion[name], [getattr(f, key) for f in frames])
            for name, key in (("v", "v"), ("omega", "om"))
            if name in motion
        ]
        return [("sensors", float(np.abs(a - np.concatenate(b)).max()) / 10) for a, b in pairs]

    def _rows(self, found: Found) -> Array:
        return self._fold(found.Phi)

    def _fold(self, forces: Mapping[str, float]) -> Array:
        felt = dict.fromkeys(self.names, 0.0)
        for name, force in forces.items():
            leader, ratio, _ = self._lead(name)
            if leader in felt:
                felt[leader] += ratio * force
        return np.array([felt[name] for name in self.names])

    def _lead(self, name: str) -> tuple[str, float, float]:
        """Follow a joint to the one that has the coordinate: its name, the ratio, the offset."""
        if name not in self.couplings:
            return name, 1.0, 0.0
        given = self.couplings[name]
        leader, ratio, offset = self._lead(given["joint"])
        own, shift = (self.absolute.number(given[key]) for key in ("ratio", "offset"))
        return leader, own * ratio, own * offset + shift

    def _reference(self, qdd: Mapping[str, float], q: Mapping[str, float] | None = None) -> Found:
        q = self.q if q is None else q
        locked = {k: value_of(x, self.mechanism.parameters) for k, x in self.mechanism.scene.get("locked", {}).items()}
        at, rates, accelerations = dict(q), {}, {}
        for name in self.absolute.velocities():
            leader, ratio, offset = self._lead(name)
            rates[name], accelerations[name] = ratio * self.qd.get(leader, 0.0), ratio * float(qdd.get(leader, 0.0))
            place = locked.get(leader, q.get(leader))
            if place is not None:
                at[name] = ratio * place + offset
        return self.absolute.run(at, rates, accelerations, self.w)

    def _evaluate(self, name: str, q: Mapping[str, float] | None = None) -> dict[str, Array]:
        tape = self.tapes[name]
        given = {
            i.name: [Decimal(float(x)) for x in self._input(i.name, q or self.q)] for i in tape.inputs if i.name != "h"
        }
        if any(i.name == "h" for i in tape.inputs):
            values = [Decimal(x) for x in self._parameters(Kind.RUNTIME)]
            has_setup = "setup" in self.tapes  # else no function depends on the parameters
            given["h"] = evaluate(self.tapes["setup"], {"p": values}, DECIMALS)["h"] if has_setup else []
        return {key: np.array([float(x) for x in found]) for key, found in evaluate(tape, given, DECIMALS).items()}

    def _input(self, name: str, q: Mapping[str, float]) -> Sequence[float]:
        match name:
            case "q":
                return [q[x] for x in self.tree.coordinates]
            case "qd" | "qdd":
                return [getattr(self, name)[x] for x in self.names]
            case "u":
                return list(self.u.values())
            case "theta" | "p":
                return self._parameters(Kind.DIFFERENTIATED if name == "theta" else Kind.RUNTIME)
        return order_inputs(self.tree, self.w)

    def _parameters(self, kind: Kind) -> list[float]:
        return [self.mechanism.parameters.get(x.name, x.value) for x in self.tree.parameters if x.kind is kind]


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine mechanisms from a seed on; one in WITH_DERIVATIVES with its derivatives, one in WRITTEN written whole."""
    tally = Tally()
    for number in range(seed, seed + count):
        mechanism = draw(number)
        try:
            finding = examine(mechanism, number, derivatives=number % WITH_DERIVATIVES == 0)
            if not finding and number % WRITTEN == 0:
                finding = write(mechanism, number)
        except VerificationError as error:
            tally.findings.append((number, str(error)))
        except MbsError as error:
            tally.refused.append((number, str(error).splitlines()[0]))
        except Exception as error:
            tally.findings.append((number, f"{type(error).__name__}: {error}"))
        else:
            if finding:
                tally.findings.append((number, finding))
            else:
                tally.agreed += 1
        if keep is not None and tally.findings and tally.findings[-1][0] == number:
            keep_file(keep, number, tally.findings[-1][1], mechanism)
        show(number, tally)
    return tally


def keep_file(folder: Path, number: int, finding: str, mechanism: Mechanism) -> None:
    """Write the model file of a mechanism that disagrees, and what was found, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    found = f"{finding}\n# reductions: {mechanism.reductions}\n# scene: {mechanism.scene}"
    text = f"# seed {number}: {found}\n# numbers: {mechanism.numbers}, tolerance: {mechanism.tolerance}\n"
    text += f"# parameters: {dict(mechanism.parameters)}\n" + yaml.safe_dump(mechanism.model, sort_keys=False)
    (folder / f"mechanism_{number}.yaml").write_text(text)
