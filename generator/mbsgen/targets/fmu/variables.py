"""The variables of a functional mock-up unit, in the order of their value references, and their units."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from mbsgen.targets.fmu.layout import Layout

_UNITS = {
    "rad": {"rad": "1"},
    "m": {"m": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "m/s": {"m": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m/s2": {"m": "1", "s": "-2"},
    "N m": {"kg": "1", "m": "2", "s": "-2"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "s": {"s": "1"},
}


_OUTSIDE_XML = {0xFFFE: 0xFFFD, 0xFFFF: 0xFFFD}  # characters of names that XML does not have, replaced


@dataclass(frozen=True)
class Variable:
    """A variable of the model description."""

    reference: int
    name: str
    causality: str
    variability: str
    unit: str | None = None
    start: float | None = None
    initial: str | None = None  # of a state: "exact", or "approx" where closing the loops changes it
    derivative: int | None = None  # the reference of the state that it is the derivative of
    description: str = ""

    @property
    def is_computed(self) -> bool:
        """Return whether the initialisation computes the variable."""
        return self.derivative is not None or (self.causality == "output" and self.initial != "exact")


def list_variables(layout: Layout, step: float) -> list[Variable]:
    """List all variables in the order of their value references; `step` is the longest step of co-simulation [s]."""
    manifest = layout.manifest
    found = [Variable(0, "time", "independent", "continuous", "s", description="time"), *_list_states(layout)]
    forces = [manifest.coordinates[i].force_unit for i in manifest.actuated]
    for k, name in enumerate(layout.named):
        unit = forces[k] if k < len(forces) else "N" if ".force." in name else "N m"
        own = None if k >= len(forces) and name in manifest.signals else unit
        found.append(Variable(0, f"u_{name}", "input", "continuous", own, 0.0, description=f"input {name}"))
    found += _list_drives(layout)
    text = "place in the base frame"
    found += [Variable(0, name, "output", "continuous", "m", description=text) for name in layout.outputs]
    found += [
        Variable(0, f"tau_{c.name}", "output", "continuous", c.force_unit, description=f"force that drives {c.name}")
        for c in manifest.coordinates
        if c.name in layout.driven
    ]
    text = "parameter of the model"
    found += [Variable(0, p.name, "parameter", "tunable", start=p.value, description=text) for p in manifest.parameters]
    found.append(Variable(0, "step", "parameter", "tunable", "s", step, description="longest step of co-simulation"))
    return _distinguish([replace(variable, reference=k) for k, variable in enumerate(found)])


def _list_states(layout: Layout) -> list[Variable]:
    """List the states, which are outputs too, and their derivatives."""
    manifest, start = layout.manifest, layout.start
    joints = [c.name for c in manifest.coordinates]
    places = layout.states
    units = {c.name: c.unit for c in manifest.coordinates}
    states = [(f"q_{x}", units.get(x), f"coordinate of {x}") for x in manifest.positions]
    states += [(f"qd_{x}", f"{units[x]}/s", f"velocity of {x}") for x in joints]
    rates = [f"{units[x]}/s" if x in units else None for x in manifest.positions]
    rates += [f"{units[x]}/s2" for x in joints]
    initial = "approx" if manifest.loops else "exact"
    found = [
        Variable(0, name, "output", "continuous", unit, start[place], initial, description=text)
        for place, (name, unit, text) in ((place, states[place]) for place in places)
    ]
    found += [
        Variable(
            0,
            f"der({name})",
            "local",
            "continuous",
            rates[place],
            derivative=1 + k,
            description=f"derivative of the {text}",
        )
        for k, (place, (name, _, text)) in enumerate((place, states[place]) for place in places)
    ]
    return found


def _list_drives(layout: Layout) -> Iterator[Variable]:
    """List the inputs of driven joints: all coordinates, then all velocities, then all accelerations."""
    units = {c.name: c.unit for c in layout.manifest.coordinates}
    places = layout.inputs[len(layout.manifest.inputs) :]
    kinds = (("q", "", "coordinate"), ("qd", "/s", "velocity"), ("qdd", "/s2", "acceleration"))
    named = [(kind, per, text, name) for kind, per, text in kinds for name in layout.driven]
    for place, (kind, per, text, name) in zip(places, named, strict=True):
        text = f"given {text} of {name}"
        yield Variable(
            0, f"{kind}_{name}", "input", "continuous", f"{units[name]}{per}", layout.start[place], description=text
        )


def _distinguish(variables: Sequence[Variable]) -> list[Variable]:
    """Return the variables with a different name each."""
    taken, found = set[str](), []
    for variable in variables:
        name = variable.name
        while name in taken:
            name += "_"
        taken.add(name)
        found.append(replace(variable, name=name))
    return found


def add_units(root: ET.Element, variables: Sequence[Variable]) -> None:
    """Define the units of the variables."""
    units = ET.SubElement(root, "UnitDefinitions")
    for name in sorted({v.unit for v in variables if v.unit}):
        ET.SubElement(ET.SubElement(units, "Unit", name=name), "BaseUnit", _UNITS[name])


def add_log(root: ET.Element) -> None:
    """Define the category of messages."""
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="why a function failed")


def write_document(root: ET.Element) -> str:
    """Return the text of an XML file."""
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode").translate(_OUTSIDE_XML)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
