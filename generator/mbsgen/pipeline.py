"""The pipeline: model.yaml or Model -> Tree -> tapes, derivatives, setup -> verification -> C, manifest, report."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mbsgen import __version__, manifest
from mbsgen.approximation.choice import Approximation, approximate
from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.documents import abbreviate, refuse, write_path
from mbsgen.errors import Fault
from mbsgen.evidence import gather
from mbsgen.families import DEFAULT, OptionError, Options, Tell, say_nothing, write_families
from mbsgen.formulations.catalogue import list_results
from mbsgen.importing import import_model, is_foreign
from mbsgen.manifest import Coordinate, Frame, Manifest, Parameter, Wrench
from mbsgen.model.checks import find_faults
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.reduction import build_tree
from mbsgen.model.releasing import with_runtime_numbers
from mbsgen.model.scene import EVERYTHING, LARGEST_TOLERANCE, Scene, read_scene, stage
from mbsgen.model.symbols import exact, to_double
from mbsgen.model.tree import NO_FORCE, Kind, Motion, Tree
from mbsgen.model.writer import write_model
from mbsgen.output import write_folder
from mbsgen.procedure.procedure import Computation, Procedure
from mbsgen.report import Report, make_report, write_json, write_markdown
from mbsgen.roles import Role
from mbsgen.targets.c import Sources, write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.entries import list_groups
from mbsgen.targets.matlab import write_matlab
from mbsgen.targets.names import mangle
from mbsgen.targets.python import write_python
from mbsgen.targets.unit import Unit
from mbsgen.verification.verify import verify

__all__ = ["OptionError", "Options", "Product", "generate", "make", "read_tree", "write_families"]


@dataclass(frozen=True)
class Product:
    """Everything made from one model; nothing is written yet."""

    manifest: Manifest
    report: Report
    files: Mapping[str, str]  # path in the folder -> text


def generate(model: Path | Model, out: Path, options: Options = DEFAULT, tell: Tell = say_nothing) -> Product:
    """Make everything from a model, and write it to the folder `out`. Where `make` raises, nothing is written."""
    product = make(model, options, tell)
    write_folder(product.files, out)
    return product


def make(model: Path | Model, options: Options = DEFAULT, tell: Tell = say_nothing) -> Product:
    """Make everything from a model file, or from a model made in Python.

    `tell` is called with the name of each stage when it begins. Raises InputError with every fault of the file,
    OptionError for unknown functions, VerificationError for a function with wrong results.
    """
    tell("reading the model")
    whole = read(model)
    if options.zeros and not options.runtime:
        raise OptionError("zeros: they are parameters only with the other numbers; give runtime too")
    scene = _read_scene(options, whole)
    staged = stage(whole, scene)
    _check_staged(whole, staged, options)
    written = build_tree(staged)
    parametric = build_parametric(whole, scene)  # zeros stay: the report counts so, independently of the options
    released = build_parametric(whole, scene, zeros=True) if options.zeros else parametric
    approximation = _approximate(written, options, scene)
    tree = approximation.tree if approximation else released if options.runtime else written
    dynamics = Dynamics(tree, options.reductions, staged=_needs_stages_alone(options, scene))
    families = write_families(tree, options, dynamics, scene, tell)
    has_setup = families[0].value.giving(Role.SETUP) is not None
    tell("the check of all functions")
    verification = verify(tree, families, still=not scene.motion)
    unit = Unit(
        mangle(tree.name),
        __version__,
        _hash(tree, families),
        families,
        tuple(p.value for p in tree.parameters if p.kind is Kind.RUNTIME and has_setup),
        design=tuple(p.value for p in tree.parameters if p.kind is Kind.DIFFERENTIATED),
        only_driven=not tree.wrenches and all(body.joint.law == NO_FORCE for body in tree.bodies),
        groups=tuple(group for group in list_groups(tree) if group.name != "p" or has_setup),
        tolerance=scene.tolerance if approximation and approximation.taken else None,
        references=verification.references,
    )
    tell("C")
    sources = write_c(unit)
    described = _describe(tree, unit, sources, identify_mechanism(staged))
    evidence = None if scene == EVERYTHING else gather(whole, scene, options, approximation)
    tell("the report")
    report = make_report(
        written, parametric, described.kernels, dynamics.flops, verification, evidence, compare=options.compare
    )
    files = {
        **sources.files,
        manifest.FILE_NAME: manifest.write(described),
        "report.md": write_markdown(report),
        "report.json": write_json(report),
    }
    if options.python:
        files[f"{unit.prefix}.py"] = write_python(unit)
    if options.matlab:
        files |= write_matlab(unit)
    return Product(described, report, files)


def read_tree(model: Path | Model) -> Tree:
    """Read a model file, or a file to import, as a Tree. Raises InputError with every fault of the file."""
    return build_tree(read(model))


def build_parametric(model: Model, scene: Scene = EVERYTHING, *, zeros: bool = False) -> Tree:
    """Build the tree of a model whose numbers are run-time parameters, as far as a scene needs them."""
    tree = build_tree(stage(with_runtime_numbers(model, zeros=zeros), scene))
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


def _read_scene(options: Options, model: Model) -> Scene:
    scene = options.scene
    if not isinstance(scene, Scene):
        scene = read_scene(scene, model, list_results())
    tolerance = scene.tolerance if options.tolerance is None else options.tolerance
    if not 0 <= (tolerance or 0) <= LARGEST_TOLERANCE:
        raise OptionError(f"tolerance: {tolerance} is no relative error; give a number from 0 to {LARGEST_TOLERANCE}")
    return replace(scene, tolerance=tolerance or None)


def _check_staged(whole: Model, staged: Model, options: Options) -> None:
    """Check a model reduced by a scene by the rules for models. Raises InputError."""
    if (staged.bodies, staged.parameters) == (whole.bodies, whole.parameters):
        return
    file = str(options.scene) if isinstance(options.scene, Path) else f"model {abbreviate(whole.name)}"
    faults = [
        Fault(file, 0, "", f"with this scene, {found.finding} (at {write_path(found.place)})", found.remedy)
        for found in find_faults(staged)
    ]
    if faults:
        raise refuse(faults)


def _approximate(tree: Tree, options: Options, scene: Scene) -> Approximation | None:
    """Remove numbers with effects below the scene's tolerance, if it has one."""
    if scene.tolerance is None:
        return None
    if options.runtime:
        finding = "with every number a run-time parameter, no value decides what can be left out"
        raise OptionError(f"tolerance: {finding}; leave one of the options out")
    return approximate(tree, scene.tolerance, options, scene)


