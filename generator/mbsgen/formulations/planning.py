"""Plans of a tree: for each recursion, the choices that write it with the fewest operations; searched for once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from mbsgen.formulations.links import PARAMETERS, Chain, State, declare_state, write_chain
from mbsgen.formulations.parsimony.articulated import accelerations
from mbsgen.formulations.parsimony.elimination import solve
from mbsgen.formulations.parsimony.mass_matrix import mass_matrix
from mbsgen.formulations.parsimony.plan import NoSuchPlanError, Plan
from mbsgen.formulations.parsimony.residual import residual
from mbsgen.formulations.parsimony.search import search
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import NO_FORCE, Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count
from mbsgen.tape.factoring import factor
from mbsgen.tape.types import Tape

ELIMINATED = 16  # larger trees write the M of EXP1 as that of SEMI: elimination takes most of the operations

Write = Callable[[Chain, State, Plan], Sequence[Scalar]]


@dataclass(frozen=True)
class Plans:
    """How to write each recursion of a tree."""

    residual: Plan  # IMPL
    bias: Plan  # c of SEMI and EXP1: the residual at qdd = 0
    mass_matrix: Plan  # M of SEMI
    elimination: Plan  # M of EXP1
    articulated: Plan  # EXP2


def find_plans(tree: Tree, reductions: Reductions) -> Plans:
    """Search for the plans of a tree; they do not depend on what drives it."""
    return _find_plans(dynamics_alone(tree, driven=False), reductions)


def dynamics_alone(tree: Tree, *, driven: bool) -> Tree:
    """Take force laws, external wrenches and sensors away, and drive all joints or none."""
    joints = (replace(b.joint, actuated=driven, law=NO_FORCE) for b in tree.bodies)
    bodies = tuple(replace(b, joint=joint) for b, joint in zip(tree.bodies, joints, strict=True))
    return replace(tree, bodies=bodies, wrenches=(), sensors=())


@lru_cache(maxsize=8)
def _find_plans(tree: Tree, reductions: Reductions) -> Plans:
    n = len(tree.bodies)

    def write_residual(chain: Chain, state: State, plan: Plan) -> Sequence[Scalar]:
        return residual(begin(chain, plan, reductions), state.qd, state.qdd)

    def write_bias(chain: Chain, state: State, plan: Plan) -> Sequence[Scalar]:
        return residual(begin(chain, plan, reductions), state.qd, [chain.builder.zero] * n)

    def write_masses(chain: Chain, state: State, plan: Plan) -> Sequence[Scalar]:
        M = mass_matrix(begin(chain, plan, reductions))
        return [*M.values(), *write_bias(chain, state, bias)]

    def write_elimination(chain: Chain, state: State, plan: Plan) -> Sequence[Scalar]:
        M = mass_matrix(begin(chain, plan, reductions), absolute=reductions.absolute)
        right = residual(
            begin(chain, bias, reductions), state.qd, [chain.builder.zero] * n, absolute=reductions.absolute
        )
        return list(solve(chain.builder, M, dict(enumerate(right, 1)), n).x.values())

    def write_accelerations(chain: Chain, state: State, plan: Plan) -> Sequence[Scalar]:
        return accelerations(begin(chain, plan, reductions), state.qd, state.qdd)[0]  # any n numbers will do for Q

    own = _search(tree, write_residual, reductions)
    bias = _search(tree, write_bias, reductions, own)
    masses = _search(tree, write_masses, reductions, bias)
    elimination = _search(tree, write_elimination, reductions, masses) if n <= ELIMINATED else masses
    return Plans(own, bias, masses, elimination, _search(tree, write_accelerations, reductions, own, bias))


def _search(tree: Tree, write: Write, reductions: Reductions, *start: Plan) -> Plan:
    """Search for the plan of one recursion; all trials share a builder, where most of what they write is known."""
    builder = Builder()
    state = declare_state(tree, builder)
    chain = write_chain(tree, builder, state)
    builder.cost((), {PARAMETERS})  # before anything is computed of the inputs

    def cost(plan: Plan) -> int | None:
        try:
            return builder.cost(write(chain, state, plan), {PARAMETERS})
        except NoSuchPlanError:
            return None

    trials = _trials(len(tree.bodies)) if reductions.trials is None else reductions.trials
    return search(align(chain, group=reductions.share_frames), cost, reductions, trials, start)


def _trials(size: int) -> int:
    """Try fewer plans for larger trees: an evaluation's time grows with the size, and so does the number of choices."""
    return 12 + 30_000 // (size + 4) ** 2


def finish(tape: Tape, reductions: Reductions) -> Tape:
    """Take common factors out of a finished recursion, if that is wanted and lowers its cost."""
    if not reductions.factor:
        return tape
    return min(tape, factor(tape, {PARAMETERS}), key=lambda t: count(t).paper)
