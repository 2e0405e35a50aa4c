"""The pipeline: model.yaml or Model -> Tree -> tapes, derivatives, setup -> verification -> C, manifest, report."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sympy import Expr, Symbol

from mbsgen import __version__, manifest, renumbering
from mbsgen.appearance import describe_appearance, write_formulas
from mbsgen.assembly import AssemblyError, assemble, list_held, list_redundant
from mbsgen.assembly import release as release_tree
from mbsgen.documents import Place, abbreviate, read_document, refuse, write_path
from mbsgen.errors import Fault
from mbsgen.expressions import Number
from mbsgen.families import Functions, Tell, say_nothing, write_families, write_functions
from mbsgen.formulations.catalogue import list_results
from mbsgen.formulations.closure import list_equations
from mbsgen.importing import Choices, import_model, is_foreign, list_formats, write_imported
from mbsgen.manifest import (
    BearingLoad,
    Coordinate,
    Frame,
    Friction,
    Loop,
    Manifest,
    Parameter,
    RigidPair,
    RigidPoint,
    Solid,
    Stops,
    Wrench,
)
from mbsgen.model.changes.opening import Opened, open_forces
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.changes.scene import EVERYTHING, Scene, apply_kinds, read_scene, stage
from mbsgen.model.checks.checks import find_faults
from mbsgen.model.model import Model
from mbsgen.model.reader import ModelWarning, read_model
from mbsgen.model.symbols import exact, to_double, total
from mbsgen.model.tree import IDENTITY, NO_FORCE, Barrier, DryFriction, Kind, Meeting, Motion, Rigid, Tree, Vector
from mbsgen.model.writer import write_model
from mbsgen.output import write_folder
from mbsgen.procedure.procedure import Computation, Procedure
from mbsgen.quick_imports import without_searches
from mbsgen.renumbering import Changes, Numbers
from mbsgen.report import Report, make_report, write_json, write_markdown
from mbsgen.request import DEFAULT, OptionError, Options, Request, merge
from mbsgen.scene_tables import Evidence
from mbsgen.targets.c.files import Sources, write_c
from mbsgen.targets.c.symbols import check_prefix
from mbsgen.targets.contract import Family
from mbsgen.targets.entries import list_groups
from mbsgen.targets.languages import find_targets
from mbsgen.targets.names import mangle
from mbsgen.targets.unit import Unit
from mbsgen.verification.verify import Verification, verify

if TYPE_CHECKING:
    from mbsgen.approximation.choice import Approximation
    from mbsgen.equations import Motion as Equations
    from mbsgen.subjects.scaling import Scaled
    from mbsgen.subjects.settings import Subject

__all__ = ["Changes", "OptionError", "Options", "Product", "generate", "make", "read_tree", "write_families"]


@dataclass(frozen=True)
class Product:
    """Everything made from one model; nothing is written yet."""

    manifest: Manifest
    report: Report
    files: Mapping[str, str]  # path in the folder -> text
    packages: Mapping[str, bytes] = field(default_factory=dict)  # path in the folder -> content


def generate(model: Path | Model, out: Path, options: Options = DEFAULT, tell: Tell = say_nothing) -> Product:
    """Make everything from a model, and write it to the folder `out`. Where `make` raises, nothing is written."""
    product = make(model, options, tell)
    write_folder({**product.files, **product.packages}, out)
    return product


def make(model: Path | Model, options: Options = DEFAULT, tell: Tell = say_nothing) -> Product:
    """Make everything from a model file, or from a model made in Python.

    `tell` is called with the name of each stage when it begins. Raises InputError with every fault of the file,
    OptionError for unknown functions, VerificationError for a function with wrong results.
    """
    with without_searches():  # tapes have millions of objects, and no cycles
        return _make(model, options, tell)


def _make(model: Path | Model, options: Options, tell: Tell) -> Product:
    tell("reading the model")
    opened = open_forces(read(model)) if options.opened else Opened(read(model))
    whole = opened.model
    request = merge(options, _read_scene(options.scene, whole))
    staged = _stage(whole, request.scene, options.scene)
    with _locating(model):
        trees = _build_trees(whole, staged, request)
    functions = write_functions(trees.generated, request, tell, staged=_needs_stages_alone(request))
    tell("the check of all functions")
    verification = verify(trees.generated, functions.families, still=not request.scene.motion)
    tell("C")
    unit = _make_unit(trees, functions, verification, request)
    sources = write_c(unit)
    unit = replace(unit, own=sources.own)
    shown = release(whole, request.scene, zeros=request.zeros) if request.runtime else staged
    described = _describe(trees.generated, unit, sources, staged, shown)
    if options.opened:
        laws = {"open_joints": opened.joints, "open_contacts": opened.contacts}
        described = described.model_copy(update=laws)
    evidence = _gather(whole, request, trees.approximation)
    tell("the report")
    report = make_report(
        trees.written,
        trees.parametric,
        described.kernels,
        functions.ways,
        verification,
        evidence,
        counted=request.count,
        compare=request.compare,
        size=request.size,
    )
    files = _write_files(unit, sources, described, report, request)
    targets, plain = find_targets(request.targets), _leave_precise_out(unit)
    packed = [{**target.pack(described, files), **target.encode(plain)} for target in targets]
    packages = {path: content for found in packed for path, content in found.items()}
    return Product(described, report, files, packages)


@dataclass(frozen=True)
class _Trees:
    """The trees of a staged model."""

    written: Tree  # as the model says
    parametric: Tree  # with every number a run-time parameter; zeros stay, so that the report always counts the same
    generated: Tree
    approximation: Approximation | None


def _build_trees(whole: Model, staged: Model, request: Request) -> _Trees:
    """Build the tree that functions are generated of, and the trees that the report counts."""
    written, parametric = _assemble(build_tree(staged)), build_parametric(whole, request.scene)
    if not (written.loops or written.constraints):
        parametric = release_tree(parametric)
    if request.scene.locked and (held := list_held(written)):
        shown = ", ".join(map(abbreviate, held))
        warnings.warn(f"with the locked joints of the scene, loops keep {shown} at rest", ModelWarning, stacklevel=3)
    if request.runtime:
        generated = build_parametric(whole, request.scene, zeros=True) if request.zeros else parametric
        return _Trees(written, parametric, assemble(generated), None)
    if request.tolerance is None:
        return _Trees(written, parametric, written, None)
    if written.is_constrained:
        raise OptionError(
            "tolerance: errors of mechanisms with loops, constraints or driven joints are not estimated; leave it out"
        )
    if loaded := [j.name for j in written.joints if j.dry is not None and j.dry.load is not None]:
        raise OptionError(
            f"tolerance: errors of the reactions are not estimated, on which friction depends in joint {loaded[0]}; "
            "leave it out"
        )
    from mbsgen.approximation.choice import approximate  # few models; it loads NumPy

    approximation = approximate(written, request.tolerance, request)
    return _Trees(written, parametric, approximation.tree, approximation)


def _gather(whole: Model, request: Request, approximation: Approximation | None) -> Evidence | None:
    if request.scene == EVERYTHING:
        return None
    from mbsgen.evidence import gather  # it loads NumPy

    return gather(whole, request, approximation)


def _make_unit(trees: _Trees, functions: Functions, verification: Verification, request: Request) -> Unit:
    tree, approximation = trees.generated, trees.approximation
    prefix = mangle(tree.name) if request.prefix is None else check_prefix(request.prefix)
    return Unit(
        prefix,
        __version__,
        _hash(tree, functions.families),
        functions.families,
        tuple(p.value for p in tree.parameters if p.kind is Kind.RUNTIME and functions.has_setup),
        design=tuple(p.value for p in tree.parameters if p.kind is Kind.DIFFERENTIATED),
        only_driven=not (tree.wrenches or tree.is_constrained)
        and all(body.joint.law == NO_FORCE for body in tree.bodies),
        groups=tuple(group for group in list_groups(tree) if group.name != "p" or functions.has_setup),
        tolerance=approximation.tolerance if approximation and approximation.taken else None,
        references=verification.references,
        headers=tuple(name for x in find_targets(request.targets) for name in x.headers(prefix)),
        widths=tuple(width for x in find_targets(request.targets) for width in x.widths),
    )


def _leave_precise_out(unit: Unit) -> Unit:
    return replace(unit, families=tuple(family for family in unit.families if not family.is_precise))


def _write_files(
    unit: Unit, sources: Sources, described: Manifest, report: Report, request: Request
) -> Mapping[str, str]:
    other = _leave_precise_out(unit)
    written = [target.write(other) for target in find_targets(request.targets)]
    return {
        **sources.files,
        manifest.FILE_NAME: manifest.write(described),
        "report.md": write_markdown(report),
        "report.json": write_json(report),
        **{path: text for files in written for path, text in files.items()},
    }


def read_tree(model: Path | Model) -> Tree:
    """Read a model file, or a file to import, as a Tree with closed loops. Raises InputError with every fault."""
    with _locating(model):
        return _assemble(build_tree(read(model)))


def _assemble(tree: Tree) -> Tree:
    """Assemble a tree, and say which equations of its loops are left out although they are not exactly redundant."""
    found = assemble(tree)
    name = abbreviate(tree.name)
    if (tree.loops or tree.constraints) and not (found.loops or found.constraints):
        text = f"{name}: its loops and constraints restrict no joint, and are left out"
        warnings.warn(text, ModelWarning, stacklevel=3)
    elif found.closure is not None and found.closure.distance:
        text = (
            f"{name}: within {found.closure.distance:.1e} (rad, or of the loop's size), these equations follow from "
            f"others: {', '.join(list_redundant(found))}. They are left out (degrees of freedom: "
            f"{len(found.closure.independent)}); `loop_tolerance: 0` keeps them"
        )
        warnings.warn(text, ModelWarning, stacklevel=3)
    return found


@contextmanager
def _locating(model: Path | Model) -> Iterator[None]:
    """Add to the faults of loops their lines in the model file."""
    try:
        yield
    except AssemblyError as error:
        if isinstance(model, Path) and not is_foreign(model):
            document = read_document(model)
            found = [(_find_place(x.place, document.data), x) for x in error.findings]
            raise refuse([document.fault(place, x.finding, x.remedy) for place, x in found]) from None
        file, data = str(model), dict[str, Any]()
        if isinstance(model, Model):
            file = f"model {abbreviate(model.name)}"
            data["loops"] = [{"name": x.name} for x in model.loops]
            data["constraints"] = [{"name": x.name} for x in model.constraints]
        found = [(_find_place(x.place, data), x) for x in error.findings]
        raise refuse([Fault(file, 0, write_path(place), x.finding, x.remedy) for place, x in found]) from None


def _find_place(place: Place, data: Any) -> Place:
    """Find in a valid model file the place of a loop or constraint that a finding names."""
    match place:
        case (("loops" | "constraints") as key, str(name), *rest):
            i = next((i for i, entry in enumerate(data.get(key, ())) if entry.get("name") == name), None)
            return place if i is None else (key, i, *rest)
    return place


def release(model: Model, scene: Scene, *, zeros: bool = False) -> Model:
    """Return the part of a model that a scene needs, with its numbers as run-time parameters."""
    return stage(with_runtime_numbers(apply_kinds(model, scene), zeros=zeros), scene)


def derive_equations(
    model: Path | Model, options: Options, parameters: Mapping[str, float], *, numbers: bool
) -> tuple[Equations, str]:
    """Derive the equations of motion that a call with the same options generates kernels of, and hash the mechanism.

    `parameters` replace values of the model. numbers: only parameters of the run time are symbols, else all of them.
    Equations whose sums would have thousands of terms are written in named intermediate values. Raises InputError with
    every fault of the file.
    """
    from mbsgen.equations import SizeError, build_numeric, build_symbolic, derive, derive_stepwise  # few need them

    whole = read(model)
    request = merge(options, _read_scene(options.scene, whole))
    staged = _stage(whole, request.scene, options.scene)
    shown = release(whole, request.scene, zeros=request.zeros) if request.runtime else staged
    present = (replace(p, value=Number(parameters[p.name])) if p.name in parameters else p for p in shown.parameters)
    shown = replace(shown, parameters=tuple(present))
    with _locating(model):
        tree = build_numeric(shown) if numbers else build_symbolic(shown)
    with without_searches():
        try:
            return derive(tree, _MOST), identify_mechanism(staged)
        except SizeError:
            return derive_stepwise(tree), identify_mechanism(staged)


_MOST = 2000  # terms of an equation on the way, beyond which it is written in intermediate values


def build_parametric(model: Model, scene: Scene = EVERYTHING, *, zeros: bool = False) -> Tree:
    """Build the tree of a model whose numbers are run-time parameters, as far as a scene needs them."""
    tree = build_tree(release(model, scene, zeros=zeros))
    own, used = {p.name for p in model.parameters if p.kind is Kind.RUNTIME}, tree.symbols
    needed = (p for p in tree.parameters if p.kind is not Kind.RUNTIME or p.name in own or p.symbol in used)
    return replace(tree, parameters=tuple(needed))


def read(model: Path | Model) -> Model:
    """Read a model file, or, by its suffix, a file to import. Raises InputError with every fault of the file.

    Python's warnings list the differences between an imported model and its file.
    """
    if isinstance(model, Model):
        return model
    if not is_foreign(model):
        return read_model(model)
    imported = import_model(model)
    for notice in imported.notices:
        if notice.alters:
            warnings.warn(str(notice), stacklevel=3)
    return imported.model


def convert(robot: Path, choices: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Return a file to import as the text of a model file, and warnings about a motion that differs.

    `choices` are fields of `Choices`. Raises InputError with all faults of the file, OptionError for a file of no
    format that is imported.
    """
    if not is_foreign(robot):
        options = "--base, --sensor, --lock, --lock-massless, --mimic and --loop-tolerance"
        raise OptionError(f"{robot}: {options} are for files of {list_formats()}")
    imported = import_model(robot, Choices(**choices))
    return write_imported(imported), tuple(str(notice) for notice in imported.notices if notice.alters)


