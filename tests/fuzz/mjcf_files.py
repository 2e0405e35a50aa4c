"""Random files of MJCF, drawn from its schema: our reader against MuJoCo's own.

Where both read a file, and ours warns of no difference, the residuals with springs and dampers agree, and so do limits,
dry friction and the largest forces. A file that MuJoCo refuses is refused here. A file that is refused here alone is
counted with the reason.
"""

from __future__ import annotations

import math
import os
import random
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, Expression, evaluate
from mbsgen.formulations import impl
from mbsgen.formulations.reductions import NONE
from mbsgen.importing import Imported, import_model
from mbsgen.importing.mjcf.schema import TABLE, Use
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.following import list_joints
from mbsgen.model.model import Body, Fixed, Joint, Model
from mbsgen.tape.interpreter import evaluate as run
from tests.fuzz.mechanisms import Tally
from tests.import_peers import MujocoPeer, State

Array = NDArray[np.float64]

TOLERANCE = 1e-9  # some hundred products, of numbers near 1
SINGLE = 2e-6  # of meshes, whose corners MuJoCo rounds
HARMLESS = ("bound problems alone", "may touch others", "gains and dynamics", "actuation:")  # to the residual
LEGAL = (  # here
    "mass and inertia of moving bodies must be larger",  # unless nothing beyond them has mass
    "must be positive in geom", "both pos and fromto", "fromto requires",  # of geoms that have no mass
    "springyield should not be defined",  # which is warned of
    "inertia should be specified in the mesh asset",  # of geoms that have no mass
)  # fmt: skip
IDLE = {"user", "material", "mesh", "hfield", "type", "fluidcoef", "fluidshape", "fitscale", "rgba", "name", "simple",
        "fuse", "surfacevel", "align", "condim", "plugin", "castshadow", "params", "normal", "texcoord", "smoothnormal",
        "solref", "solimp", "solreflimit", "solimplimit", "solreffriction", "solimpfriction", "actuatorgravcomp",
        "interp", "lengthrange", "nsample", "friction", "priority", "adhesion"}  # fmt: skip


@dataclass
class Part:
    """An element of a file."""

    tag: str
    attributes: dict[str, str] = field(default_factory=dict)
    children: list[Part] = field(default_factory=list)

    def write(self) -> str:
        """Write it as XML."""
        head = "".join(f" {key}={quoteattr(value)}" for key, value in self.attributes.items())
        inner = "".join(child.write() for child in self.children)
        return f"<{self.tag}{head}>{inner}</{self.tag}>\n" if inner else f"<{self.tag}{head}/>\n"


