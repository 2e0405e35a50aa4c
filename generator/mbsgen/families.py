"""Families: the requested functions of a tree, each with its derivatives, as tapes.

Operations on run-time parameters alone are split off as `setup`. The parts of a scene that concern functions are
applied here.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.derivatives.kernels import Derivatives, differentiable, differentiate
from mbsgen.derivatives.staged import StagedDerivatives
from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS, Entry, is_by_tables, refuse, select_functions
from mbsgen.formulations.planning import count_own
from mbsgen.model.tree import Kind, Tree
from mbsgen.procedure.procedure import Computation, Procedure, straight
from mbsgen.procedure.splitting import hoist
from mbsgen.request import EVERY_FUNCTION, OptionError, Request
from mbsgen.roles import ACCELERATING, ON_REQUEST, QUICKEST, Order, Role, choose_quickest
from mbsgen.tape.passes import keep_results, merge, set_zero
from mbsgen.tape.ports import Function, is_of
from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family
from mbsgen.targets.languages import add_functions, find_targets

ORDERS = ((), (Order.JACOBIAN, Order.ADJOINT, Order.LINEARISATION), tuple(Order))  # by the order of derivatives
Tell = Callable[[str], None]  # called with the name of each stage that begins


def say_nothing(_: str) -> None:
    """Ignore the name of a stage."""


@dataclass(frozen=True)
class Functions:
    """The functions of a tree, with their derivatives."""

    families: tuple[Family, ...]
    ways: Mapping[str, Mapping[str, int]]  # flops of derivatives by each way of writing them, by the paper's convention

    @property
    def has_setup(self) -> bool:
        """Return whether run-time parameters matter: one function then computes what the others need of them."""
        return any(family.value.giving(Role.SETUP) for family in self.families)


def write_families(tree: Tree, request: Request = EVERY_FUNCTION, tell: Tell = say_nothing) -> tuple[Family, ...]:
    """Write functions of a tree as `write_functions` does."""
    return write_functions(tree, request, tell).families


def write_functions(
    tree: Tree, request: Request = EVERY_FUNCTION, tell: Tell = say_nothing, *, staged: bool = False
) -> Functions:
    """Write functions of a tree with their derivatives; what depends on parameters alone is split off as `setup`.

    The scene of the request has been applied to the tree; what it says of functions is done here. staged: large
    derivatives are needed in stages only, not in straight code. Raises OptionError for functions that the tree does
    not have.
    """
    request = _name_quickest(tree, request)
    families, ways = _write_chosen(tree, request, tell, staged=staged)
    families = _finish(families, request)
    added = add_functions(families, find_targets(request.targets))  # they compute run-time parameters themselves
    if any(p.kind is Kind.RUNTIME for p in tree.parameters):
        return Functions((*_split_setup(families), *added), ways)
    return Functions((*families, *added), ways)


def list_functions(tree: Tree, request: Request) -> tuple[str, ...]:
    """List the functions of the catalogue that are written. Raises OptionError for unknown names."""
    return tuple(_choose_functions(tree, _name_quickest(tree, request)))


def _name_quickest(tree: Tree, request: Request) -> Request:
    """Replace the name of the quickest accelerations by the name of the form."""
    if not any(QUICKEST in names for names in (request.functions or (), request.optional, request.values)):
        return request

    def replace_in(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(best if name == QUICKEST else name for name in names))

    best = choose_quickest(
        {name: count_own(straight(FUNCTIONS[name].build(tree, request.reductions)))[0] for name in ACCELERATING}
    )
    functions = None if request.functions is None else replace_in(request.functions)
    return replace(
        request, functions=functions, optional=replace_in(request.optional), values=replace_in(request.values)
    )


def _write_chosen(
    tree: Tree, request: Request, tell: Tell, *, staged: bool
) -> tuple[list[Family], Mapping[str, Mapping[str, int]]]:
    """Write the chosen functions with their derivatives, and count the ways of writing these."""
    families: list[Family] = []
    ways: dict[str, Mapping[str, int]] = {}
    dynamics = Dynamics(tree, request.reductions, staged=staged, size=request.size, counted=request.compare)
    read = dict(request.scene.results)
    forms: list[Derivatives] = []
    for name, entry in _choose_functions(tree, request).items():
        tell(name)
        function = _build(name, entry, tree, request, staged=staged)
        assert function.name == name, "the catalogue calls a function by its own name"
        order = 0 if name in request.values else min(entry.order, request.derivatives)
        if entry.iterated and order:
            families += _write_staged(function, entry.iterated(tree), entry.title, order)
            continue
        if isinstance(function, Procedure):
            outputs = tuple(wire for wire in function.outputs if wire.name in read.get(name, (wire.name,)))
            families.append(Family(replace(function, outputs=outputs), title=entry.title))
            continue
        tape = keep_results(function, read[name]) if name in read else function
        if not order:
            families.append(Family(tape, title=entry.title))
            continue
        tell(f"{name} and its derivatives")
        if entry.by_adjoint:
            families.append(Family(tape, adj1=differentiate(tape, differentiable(tape)).adj1, title=entry.title))
            continue
        if entry.is_form:
            found = dynamics.differentiate(tape, forms)
            forms.append(found)
        else:
            found = differentiate(tape, differentiable(tape))
        families += _write_family(found, entry.title, order)
        ways |= found.count_ways(ORDERS[order])
    return families, ways


def _build(name: str, entry: Entry, tree: Tree, request: Request, *, staged: bool) -> Computation:
    """Write a function, with loops over tables where its straight code would be long."""
    is_alone = request.scene.motion and not any(name in parts for _, parts in request.scene.together)
    if entry.by_tables and staged and is_alone and is_by_tables(entry, tree, request.size.matrix):
        return entry.by_tables(tree, request.reductions)
    return entry.build(tree, request.reductions)


def _write_family(found: Derivatives, title: str, order: int) -> Iterator[Family]:
    """Write a function with its derivatives up to an order, and the function that comes with its Jacobians."""
    second = found.jac_adj1 if order > 1 else None
    yield Family(found.tape, found.jac, found.adj1, second, title, found.staged)
    yield Family(found.lin, title=f"{title}, with its Jacobians", staged=found.staged)


def _write_staged(value: Computation, procedure: Procedure, title: str, order: int) -> Iterator[Family]:
    """Write a function with the derivatives of a procedure that computes the same."""
    found = StagedDerivatives.of(procedure, order)
    yield Family(value, found.jac, found.adj1, found.jac_adj1, title)
    yield Family(found.lin, title=f"{title}, with its Jacobians")


def _finish(families: Sequence[Family], request: Request) -> list[Family]:
    """Set velocities at rest to zero, join functions of one state, and drop functions that only joining needed."""
    scene = request.scene
    chosen = None if request.functions is None else {*request.functions, *request.optional}
    still = families if scene.motion else [_let_rest(family) for family in families]
    by_name = {family.value.name: family for family in still}
    joined = []
    for name, parts in scene.together:
        members = [by_name[part] for part in parts]
        _refuse_iterations(name, members)
        _refuse_clashes(name, members)
        jacs = _differentiate_all(members)
        function = Function(name)
        value = merge([straight(family.value) for family in members], function)
        jac = merge(jacs, function.to(Order.JACOBIAN)) if jacs else None
        joined.append(Family(value, jac, title=" and ".join(parts)))
    kept = [f for f in still if chosen is None or f.value.function.base in chosen]
    return [*kept, *joined]


def _differentiate_all(members: Sequence[Family]) -> list[Tape]:
    """Return the Jacobians of all functions that are joined, or none: a missing block is a derivative of 0.

    Functions such as the energy have no derivatives outside of a joined function.
    """
    if all(family.jac is None for family in members):
        return []
    written = ((straight(family.value), family.jac) for family in members)
    return [
        straight(jac) if jac is not None else straight(differentiate(value, differentiable(value)).jac)
        for value, jac in written
    ]


def _refuse_iterations(name: str, members: Sequence[Family]) -> None:
    """Refuse to join functions that iterate. Raises OptionError."""
    found = [family.value.name for family in members if isinstance(family.value, Procedure)]
    if found:
        remedy = "generate it on its own"
        raise OptionError(f"together: {name}: {found[0]} is solved by an iteration, which cannot be joined; {remedy}")


def _refuse_clashes(name: str, members: Sequence[Family]) -> None:
    """Refuse to join functions of which one gives a number that another gives or reads. Raises OptionError."""
    for own in members:
        for other in members:
            if other is own:
                continue
            given = {o.name for o in own.value.outputs}
            # setup takes the parameters
            read = given & {i.name for i in other.value.inputs if i.port.role is not Role.PARAMETER}
            both = given & {o.name for o in other.value.outputs}
            if found := sorted(read) or sorted(both):
                verb = "reads" if read else "gives too"
                finding = f"{own.value.name} gives {found[0]}, which {other.value.name} {verb}"
                raise OptionError(f"together: {name}: {finding}; leave one of the two out")


def _let_rest(family: Family) -> Family:
    """Replace the velocities by zeros; drop derivatives by them. Functions that iterate keep all their inputs."""

    def rest(function: Computation | None) -> Computation | None:
        if function is None:
            return None
        if isinstance(function, Procedure):
            return function
        kept = {o.name for o in function.outputs if not is_of(o.port, Role.VELOCITY)}
        return set_zero(keep_results(function, kept), Role.VELOCITY)

    value = rest(family.value)
    assert value is not None, "a family has a value"
    jac, adj1, jac_adj1 = rest(family.jac), rest(family.adj1), rest(family.jac_adj1)
    return replace(family, value=value, jac=jac, adj1=adj1, jac_adj1=jac_adj1, staged={})


def _choose_functions(tree: Tree, request: Request) -> Mapping[str, Entry]:
    """Choose functions by name, in the order of the catalogue; report all faulty names together."""
    present = select_functions(tree)
    if request.needed is None:
        rests = [body.joint.dry for body in tree.bodies if body.joint.dry is not None]
        asked = {"reactions"} if any(dry.load is not None for dry in rests) else set()  # friction depends on them
        return {name: entry for name, entry in present.items() if name in asked or name not in ON_REQUEST}
    names = [name for name in request.needed if name in present or name not in request.optional]
    faults = [] if names else [f"no function is named; there are {', '.join(present)}"]
    for name in names:
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
