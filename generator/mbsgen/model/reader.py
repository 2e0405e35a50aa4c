"""A model file -> Model, or all that is wrong with the file."""

from __future__ import annotations

from pathlib import Path

from mbsgen.documents import examine, read_document, refuse
from mbsgen.expressions import Expression
from mbsgen.model import schema
from mbsgen.model.checks import find_faults
from mbsgen.model.model import Body, Frame, Inertia, Joint, Model, Parameter, Placement, Rotation
from mbsgen.model.tree import Kind, Motion


def read_model(path: Path) -> Model:
    """Read a model file. Raises InputError with every fault of it: of YAML, of shape, and of meaning."""
    document = read_document(path)
    examination = examine(document, schema.ModelSection)
    faults = list(examination.faults)
    if examination.value is not None:
        model = _make_model(examination.value)
        findings = find_faults(model, examination.stand_ins)
        faults += [document.fault(found.place, found.finding, found.remedy) for found in findings]
    if faults:
        raise refuse(faults)
    return model


def _make_model(section: schema.ModelSection) -> Model:
    return Model(
        name=section.name,
        gravity=section.gravity,
        parameters=tuple(_make_parameter(name, value) for name, value in section.parameters.items()),
        bodies=tuple(map(_make_body, section.bodies)),
        frames=tuple(Frame(frame.name, frame.body, _make_placement(frame)) for frame in section.frames),
        allow_unphysical=section.allow_unphysical,
    )


def _make_parameter(name: str, value: Expression | schema.ParameterSection) -> Parameter:
    if isinstance(value, schema.ParameterSection):
        return Parameter(name, value.value, value.kind)
    return Parameter(name, value, Kind.CONSTANT)


def _make_body(section: schema.BodySection) -> Body:
    joint = section.joint
    return Body(
        name=section.name,
        parent=section.parent,
        joint=Joint(
            name=section.name if joint.name is None else joint.name,
            motion=Motion(joint.type),
            axis=joint.axis,
            placement=_make_placement(joint),
            actuated=joint.actuated,
            lower=joint.limits[0],
            upper=joint.limits[1],
        ),
        mass=section.mass,
        com=section.com,
        inertia=_make_inertia(section.inertia),
    )


def _make_inertia(value: tuple[Expression, Expression, Expression] | schema.TensorSection) -> Inertia:
    if isinstance(value, schema.TensorSection):
        return Inertia(value.xx, value.yy, value.zz, value.xy, value.xz, value.yz)
    return Inertia(*value, schema.ZERO, schema.ZERO, schema.ZERO)


def _make_placement(section: schema.PlacementSection) -> Placement:
    rotations = tuple(Rotation("xyz".index(step.axis), step.angle) for step in section.orientation)
    return Placement(section.position, rotations)
