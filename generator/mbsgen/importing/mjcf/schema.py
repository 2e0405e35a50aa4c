"""Every element and attribute of MJCF that can change a motion, with its treatment here; `review` warns of the rest.

An attribute is read, warned of, or refused; or it is idle: it changes no motion of a model, which has no contacts of
geoms, no softness of constraints, and no sensors. An unknown attribute or element, where motion is described, is left
out with a warning.

Source: MuJoCo 4.0, XML reference and schema; the last attributes of an entry are of older versions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element


class Use(Enum):
    """The treatment of an attribute, or of an element with all its attributes."""

    READ = "read"
    WARNED = "warned of"
    REFUSED = "refused"
    IDLE = "changes no motion"


@dataclass(frozen=True)
class Entry:
    """An element: its attributes by treatment, and the entries of its children by tag; `use` is the element's own."""

    attributes: Mapping[str, Use] = field(default_factory=dict)
    children: Mapping[str, str] = field(default_factory=dict)  # entries of TABLE
    use: Use = Use.READ


def _list(
    read: str = "", warned: str = "", refused: str = "", idle: str = "", children: str = "", use: Use = Use.READ
) -> Entry:
    """Make an entry from lists of words; a child is `tag`, or `tag=entry`."""
    uses = ((read, Use.READ), (warned, Use.WARNED), (refused, Use.REFUSED), (idle, Use.IDLE))
    attributes = {word: each for words, each in uses for word in words.split()}
    pairs = (child.partition("=") for child in children.split())
    return Entry(MappingProxyType(attributes), MappingProxyType({tag: entry or tag for tag, _, entry in pairs}), use)


_TURNS = "quat axisangle xyaxes zaxis euler"
_ACTUATOR = "armature class ctrllimited ctrlrange damping forcelimited forcerange gear joint jointinparent name"
_ELSEWHERE = "cranklength cranksite refsite site slidersite tendon"  # by which an actuator drives no joint
_SOFT = "solref solimp"
_BODY = "inertial joint freejoint geom site camera light plugin attach flexcomp composite replicate frame body"
_DRIVES = "general motor position velocity intvelocity orientation pid damper cylinder muscle adhesion dcmotor plugin"
_UNCHECKED = _list(use=Use.IDLE)  # with everything in it
_WARNED = _list(use=Use.WARNED)
_REFUSED = _list(use=Use.REFUSED)

TABLE: Mapping[str, Entry] = MappingProxyType(
    {
        "mujoco": _list(
            "model",
            children="compiler option size=unchecked statistic=unchecked visual=unchecked default extension asset "
            "worldbody deformable contact equality tendon actuator sensor=unchecked custom=unchecked "
            "keyframe=unchecked",
        ),
        "unchecked": _UNCHECKED,
        "warned": _WARNED,
        "refused": _REFUSED,
        "compiler": _list(
            "angle assetdir autolimits eulerseq inertiafromgeom inertiagrouprange meshdir settotalmass strippath "
            "exactmeshinertia fitaabb",
            "balanceinertia boundinertia boundmass",
            "coordinate",
            "alignfree conflict discardvisual fusestatic passthrough savecanonical savecompiled saveinertial "
            "texturedir usethread convexhull",
            "lengthrange=unchecked",
        ),
        "option": _list(
            "gravity",
            "actuatorgroupdisable density viscosity wind",
            "",
            "ccd_iterations ccd_tolerance cone impratio integrator iterations jacobian ls_iterations ls_tolerance "
            "magnetic noslip_iterations noslip_tolerance o_friction o_margin o_solimp o_solref sdf_initpoints "
            "sdf_iterations sleep_tolerance solver timestep tolerance apirate collision mpr_iterations mpr_tolerance",
            "flag",
        ),
        "flag": _list(
            "clampctrl constraint contact damper equality frictionloss gravity limit spring passive",
            "actuation",
            "",
            "autoreset diagexact energy eulerdamp filterparent fwdinv invdiscrete ipc island midphase multiccd "
            "nativeccd override refsafe sensor sleep speculative warmstart sensornoise",
        ),
        "default": _list(
            "class",
            children="default mesh texture=unchecked material=unchecked joint geom site camera=unchecked "
            f"light=unchecked pair=unchecked equality=default_equality tendon=unchecked {_DRIVES}",
        ),
        "default_equality": _list("active", idle=_SOFT),
        "extension": _list(children="plugin=warned"),
        "asset": _list(
            children="mesh hfield=unchecked skin=unchecked texture=unchecked material=unchecked model=unchecked"
        ),
        "mesh": _list(
            "class content_type face file inertia name refpos refquat scale vertex",
            "",
            "builtin maxhullvert",
            "material normal params smoothnormal texcoord",
            "plugin=refused",
        ),
        "worldbody": _list("childclass", "", f"pos {_TURNS}", "name", children=_BODY),
        "body": _list(f"childclass name pos {_TURNS}", "gravcomp mocap sleep", "", "fuse simple user", children=_BODY),
        "frame": _list(f"childclass pos {_TURNS}", "", "massscale scale scaling", "name", children=_BODY),
        "inertial": _list(f"diaginertia fullinertia mass pos {_TURNS}"),
        "joint": _list(
            "actuatorfrclimited actuatorfrcrange armature axis class damping frictionloss limited name pos range ref "
            "springdamper springref stiffness type",
            "springyield",
            "",
            "actuatorgravcomp group margin solimpfriction solimplimit solreffriction solreflimit user",
        ),
        "freejoint": _list("name", idle="align group"),
        "geom": _list(
            "class conaffinity contype density fitscale fromto group mass mesh pos rgba shellinertia size type "
            f"{_TURNS}",
            "",
            "",
            "adhesion castshadow condim fluidcoef fluidshape friction gap hfield margin material name "
            "priority solimp solmix solref surfacevel user",
            "plugin=unchecked",
        ),
        "site": _list(f"class fromto name pos {_TURNS}", idle="group material mesh rgba size type user"),
        "camera": _UNCHECKED,
        "light": _UNCHECKED,
        "attach": _REFUSED,
        "flexcomp": _REFUSED,
        "composite": _REFUSED,
        "replicate": _REFUSED,
        "deformable": _list(children="flex=warned skin=warned"),
        "contact": _list(children="pair=warned exclude=unchecked"),
        "tendon": _list(children="spatial=warned fixed=warned"),
        "equality": _list(children="connect weld joint=coupling tendon=warned flex=warned flexstrain=warned"),
        "connect": _list("active anchor body1 body2 class name site1 site2", idle=_SOFT),
        "weld": _list("active anchor body1 body2 class name relpose site1 site2 torquescale", idle=_SOFT),
        "coupling": _list("active class joint1 joint2 name polycoef", idle=_SOFT),
        "actuator": _list(children=_DRIVES),
        "motor": _list(_ACTUATOR, f"delay group {_ELSEWHERE}", "", "interp lengthrange nsample user"),
        "general": _list(
            _ACTUATOR,
            f"actdim biasprm biastype body delay dynprm dyntype gainprm gaintype group {_ELSEWHERE}",
            "",
            "actearly actlimited actrange ffrange inheritrange input interp lengthrange nsample user velrange",
        ),
        **dict.fromkeys(
            ("position", "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder", "muscle"), _WARNED
        ),
        **dict.fromkeys(("adhesion", "dcmotor"), _WARNED),
        "plugin": _REFUSED,  # of a body; of an actuator, warned of
    }
)