def list_undrawn(robot: Path) -> tuple[str, ...]:
    """List the shapes of a file to import that pictures lack, each with its reason; none for a model file."""
    return tuple(str(x) for x in import_model(robot).notices if x.undrawn) if is_foreign(robot) else ()


def _read_scene(scene: Path | Scene, model: Model) -> Scene:
    return scene if isinstance(scene, Scene) else read_scene(scene, model, list_results())


def _stage(whole: Model, scene: Scene, origin: Path | Scene) -> Model:
    """Apply a scene to a model, and check the reduced model by the rules for models. Raises InputError."""
    staged = stage(whole, scene)
    if (staged.bodies, staged.parameters) == (whole.bodies, whole.parameters):
        return staged
    file = str(origin) if isinstance(origin, Path) else f"model {abbreviate(whole.name)}"
    faults = [
        Fault(file, 0, "", f"with this scene, {found.finding} (at {write_path(found.place)})", found.remedy)
        for found in find_faults(staged)
    ]
    if faults:
        raise refuse(faults)
    return staged


def _needs_stages_alone(request: Request) -> bool:
    """Return whether nothing asks for the straight form of a function in stages: the C does not."""
    return request.scene.motion and not (request.targets or request.scene.together)


def _hash(tree: Tree, families: tuple[Family, ...]) -> str:
    """Return a hash of the generated content: the tapes to their last digit, and the tree's entries in the manifest."""
    told = [(b.name, b.parent, b.joint) for b in tree.bodies], [(s.name, s.body) for s in tree.sensors], tree.wrenches
    text = repr(tree.couplings) if tree.couplings else ""
    text += repr(more) if any(more := [x.more for x in tree.couplings]) else ""
    text += repr((tree.loops, tree.constraints, tree.driven, tree.closure)) if tree.is_constrained else ""
    text += repr(tree.signals) if tree.signals else ""
    text += repr((tree.name, told, [(p.name, p.value, p.kind) for p in tree.parameters]))
    bounds = [(j.max_speed, j.max_force) for j in (b.joint for b in tree.bodies)]
    text += repr(bounds) if any(map(any, bounds)) else ""
    ends = [(j.stops, j.dry) for j in (b.joint for b in tree.bodies)]
    text += repr(ends) if any(map(any, ends)) else ""
    loads = [None if dry is None else dry.load for _, dry in ends]
    text += repr(loads) if any(loads) else ""
    written = [function for family in families for function in family.functions]
    tapes = [_content(function) for function in written]
    return hashlib.sha256(f"{text}{tapes!r}".encode()).hexdigest()