@dataclass(frozen=True)
class Files:
    """A file, and the files that it includes, by name."""

    main: str
    others: dict[str, str]

    def write(self, folder: Path) -> Path:
        """Write all into a folder, and return the path of the first."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in {**self.others, "machine.xml": self.main}.items():
            (folder / name).write_text(text, encoding="utf-8")
        return folder / "machine.xml"


def draw(seed: int) -> Files:
    """Draw a file."""
    return _Draw(seed).files()


class _Draw:
    """Draws one file."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._classes: list[str] = []
        self._joints: list[str] = []
        self._names = 0
        self._degrees = self._rng.random() < 0.6
        self._autolimits = self._rng.random() < 0.85
        self._others: dict[str, str] = {}
        self._meshes: list[str] = []

    def files(self) -> Files:
        """Draw all sections."""
        compiler, option = self._compiler(), self._option()
        assets = self._assets()
        defaults = [self._default()] if self._chance(0.6) else []
        world = Part("worldbody", children=[self._body(0, top=True) for _ in range(self._rng.choice((1, 1, 2)))])
        world.children = self._wrap(world.children)
        actuators = self._actuators()
        root = Part("mujoco", {}, [compiler, option, *assets, *defaults, world, *actuators])
        if self._chance(0.2):
            self._rng.shuffle(root.children)
        for part in (world, *defaults):
            self._outsource(part)
        return Files(root.write(), self._others)

    # --- words -------------------------------------------------------------------------------------------------------

    def _chance(self, share: float) -> bool:
        return self._rng.random() < share

    def _number(self, low: float = -1.0, high: float = 1.0) -> str:
        return f"{self._rng.uniform(low, high):.3g}"

    def _numbers(self, count: int, low: float = -1.0, high: float = 1.0) -> str:
        return " ".join(self._number(low, high) for _ in range(count))

    def _name(self, kind: str) -> str:
        self._names += 1
        return f"{kind}{self._names}"

    def _angle(self, size: float) -> str:
        return f"{self._rng.uniform(-size, size) * (180 / math.pi if self._degrees else 1):.4g}"

    def _limits(self, key: str, switch: str, size: float) -> dict[str, str]:
        """Draw a range, and mostly the switch that belongs to it."""
        low, high = sorted((self._rng.uniform(-size, size), self._rng.uniform(-size, size)))
        found = {key: f"{low:.3g} {high:.3g}"} if self._chance(0.95) else {}
        if self._chance(0.3 if self._autolimits else 0.95):
            found[switch] = self._rng.choice(("true", "true", "false") if not self._autolimits else
                                             ("true", "false", "auto"))  # fmt: skip
        return found

    def _placed(self, *, turned: bool = True) -> dict[str, str]:
        found = {"pos": self._numbers(3)} if self._chance(0.7) else {}
        if turned and self._chance(0.5):
            a, b, c = (self._angle(1.0) for _ in range(3))
            found |= self._rng.choice(
                (
                    {"quat": self._numbers(4)},
                    {"axisangle": f"{self._numbers(3)} {a}"},
                    {"euler": f"{a} {b} {c}"},
                    {"xyaxes": self._numbers(6)},
                    {"zaxis": self._numbers(3)},
                )
            )
        return found

    def _class(self) -> dict[str, str]:
        return {"class": self._rng.choice(self._classes)} if self._classes and self._chance(0.25) else {}

    def _idle(self, name: str) -> dict[str, str]:
        """Draw an attribute that changes no motion, now and then."""
        words = [key for key, use in TABLE[name].attributes.items() if use is Use.IDLE and key not in IDLE]
        return {self._rng.choice(words): "1"} if words and self._chance(0.15) else {}

    # --- sections ----------------------------------------------------------------------------------------------------

    def _compiler(self) -> Part:
        attributes = {"angle": "degree" if self._degrees else "radian"}
        if not self._autolimits:
            attributes["autolimits"] = "false"
        for key, word in (
            ("eulerseq", self._rng.choice(("zyx", "XYZ", "xYz", "zxz"))),
            ("inertiafromgeom", self._rng.choice(("true", "auto"))),
            ("settotalmass", self._number(1, 9)),
            ("inertiagrouprange", self._rng.choice(("0 1", "1 3", "0 5"))),
            ("fusestatic", "true"),
            ("balanceinertia", "true"),
        ):
            if self._chance(0.12):
                attributes[key] = word
        return Part("compiler", attributes)

    def _option(self) -> Part:
        words = [key for key, use in TABLE["flag"].attributes.items() if key not in ("passive", "sensornoise", "ipc")]
        flags = {self._rng.choice(words): self._rng.choice(("disable", "disable", "enable")) for _ in range(2)}
        option = Part("option", {"gravity": self._numbers(3, -10, 10)} if self._chance(0.5) else {})
        option.children = [Part("flag", flags)] if self._chance(0.35) else []
        return option

    def _assets(self) -> list[Part]:
        if not self._chance(0.25):
            return []
        self._meshes = ["m1", "m2"]
        corners = np.random.default_rng(self._rng.randrange(1 << 30)).uniform(-0.3, 0.3, (8, 3)).round(3)
        vertex = " ".join(map(str, corners.ravel()))
        rule = self._rng.choice(("legacy", "convex", "exact", "shell"))
        more = {"scale": self._numbers(3, 0.5, 2)} if self._chance(0.4) else {}
        more |= {"refpos": self._numbers(3), "refquat": self._numbers(4)} if self._chance(0.3) else {}
        return [
            Part(
                "asset",
                children=[
                    Part("mesh", {"name": "m1", "vertex": vertex, "inertia": rule, **more}),
                    Part("mesh", {"name": "m2", "vertex": "0 0 0 1 0 0 0 1 0 0 0 1", "face": "0 2 1 0 1 3 0 3 2 1 2 3",
                                  "inertia": rule, **more}),
                ],
            )
        ]  # fmt: skip

    def _default(self, depth: int = 0) -> Part:
        """Draw default classes, each in its outer one."""
        part = Part("default", {"class": self._name("class")} if depth else {})
        self._classes += [part.attributes["class"]] if depth else []
        draws: tuple[tuple[str, Callable[[], dict[str, str]]], ...] = (
            ("joint", lambda: self._joint_attributes("hinge")),
            ("geom", self._geom_attributes),
            ("motor", lambda: self._motor_attributes("motor")),
            ("position", lambda: self._motor_attributes("position")),
            ("general", lambda: self._motor_attributes("general")),
        )
        part.children = [Part(tag, make()) for tag, make in draws if self._chance(0.35)]
        part.children += [self._default(depth + 1) for _ in range(self._rng.choice((0, 1, 2))) if depth < 2]
        return part

    def _geom_attributes(self) -> dict[str, str]:
        """Draw defaults of geoms, which may place, turn, size and weigh them."""
        found = self._placed() if self._chance(0.3) else {}
        for key, word in (
            ("density", self._number(100, 2000)),
            ("mass", self._number(0.1, 3)),
            ("type", self._rng.choice(("box", "capsule", "ellipsoid"))),
            ("size", self._numbers(self._rng.choice((1, 2, 3)), 0.05, 0.3)),
            ("fromto", self._numbers(6)),
            ("group", self._rng.choice("0123")),
        ):
            found |= {key: word} if self._chance(0.12 if key == "fromto" else 0.3) else {}
        return found

    def _actuators(self) -> list[Part]:
        if not self._joints or self._chance(0.4):
            return []
        parts = []
        for joint in self._rng.choices(self._joints, k=self._rng.choice((1, 2, 3))):
            tag = self._rng.choice(("motor", "motor", "motor", "general", "position"))
            named = self._rng.choice(("joint", "joint", "jointinparent"))
            parts.append(Part(tag, {named: joint, **self._motor_attributes(tag), **self._class()}))
        return [Part("actuator", children=parts)]

    def _motor_attributes(self, tag: str) -> dict[str, str]:
        found: dict[str, str] = {}
        for key, word in (
            ("gear", self._number(-5, 5)),
            ("armature", self._number(0, 1)),
            ("damping", self._numbers(self._rng.choice((1, 2, 3)), 0, 1)),
        ):
            found |= {key: word} if self._chance(0.3) else {}
        found |= self._limits("ctrlrange", "ctrllimited", 3) if self._chance(0.3) else {}
        found |= self._limits("forcerange", "forcelimited", 3) if self._chance(0.3) else {}
        return found | (self._idle("motor") if tag == "motor" else {})

    # --- bodies ------------------------------------------------------------------------------------------------------

    def _body(self, depth: int, *, top: bool = False) -> Part:
        body = Part("body", {"name": self._name("body"), **self._placed()})
        if self._chance(0.03):
            body.attributes |= {"gravcomp": self._number()}
        if self._classes and self._chance(0.3):
            body.attributes["childclass"] = self._rng.choice(self._classes)
        body.children = self._moves(top=top)
        if self._chance(0.6):
            body.children.append(self._inertial())
        body.children += [self._geom() for _ in range(self._rng.choice((1, 1, 2)))]
        body.children = self._wrap(body.children)
        if depth < 3:
            inner = [self._body(depth + 1) for _ in range(self._rng.choice((0, 1, 1, 2)))]
            body.children += self._wrap(inner)
        return body

    def _wrap(self, parts: list[Part]) -> list[Part]:
        """Put some of the parts into a frame; joints too."""
        if not parts or not self._chance(0.25):
            return parts
        k = self._rng.randrange(len(parts))
        frame = Part("frame", self._placed(), parts[k:])
        if self._classes and self._chance(0.3):
            frame.attributes["childclass"] = self._rng.choice(self._classes)
        return [*parts[:k], frame]

    def _moves(self, *, top: bool) -> list[Part]:
        if top and self._chance(0.25):
            return [self._rng.choice((Part("freejoint"), Part("joint", {"type": "free", **self._still()})))]
        if self._chance(0.1):
            return [Part("joint", {"type": "ball", **self._still(), "pos": self._numbers(3)})]
        parts = []
        for _ in range(self._rng.choice((1, 1, 1, 2, 0 if not top else 1))):
            name = self._name("joint")
            self._joints.append(name)
            kind = self._rng.choice(("hinge", "hinge", "slide"))
            parts.append(Part("joint", {"name": name, "type": kind, **self._joint_attributes(kind), **self._class()}))
        return parts

    def _still(self) -> dict[str, str]:
        """Return what keeps the defaults of joints away, mostly."""
        if self._chance(0.2):
            return {}
        return dict.fromkeys(("stiffness", "damping", "frictionloss", "armature"), "0") | {"limited": "false"}

    def _joint_attributes(self, kind: str) -> dict[str, str]:
        found: dict[str, str] = {}
        for key, word in (
            ("axis", self._numbers(3)),
            ("pos", self._numbers(3)),
            ("ref", self._angle(0.5) if kind == "hinge" else self._number()),
            ("stiffness", self._numbers(self._rng.choice((1, 1, 2, 3)), 0, 9)),
            ("springref", self._angle(0.5) if kind == "hinge" else self._number()),
            ("damping", self._numbers(self._rng.choice((1, 1, 2, 3)), 0, 2)),
            ("frictionloss", self._number(0, 1)),
            ("armature", self._number(0, 1)),
            ("springdamper", self._numbers(2, 0.1, 2)),
            ("springyield", "0.1"),
        ):
            share = {"springdamper": 0.1, "springyield": 0.04}.get(key, 0.3)
            found |= {key: word} if self._chance(share) else {}
        found |= self._limits("range", "limited", 2) if self._chance(0.3) else {}
        found |= self._limits("actuatorfrcrange", "actuatorfrclimited", 9) if self._chance(0.2) else {}
        return found | self._idle("joint")

    def _inertial(self) -> Part:
        a, b = self._rng.uniform(0.1, 1), self._rng.uniform(0.1, 1)
        c = self._rng.uniform(abs(a - b), a + b)
        attributes = {"pos": self._numbers(3), "mass": self._number(0.5, 3)}
        if self._chance(0.4):
            small = self._numbers(3, -0.02, 0.02)
            return Part("inertial", {**attributes, "fullinertia": f"0.5 0.6 0.7 {small}"})
        turns = {k: v for k, v in self._placed().items() if k != "pos"}
        return Part("inertial", {**attributes, "diaginertia": f"{a:.4g} {b:.4g} {c:.4g}", **turns})

    def _geom(self) -> Part:
        shape = self._rng.choice(
            ("sphere", "box", "capsule", "cylinder", "ellipsoid", "mesh" if self._meshes else "box")
        )
        size = self._numbers(self._rng.choice((1, 2, 3, 3, 3, 3, 3, 3)), 0.05, 0.3)
        attributes = {"type": shape, "size": size, **self._placed(), **self._idle("geom")}
        if self._chance(0.1):
            del attributes["type"]
        if shape == "mesh":
            attributes |= {"mesh": self._rng.choice(self._meshes)}
            del attributes["size"]
        elif self._meshes and self._chance(0.3):
            attributes |= {"mesh": self._rng.choice(self._meshes), "fitscale": self._number(0.5, 2)}
        elif shape in ("box", "capsule", "cylinder", "ellipsoid") and self._chance(0.3):
            attributes = {"type": shape, "size": self._number(0.05, 0.3), "fromto": self._numbers(6)}
        for key, word in (
            ("mass", self._number(0.1, 3)),
            ("density", self._number(100, 3000)),
            ("group", self._rng.choice("0123")),
            ("contype", "0"),
            ("conaffinity", "0"),
            ("shellinertia", "true"),
        ):
            attributes |= {key: word} if self._chance(0.2) else {}
        return Part("geom", {**attributes, **self._class()})

    def _outsource(self, part: Part) -> None:
        """Put the last parts of a section into a file that it includes."""
        if part.children and self._chance(0.25):
            k = self._rng.randrange(len(part.children))
            name = f"{part.tag}.xml"
            self._others[name] = Part("mujocoinclude", {}, part.children[k:]).write()
            part.children[k:] = [Part("include", {"file": name})]


