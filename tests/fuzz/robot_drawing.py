"""Draws robots in URDF and SDF: their links, joints, frames and models, in any order that the formats allow."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

ONE_AXIS = ("revolute", "continuous", "prismatic")
QUARTERS = (0.0, 1.5707963267948966, -1.5707963267948966, 3.141592653589793)
IDLE = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'
IDLE_OF_SDF = '<visual name="v"><geometry><sphere><radius>0.1</radius></sphere></geometry></visual>'


@dataclass(frozen=True)
class Robot:
    """A robot's file."""

    suffix: str
    text: str
    links: tuple[str, ...]
    root: str | None = None  # the root link of URDF that is fixed to the base
    is_plain: bool = False  # URDF whose joints have one freedom at most
    rotors: dict[str, float] = field(default_factory=dict)


def draw(seed: int) -> Robot:
    """Draw a robot."""
    pick = random.Random(f"robot {seed}")
    return _Urdf(pick).draw() if pick.random() < 0.5 else _Sdf(pick).draw()


@dataclass
class _Numbers:
    pick: random.Random

    def vector(self, size: float = 1.0) -> str:
        return " ".join(self.number(size) for _ in range(3))

    def number(self, size: float = 1.0) -> str:
        value = self.pick.uniform(-size, size)
        return self.pick.choice([repr(value), f"{value:.3f}", f"{value:.2e}", "0"])

    def angles(self) -> str:
        return " ".join(
            repr(self.pick.choice(QUARTERS) if self.pick.random() < 0.3 else self.pick.uniform(-3, 3)) for _ in range(3)
        )

    def axis(self) -> str:
        return self.pick.choice(["1 0 0", "0 -1 0", "0 0 2", "0.6 0 -0.8", "1 2 -2", "0.1 0.3 0.2"])

    def moments(self) -> dict[str, str]:
        """Draw an inertia that a body can have: of moments near each other, and small products."""
        found = {f"i{a}{a}": f"{self.pick.uniform(1, 1.5):.4f}" for a in "xyz"}
        return found | {f"i{pair}": f"{self.pick.uniform(-0.1, 0.1):.4f}" for pair in ("xy", "xz", "yz")}

    def maybe(self, chance: float, text: str) -> str:
        return text if self.pick.random() < chance else ""

    def shuffle(self, parts: list[str]) -> str:
        kept = [part for part in parts if part]
        self.pick.shuffle(kept)
        return "".join(kept)

    def positive(self) -> str:
        return f"{self.pick.uniform(0.1, 2):.3f}"


class _Urdf(_Numbers):
    def draw(self) -> Robot:
        count = self.pick.randint(2, 6)
        is_plain = self.pick.random() < 0.5
        names = [self.pick.choice(["l{}", "arm-{}", "Left.{}", "{}_link"]).format(k) for k in range(count)]
        parts = [self._link(name, is_root=name == names[0]) for name in names]
        for k in range(1, count):
            parts.append(self._joint(f"j{k}", names[self.pick.randrange(k)], names[k], is_plain=is_plain))
        self.pick.shuffle(parts)
        inside = "\n".join(parts)
        text = f'<robot name="machine" xmlns:drake="http://drake.mit.edu">\n{inside}\n</robot>\n'
        return Robot("urdf", text, tuple(names), root=names[0], is_plain=is_plain)

    def _link(self, name: str, *, is_root: bool) -> str:
        if is_root and self.pick.random() < 0.4:
            return f'<link name="{name}"/>'
        inertia = " ".join(f'{key}="{value}"' for key, value in self.moments().items())
        inertial = self.shuffle([self._origin(), f'<mass value="{self.positive()}"/>', f"<inertia {inertia}/>"])
        return f'<link name="{name}">{self.shuffle([f"<inertial>{inertial}</inertial>", self.maybe(0.3, IDLE)])}</link>'

    def _origin(self) -> str:
        attributes = self.shuffle(
            [self.maybe(0.8, f' xyz="{self.vector()}"'), self.maybe(0.8, f' rpy="{self.angles()}"')]
        )
        return self.maybe(0.85, f"<origin{attributes}/>")

    def _joint(self, name: str, parent: str, child: str, *, is_plain: bool) -> str:
        kinds = [*ONE_AXIS, "fixed"]
        tag = "joint"
        if not is_plain and self.pick.random() < 0.5:
            tag, kinds = "drake:joint", ["ball", "universal", "planar", "screw"]
        kind = self.pick.choice(kinds)
        size = 3 if kind == "planar" else 1
        damping = " ".join(self.positive() for _ in range(size))
        has_axis = kind not in ("fixed", "ball", "universal")
        parts = [
            f'<parent link="{parent}"/>',
            f'<child link="{child}"/>',
            self._origin(),
            self.maybe(0.8, f'<axis xyz="{self.axis()}"/>') if has_axis else "",
            self.maybe(0.5, f'<dynamics damping="{damping}"/>') if kind != "fixed" else "",
            '<limit lower="-9" upper="9" effort="4" velocity="3"/>' if kind in ("revolute", "prismatic") else "",
            self.maybe(0.2, '<calibration rising="0.1"/>'),
            f'<drake:screw_thread_pitch value="{self.positive()}"/>' if kind == "screw" else "",
        ]
        return f'<{tag} name="{name}" type="{kind}">{self.shuffle(parts)}</{tag}>'