def _content(function: Computation) -> tuple[object, ...]:
    """Return what makes two functions the same."""
    if isinstance(function, Procedure):
        return function.name, function.inputs, function.stages, function.outputs
    return function.name, function.inputs, function.literals, function.operations, function.outputs, function.guards


def identify_mechanism(model: Model) -> str:
    """Return a hash of a mechanism: layout, comments, visuals and this program's version do not matter."""
    bare = replace(model, bodies=tuple(replace(body, visuals=()) for body in model.bodies))
    return hashlib.sha256(write_model(bare).encode()).hexdigest()


def _describe_rigid(name: str, point: Rigid | Barrier) -> RigidPoint:
    found = RigidPoint(name=name, restitution=point.restitution, coefficient=point.coefficient)
    if not isinstance(point, Barrier):
        return found
    return found.model_copy(update={"is_stop": True, "hold": point.hold, "is_coupling": point.is_coupling})


def _list_parameters(tree: Tree, kind: Kind) -> tuple[Parameter, ...]:
    return tuple(Parameter(name=p.name, value=p.value) for p in tree.parameters if p.kind is kind)


def _describe(tree: Tree, unit: Unit, sources: Sources, staged: Model, shown: Model) -> Manifest:
    joints = tree.joints
    frames, loops = tuple(_describe_frame(tree, i) for i in range(1, len(tree.bodies) + 1)), _describe_loops(tree)
    return Manifest(
        format=manifest.FORMAT,
        generator=f"mbsgen {__version__}",
        model=tree.name,
        prefix=unit.prefix,
        symbols=unit.own,
        model_hash=unit.model_hash,
        mechanism=identify_mechanism(staged),
        header=sources.header,
        sources=sources.sources,
        coordinates=tuple(
            Coordinate(
                name=j.name,
                motion=j.motion.value,
                actuated=j.actuated,
                lower=j.lower,
                upper=j.upper,
                max_speed=j.max_speed,
                max_force=j.max_force,
                stops=None if j.stops is None else Stops(**asdict(j.stops)),
                friction=None if j.dry is None else _describe_friction(j.dry),
            )
            for j in joints
        ),
        configuration=tree.coordinates if tree.quaternions else (),
        quaternions=tuple(tree.coordinates.index(x.coordinates[-4]) for x in tree.quaternions),
        parameters=_list_parameters(tree, Kind.RUNTIME),
        design=_list_parameters(tree, Kind.DIFFERENTIATED),
        frames=frames + tuple(Frame(name=s.name, parent=s.body - 1, sensor=True) for s in tree.sensors),
        wrenches=tuple(
            Wrench(name=x.name, frame=x.body - 1, in_base=x.in_base, force=x.force is None, moment=x.moment is None)
            for x in tree.wrenches
            if x.force is None or x.moment is None
        ),
        signals=tree.signals,
        contacts=tuple(x.name for x in tree.distances),
        rigid=tuple(_describe_rigid(name, point) for name, point in tree.rigid),
        meetings=tuple(map(_describe_meeting, tree.meetings)),
        elements=tree.elements,
        lengths=tuple(x.length.label for x in tree.definitions if x.length is not None),
        loops=loops,
        independent=tree.closure.independent if tree.closure else (),
        dependent=tree.closure.dependent if tree.closure else (),
        pose=tree.closure.pose if tree.closure else (),
        driven=tuple(joints.index(tree.bodies[number - 1].joint) for number in tree.driven),
        appearance=describe_appearance(shown, tree),
        formulas=write_formulas(shown, _list_points(tree, frames)),
        kernels=sources.kernels,
        tolerance=unit.tolerance,
    )


