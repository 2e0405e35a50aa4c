"""The settings of an MJCF file -> numbers of its compiler, flags, gravity; and the rule by which ranges limit.

Source: MuJoCo, XML reference, `compiler`, `option`, `option/flag`. Sections may be repeated; the last setting counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mbsgen.documents import abbreviate
from mbsgen.importing.drafting import GRAVITY
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element

SWITCHES = ("auto", "true", "false")
FLAG = ("enable", "disable")
CONSTRAINTS = ("equality", "frictionloss", "limit", "contact")  # kinds of forces that the flag `constraint` disables
FLUID = ("density", "viscosity", "wind")


@dataclass(frozen=True)
class Settings:
    """The settings that decide what a file says."""

    compiler: Mapping[str, str]
    disabled: frozenset[str]  # flags
    enabled: frozenset[str]
    gravity: tuple[float, ...]
    degrees: bool = True
    sequence: str = "xyz"
    from_geometry: str = "auto"
    groups: tuple[float, ...] = (0, 5)  # of geoms that have mass
    autolimits: bool = True
    asleep: frozenset[int] = frozenset()  # groups of actuators that the file disables

    @property
    def is_passive(self) -> bool:
        """Whether any passive force acts; without springs and dampers, nor do weight compensation and fluids."""
        return not {"spring", "damper"} <= self.disabled

    def lacks(self, kind: str) -> bool:
        """Return whether the file disables a kind of force."""
        return kind in self.disabled or (kind in CONSTRAINTS and "constraint" in self.disabled)


def read_settings(root: Element, findings: Findings) -> Settings:
    """Read the settings of a file, with notices of the settings that a model does not obey."""
    compiler = {k: v for element in root.all("compiler") for k, v in element.attributes.items()}
    source = next(root.all("compiler"), root)
    flags: dict[str, str] = {}
    gravity: tuple[float, ...] = GRAVITY
    asleep: frozenset[int] = frozenset()
    for option in root.all("option"):
        gravity = findings.numbers(option, "gravity", gravity)
        if words := option.attributes.get("actuatorgroupdisable", "").split():
            given = {"actuatorgroupdisable": " ".join(words)}
            numbers = findings.numbers(option, "actuatorgroupdisable", (0.0,) * len(words), attributes=given)
            asleep = frozenset(map(int, numbers))
        for flag in option.all("flag"):
            flags |= {name: findings.choice(flag, name, FLAG, flag.attributes) for name in flag.attributes}
    disabled = frozenset(name for name, word in flags.items() if word == "disable")
    disabled |= {"spring", "damper"} if "passive" in disabled else frozenset()
    settings = Settings(
        compiler,
        disabled,
        frozenset(flags) - disabled,
        (0.0, 0.0, 0.0) if "gravity" in disabled else gravity,
        findings.choice(source, "angle", ("degree", "radian"), compiler) == "degree",
        _read_sequence(source, compiler, findings),
        findings.choice(source, "inertiafromgeom", SWITCHES, compiler),
        findings.numbers(source, "inertiagrouprange", (0.0, 5.0), attributes=compiler),
        findings.choice(source, "autolimits", ("true", "false"), compiler) == "true",
        asleep,
    )
    _warn_of_compiler(source, settings, findings)
    _warn_of_options(root, settings, findings)
    return settings


def read_limits(
    element: Element, attributes: Mapping[str, str], key: str, switch: str, settings: Settings, findings: Findings
) -> tuple[float, float] | None:
    """Read a range that limits something; None where it limits nothing.

    `switch` is an attribute that turns the range on or off. Left to itself, a range limits unless it is empty.
    """
    word = findings.choice(element, switch, SWITCHES, attributes)
    if key not in attributes:
        if word == "true":
            findings.fault(element, f"{switch} without {key}", f"give {key}, or take {switch} away")
        return None
    if word == "auto" and not settings.autolimits:
        remedy = f'say {switch}="true" or "false"; by itself a range says so only with autolimits'
        findings.fault(element, f"{key} without {switch}, where the compiler has no autolimits", remedy)
        return None
    lower, upper = findings.numbers(element, key, (0.0, 0.0), attributes=attributes)
    if word == "false" or (word == "auto" and lower >= upper):
        return None
    if lower >= upper:
        findings.fault(element, f"{key} is {lower:g} to {upper:g}", "swap them" if lower > upper else "widen it")
        return None
    return lower, upper


def _read_sequence(source: Element, compiler: Mapping[str, str], findings: Findings) -> str:
    sequence = compiler.get("eulerseq", "xyz")
    if len(sequence) == 3 and set(sequence) <= set("xyzXYZ"):
        return sequence
    findings.fault(source, f"eulerseq is {abbreviate(sequence)}", "give three of x, y, z, X, Y, Z")
    return "xyz"


def _warn_of_compiler(source: Element, settings: Settings, findings: Findings) -> None:
    compiler = settings.compiler
    if compiler.get("coordinate", "local") != "local":
        findings.fault(source, "global coordinates", "save the file by a MuJoCo before 2.3.3, as local ones")
    for key in ("boundmass", "boundinertia"):
        if findings.number(source, key, 0.0, compiler) > 0:
            findings.warn(source, f"{key}: masses and inertias are taken as they are in the file")
    if compiler.get("balanceinertia") == "true":
        findings.warn(source, "balanceinertia: inertias are taken as they are in the file")


def _warn_of_options(root: Element, settings: Settings, findings: Findings) -> None:
    for option in root.all("option"):
        for key in FLUID:
            if any(findings.numbers(option, key, (0.0,) * (3 if key == "wind" else 1))) and settings.is_passive:
                findings.warn(option, f"{key}: the forces of a fluid are not part of a model")
        for flag in option.all("flag"):
            if flag.attributes.get("actuation") == "disable" and "actuation" in settings.disabled:
                findings.warn(flag, "actuation: the file disables its actuators; the inputs of the model act")
