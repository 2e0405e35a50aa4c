"""A model file -> Model, or all that is wrong with the file."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from mbsgen.documents import (
    Document,
    Finding,
    Place,
    examine,
    expect,
    lies_under,
    read_document,
    refuse,
)
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import Expression
from mbsgen.model.checks.checks import find_doubts, find_faults
from mbsgen.model.file import schema
from mbsgen.model.file.force_sections import TyreSection
from mbsgen.model.file.tir import VERTICAL, TyreFile, read_tyre
from mbsgen.model.file.visual_sections import make_visuals
from mbsgen.model.joints.dh import DhSection, place_tail
from mbsgen.model.joints.elementary import ElementarySection
from mbsgen.model.joints.section import JointSection
from mbsgen.model.model import Body, Carrier, Fixed, Frame, Inertia, Joint, Model, Parameter, Row, Triple, Wrench
from mbsgen.model.slips import list_slips
from mbsgen.model.tree import Kind
from mbsgen.model.tyres import NEEDED, RELAXING


def read_model(path: Path) -> Model:
    """Read a model file. Raises InputError with every fault of it: of YAML, of shape, and of meaning."""
    document = read_document(path)
    expect(document, "model")
    examination = examine(document, schema.model_section())
    faults = list(examination.faults)
    section = examination.value
    if section is not None:
        tyres, amiss = _read_tyres(path, document, section, examination.stand_ins)
        faults += amiss
        model = _make_model(section, tyres)
        doubtful = examination.stand_ins | _follow_carriers(section, examination.stand_ins)
        findings = [*_check_joints(section), *_check_contacts(section, tyres), *find_faults(model, doubtful)]
        faults += [
            document.fault(_locate(found.place, section, model), found.finding, found.remedy) for found in findings
        ]
    if faults or section is None:
        raise refuse(faults)
    for table in dict.fromkeys(tyres.values()):
        if found := _list_steady(table, section, tyres):
            warnings.warn(f"{table.file}: {STEADY.format(', '.join(found))}", ModelWarning, stacklevel=2)
        if table.unused:
            warnings.warn(f"{table.file}: {UNUSED.format(', '.join(table.unused))}", ModelWarning, stacklevel=2)
    for doubt in find_doubts(model):
        fault = document.fault(_locate(doubt.place, section, model), doubt.finding, doubt.remedy)
        warnings.warn(str(fault), ModelWarning, stacklevel=2)
    return model


class ModelWarning(UserWarning):
    """Something in a model file that is taken as it stands, but may not be meant."""


UNUSED = "no formula of MF-Tyre 5.2 without turn slip and pressure has {}; these are left out"
STEADY = "without transient: true in a tyre, the relaxation lengths {} are left out"
NO_TYRE = TyreFile("", dict.fromkeys(NEEDED, 1.0), {}, ())  # in place of a file that is at fault


def _read_tyres(
    path: Path, document: Document, section: schema.ModelSection, doubtful: frozenset[Place]
) -> tuple[dict[int, TyreFile], list[Fault]]:
    """Read the files of tyres, by the numbers of their contacts; and list what is wrong with them."""
    tables, faults, known = dict[int, TyreFile](), list[Fault](), dict[str, TyreFile]()
    for i, contact in enumerate(section.contacts):
        place = ("contacts", i, "tyre", "file")
        if contact.tyre is None or (name := contact.tyre.file) is None:
            continue
        if lies_under(place, doubtful):
            name = ""
            known[name] = NO_TYRE
        if name not in known:
            known[name], file = NO_TYRE, path.parent / name
            if not file.resolve().is_relative_to(path.parent.resolve()):
                finding = "a link out of the model's folder"
                faults.append(document.fault(place, finding, "name a file below that folder"))
            else:
                try:
                    known[name] = read_tyre(file)
                except InputError as error:
                    faults += error.faults
        tables[i] = known[name]
    return tables, faults


def _list_steady(table: TyreFile, section: schema.ModelSection, tyres: Mapping[int, TyreFile]) -> list[str]:
    """List the coefficients of a file by which slips relax, where no tyre of the file is transient."""
    used = [contact.tyre for i, contact in enumerate(section.contacts) if tyres.get(i) is table]
    if any(tyre is not None and tyre.transient for tyre in used):
        return []
    return [key for key in RELAXING if key.startswith("P") and table.magic.get(key)]


def _make_model(section: schema.ModelSection, tyres: Mapping[int, TyreFile]) -> Model:
    contacts = tuple(contact.make(tyres.get(i)) for i, contact in enumerate(section.contacts))
    carriers = (_make_carrier(section.bodies[i]) for i in _list_standard(section))
    return Model(
        name=section.name,
        gravity=section.gravity,
        parameters=tuple(_make_parameter(name, value) for name, value in section.parameters.items()),
        bodies=(*map(_make_body, section.bodies), *carriers, *list_slips(contacts)),
        frames=tuple(Frame(x.name, x.body, x.placement, x.sensor) for x in section.frames),
        wrenches=tuple(map(_make_wrench, section.wrenches)),
        forces=tuple(element.make() for element in section.forces),
        contacts=contacts,
        stops=tuple(stop.make() for stop in section.stops),
        signals=section.signals,
        loops=tuple(loop.make() for loop in section.loops),
        constraints=tuple(constraint.make() for constraint in section.constraints),
        driven=section.driven,
        independent=section.independent,
        assembly=tuple(section.assembly.items()),
        loop_tolerance=section.loop_tolerance,
        allow_unphysical=section.allow_unphysical,
    )


def _make_parameter(name: str, value: Expression | schema.ParameterSection) -> Parameter:
    if isinstance(value, schema.ParameterSection):
        return Parameter(name, value.value, value.kind)
    return Parameter(name, value, Kind.CONSTANT)


def _make_body(section: schema.BodySection) -> Body:
    row = _find_standard(section)
    return Body(
        name=section.name,
        joint=_make_joint(section.name, section.joint) if row is None else Fixed(place_tail(row), row),
        parent=section.parent if row is None else _name_carrier(section),
        mass=section.mass,
        com=section.com,
        inertia=_make_inertia(section),
        visuals=make_visuals(section.visual),
        is_list=isinstance(section.joint, tuple),
    )


def _find_standard(section: schema.BodySection) -> Row | None:
    """Return the row of a standard Denavit-Hartenberg table, where the body's frame is beyond its joint."""
    row = section.joint.row if isinstance(section.joint, DhSection) else None
    return row if row is not None and row.is_standard else None


