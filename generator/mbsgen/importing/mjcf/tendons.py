"""The ranges of tendons in MJCF -> stops of a draft, if the choices ask for stops.

- fixed: the sum of coef times the coordinate, over hinges and slides.
- spatial: the length of the line through sites, in turn. A pulley begins a new branch, whose length counts 1/divisor.

Springs, dampers and friction of tendons, and lines around geoms, are left out with a warning.

Source: MuJoCo, XML reference, `tendon`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.closing import Spot
from mbsgen.importing.drafting import Draft, Reach
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.equalities import Register
from mbsgen.importing.mjcf.inheritance import MAIN, Defaults
from mbsgen.importing.mjcf.settings import Settings, read_limits

ACTING = ("stiffness", "damping", "frictionloss", "armature")


def list_passed_sites(root: Element) -> Iterator[str]:
    """Yield the names of the sites that lines of tendons pass."""
    for element in (element for section in root.all("tendon") for element in section.all("spatial")):
        yield from (part.attributes.get("site", "") for part in element.all("site"))


@dataclass(frozen=True)
class Tendons:
    """Reads one tendon at a time."""

    register: Register
    draft: Draft
    defaults: Defaults
    settings: Settings
    findings: Findings

    def read(self, element: Element) -> None:
        """Read a tendon; warn of its springs, dampers and friction."""
        attributes = self.defaults.resolve(element, MAIN, "tendon")
        limits = read_limits(element, attributes, "range", "limited", self.settings, self.findings)
        known = {"fixed": self._sum, "spatial": self._measure}
        reach = known[element.tag](element) if element.tag in known and limits is not None else None
        acting = [key for key in ACTING if self._acts(element, key, attributes)]
        if reach is None or limits is None or self.settings.lacks("limit"):
            self.findings.warn(element, f"{element.tag[:40]} (tendon) is not part of a model")
        elif self.draft.choices.stops is None:
            text = f"{element.tag} (tendon) is not part of a model; with --stops 0 its range makes stops"
            self.findings.warn(element, text)
        else:
            self.draft.add_stops(element.attributes.get("name", "") or "tendon", reach, limits, element)
            if acting:
                self.findings.warn(element, f"{' and '.join(acting)} of a tendon: left out; its range makes stops")

    def _acts(self, element: Element, key: str, attributes: Mapping[str, str]) -> bool:
        words = attributes.get(key, "0").split()
        return any(self.findings.numbers(element, key, (0.0,) * len(words), attributes=attributes)) if words else False

    def _sum(self, element: Element) -> Reach | None:
        """Read a sum of coordinates."""
        found = dict[str, float]()
        for part in element.all("joint"):
            name = part.attributes.get("joint", "")
            if name not in self.register.coordinates:
                self._miss(part, "hinge or slide", name, self.register.coordinates)
                return None
            found[name] = found.get(name, 0.0) + self.findings.number(part, "coef", 1.0)
        return Reach(tuple(found.items())) if found else None

    def _measure(self, element: Element) -> Reach | None:
        """Read lines through sites; None for one around geoms."""
        branches = [_Branch(1.0)]
        for part in element.children:
            if part.tag == "pulley":
                branches.append(_Branch(self.findings.number(part, "divisor", 1.0)))
            elif part.tag != "site":
                return None
            elif (name := part.attributes.get("site", "")) in self.register.sites:
                branches[-1].points.append(self.register.sites[name])
            else:
                self._miss(part, "site", name, self.register.sites)
                return None
        lines = tuple((x.divisor, tuple(x.points)) for x in branches if len(x.points) > 1)
        return Reach((), lines) if lines and all(divisor > 0 for divisor, _ in lines) else None

    def _miss(self, part: Element, what: str, name: str, known: Mapping[str, object]) -> None:
        meant = nearest(name, list(known))
        remedy = f"did you mean {abbreviate(meant)}?" if meant else f"name a {what} of the file"
        self.findings.fault(part, f"there is no {what} {abbreviate(name)}", remedy)


@dataclass(frozen=True)
class _Branch:
    divisor: float
    points: list[Spot] = field(default_factory=list)