def _describe_meeting(pair: Meeting) -> RigidPair:
    first, other = (Solid(points=x.points, radius=x.radius) for x in (pair.first, pair.other))
    return RigidPair(
        name=pair.name, first=first, other=other, restitution=pair.restitution, coefficient=pair.coefficient
    )


def _describe_friction(dry: DryFriction) -> Friction:
    load = None if dry.load is None else BearingLoad(**asdict(dry.load))
    return Friction(**{**asdict(dry), "load": load})


def _describe_loops(tree: Tree) -> tuple[Loop, ...]:
    """Describe loops, then constraints."""
    if tree.closure is None:
        return ()
    every = list(enumerate(list_equations(tree)))

    def name(number: int, *, is_kept: bool) -> tuple[str, ...]:
        kept = tree.closure.kept if tree.closure else ()
        return tuple(x for i, (own, x) in every if own == number and (i in kept) is is_kept)

    loops = [
        Loop(
            name=loop.name,
            cut=loop.cut.value,
            first=loop.first.body - 1,
            second=loop.second.body - 1,
            first_point=_locate(tree, loop.first.body, loop.first.position),
            second_point=_locate(tree, loop.second.body, loop.second.position),
            equations=name(k, is_kept=True),
            redundant=name(k, is_kept=False),
        )
        for k, loop in enumerate(tree.loops)
    ]
    return (
        *loops,
        *(
            Loop(name=x.name, cut="constraint", equations=name(k, is_kept=True), redundant=name(k, is_kept=False))
            for k, x in enumerate(tree.constraints, len(loops))
        ),
    )