def _needs_stages_alone(options: Options, scene: Scene) -> bool:
    """Return whether nothing asks for the straight form of a function in stages: the C does not."""
    return scene.motion and not (options.python or options.matlab or options.acados or scene.together)


def _hash(tree: Tree, families: tuple[Family, ...]) -> str:
    """Return a hash of the generated content: the tapes to their last digit, and the tree's entries in the manifest."""
    told = [(b.name, b.parent, b.joint) for b in tree.bodies], [(s.name, s.body) for s in tree.sensors], tree.wrenches
    text = repr(tree.couplings) if tree.couplings else ""
    text += repr((tree.name, told, [(p.name, p.value, p.kind) for p in tree.parameters]))
    bounds = [(j.max_speed, j.max_force) for j in (b.joint for b in tree.bodies)]
    text += repr(bounds) if any(map(any, bounds)) else ""
    written = [function for family in families for function in family.functions]
    tapes = [_content(function) for function in written]
    return hashlib.sha256(f"{text}{tapes!r}".encode()).hexdigest()


def _content(function: Computation) -> tuple[object, ...]:
    """Return what makes two functions the same."""
    if isinstance(function, Procedure):
        return function.name, function.inputs, function.stages, function.outputs
    return function.name, function.inputs, function.literals, function.operations, function.outputs, function.guards


def identify_mechanism(model: Model) -> str:
    """Return a hash of a model's content: layout, comments, order of keys, and this program's version do not matter."""
    return hashlib.sha256(write_model(model).encode()).hexdigest()


def _list_parameters(tree: Tree, kind: Kind) -> tuple[Parameter, ...]:
    return tuple(Parameter(name=p.name, value=p.value) for p in tree.parameters if p.kind is kind)


def _describe(tree: Tree, unit: Unit, sources: Sources, mechanism: str) -> Manifest:
    joints = tree.joints
    return Manifest(
        format=manifest.FORMAT,
        generator=f"mbsgen {__version__}",
        model=tree.name,
        prefix=unit.prefix,
        model_hash=unit.model_hash,
        mechanism=mechanism,
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
            )
            for j in joints
        ),
        configuration=tree.coordinates if tree.quaternions else (),
        quaternions=tuple(tree.coordinates.index(x.coordinates[-4]) for x in tree.quaternions),
        parameters=_list_parameters(tree, Kind.RUNTIME),
        design=_list_parameters(tree, Kind.DIFFERENTIATED),
        frames=tuple(_describe_frame(tree, i) for i in range(1, len(tree.bodies) + 1))
        + tuple(Frame(name=s.name, parent=s.body - 1, sensor=True) for s in tree.sensors),
        wrenches=tuple(
            Wrench(name=x.name, frame=x.body - 1, in_base=x.in_base, force=x.force is None, moment=x.moment is None)
            for x in tree.wrenches
            if x.force is None or x.moment is None
        ),
        kernels=sources.kernels,
        tolerance=unit.tolerance,
    )


def _describe_frame(tree: Tree, i: int) -> Frame:
    """Describe the frame of a body, with the centre of mass of a body that carries nothing, at the model's numbers."""
    body = tree.bodies[i - 1]
    values = {p.symbol: exact(p.value) for p in tree.parameters}
    carries = bool(tree.children(i)) or any(s.body == i for s in tree.sensors)
    x, y, z = (0.0 if carries or body.mass == 0 else to_double(number.xreplace(values)) for number in body.com)
    slides, com = body.joint.motion is Motion.PRISMATIC, (x, y, z) if (x, y, z) != (0, 0, 0) else None
    return Frame(name=body.name, parent=body.parent - 1, sensor=False, slides=slides, com=com)