NAMED = (  # kinds of elements by whose names other elements find them: section, tags, names that exist
    ("worldbody", ("body",), ("world",)),
    ("worldbody", ("joint", "freejoint"), ()),
    ("worldbody", ("site",), ()),
    ("asset", ("mesh",), ()),
)
OF_WORLD = ("joint", "freejoint", "inertial")  # which the world does not have


def review(root: Element, findings: Findings) -> None:
    """Warn of elements and attributes that the schema does not have; refuse names and parts that contradict others."""
    _check_names(root, findings)
    _check_world(root, findings)
    for element, entry, parent in _walk(root):
        if entry is None:
            meant = nearest(element.tag, list(parent.children))
            hint = f" (did you mean {meant}?)" if meant else ""
            findings.warn(element, f"MJCF has no such element here: it is left out{hint}")
        elif entry.attributes:
            for name in element.attributes:
                if name not in entry.attributes and ":" not in name and not name.startswith("xmlns"):
                    meant = nearest(name, list(entry.attributes))
                    hint = f" (did you mean {meant}?)" if meant else ""
                    findings.warn(element, f"{name[:40]} is no attribute of it: it is left out{hint}")


def _check_names(root: Element, findings: Findings) -> None:
    for section, tags, given in NAMED:
        lines: dict[str, str] = dict.fromkeys(given, "MuJoCo itself")
        for element in (x for part in root.all(section) for x in part.walk() if x.tag in tags):
            name = element.attributes.get("name", "")
            if name in lines:
                text = f"a second {tags[0]} called {abbreviate(name)}: {lines[name]} has the first"
                findings.fault(element, text, "give each its own name")
            elif name:
                lines[name] = f"line {element.line}"


def _check_world(root: Element, findings: Findings) -> None:
    for world in root.all("worldbody"):
        if wrong := [name for name in world.attributes if name in ("pos", *_TURNS.split())]:
            findings.fault(world, f"the world has {' and '.join(wrong)}", "put its bodies into a <frame>, placed so")
        for element in world.all(*OF_WORLD):
            findings.fault(element, f"the world has a part <{element.tag}>", "move it into a body")


def _walk(root: Element) -> Iterator[tuple[Element, Entry | None, Entry]]:
    """Yield the elements of a file with their entries, None for an unknown one, and the entries of their parents."""
    waiting = [(root, TABLE["mujoco"])]
    while waiting:
        element, entry = waiting.pop()
        yield element, entry, entry
        for child in element.children:
            name = entry.children.get(child.tag)
            if name is not None:
                waiting.append((child, TABLE[name]))
            elif entry.children:
                yield child, None, entry