def _describe_frame(tree: Tree, i: int) -> Frame:
    """Describe the frame of a body, with the centre of mass of a body that carries nothing, at the model's numbers."""
    body = tree.bodies[i - 1]
    ends = {end.body for loop in tree.loops for end in (loop.first, loop.second)}
    carries = bool(tree.children(i)) or any(s.body == i for s in tree.sensors) or i in ends
    place = _locate(tree, i, body.com) if not carries and body.mass != 0 else (0.0, 0.0, 0.0)
    slides, com = body.joint.motion is Motion.PRISMATIC, place if any(place) else None
    return Frame(name=body.name, parent=body.parent - 1, sensor=False, slides=slides, com=com)


def _list_points(tree: Tree, frames: Sequence[Frame]) -> dict[tuple[str | int, ...], Vector]:
    """List the points of frames and loops in the manifest, over parameters that a use may change."""
    fixed = {p.symbol: exact(p.value) for p in tree.parameters if p.kind is Kind.CONSTANT}
    places: dict[tuple[str | int, ...], tuple[int, Vector]] = {}
    places |= {("frames", i, "com"): (i + 1, tree.bodies[i].com) for i, x in enumerate(frames) if x.com is not None}
    for k, loop in enumerate(tree.loops):
        for key, end in (("first_point", loop.first), ("second_point", loop.second)):
            places["loops", k, key] = end.body, end.position
    return {place: _settle(tree, *point, fixed) for place, point in places.items()}