def _list_standard(section: schema.ModelSection) -> list[int]:
    """Number the bodies whose frames stand beyond their joints; their carriers follow the bodies of the file."""
    return [i for i, body in enumerate(section.bodies) if _find_standard(body) is not None]


def _name_carrier(section: schema.BodySection) -> str:
    return f"{section.name}.joint"


def _make_carrier(section: schema.BodySection) -> Body:
    """Make the massless body that the joint of a standard table moves."""
    joint = _make_joint(section.name, section.joint)
    assert isinstance(joint, Joint), "a row of a table is one joint"
    return Body(_name_carrier(section), replace(joint, name=joint.name or section.name), section.parent)


def _make_joint(body: str, section: JointSection | tuple[ElementarySection, ...]) -> Carrier:
    return tuple(joint.make(body) for joint in section) if isinstance(section, tuple) else section.make(body)


def _make_inertia(section: schema.BodySection) -> Inertia:
    value = section.inertia
    if not isinstance(value, schema.TensorSection):
        return Inertia(*value)
    return Inertia(value.xx, value.yy, value.zz, value.xy, value.xz, value.yz, about=value.about)


def _make_wrench(section: schema.WrenchSection) -> Wrench:
    return Wrench(
        name=section.name,
        body=section.body,
        position=section.position,
        in_base=section.frame == "base",
        force=_read_components(section.force),
        moment=_read_components(section.moment),
        orientation=section.placement.orientation,
        against=None if section.against is None else section.against.end,
        by_turns=section.about == "turns",
    )


