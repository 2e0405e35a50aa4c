"""Families: the requested functions of a tree, each with its derivatives, as tapes.

Operations on run-time parameters alone are split off as `setup`. The parts of a scene that concern functions are
applied here.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import differentiable, differentiate
from mbsgen.errors import MbsError
from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS, REFERENCE, Entry, list_giving, refuse, select_functions
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.scene import EVERYTHING, Scene
from mbsgen.model.tree import Kind, Tree
from mbsgen.procedure.procedure import Computation, Procedure, straight
from mbsgen.procedure.splitting import hoist
from mbsgen.roles import Order, Role
from mbsgen.tape.counts import count
from mbsgen.tape.passes import keep_results, merge, set_zero
from mbsgen.tape.ports import Function, is_of
from mbsgen.tape.types import Tape
from mbsgen.targets import acados
from mbsgen.targets.contract import Family


@dataclass(frozen=True)
class Options:
    """The outputs to generate, besides the C of every function."""

    runtime: bool = False  # every number of the model a run-time parameter, see `model.releasing`
    zeros: bool = False  # with `runtime`: also numbers that are 0
    python: bool = False  # also the Python target
    matlab: bool = False  # also the Matlab target
    acados: bool = False  # also the functions for acados, under its names
    untimed: bool = False  # without the argument t of implicit functions, for acados before 0.3
    compare: bool = False  # also count the formulations without each reduction
    functions: tuple[str, ...] | None = None  # of the catalogue; None: the scene's
    derivatives: int = 2  # the highest order; the scene may lower it
    scene: Path | Scene = EVERYTHING  # the part of the model to generate
    tolerance: float | None = None  # allowed relative error; None: the scene's
    reductions: Reductions = ALL  # the transformations that lower the operation count


DEFAULT = Options()


class OptionError(MbsError):
    """Options that a model cannot be generated with."""


Tell = Callable[[str], None]  # called with the name of each stage that begins


def say_nothing(_: str) -> None:
    """Ignore the name of a stage."""


def write_families(
    tree: Tree,
    options: Options = DEFAULT,
    dynamics: Dynamics | None = None,
    scene: Scene = EVERYTHING,
    tell: Tell = say_nothing,
) -> tuple[Family, ...]:
    """Write functions of a tree with their derivatives; operations on parameters alone are split off as `setup`.

    `dynamics` writes the derivatives of the formulations, and holds their flops afterwards. Of the scene, only the
    choice of functions is used here; `stage` has applied the rest to the tree.
    """
    families: list[Family] = []
    dynamics = dynamics or Dynamics(tree, options.reductions)
    chosen = _choose(options, scene)
    read = dict(scene.results)
    for name, entry in _choose_functions(tree, _list_needed(chosen, scene)).items():
        tell(name)
        tape = entry.build(tree, options.reductions)
        assert tape.name == name, "the catalogue calls a tape by its own name"
        tape = keep_results(tape, read[name]) if name in read else tape
        order = min(entry.order, options.derivatives, scene.derivatives)
        if not order:
            families.append(Family(tape, title=entry.title))
            continue
        tell(f"{name} and its derivatives")
        found = dynamics.differentiate(tape) if entry.is_form else differentiate(tape, differentiable(tape))
        second = found.jac_adj1 if order > 1 else None
        staged = found.staged
        families.append(Family(tape, found.jac, found.adj1, second, entry.title, staged))
        families.append(Family(found.lin, title=f"{entry.title}, with its Jacobians", staged=staged))
    families = _finish(families, scene, chosen)
    if options.acados and tree.quaternions:
        raise OptionError("acados: its states are q and qd, of one size; a joint with a quaternion has more of the one")
    special = (
        _write_acados(families, timed=not options.untimed) if options.acados else ()
    )  # its functions have acados' own parameters
    if any(p.kind is Kind.RUNTIME for p in tree.parameters):
        return (*_split_setup(families), *special)
    return (*families, *special)


def list_functions(tree: Tree, options: Options, scene: Scene) -> tuple[str, ...]:
    """List the functions of the catalogue that are written. Raises OptionError for unknown names."""
    return tuple(_choose_functions(tree, _list_needed(_choose(options, scene), scene)))


def _choose(options: Options, scene: Scene) -> tuple[str, ...] | None:
    return options.functions if options.functions is not None else scene.functions


def _list_needed(chosen: Sequence[str] | None, scene: Scene) -> tuple[str, ...] | None:
    """List the chosen functions, and the parts of joined ones; None: all."""
    parts = [part for _, group in scene.together for part in group]
    return None if chosen is None else tuple(dict.fromkeys((*chosen, *parts)))


def _finish(families: Sequence[Family], scene: Scene, chosen: Sequence[str] | None) -> list[Family]:
    """Set velocities at rest to zero, join functions of one state, and drop functions that only joining needed."""
    still = families if scene.motion else [_let_rest(family) for family in families]
    by_name = {family.value.name: family for family in still}
    joined = []
    for name, parts in scene.together:
        members = [by_name[part] for part in parts]
        jacs = [straight(family.jac) for family in members if family.jac is not None]
        function = Function(name)
        value = merge([straight(family.value) for family in members], function)
        jac = merge(jacs, function.to(Order.JACOBIAN)) if jacs else None
        joined.append(Family(value, jac, title=" and ".join(parts)))
    kept = [f for f in still if chosen is None or f.value.function.base in chosen]
    return [*kept, *joined]


def _let_rest(family: Family) -> Family:
    """Replace the velocities by zeros; drop derivatives by them."""

    def rest(function: Computation | None) -> Tape | None:
        if function is None:
            return None
        tape = straight(function)
        kept = {o.name for o in tape.outputs if not is_of(o.port, Role.VELOCITY)}
        return set_zero(keep_results(tape, kept), Role.VELOCITY)

    value = rest(family.value)
    assert value is not None, "a family has a value"
    jac, adj1, jac_adj1 = rest(family.jac), rest(family.adj1), rest(family.jac_adj1)
    return replace(family, value=value, jac=jac, adj1=adj1, jac_adj1=jac_adj1, staged={})


def _write_acados(families: Sequence[Family], *, timed: bool) -> tuple[Family, ...]:
    tapes = {tape.function: tape for family in families for tape in family.tapes}
    known = [Function(name) for name in list_giving(Role.ACCELERATION)]
    explicit = [function for function in known if function in tapes]
    residual = Function(REFERENCE)
    if residual not in tapes and not explicit:
        forms = " or ".join(function.name for function in known)
        raise OptionError(f"acados: its functions are made of {residual.name}, {forms}; name one")

    def measure(function: Function) -> int:
        return count(tapes.get(function.to(Order.LINEARISATION), tapes[function])).paper

    return acados.write_acados(tapes, residual, min(explicit, key=measure, default=None), timed=timed)


def _choose_functions(tree: Tree, names: tuple[str, ...] | None) -> Mapping[str, Entry]:
    """Choose functions by name, in the order of the catalogue; report all faulty names together."""
    present = select_functions(tree)
    if names is None:
        return present
    faults = [] if names else [f"no function is named; there are {', '.join(present)}"]
    for name in dict.fromkeys(names):
        if name in FUNCTIONS and name not in present:
            faults.append(refuse(name, tree))
        elif name not in FUNCTIONS:
            near = difflib.get_close_matches(name, present, 1)
            remedy = f"is {near[0]} meant?" if near else f"there are {', '.join(present)}"
            faults.append(f"there is no function {name!r}; {remedy}")
    if faults:
        raise OptionError("\n".join(f"functions: {fault}" for fault in faults))
    return {name: entry for name, entry in present.items() if name in names}


def _split_setup(families: list[Family]) -> tuple[Family, ...]:
    functions = [f for family in families for f in family.functions]
    staged = [p for family in families for p in (*family.functions, *family.staged.values())]
    procedures = {p.name: p for p in staged if isinstance(p, Procedure)}
    whole: list[Computation] = [*(f for f in functions if isinstance(f, Tape)), *procedures.values()]
    setup, hoisted = hoist(whole, ports.PARAMETERS, ports.SETUP)
    tapes = {f.name: f for f in hoisted if isinstance(f, Tape)}
    rest = {f.name: f for f in hoisted if isinstance(f, Procedure)}

    def find(function: Computation) -> Computation:
        return tapes[function.name] if isinstance(function, Tape) else rest[function.name]

    split = [
        replace(
            f,
            value=find(f.value),
            jac=f.jac and find(f.jac),
            adj1=f.adj1 and find(f.adj1),
            jac_adj1=f.jac_adj1 and find(f.jac_adj1),
            staged={name: rest[name] for name in f.staged},
        )
        for f in families
    ]
    if not setup.output(ports.SETUP.name).sparsity.nnz:  # no chosen function depends on the parameters
        return tuple(split)
    return (Family(setup, title="what the kernels need of the run-time parameters"), *split)
