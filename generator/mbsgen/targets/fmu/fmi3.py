"""The XML files of a unit of FMI 3.0: model description, build description, terminals."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence

from mbsgen.manifest import Manifest
from mbsgen.targets.fmu.layout import Layout
from mbsgen.targets.fmu.variables import Variable, add_log, add_units, list_variables, write_document


def describe(layout: Layout, step: float, sources: Sequence[str]) -> Mapping[str, str]:
    """Write the XML files, path -> text, of a unit with these C files."""
    variables = list_variables(layout, step)
    return {
        "modelDescription.xml": _describe_model(layout, variables, step),
        "sources/buildDescription.xml": _describe_build(layout.manifest, sources),
        "terminalsAndIcons/terminalsAndIcons.xml": _describe_terminals(layout, variables),
    }


def _describe_model(layout: Layout, variables: Sequence[Variable], step: float) -> str:
    manifest = layout.manifest
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
    closes = {"needsCompletedIntegratorStep": "true"} if manifest.loops else {}
    ET.SubElement(root, "ModelExchange", {**abilities, **closes})
    ET.SubElement(root, "CoSimulation", {**abilities, "canHandleVariableCommunicationStepSize": "true"})
    add_units(root, variables)
    add_log(root)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(step))
    listed = ET.SubElement(root, "ModelVariables")
    for variable in variables:
        ET.SubElement(listed, "Float64", dict(_describe_variable(variable)))
    structure = ET.SubElement(root, "ModelStructure")
    chosen = {
        "Output": [v for v in variables if v.causality == "output"],
        "ContinuousStateDerivative": [v for v in variables if v.derivative is not None],
        "InitialUnknown": [v for v in variables if v.is_computed],
    }
    for tag, unknowns in chosen.items():
        for variable in unknowns:
            ET.SubElement(structure, tag, valueReference=str(variable.reference))
    return write_document(root)


def _describe_variable(variable: Variable) -> Iterator[tuple[str, str]]:
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
    if variable.initial:
        yield "initial", variable.initial
    if variable.start is not None:
        yield "start", repr(variable.start)


def _describe_build(manifest: Manifest, sources: Sequence[str]) -> str:
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=manifest.prefix)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for source in sources:
        ET.SubElement(files, "SourceFile", name=source)
    ET.SubElement(configuration, "Library", name="m", external="true")
    return write_document(root)


def _describe_terminals(layout: Layout, variables: Sequence[Variable]) -> str:
    """Describe a terminal for each joint, with its position, velocity and force, and a given acceleration."""
    names, driven = {v.name for v in variables}, layout.driven
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    terminals = ET.SubElement(root, "Terminals")
    for coordinate in layout.manifest.coordinates:
        force = "tau_" if coordinate.name in driven else "u_"
        members = {"position": "q_", "velocity": "qd_", "acceleration": "qdd_", "force": force}
        found = {kind: f"{start}{coordinate.name}" for kind, start in members.items()}
        terminal = ET.SubElement(terminals, "Terminal", name=coordinate.name, matchingRule="plug")
        for kind, name in found.items():
            if name in names:
                ET.SubElement(
                    terminal, "TerminalMemberVariable", variableName=name, memberName=kind, variableKind="signal"
                )
    return write_document(root)
