"""A model file -> Model, or all that is wrong with the file."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mbsgen.documents import Place, abbreviate, examine, expect, read_document, refuse
from mbsgen.expressions import Expression
from mbsgen.model import schema
from mbsgen.model.checks import find_doubts, find_faults
from mbsgen.model.compounds import COMPOUNDS, Compound, make_joints
from mbsgen.model.findings import Finding
from mbsgen.model.model import (
    Body,
    Fixed,
    Follow,
    Frame,
    Friction,
    Inertia,
    Joint,
    Law,
    Model,
    Parameter,
    Placement,
    Rotation,
    Triple,
    Wrench,
)
from mbsgen.model.tree import Kind, Motion


def read_model(path: Path) -> Model:
    """Read a model file. Raises InputError with every fault of it: of YAML, of shape, and of meaning."""
    document = read_document(path)
    expect(document, "model")
    examination = examine(document, schema.ModelSection)
    faults = list(examination.faults)
    section = examination.value
    if section is not None:
        model = _make_model(section)
        findings = [*_check_axes(section), *find_faults(model, examination.stand_ins)]
        faults += [document.fault(_locate(found.place, section), found.finding, found.remedy) for found in findings]
    if faults or section is None:
        raise refuse(faults)
    for found in find_doubts(model):
        fault = document.fault(_locate(found.place, section), found.finding, found.remedy)
        warnings.warn(str(fault), ModelWarning, stacklevel=2)
    return model


class ModelWarning(UserWarning):
    """Something in a model file that is taken as it stands, but may not be meant."""


def _make_model(section: schema.ModelSection) -> Model:
    return Model(
        name=section.name,
        gravity=section.gravity,
        parameters=tuple(_make_parameter(name, value) for name, value in section.parameters.items()),
        bodies=tuple(map(_make_body, section.bodies)),
        frames=tuple(Frame(frame.name, frame.body, _make_placement(frame)) for frame in section.frames),
        wrenches=tuple(map(_make_wrench, section.wrenches)),
        allow_unphysical=section.allow_unphysical,
    )


def _make_parameter(name: str, value: Expression | schema.ParameterSection) -> Parameter:
    if isinstance(value, schema.ParameterSection):
        return Parameter(name, value.value, value.kind)
    return Parameter(name, value, Kind.CONSTANT)


def _make_body(section: schema.BodySection) -> Body:
    return Body(
        name=section.name,
        joint=_make_joint(section.joint),
        parent=section.parent,
        mass=section.mass,
        com=section.com,
        inertia=_make_inertia(section.inertia),
    )


def _make_joint(
    section: schema.JointSection | tuple[schema.ElementarySection, ...],
) -> Joint | Fixed | tuple[Joint, ...]:
    match section:
        case tuple():
            return tuple(map(_make_elementary, section))
        case schema.ElementarySection():
            return _make_elementary(section)
        case schema.FixedSection():
            return Fixed(_make_placement(section))
        case schema.BallSection() | schema.FreeSection():
            loose = COMPOUNDS[section.type, "xyz"]
            return make_joints(loose, _make_placement(section), actuated=section.actuated)
    compound = _find_compound(section)
    joints = make_joints(compound, _make_placement(section), actuated=section.actuated)
    return tuple(
        _set_joint(joint, section.axes[label]) if label in section.axes else joint
        for joint, label in zip(joints, compound.labels, strict=True)
    )


def _find_compound(section: schema.NamedSection) -> Compound:
    order = section.plane if isinstance(section, schema.PlanarSection) else section.order
    return COMPOUNDS[section.type, order]


def _make_elementary(section: schema.ElementarySection) -> Joint:
    return _set_joint(Joint(Motion(section.type), section.axis, placement=_make_placement(section)), section)


def _set_joint(joint: Joint, setting: schema.SettingSection) -> Joint:
    dry = None if setting.friction is None else Friction(setting.friction.torque, setting.friction.speed)
    followed = setting.follows
    follows = None if followed is None else Follow(followed.joint, followed.ratio, followed.offset)
    actuated = joint.actuated and follows is None
    return replace(
        joint,
        name=setting.name,
        actuated=actuated if setting.actuated is None else setting.actuated,
        lower=setting.limits[0],
        upper=setting.limits[1],
        max_speed=setting.max_speed,
        max_force=setting.max_force,
        law=Law(setting.stiffness, setting.rest, setting.damping, dry, setting.force),
        armature=setting.armature,
        follows=follows,
    )


def _make_inertia(value: tuple[Expression, Expression, Expression] | schema.TensorSection) -> Inertia:
    if isinstance(value, schema.TensorSection):
        return Inertia(value.xx, value.yy, value.zz, value.xy, value.xz, value.yz)
    return Inertia(*value)


def _make_placement(section: schema.PlacementSection) -> Placement:
    rotations = tuple(Rotation("xyz".index(step.axis), step.angle) for step in section.orientation)
    return Placement(section.position, rotations)


def _make_wrench(section: schema.WrenchSection) -> Wrench:
    return Wrench(
        name=section.name,
        body=section.body,
        position=section.position,
        in_base=section.frame == "base",
        force=_read_components(section.force),
        moment=_read_components(section.moment),
    )


def _read_components(value: Triple | str) -> Triple | None:
    return None if isinstance(value, str) else value


# --- joints that have a name for all of them: where their settings are in the file -----------------------------------


def _check_axes(section: schema.ModelSection) -> Iterator[Finding]:
    for i, body in enumerate(section.bodies):
        if isinstance(body.joint, schema.NamedSection):
            labels = _find_compound(body.joint).labels
            for label in body.joint.axes:
                if label not in labels:
                    remedy = f"the axes of this joint are {', '.join(labels)}"
                    yield Finding(("bodies", i, "joint", "axes", label), f"no axis {abbreviate(label)}", remedy)


def _locate(place: Place, section: schema.ModelSection) -> Place:
    """Find in the file what is joint k of a body: an entry of a list, or a setting of a joint that has a name."""
    match place:
        case ("bodies", int(i), "joint", int(k), *rest):
            joint = section.bodies[i].joint
            if isinstance(joint, schema.NamedSection):
                label = _find_compound(joint).labels[k]
                inner = (
                    ("axes", label) if label in joint.axes and rest[:1] not in (["position"], ["orientation"]) else ()
                )
                return ("bodies", i, "joint", *inner, *rest)
    return place