# --- comparison ------------------------------------------------------------------------------------------------------


def examine(path: Path) -> str:
    """Return a difference between both readers of a file, if there is one. Raises InputError for one refused here."""
    try:
        peer = MujocoPeer(path)
    except ValueError as error:
        peer, told = None, " ".join(str(error).split())[:150]
    if peer is None:
        try:
            import_model(path)
        except InputError:
            return ""
        return "" if any(each in told for each in LEGAL) else f"MuJoCo refuses: {told}"
    imported = import_model(path)
    warned = [str(x.text) for x in imported.notices if x.alters and not any(word in x.text for word in HARMLESS)]
    return _compare_joints(imported.model, peer) or ("" if warned else _compare_motion(imported, peer, path))


def _compare_motion(imported: Imported, peer: MujocoPeer, path: Path) -> str:
    tree = build_tree(_strip(imported.model))
    n = len(tree.bodies)
    if n != peer.model.nv:
        return f"{n} degrees of freedom instead of {peer.model.nv}"
    tape = impl.build(tree, NONE)
    tolerance = SINGLE if "<mesh" in path.read_text() else TOLERANCE
    rng = np.random.default_rng(0)
    for _ in range(2):
        state = State(*rng.uniform(-1.2, 1.2, (3, n)), np.zeros(n))
        given = {"q": list(state.q), "qd": list(state.qd), "qdd": list(state.qdd), "u": [0.0] * n}
        values = run(tape, {i.name: given.get(i.name, [0.0] * i.sparsity.nnz) for i in tape.inputs})
        found, expected = np.array(values["Phi"]), peer.compute(state)["Phi"] - _find_passive(peer, state)
        scale = max(1.0, float(np.abs(expected).max()), float(np.abs(found).max()))
        if not np.abs(found - expected).max() <= tolerance * scale:
            return f"residual {found.tolist()} instead of {expected.tolist()}"
    return ""


