"""The actuators of MJCF -> inputs of joints: rotors, dampers, and the largest forces.

An input is the force at the joint. An actuator adds armature and damping times its gear ratio squared to its joint.

Source: MuJoCo, XML reference, `actuator`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.mjcf.inheritance import MAIN, SERVO, Defaults
from mbsgen.importing.mjcf.settings import Settings, read_limits

JOINTS = ("joint", "freejoint")
TERMS = 3  # of a polynomial


@dataclass
class Drives:
    """The effects of the actuators on joints, by the names of joints."""

    efforts: dict[str, float | None] = field(default_factory=dict)  # of driven joints: the largest force, if bounded
    rotors: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    dampers: defaultdict[str, tuple[float, ...]] = field(default_factory=lambda: defaultdict(lambda: (0.0,) * TERMS))


def read_polynomial(element: Element, key: str, attributes: Mapping[str, str], findings: Findings) -> tuple[float, ...]:
    """Read one to three coefficients; the missing ones are 0."""
    words = attributes.get(key, "0").split()
    if not 0 < len(words) <= TERMS:
        findings.fault(element, f"{key} has {len(words)} numbers", f"give 1 to {TERMS}")
        return (0.0,) * TERMS
    padded = {key: " ".join([*words, *["0"] * (TERMS - len(words))])}
    return findings.numbers(element, key, (0.0,) * TERMS, attributes=padded)


def read_actuators(root: Element, defaults: Defaults, settings: Settings, findings: Findings) -> Drives:
    """Read the actuators of joints; the others make notices, and so does each that is no motor."""
    return _Reader(root, defaults, settings, findings).read()


class _Reader:
    """Reads one actuator at a time."""

    def __init__(self, root: Element, defaults: Defaults, settings: Settings, findings: Findings) -> None:
        self._root = root
        self._defaults = defaults
        self._settings = settings
        self._findings = findings
        self._drives = Drives()
        self._joints = [x.attributes["name"] for x in root.walk() if x.tag in JOINTS and "name" in x.attributes]

    def read(self) -> Drives:
        """Read all actuators."""
        for section in self._root.all("actuator"):
            for element in section.children:
                self._read_one(element)
        return self._drives

    def _read_one(self, element: Element) -> None:
        findings, attributes = self._findings, self._defaults.resolve(element, MAIN)
        joint = attributes.get("joint", attributes.get("jointinparent"))
        if joint is None:
            findings.warn(element, f"{element.tag[:40]}: only actuators of joints become inputs")
            return
        if joint not in self._joints:
            meant = nearest(joint, self._joints)
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a joint of the file"
            findings.fault(element, f"there is no joint {abbreviate(joint)}", remedy)
            return
        gear = findings.number(element, "gear", 1.0, _take_first(attributes, "gear"))
        is_motor = element.tag == "motor" or (element.tag == "general" and not SERVO & attributes.keys())
        self._tell(element, joint, attributes, gear, is_motor=is_motor)
        self._drives.rotors[joint] += gear**2 * findings.number(element, "armature", 0.0, attributes)
        added = read_polynomial(element, "damping", attributes, findings)
        self._drives.dampers[joint] = tuple(
            x + gear**2 * y for x, y in zip(self._drives.dampers[joint], added, strict=True)
        )
        bounds = [*self._list_bounds(element, attributes, is_motor=is_motor)]
        effort = min(bounds) * abs(gear) if bounds else None
        before = self._drives.efforts.get(joint, 0.0)
        self._drives.efforts[joint] = None if effort is None or before is None else before + effort

    def _tell(
        self, element: Element, joint: str, attributes: Mapping[str, str], gear: float, *, is_motor: bool
    ) -> None:
        what = "the joint's force" if gear == 1 else f"the joint's force, after the gear {gear:g}"
        if not is_motor:
            text = f"{element.tag[:40]} of joint {abbreviate(joint)}: gains and dynamics are left out"
            self._findings.warn(element, f"{text}; the input u is {what}")
        elif gear != 1:
            self._findings.tell(element, f"the input u of joint {abbreviate(joint)} is {what}")
        if self._findings.number(element, "delay", 0.0, attributes):
            self._findings.warn(element, f"delay: the input u of joint {abbreviate(joint)} acts at once")
        if self._findings.number(element, "group", 0.0, attributes) in self._settings.asleep:
            text = f"the file disables its group; the input u of joint {abbreviate(joint)} acts"
            self._findings.warn(element, text)

    def _list_bounds(self, element: Element, attributes: Mapping[str, str], *, is_motor: bool) -> Iterator[float]:
        """Yield the largest forces before the gear that ranges allow."""
        keys = [("forcerange", "forcelimited"), ("ctrlrange", "ctrllimited")]
        for key, switch in keys:
            limits = read_limits(element, attributes, key, switch, self._settings, self._findings)
            if limits is None or (key == "ctrlrange" and not (is_motor and "clampctrl" not in self._settings.disabled)):
                continue
            lower, upper = limits
            if -lower != upper:
                largest = max(map(abs, limits))
                self._findings.tell(
                    element, f"{key} of {lower:g} to {upper:g} bounds the input at {largest:g}, both ways"
                )
            yield max(map(abs, limits))


def _take_first(attributes: Mapping[str, str], name: str) -> dict[str, str]:
    """Return the first of several numbers, for a joint with one degree of freedom."""
    words = attributes.get(name, "").split()
    return {name: words[0]} if words else {}
