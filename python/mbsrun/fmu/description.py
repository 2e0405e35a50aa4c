"""The XML files of a functional mock-up unit: model description, build description, terminals."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mbsgen.manifest import Manifest
from mbsgen.roles import Role
from mbsrun.fmu.layout import Layout
from mbsrun.simulation.drive import input_labels

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


@dataclass(frozen=True)
class Variable:
    """A variable of the model description."""

    reference: int
    name: str
    causality: str
    variability: str
    unit: str | None = None
    start: float | None = None
    derivative: int | None = None  # the reference of the state that it is the derivative of
    description: str = ""


def list_variables(layout: Layout, step: float) -> list[Variable]:
    """List all variables in the order of their value references."""
    manifest, start = layout.manifest, layout.start
    names, joints = manifest.positions, [c.name for c in manifest.coordinates]
    units = {c.name: c.unit for c in manifest.coordinates}
    states = [(f"q_{x}", units.get(x), f"coordinate of {x}") for x in names]
    states += [(f"qd_{x}", f"{units[x]}/s", f"velocity of {x}") for x in joints]
    rates = [f"{units[x]}/s" if x in units else None for x in names] + [f"{units[x]}/s2" for x in joints]
    found = [Variable(0, "time", "independent", "continuous", "s", description="time")]
    for k, (name, unit, text) in enumerate(states):
        found.append(Variable(1 + k, name, "output", "continuous", unit, start[k], description=text))
    first = 1 + layout.states
    for k, (name, _, text) in enumerate(states):
        told = f"derivative of the {text}"
        found.append(
            Variable(first + k, f"der({name})", "local", "continuous", rates[k], derivative=1 + k, description=told)
        )
    forces = [manifest.coordinates[i].force_unit for i in manifest.actuated]
    first += layout.states
    for k, name in enumerate(input_labels(manifest)):
        unit = forces[k] if k < len(forces) else "N" if ".force." in name else "N m"
        found.append(Variable(first + k, f"u_{name}", "input", "continuous", unit, 0.0, description=f"input {name}"))
    first += layout.inputs
    found += [
        Variable(first + k, name, "output", "continuous", "m", description="place in the base frame")
        for k, name in enumerate(layout.outputs)
    ]
    first += len(layout.outputs)
    place = layout.first[Role.PARAMETER]
    found += [
        Variable(
            first + k, p.name, "parameter", "tunable", start=start[place + k], description="parameter of the model"
        )
        for k, p in enumerate(manifest.parameters)
    ]
    first += len(manifest.parameters)
    text = "longest step of co-simulation"
    return _distinguish([*found, Variable(first, "step", "parameter", "tunable", "s", step, description=text)])


def _distinguish(variables: Sequence[Variable]) -> list[Variable]:
    """Return the variables with a different name each."""
    taken, found = set[str](), []
    for variable in variables:
        name = variable.name
        while name in taken:
            name += "_"
        taken.add(name)
        found.append(Variable(**{**vars(variable), "name": name}))
    return found


def describe_model(layout: Layout, step: float) -> str:
    """Write modelDescription.xml."""
    manifest, variables = layout.manifest, list_variables(layout, step)
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=manifest.model,
        instantiationToken=manifest.model_hash,
        generationTool=manifest.generator,
        variableNamingConvention="flat",
    )
    abilities = {
        "modelIdentifier": manifest.prefix,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
    }
    ET.SubElement(root, "ModelExchange", abilities)
    ET.SubElement(root, "CoSimulation", {**abilities, "canHandleVariableCommunicationStepSize": "true"})
    units = ET.SubElement(root, "UnitDefinitions")
    for name in sorted({v.unit for v in variables if v.unit}):
        ET.SubElement(ET.SubElement(units, "Unit", name=name), "BaseUnit", _UNITS[name])
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="why a function failed")
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(step))
    listed = ET.SubElement(root, "ModelVariables")
    for variable in variables:
        ET.SubElement(listed, "Float64", dict(_describe(variable)))
    structure = ET.SubElement(root, "ModelStructure")
    derivatives = [v for v in variables if v.derivative is not None]
    outputs = [v for v in variables if v.causality == "output"]
    computed = [v for v in outputs if v.start is None]
    for tag, chosen in (("Output", outputs), ("ContinuousStateDerivative", derivatives)):
        for variable in chosen:
            ET.SubElement(structure, tag, valueReference=str(variable.reference))
    for variable in sorted((*derivatives, *computed), key=lambda v: v.reference):
        ET.SubElement(structure, "InitialUnknown", valueReference=str(variable.reference))
    return _write(root)


def _describe(variable: Variable) -> Iterator[tuple[str, str]]:
    yield "name", variable.name
    yield "valueReference", str(variable.reference)
    yield "causality", variable.causality
    yield "variability", variable.variability
    if variable.description:
        yield "description", variable.description
    if variable.unit:
        yield "unit", variable.unit
    if variable.derivative is not None:
        yield "derivative", str(variable.derivative)
    if variable.start is not None:
        if variable.causality == "output":
            yield "initial", "exact"
        yield "start", repr(variable.start)


def describe_build(manifest: Manifest, sources: Sequence[str]) -> str:
    """Write buildDescription.xml."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=manifest.prefix)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for source in sources:
        ET.SubElement(files, "SourceFile", name=source)
    ET.SubElement(configuration, "Library", name="m", external="true")
    return _write(root)


def describe_terminals(layout: Layout, step: float) -> str:
    """Write terminalsAndIcons.xml: a terminal for each joint, with its position, velocity and force."""
    names = {v.name for v in list_variables(layout, step)}
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    terminals = ET.SubElement(root, "Terminals")
    for coordinate in layout.manifest.coordinates:
        members = {"position": "q_", "velocity": "qd_", "force": "u_"}
        found = {kind: f"{start}{coordinate.name}" for kind, start in members.items()}
        terminal = ET.SubElement(terminals, "Terminal", name=coordinate.name, matchingRule="plug")
        for kind, name in found.items():
            if name in names:
                ET.SubElement(
                    terminal, "TerminalMemberVariable", variableName=name, memberName=kind, variableKind="signal"
                )
    return _write(root)


def _write(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
