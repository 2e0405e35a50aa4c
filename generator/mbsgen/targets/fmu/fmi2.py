"""The XML file of a unit of FMI 2.0: the model description, which lists the sources too."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence

from mbsgen.targets.fmu.layout import Layout
from mbsgen.targets.fmu.variables import Variable, add_log, add_units, list_variables, write_document


def describe(layout: Layout, step: float, sources: Sequence[str]) -> Mapping[str, str]:
    """Write the XML files, path -> text, of a unit with these C files."""
    manifest, variables = layout.manifest, list_variables(layout, step)
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=manifest.model,
        guid=manifest.model_hash,
        generationTool=manifest.generator,
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    abilities = {
        "modelIdentifier": manifest.prefix,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    kinds = {
        "ModelExchange": {} if manifest.loops else {"completedIntegratorStepNotNeeded": "true"},
        "CoSimulation": {"canHandleVariableCommunicationStepSize": "true"},
    }
    for kind, more in kinds.items():
        files = ET.SubElement(ET.SubElement(root, kind, {**abilities, **more}), "SourceFiles")
        for source in sources:
            ET.SubElement(files, "File", name=source)
    add_units(root, variables)
    add_log(root)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(step))
    listed = ET.SubElement(root, "ModelVariables")
    for variable in variables:
        _add_variable(listed, variable)
    structure = ET.SubElement(root, "ModelStructure")
    chosen = {
        "Outputs": [v for v in variables if v.causality == "output"],
        "Derivatives": [v for v in variables if v.derivative is not None],
        "InitialUnknowns": [v for v in variables if v.is_computed],
    }
    for tag, unknowns in chosen.items():
        group = ET.SubElement(structure, tag)
        for variable in unknowns:
            ET.SubElement(group, "Unknown", index=_index(variable.reference))
    return {"modelDescription.xml": write_document(root)}


def _index(reference: int) -> str:
    """Return the place of a variable in the list, from 1."""
    return str(reference + 1)


def _add_variable(listed: ET.Element, variable: Variable) -> None:
    scalar = ET.SubElement(
        listed,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(variable.reference),
        description=variable.description,
        causality=variable.causality,
        variability=variable.variability,
    )
    if variable.initial:
        scalar.set("initial", variable.initial)
    ET.SubElement(scalar, "Real", dict(_describe_real(variable)))


def _describe_real(variable: Variable) -> Iterator[tuple[str, str]]:
    if variable.unit:
        yield "unit", variable.unit
    if variable.start is not None:
        yield "start", repr(variable.start)
    if variable.derivative is not None:
        yield "derivative", _index(variable.derivative)