def _locate(tree: Tree, number: int, point: Vector) -> tuple[float, float, float]:
    """Return a point of a body in the axes that its author gave it, at the model's numbers [m]."""
    x, y, z = map(to_double, _settle(tree, number, point, {p.symbol: exact(p.value) for p in tree.parameters}))
    return x, y, z


def _settle(tree: Tree, number: int, point: Vector, values: Mapping[Symbol, Expr]) -> Vector:
    """Return a point of a body in the axes that its author gave it, with numbers for some symbols [m]."""
    axes = tree.bodies[number - 1].axes if number else IDENTITY
    x, y, z = (total(axes[r][c] * point[r] for r in range(3)).xreplace(values) for c in range(3))
    return x, y, z


def read_numbers(model: Path | Model, parameters: Mapping[str, float]) -> Numbers:
    """Read the numbers of a model that can be identified. Raises InputError with every fault of the file."""
    return renumbering.read_numbers(read(model), parameters)


def change_numbers(model: Path | Model, changes: Changes, remarks: Sequence[str]) -> str:
    """Return a model with other numbers as the text of a model file, after remarks as comments, one a line.

    Raises InputError where the changed model is none.
    """
    changed = renumbering.change_numbers(read(model), changes)
    faults = [
        Fault(f"model {abbreviate(changed.name)}", 0, write_path(x.place), x.finding, x.remedy)
        for x in find_faults(changed)
    ]
    if faults:
        raise refuse(faults)
    return "".join(f"# {line}".rstrip() + "\n" for line in remarks) + ("\n" if remarks else "") + write_model(changed)


def read_subject(path: Path) -> Subject:
    """Read settings of a scaling, or the setup of OpenSim's ScaleTool. Raises InputError with every fault."""
    from mbsgen.subjects.reading import read_subject

    return read_subject(path)


def scale_subject(subject: Subject, distances: Mapping[tuple[str, str], float]) -> Scaled:
    """Scale a model by settings and measured distances of pairs of markers [m]. Raises InputError."""
    from mbsgen.subjects.scaling import scale_subject

    return scale_subject(subject, distances)


def place_markers(subject: Subject, scaled: Scaled, joints: Mapping[str, float], places: Mapping[str, Any]) -> Scaled:
    """Move markers to places in the base, (3,) [m], at a pose of joints."""
    from mbsgen.subjects.scaling import place_markers

    return place_markers(subject, scaled, joints, places)
