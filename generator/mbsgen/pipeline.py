"""The pipeline: model.yaml or Model -> Tree -> tapes -> derivatives -> setup split off -> C, manifest, report."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mbsgen import __version__, manifest
from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import differentiable, differentiate
from mbsgen.errors import MbsError
from mbsgen.formulations.catalogue import FUNCTIONS, MEANINGS, SETUP, Entry, select_functions
from mbsgen.formulations.links import PARAMETERS
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.manifest import Coordinate, Frame, Manifest, Parameter, Wrench
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.reduction import build_tree, with_runtime_numbers
from mbsgen.model.tree import NO_FORCE, Kind, Tree
from mbsgen.output import write_folder
from mbsgen.report import Report, make_report, write_json, write_markdown
from mbsgen.tape.counts import count
from mbsgen.tape.passes import hoist
from mbsgen.tape.types import Tape
from mbsgen.targets import acados
from mbsgen.targets.c import Sources, Unit, write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.matlab import write_matlab
from mbsgen.targets.names import mangle
from mbsgen.targets.python import write_python


@dataclass(frozen=True)
class Options:
    """What to generate, besides the C of every function."""

    runtime: bool = False  # every number of the model a run-time parameter
    python: bool = False  # also the Python target
    matlab: bool = False  # also the Matlab target
    acados: bool = False  # also the functions that acados asks for, under its names
    compare: bool = False  # also count the formulations without each reduction
    functions: tuple[str, ...] | None = None  # which functions of the catalogue; None: all that the model has
    derivatives: int = 2  # up to which order
    reductions: Reductions = ALL  # what is done to lower the operation count


@dataclass(frozen=True)
class Product:
    """All that is made of one model; nothing is written yet."""

    manifest: Manifest
    report: Report
    files: Mapping[str, str]  # path in the folder -> text


class OptionError(MbsError):
    """Options that a model cannot be generated with."""


def generate(model: Path | Model, out: Path, options: Options = Options()) -> Product:
    """Make everything of a model, and write it to the folder `out`. Where `make` raises, nothing is written."""
    product = make(model, options)
    write_folder(product.files, out)
    return product


def make(model: Path | Model, options: Options = Options()) -> Product:
    """Make everything of a model file, or of a model made in Python.

    Raises InputError with every fault of the file, OptionError for functions that there are not.
    """
    written = read_tree(model)
    parametric = with_runtime_numbers(written)
    tree = parametric if options.runtime else written
    dynamics = Dynamics(tree, options.reductions)
    families = write_families(tree, options, dynamics)
    unit = Unit(
        mangle(tree.name),
        __version__,
        _hash(tree, families),
        families,
        tuple(p.value for p in tree.parameters if p.kind is Kind.RUNTIME and families[0].value.name == "setup"),
        design=tuple(p.value for p in tree.parameters if p.kind is Kind.DIFFERENTIATED),
        only_driven=not tree.wrenches and all(body.joint.law == NO_FORCE for body in tree.bodies),
    )
    sources = write_c(unit)
    described = _describe(tree, unit, sources)
    report = make_report(written, parametric, described.kernels, dynamics.flops, compare=options.compare)
    files = {
        **sources.files,
        manifest.FILE_NAME: described.model_dump_json(indent=2) + "\n",
        "report.md": write_markdown(report),
        "report.json": write_json(report),
    }
    if options.python:
        files[f"{unit.prefix}.py"] = write_python(unit)
    if options.matlab:
        files |= write_matlab(unit)
    return Product(described, report, files)


def read_tree(model: Path | Model) -> Tree:
    """Read a model file as a Tree. Raises InputError with every fault of the file."""
    return build_tree(model if isinstance(model, Model) else read_model(model))


def write_families(tree: Tree, options: Options = Options(), dynamics: Dynamics | None = None) -> tuple[Family, ...]:
    """Write functions of a tree with their derivatives; what depends on parameters alone is split off as `setup`.

    `dynamics` writes those of the formulations, and can tell afterwards what each way of writing them takes.
    """
    families: list[Family] = []
    dynamics = dynamics or Dynamics(tree, options.reductions)
    for name, entry in _choose_functions(tree, options.functions).items():
        tape = entry.build(tree, options.reductions)
        assert tape.name == name, "the catalogue calls a tape by its own name"
        if not (entry.differentiated and options.derivatives):
            families.append(Family(tape, title=entry.title, meanings=MEANINGS))
            continue
        found = dynamics.differentiate(tape) if entry.of_dynamics else differentiate(tape, differentiable(tape))
        second = found.jac_adj1 if options.derivatives > 1 else None
        families.append(Family(tape, found.jac, found.adj1, second, title=entry.title, meanings=MEANINGS))
        families.append(Family(found.lin, title=f"{entry.title}, with its Jacobians", meanings=MEANINGS))
    special = _write_acados(families) if options.acados else ()  # whose parameters are acados' own
    if any(p.kind is Kind.RUNTIME for p in tree.parameters):
        return (*_split_setup(families), *special)
    return (*families, *special)


def _write_acados(families: Sequence[Family]) -> tuple[Family, ...]:
    tapes = {tape.name: tape for family in families for tape in family.tapes}
    explicit = [name for name in acados.EXPLICIT if name in tapes]
    if acados.RESIDUAL not in tapes and not explicit:
        raise OptionError(
            f"acados: its functions are made of {acados.RESIDUAL}, {' or '.join(acados.EXPLICIT)}; name one"
        )
    cheapest = min(explicit, key=lambda name: count(tapes.get(f"lin_{name}", tapes[name])).paper, default="")
    return acados.write_acados(tapes, cheapest)


def _choose_functions(tree: Tree, names: tuple[str, ...] | None) -> Mapping[str, Entry]:
    """Choose functions by name, in the order of the catalogue; all that is wrong with the names is told at once."""
    present = select_functions(tree)
    if names is None:
        return present
    faults = [] if names else [f"no function is named; there are {', '.join(present)}"]
    for name in dict.fromkeys(names):
        if name in FUNCTIONS and name not in present:
            faults.append(f"{name} is of sensors, and {tree.name} has none; name some under `frames:`")
        elif name not in FUNCTIONS:
            near = difflib.get_close_matches(name, present, 1)
            remedy = f"is {near[0]} meant?" if near else f"there are {', '.join(present)}"
            faults.append(f"there is no function {name!r}; {remedy}")
    if faults:
        raise OptionError("\n".join(f"functions: {fault}" for fault in faults))
    return {name: entry for name, entry in present.items() if name in names}


def _split_setup(families: list[Family]) -> tuple[Family, ...]:
    setup, hoisted = hoist([tape for family in families for tape in family.tapes], PARAMETERS, SETUP)
    rest = {tape.name: tape for tape in hoisted}

    def found(tape: Tape | None) -> Tape | None:
        return tape and rest[tape.name]

    split = [
        replace(f, value=rest[f.value.name], jac=found(f.jac), adj1=found(f.adj1), jac_adj1=found(f.jac_adj1))
        for f in families
    ]
    if not setup.output(SETUP).sparsity.nnz:  # parameters matter to none of the functions chosen
        return tuple(split)
    return (Family(setup, title="what the kernels need of the run-time parameters", meanings=MEANINGS), *split)


def _hash(tree: Tree, families: tuple[Family, ...]) -> str:
    """Name what is generated by its content: the tapes to their last digit, and what the manifest tells of the tree."""
    told = [(b.name, b.parent, b.joint) for b in tree.bodies], [(s.name, s.body) for s in tree.sensors], tree.wrenches
    text = repr((tree.name, told, [(p.name, p.value, p.kind) for p in tree.parameters]))
    tapes = [(t.name, t.inputs, t.literals, t.operations, t.outputs, t.guards) for f in families for t in f.tapes]
    return hashlib.sha256(f"{text}{tapes!r}".encode()).hexdigest()


def _list_parameters(tree: Tree, kind: Kind) -> tuple[Parameter, ...]:
    return tuple(Parameter(name=p.name, value=p.value) for p in tree.parameters if p.kind is kind)


def _describe(tree: Tree, unit: Unit, sources: Sources) -> Manifest:
    joints = [body.joint for body in tree.bodies]
    return Manifest(
        format=manifest.FORMAT,
        generator=f"mbsgen {__version__}",
        model=tree.name,
        prefix=unit.prefix,
        model_hash=unit.model_hash,
        header=sources.header,
        sources=sources.sources,
        coordinates=tuple(
            Coordinate(name=j.name, motion=j.motion.value, actuated=j.actuated, lower=j.lower, upper=j.upper)
            for j in joints
        ),
        parameters=_list_parameters(tree, Kind.RUNTIME),
        design=_list_parameters(tree, Kind.DIFFERENTIATED),
        frames=tuple(Frame(name=b.name, parent=b.parent - 1, sensor=False) for b in tree.bodies)
        + tuple(Frame(name=s.name, parent=s.body - 1, sensor=True) for s in tree.sensors),
        wrenches=tuple(
            Wrench(name=x.name, frame=x.body - 1, in_base=x.in_base, force=x.force is None, moment=x.moment is None)
            for x in tree.wrenches
            if x.force is None or x.moment is None
        ),
        kernels=sources.kernels,
    )