def _find_passive(peer: MujocoPeer, state: State) -> Array:
    T = peer._rates(state.q)
    return np.asarray(T.T @ peer.data.qfrc_passive)


def _strip(model: Model) -> Model:
    """Take dry friction away, which is smooth here, and inputs."""

    def bare(joint: Joint) -> Joint:
        return replace(joint, law=replace(joint.law, friction=None), actuated=True)

    def strip(body: Body) -> Body:
        if isinstance(body.joint, Fixed):
            return body
        return replace(body, joint=bare(body.joint) if isinstance(body.joint, Joint) else tuple(map(bare, body.joint)))

    return replace(model, bodies=tuple(map(strip, model.bodies)))


def _compare_joints(model: Model, peer: MujocoPeer) -> str:
    """Compare what the residual does not show: limits, dry friction, and the largest forces of motors."""
    theirs = peer.model
    flags = theirs.opt.disableflags
    lacks = {name: bool(flags & bit) for name, bit in (("constraint", 1), ("frictionloss", 4), ("limit", 8))}
    for step in list_joints(model):
        if not step.name.startswith("joint"):
            continue
        j = theirs.joint(step.name).id
        limits = tuple(theirs.jnt_range[j]) if theirs.jnt_limited[j] else None
        limits = None if lacks["constraint"] or lacks["limit"] else limits
        lower, upper = (_value(limit) for limit in (step.joint.lower, step.joint.upper))
        ours = None if lower is None or upper is None else (lower, upper)
        if (ours is None) != (limits is None) or (ours and limits and not np.allclose(ours, limits, rtol=1e-9)):
            return f"{step.name}: limits {ours} instead of {limits}"
        friction = step.joint.law.friction
        torque = 0.0 if friction is None else _value(friction.torque)
        wanted = 0.0 if lacks["constraint"] or lacks["frictionloss"] else theirs.dof_frictionloss[theirs.jnt_dofadr[j]]
        if not np.isclose(torque, wanted, rtol=1e-9):
            return f"{step.name}: friction {torque} instead of {wanted}"
        effort, largest = _value(step.joint.max_force), _find_effort(peer, j)
        if effort != largest and not np.isclose(effort or 0.0, largest or 0.0, rtol=1e-6):
            return f"{step.name}: max_force {effort} instead of {largest}"
    return ""


