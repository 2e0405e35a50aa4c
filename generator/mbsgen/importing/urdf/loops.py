"""Extensions of URDF that close loops -> loops, equations and followers of a draft.

- `<loop>` of URDF+: a joint between frames on two links, `<predecessor>` and `<successor>`, each with its `<origin>`.
- `<coupling>` of URDF+: ratio times the sum of the coordinates from the last link that carries both links to the
  predecessor is the sum of the coordinates from there to the successor.
- `independent="false"` of a joint of URDF+: others determine its coordinate.
- `<loop_joint type="spherical">` of Isaac Sim: a point of `link1` and a point of `link2` coincide.
- `<drake:ball_constraint>` of Drake: the points P of body A and Q of body B coincide.

Sources: Chignoli, Slotine, Wensing, Kim, URDF+ (2024, arXiv 2411.19753), and its parser; the manuals of NVIDIA's URDF
importer and of Drake's parsers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.closing import Closure, Equation, Spot, Term
from mbsgen.importing.drafting import Draft
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import place
from mbsgen.importing.urdf.frames import read_axis, read_origin, read_pose
from mbsgen.model.tree import Cut

COUPLING = "coupling"
BALL = "drake:ball_constraint"
CUTS: Mapping[str, Cut] = MappingProxyType(
    {
        "revolute": Cut.HINGE,
        "continuous": Cut.HINGE,
        "prismatic": Cut.PRISMATIC,
        "fixed": Cut.SOLID,
        "planar": Cut.PLANAR,
        "spherical": Cut.BALL,
    }
)
WITHOUT_AXIS = (Cut.SOLID, Cut.BALL)
LINKS = ("link1", "link2")  # of Isaac Sim; its manual also shows the first one twice
MOVING = ("revolute", "continuous", "prismatic", "screw")
_FLAGS = ("true", "false")


def is_dependent(joint: Element, findings: Findings) -> bool:
    """Read whether others determine the coordinate of a joint."""
    flag = joint.attributes.get("independent", "true")
    return findings.choice(joint, "independent", _FLAGS, {"independent": flag.lower()}) == "false"


def has_loops(root: Element) -> bool:
    """Return whether a file closes loops, or couples joints."""
    return any(element.tag in READERS for element in root.children)


def add_loops(root: Element, bodies: Mapping[str, str], carriers: Mapping[str, Element], draft: Draft) -> None:
    """Close a draft, given the bodies of the links of the file, and the joints that carry the links."""
    reader = _Reader(bodies, carriers, draft, draft.findings)
    for element in root.children:
        if element.tag in READERS:
            READERS[element.tag](reader, element)


@dataclass(frozen=True)
class _Reader:
    """Reads one element at a time."""

    bodies: Mapping[str, str]
    carriers: Mapping[str, Element]
    draft: Draft
    findings: Findings

    def read_loop(self, element: Element) -> None:
        """Read a <loop> of URDF+."""
        ends = [self._find_end(element, tag) for tag in ("predecessor", "successor")]
        kind = element.attributes.get("type", "")
        if kind not in CUTS:
            self.findings.fault(element, f"type is {abbreviate(kind)}", f"give {', '.join(CUTS)}")
            return
        cut = CUTS[kind]
        axis = None if cut in WITHOUT_AXIS else read_axis(element, self.findings)
        if ends[0] is not None and ends[1] is not None:
            self._close(Closure(_name(element), cut, ends[0], ends[1], element, axis))

    def _find_end(self, element: Element, tag: str) -> Spot | None:
        end = self._find_child(element, tag)
        body = None if end is None else self._find_body(end, "link")
        if end is None or body is None:
            return None
        return Spot(body, read_origin(end, self.findings, self.draft.writer))

    def read_loop_joint(self, element: Element) -> None:
        """Read a <loop_joint> of Isaac Sim."""
        if (kind := element.attributes.get("type", "")) != "spherical":
            self.findings.fault(element, f"type is {abbreviate(kind)}", "give spherical, or a <loop> of URDF+")
        links = [*element.all(*LINKS)]
        if len(links) != 2:
            self.findings.fault(element, f"a loop joint of {len(links)} links", "give link1 and link2")
            return
        spots = [
            Spot(body, place(read_pose(link, self.findings, self.draft.writer).position))
            for link in links
            if (body := self._find_body(link, "link")) is not None
        ]
        if len(spots) == 2:
            self._close(Closure(_name(element), Cut.BALL, spots[0], spots[1], element))

    def read_ball(self, element: Element) -> None:
        """Read a <drake:ball_constraint>."""
        spots = []
        for link, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
            named, given = (self._find_child(element, f"{BALL}_{key}") for key in (link, point))
            body = None if named is None else self._find_body(named, "name")
            if body is not None and given is not None:
                spots.append(Spot(body, place(self.findings.numbers(given, "value", (0.0, 0.0, 0.0)))))
        if len(spots) == 2:
            self._close(Closure(_name(element), Cut.BALL, spots[0], spots[1], element))

    def _close(self, closure: Closure) -> None:
        self.draft.closing.closures.append(closure)

    # --- couplings ---------------------------------------------------------------------------------------------------

    def read_coupling(self, element: Element) -> None:
        """Read a <coupling> of URDF+."""
        links = [self._find_link(element, tag) for tag in ("predecessor", "successor")]
        ratio_element = element.first("ratio")
        ratio = 1.0 if ratio_element is None else self.findings.number(ratio_element, "value", 1.0)
        if ratio == 0:
            self.findings.fault(ratio_element or element, "a ratio of 0", "give another one")
        if links[0] is None or links[1] is None:
            return
        chains = [[*self._climb(link)][::-1] for link in links if link is not None]
        shared = sum(1 for a, b in zip(*chains, strict=False) if a is b)
        first, second = ([*self._name_moving(chain[shared:])] for chain in chains)
        if not (first or second):
            self.findings.fault(element, "no joint moves its links against each other", "name links beyond joints")
        elif not self._follow(element, first, second, ratio):
            terms = [*(Term(name, ratio) for name in first), *(Term(name, -1.0) for name in second)]
            self.draft.closing.equations.append(Equation(_name(element), tuple(terms), 0.0, element))

    def _follow(self, element: Element, first: list[str], second: list[str], ratio: float) -> bool:
        """Couple two joints where none is held; return False otherwise."""
        held = {name for name, _ in self.draft.choices.locked}
        if len(first) != 1 or len(second) != 1 or held & {*first, *second} or not ratio:
            return False
        (leader,), (follower,) = first, second
        dependent = self.draft.closing.dependent
        if leader in dependent and follower not in dependent:
            leader, follower, ratio = follower, leader, 1 / ratio
        if not self.draft.closing.couple(follower, (leader, ratio, 0.0)):
            return False
        text = f"joint {abbreviate(follower)} has no coordinate: its q is {ratio:g} times the q of {abbreviate(leader)}"
        self.findings.tell(element, text)
        return True

    def _climb(self, link: str) -> Iterator[Element]:
        """Yield the joints that carry a link, up to the root."""
        while link in self.carriers:
            joint = self.carriers[link]
            yield joint
            parent = joint.first("parent")
            assert parent is not None, "a joint that carries a link has a parent"
            link = parent.attributes["link"]

    def _name_moving(self, joints: list[Element]) -> Iterator[str]:
        for joint in joints:
            kind = joint.attributes.get("type", "")
            if kind in MOVING:
                yield joint.attributes["name"]
            elif kind != "fixed":
                self.findings.fault(joint, f"a {kind} joint in a coupling", "couple joints that move about one axis")

    # --- links -------------------------------------------------------------------------------------------------------

    def _find_child(self, element: Element, tag: str) -> Element | None:
        found = element.first(tag)
        if found is None:
            self.findings.fault(element, f"a {element.tag} without a {tag}", f"give it a <{tag}>")
        return found

    def _find_link(self, element: Element, tag: str) -> str | None:
        end = self._find_child(element, tag)
        if end is None or self._find_body(end, "link") is None:
            return None
        return end.attributes["link"]

    def _find_body(self, element: Element, key: str) -> str | None:
        name = element.attributes.get(key, "")
        if name not in self.bodies:
            meant = nearest(name, list(self.bodies))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a link of the file"
            self.findings.fault(element, f"there is no link {abbreviate(name)}", remedy)
        return self.bodies.get(name)


def _name(element: Element) -> str:
    return element.attributes.get("name", "") or element.tag


READERS: Mapping[str, Callable[[_Reader, Element], None]] = MappingProxyType(
    {
        "loop": _Reader.read_loop,
        COUPLING: _Reader.read_coupling,
        "loop_joint": _Reader.read_loop_joint,
        BALL: _Reader.read_ball,
    }
)