class _Sdf(_Numbers):
    def draw(self) -> Robot:
        self.links: list[str] = []
        self.count = 0
        self.version = self.pick.choice(["1.7", "1.8", "1.9", "1.10"])
        text = f'<sdf version="{self.version}">{self._model("machine", 0, self.pick.randint(1, 4))}</sdf>\n'
        return Robot("sdf", text, tuple(self.links))

    def _model(self, name: str, depth: int, count: int, path: str = "") -> str:
        """Draw a model: links, models in it, frames, and joints between them, each child with one joint."""
        links = [f"l{k}" for k in range(count)]
        self.links += [f"{path}{link}" for link in links]
        inner = []
        ends = [*links]
        for k in range(self.pick.choice([0, 0, 1, 2]) if depth < 2 else 0):
            inner.append(self._model(f"m{k}", depth + 1, self.pick.randint(1, 2), f"{path}m{k}::"))
            ends += [f"m{k}::l0", *([f"m{k}", f"m{k}::__model__"] if self.version != "1.7" else [])]
        places = ["__model__", *links]
        frames = []
        for k in range(self.pick.choice([0, 1, 2])):
            attached = self.maybe(0.7, f' attached_to="{self.pick.choice(places)}"')
            frames.append(f'<frame name="f{k}"{attached}>{self._pose(places)}</frame>')
            places.append(f"f{k}")
        parts = [self._link(link, places[:1]) for link in links]
        parts += inner
        parts += frames
        joints, taken = [], set()
        order = ends[1:]
        for child in order:
            owner = child.split("::")[0]
            if owner in taken or self.pick.random() < 0.2:
                continue
            taken.add(owner)
            before = [
                links[0],
                *(one for one in links if links.index(one) < (links.index(child) if child in links else 99)),
            ]
            joints.append(self._joint(self._name_joint(), self.pick.choice(before), child, places))
        if self.pick.random() < 0.5 and depth == 0:
            joints.append(self._joint(self._name_joint(), "world", links[0], places))
        static = self.maybe(0.05, "<static>true</static>") if depth == 0 and not joints else ""
        canonical = self.maybe(0.2, f' canonical_link="{self.pick.choice(links)}"')
        pose = self._pose([])
        return f'<model name="{name}"{canonical}>{static}{pose}{self.shuffle([*parts, *joints])}</model>\n'

    def _name_joint(self) -> str:
        self.count += 1
        return f"j{self.count}"

    def _pose(self, places: list[str]) -> str:
        relative = f' relative_to="{self.pick.choice(places)}"' if places and self.pick.random() < 0.5 else ""
        position, angles = self.vector(), self.angles()
        if self.version >= "1.9" or self.version == "1.10":
            match self.pick.randrange(3):
                case 0:
                    angles = " ".join(repr(self.pick.uniform(-180, 180)) for _ in range(3))
                    return f'<pose degrees="true"{relative}>{position} {angles}</pose>'
                case 1:
                    drawn = [self.pick.uniform(-1, 1) for _ in range(4)]  # of length 1, as Drake needs it
                    quaternion = " ".join(repr(x / math.hypot(*drawn)) for x in drawn)
                    return f'<pose rotation_format="quat_xyzw"{relative}>{position} {quaternion}</pose>'
        return self.maybe(0.8, f"<pose{relative}>{position} {angles}</pose>")

    def _link(self, name: str, places: list[str]) -> str:
        inertia = "".join(f"<{key}>{value}</{key}>" for key, value in self.moments().items())
        pose = f"<pose>{self.vector()} {self.angles()}</pose>"
        inertial = self.shuffle(
            [self.maybe(0.7, pose), f"<mass>{self.positive()}</mass>", f"<inertia>{inertia}</inertia>"]
        )
        inside = [self._pose(places), self.maybe(0.9, f"<inertial>{inertial}</inertial>"), self.maybe(0.3, IDLE_OF_SDF)]
        return f'<link name="{name}">{self.shuffle(inside)}</link>'

    def _joint(self, name: str, parent: str, child: str, places: list[str]) -> str:
        kind = self.pick.choice([*ONE_AXIS, "fixed", "ball", "universal", "screw"])
        damping = f"<damping>{self.positive()}</damping>"
        spring = f"<spring_stiffness>{self.positive()}</spring_stiffness><spring_reference>0.3</spring_reference>"
        if kind not in ("revolute", "continuous", "prismatic"):
            spring = ""
        dynamics = self.maybe(
            0.6, f"<dynamics>{self.shuffle([self.maybe(0.8, damping), self.maybe(0.5, spring)])}</dynamics>"
        )
        axes = self._axis("axis", self.axis(), dynamics, places) if kind not in ("fixed", "ball", "universal") else ""
        if kind == "ball":
            axes = self.maybe(0.6, f"<axis><xyz>0 0 1</xyz>{dynamics}</axis>")
        if kind == "universal":
            axes = f"<axis><xyz>1 0 0</xyz>{dynamics}</axis><axis2><xyz>0 1 0</xyz>{dynamics}</axis2>"
        pitch = ""
        if kind == "screw":
            pitch = f"<screw_thread_pitch>{self.positive()}</screw_thread_pitch>" if self.version == "1.10" else ""
            pitch = pitch or f"<thread_pitch>{self.positive()}</thread_pitch>"
        parts = [f"<parent>{parent}</parent>", f"<child>{child}</child>", self._pose(places), axes, pitch]
        return f'<joint name="{name}" type="{kind}">{self.shuffle(parts)}</joint>'

    def _axis(self, tag: str, direction: str, dynamics: str, places: list[str]) -> str:
        expressed = f' expressed_in="{self.pick.choice(places)}"' if self.pick.random() < 0.4 else ""
        return f"<{tag}><xyz{expressed}>{direction}</xyz>{dynamics}</{tag}>"