def _read_components(value: Triple | str) -> Triple | None:
    return None if isinstance(value, str) else value


# --- joints: where their parts are in the file ------------------------------------------------------------------------


def _check_joints(section: schema.ModelSection) -> Iterator[Finding]:
    for i, body in enumerate(section.bodies):
        if isinstance(body.joint, JointSection):
            for found in body.joint.find_faults():
                yield replace(found, place=("bodies", i, "joint", *found.place))


def _check_contacts(section: schema.ModelSection, tyres: Mapping[int, TyreFile]) -> Iterator[Finding]:
    for i, contact in enumerate(section.contacts):
        table = tyres.get(i, NO_TYRE)
        known = VERTICAL if table is NO_TYRE and i in tyres else table.vertical  # a file that is at fault may have all
        if contact.stiffness is None and contact.restitution is None and "VERTICAL_STIFFNESS" not in known:
            yield Finding(("contacts", i, "stiffness"), "missing", "give it, or restitution of a rigid contact")
        if contact.wheel is not None and contact.wheel.radius is None and "UNLOADED_RADIUS" not in known:
            yield Finding(("contacts", i, "wheel", "radius"), "missing", "give it, or a tyre's file that has it")
        yield from _check_tyre(("contacts", i, "tyre"), contact.tyre)
        given = [key for key in ("plane", "sphere", "box", "capsule", "hull") if getattr(contact, key) is not None]
        if len(given) > 1:
            finding = " and ".join(f"a {key}" for key in given)
            yield Finding(("contacts", i, given[1]), finding, "give one of them, or make a contact for each")


def _check_tyre(place: Place, tyre: TyreSection | None) -> Iterator[Finding]:
    if tyre is None:
        return
    if tyre.brush is None:
        for key in RELAXING:
            if key in tyre.coefficients and not tyre.transient:
                finding = f"{key} of a tyre that is not transient"
                yield Finding((*place, "coefficients", key), finding, "give transient: true, or leave it out")
        return
    for key, given in (("file", tyre.file), ("coefficients", tyre.coefficients), ("transient", tyre.transient)):
        if given:
            yield Finding((*place, key), f"{key} beside a brush", "give one of them")


def _follow_carriers(section: schema.ModelSection, doubtful: frozenset[Place]) -> frozenset[Place]:
    """Return the places in the carriers of standard tables whose values come from doubtful places of the file."""
    carriers = {i: len(section.bodies) + k for k, i in enumerate(_list_standard(section))}
    return frozenset(
        ("bodies", carriers[i], *rest)
        for head, i, *rest in (place for place in doubtful if len(place) > 1)
        if head == "bodies" and isinstance(i, int) and i in carriers
    )


def _locate(place: Place, section: schema.ModelSection, model: Model) -> Place:
    """Find in the file what a Model has at a place: an elementary joint may be part of one that the file names."""
    standard, count = _list_standard(section), len(section.bodies)
    match place:
        case ("bodies", int(i), *_) if i >= count + len(standard):
            own = [contact.name for contact in section.contacts].index(model.bodies[i].slips_at)
            return ("contacts", own, "tyre")
        case ("bodies", int(i), *rest) if i >= count:
            return ("bodies", standard[i - count], *rest)
        case ("bodies", int(i), "joint", *_) if i in standard:
            return ("bodies", i, "joint")
        case ("bodies", int(i), "joint", int(k), *rest):
            joint = section.bodies[i].joint
            if isinstance(joint, JointSection):
                return ("bodies", i, "joint", *joint.locate(k, tuple(rest)))
    return place