def _find_effort(peer: MujocoPeer, joint: int) -> float | None:
    """Return the largest force of the actuators of a joint, by the ranges that MuJoCo compiled."""
    import mujoco

    model = peer.model
    driven = [i for i in range(model.nu) if model.actuator_trnid[i, 0] == joint]
    limit = np.abs(model.jnt_actfrcrange[joint]).max() if model.jnt_actfrclimited[joint] else math.inf
    total = 0.0
    for i in driven:
        bounds = [np.abs(model.actuator_forcerange[i]).max()] if model.actuator_forcelimited[i] else []
        is_motor = model.actuator_biastype[i] == 0 and model.actuator_gainprm[i, 0] == 1
        unclamped = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        bounds += (
            [np.abs(model.actuator_ctrlrange[i]).max()]
            if (model.actuator_ctrllimited[i] and is_motor and not unclamped)
            else []
        )
        total += min(bounds, default=math.inf) * abs(model.actuator_gear[i, 0])
    if not driven:
        total = math.inf
    least = min(limit, total)
    return None if not math.isfinite(least) or least == 0 else float(least)


def _value(number: Expression | None) -> float | None:
    return None if number is None else float(evaluate(number, {}, FLOATS))


@contextmanager
def _stand_in(folder: Path) -> Iterator[None]:
    """Work in a folder, since MuJoCo logs where it runs."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        os.chdir(before)


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine files from a seed on."""
    tally = Tally()
    with tempfile.TemporaryDirectory() as place, _stand_in(Path(place)):
        for number in range(seed, seed + count):
            files = draw(number)
            path = files.write(Path(place) / "files")
            try:
                finding = examine(path)
            except InputError as error:
                tally.refused.append((number, str(error).splitlines()[0].removeprefix(str(path))))
            except Exception as error:
                tally.findings.append((number, f"{type(error).__name__}: {error}"))
            else:
                if finding:
                    tally.findings.append((number, finding))
                else:
                    tally.agreed += 1
            if keep is not None and tally.findings and tally.findings[-1][0] == number:
                files.write(keep / f"mjcf_{number}")
            show(number, tally)
    return tally
