"""Plans of a tree: for each recursion, the choices with the fewest operations; each is searched for once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, cached_property, lru_cache, partial
from math import inf
from typing import Self

from mbsgen.errors import TapeError
from mbsgen.formulations.chain import Chain, check_pivot, write_chain
from mbsgen.formulations.parsimony.articulated import accelerations, find_depths
from mbsgen.formulations.parsimony.elimination import solve
from mbsgen.formulations.parsimony.mass_matrix import joint_matrix, mass_matrix
from mbsgen.formulations.parsimony.plan import Choice, NoSuchPlanError, Plan, Transferred
from mbsgen.formulations.parsimony.proportions import Proportions, find_least
from mbsgen.formulations.parsimony.regrouping import regroup, restrain
from mbsgen.formulations.parsimony.residual import residual
from mbsgen.formulations.parsimony.search import Restraint, flip_each, leave, meet, search, spin
from mbsgen.formulations.parsimony.segments import Moments, Segment, align, largest_inertias
from mbsgen.formulations.parsimony.sensitivities import sensitivities
from mbsgen.formulations.parsimony.writing import Writing, begin
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import NO_FORCE, Kind, Tree
from mbsgen.roles import Role
from mbsgen.tape.brackets import take_brackets
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import once
from mbsgen.tape.factoring import factor
from mbsgen.tape.replay import count_varying
from mbsgen.tape.sums import rewrite
from mbsgen.tape.types import Tape

LARGEST_GROWTH = 16.0  # bound on the factor by which regrouping may raise the rounding errors of EXP2
FIXED = frozenset({Role.PARAMETER})  # what depends on these alone moves to the setup
LONG = 10_000  # operations; the sums of longer tapes keep their form, since all of this would take seconds
FIRM = 1e-3  # least inertia of a joint that EXP2 may eliminate with others, in any pose, relative to the largest
WORTH = 1.005  # times the operations of a tape: more are not worth it that no sum waits; another order shares less
NEAR = 1.08  # times the fewest operations: other plans are not pursued further; motions that meet inertia save less
ELIMINATED = 16  # larger trees use the plan of SEMI's M for EXP1 and sensitivities, whose trials take too long


class Plans:
    """The plan of each recursion of a tree, searched for on first use."""

    def __init__(self, tree: Tree, reductions: Reductions) -> None:
        self._tree, self._reductions = tree, reductions
        self._size = len(tree.bodies)

    @cached_property
    def residual(self) -> Plan:
        """IMPL."""
        with self._begin() as trials:
            return self._search(
                trials, lambda shared, plan: residual(shared.begin(plan), shared.state.qd, shared.state.qdd)
            )

    @cached_property
    def bias(self) -> Plan:
        """c of SEMI and EXP1: the residual at qdd = 0."""
        start = self.residual
        with self._begin() as trials:
            return self._search(trials, lambda shared, plan: shared.write_bias(plan, absolute=False), start)

    @cached_property
    def mass_matrix(self) -> Plan:
        """M of SEMI."""

        def write(shared: PlanTrials, plan: Plan) -> Sequence[Scalar]:
            return [*joint_matrix(shared.begin(plan)).values(), *shared.bias(self.bias, absolute=False)]

        start = self.bias
        with self._begin() as trials:
            plan = self._search(trials, write, start, rates=False)
            others = [replace(plan, by_angles=True)] if self._reductions.absolute else []
            return self._refine(trials, write, plan, *others)

    @cached_property
    def elimination(self) -> Plan:
        """M of EXP1."""
        absolute = self._reductions.absolute

        def write(shared: PlanTrials, plan: Plan) -> Sequence[Scalar]:
            M = mass_matrix(shared.begin(plan), absolute=absolute)
            right = dict(enumerate(shared.bias(self.bias, absolute=absolute), 1))
            return list(solve(shared.chain.builder, M, right, self._size, partial(check_pivot, self._tree)).x.values())

        if self._size > ELIMINATED:
            return self.mass_matrix
        start = self.mass_matrix
        with self._begin() as trials:
            return self._refine(trials, write, self._search(trials, write, start, rates=False))

    @cached_property
    def articulated(self) -> Plan:
        """EXP2."""
        absolute = self._reductions.absolute

        def write(shared: PlanTrials, plan: Plan) -> Sequence[Scalar]:
            state = shared.state  # any n numbers serve as Q
            return accelerations(shared.begin(plan), state.qd, state.qdd, absolute=absolute).qdd

        restraint, rest = _restraint(self._tree, self._reductions), self._reductions.rest

        def restrain(plan: Plan) -> Plan | None:
            found = restraint(plan)
            return replace(found, at_rest=rest) if found else None

        start = self.residual
        flags = ["shift_first", "first_resists", "by_motions", "turns_apart", "by_squares"] + [
            "in_series"
        ] * self._reductions.series
        with self._begin() as trials:
            plan = self._search(trials, write, start, restrain=restrain)
            others = (replace(plan, together=depth, by_motions=True) for depth in self._list_together())
            best = self._refine(trials, write, plan, *others, flags=flags)
        if self._size > ELIMINATED:
            return best
        finished = [best] + [replace(best, at_rest=False)] * rest
        if best.together and any(c.scaled for c in best.choices):
            finished.append(best.flip("by_levers"))
        return min(finished, key=partial(self._finish, write)) if len(finished) > 1 else best

    def _list_together(self) -> Iterator[int]:
        """List how many joints of each branch EXP2 may eliminate together.

        They are firm enough, and end a group, but perhaps for its last joint.
        """
        if not self._reductions.together:
            return
        _, segments = align_numbers(self._tree, self._reductions)
        depths = find_depths(segments)
        least = find_least_shares(self._tree, self._reductions)
        within = {
            d for s in segments for d in range(depths[s.number], max(depths.values()) + 1) if least[s.number] < FIRM
        }
        continued = {s.parent for s in segments if not s.opens_group}
        for depth in range(1, max(depths.values())):
            beyond = [s for s in segments if depths[s.number] == depth + 1]
            if depth not in within and all(s.opens_group or s.number not in continued for s in beyond):
                yield depth

    def _begin(self) -> PlanTrials:
        return PlanTrials(self._tree, self._reductions)

    def _refine(
        self,
        shared: PlanTrials,
        write: Callable[[PlanTrials, Plan], Sequence[Scalar]],
        plan: Plan,
        *others: Plan,
        flags: Sequence[str] = ("first_resists",),
    ) -> Plan:
        """Choose among plans that differ in more than one body, each with the bodies that M meets.

        Then choices of the whole plan, its `flags`, are tried the other way, one by one.
        """
        if self._reductions.trials == 1 or self._size > ELIMINATED:
            return plan

        @cache
        def cost(plan: Plan) -> int:
            return shared.cost(write(shared, plan))

        tried = [plan, *others]
        if self._reductions.meet:
            fewest = min(map(cost, tried))
            tried = [meet(shared.segments, cost, x) for x in tried if cost(x) <= NEAR * fewest]
        best = min(tried, key=cost)
        for flag in flags:
            best = min(best, best.flip(flag), key=cost)
        return best

    def _finish(self, write: Callable[[PlanTrials, Plan], Sequence[Scalar]], plan: Plan) -> tuple[int, int]:
        """Count the operations that a plan takes after its sums are written: what they share may decide."""
        with PlanTrials(self._tree, self._reductions) as alone:
            builder = alone.chain.builder
            builder.output_dense("found", [[x] for x in write(alone, plan)])
            return count_own(finish(builder.build("trial"), replace(self._reductions, order=False)))

    @cached_property
    def sensitivities(self) -> Plan:
        """The derivatives of IMPL."""

        def write(shared: PlanTrials, plan: Plan) -> Sequence[Scalar]:
            found = sensitivities(shared.begin(plan), shared.state.qd, shared.state.qdd)
            return [*found.q.values(), *found.qd.values(), *found.qdd.values()]

        if self._size > ELIMINATED:
            return self.mass_matrix.carried_down
        start = self.mass_matrix.carried_down
        with self._begin() as trials:
            plan = self._refine(trials, write, self._search(trials, write, start), flags=())
            if self._reductions.trials == 1:
                return plan

            def cost(plan: Plan) -> int:
                return trials.cost(write(trials, plan))

            plan = flip_each(trials.segments, cost, plan, "by_columns", by_group=True)
            return flip_each(trials.segments, cost, plan, "by_moments")

    def _search(
        self,
        shared: PlanTrials,
        write: Callable[[PlanTrials, Plan], Sequence[Scalar]],
        *start: Plan,
        restrain: Restraint = leave,
        rates: bool = True,
    ) -> Plan:
        wanted = self._reductions.trials
        trials = _trials(self._size) if wanted is None else wanted
        if self._reductions.lump_runtime and self._reductions.regroup:
            restrain = _allow(self._tree, self._reductions, shared.segments, restrain)

        def cost(plan: Plan) -> int | None:
            try:
                return shared.cost(write(shared, plan))
            except NoSuchPlanError:
                return None

        found = search(shared.segments, cost, self._reductions, trials, start, restrain)
        spins = rates and trials > 1 and self._size <= ELIMINATED
        return spin(shared.segments, cost, found, self._reductions) if spins else found


def align_numbers(tree: Tree, reductions: Reductions) -> tuple[Chain, tuple[Segment, ...]]:
    """Align the bodies of a tree, with the parameters at their values."""
    builder = Builder()
    builder.memory = {}
    known = replace(tree, parameters=tuple(replace(p, kind=Kind.CONSTANT) for p in tree.parameters))
    chain = write_chain(known, builder, declare_state(known, builder))
    return chain, align(chain, group=reductions.share_frames)


def find_least_shares(tree: Tree, reductions: Reductions) -> dict[int, float]:
    """Return the least inertia that each joint feels in any position, relative to the largest, at known numbers.

    A pair of joints without mass may feel less, close to its lock.
    """
    chain, segments = align_numbers(tree, reductions)
    largest = largest_inertias(chain, segments)
    return {s.number: find_least(segments, s) / (largest[s.number].literal or inf) for s in segments}


def _allow(tree: Tree, reductions: Reductions, segments: Sequence[Segment], restrain: Restraint) -> Restraint:
    """Refuse plans that divide by 0, or move masses out of proportion, at the parameters' values."""
    chain, known = align_numbers(tree, reductions)
    vanishing = {  # bodies whose directions with lengths would be 0
        own.parent
        for own, number in zip(segments, known, strict=True)
        if own.parent and any(x.is_zero and not y.is_zero for x, y in zip(number.d, own.d, strict=True))
    }

    @cache
    def may_move(by_runtime: bool, moved: tuple[Transferred, ...]) -> bool:
        try:
            regroup(chain.builder, known, Plan(tuple(Choice(mass=mass, spin_from=k) for mass, k in moved), by_runtime))
        except TapeError:
            return False
        return True

    def restrain_plan(plan: Plan) -> Plan | None:
        found = restrain(plan)
        if found is None or not may_move(found.by_runtime, found.moved):
            return None
        return None if any(found[number].scaled for number in vanishing) else found

    return restrain_plan


def _restraint(tree: Tree, reductions: Reductions) -> Restraint:
    """Keep inertia in place where it would dwarf the inertia that it moves to, with the parameters at their values."""
    if not reductions.regroup:
        return leave
    chain, segments = align_numbers(tree, reductions)
    proportions = Proportions(segments)

    @cache
    def fits(number: int, moved: Moments) -> bool:
        return proportions.growth(number, moved) <= LARGEST_GROWTH

    @cache
    def move(by_runtime: bool, moved: tuple[Transferred, ...]) -> tuple[Transferred, ...] | None:
        plan = Plan(tuple(Choice(mass=mass, spin_from=k) for mass, k in moved), by_runtime)
        try:
            return restrain(chain.builder, segments, plan, fits).moved
        except NoSuchPlanError:
            return None

    def restrain_plan(plan: Plan) -> Plan | None:
        found = move(plan.by_runtime, plan.moved)
        if found is None or found == plan.moved:
            return None if found is None else plan
        choices = (
            replace(c, mass=mass, spin_from=spin_from) for c, (mass, spin_from) in zip(plan.choices, found, strict=True)
        )
        return replace(plan, choices=tuple(choices))

    return restrain_plan


@lru_cache(maxsize=8)
def _plans(tree: Tree, reductions: Reductions) -> Plans:
    return Plans(tree, reductions)


def find_plans(tree: Tree, reductions: Reductions) -> Plans:
    """Return the plans of a tree; they do not depend on forces and wrenches."""
    return _plans(dynamics_alone(tree, driven=False), reductions)


def dynamics_alone(tree: Tree, *, driven: bool) -> Tree:
    """Remove force laws, external wrenches and sensors, and actuate all joints or none."""
    followers = tree.followers
    joints = (
        replace(b.joint, actuated=driven and i not in followers, law=NO_FORCE) for i, b in enumerate(tree.bodies, 1)
    )
    bodies = tuple(replace(b, joint=joint) for b, joint in zip(tree.bodies, joints, strict=True))
    return replace(tree, bodies=bodies, wrenches=(), probes=(), definitions=(), distances=(), sensors=())


class PlanTrials:
    """The parts that the trials of one search share: above all a builder, which holds most values of a plan already."""

    def __init__(self, tree: Tree, reductions: Reductions) -> None:
        builder = Builder()
        builder.memory = {}  # plans differ in one body; what the others compute without it is the same
        self.state = declare_state(tree, builder)
        self.chain = write_chain(tree, builder, self.state)
        self.segments = align(self.chain, group=reductions.share_frames)
        self._reductions = reductions
        self._costs: dict[tuple[int, ...], int] = {}  # by the values of a plan: many plans have the same
        self._biases: dict[tuple[Plan, bool], Sequence[Scalar]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Forget the parts: they refer to the builder that remembers them, and only a search for cycles finds those."""
        self.chain.builder.memory = None

    def begin(self, plan: Plan) -> Writing:
        """Start to write by a plan."""
        return begin(self.chain, self.segments, plan, self._reductions)

    def write_bias(self, plan: Plan, *, absolute: bool) -> Sequence[Scalar]:
        """Write c by a plan."""
        return residual(self.begin(plan), self.state.qd, self.chain.drift, absolute=absolute)

    def bias(self, plan: Plan, *, absolute: bool) -> Sequence[Scalar]:
        """Write c by a plan, or return it if it is written."""
        key = (plan, absolute)
        if key not in self._biases:
            self._biases[key] = self.write_bias(plan, absolute=absolute)
        return self._biases[key]

    def cost(self, values: Sequence[Scalar]) -> int:
        """Count the operations of a trial, except operations on parameters alone."""
        refs = tuple(value.ref for value in values)
        known = self._costs.get(refs)
        if known is None:
            known = self._costs[refs] = self.chain.builder.cost(values, FIXED)
        return known


def _trials(size: int) -> int:
    """Return the number of plans to try: fewer for larger trees, whose trials take longer and are more."""
    return 12 + 6_000 // (size + 4) ** 2


def finish(tape: Tape, reductions: Reductions) -> Tape:
    """Lower the cost of a finished recursion by its sums, as requested."""
    return write_sums(take_factors(tape, reductions), reductions)


def take_factors(tape: Tape, reductions: Reductions) -> Tape:
    """Take common factors out of a recursion, if requested and if this lowers its cost."""
    return min(factor(tape, FIXED), tape, key=count_own) if reductions.factor else tape


def write_sums(tape: Tape, reductions: Reductions) -> Tape:
    """Compute common parts of sums once, and add terms as they are ready, each if requested and worth it."""
    if len(tape.operations) > LONG or not (reductions.share or reductions.order):
        return tape
    return _rewrite(take_brackets(tape, FIXED) if reductions.factor else tape, reductions)


def write_sums_again(tape: Tape, reductions: Reductions) -> Tape:
    """Take factors out of sums that are written, and write them once more, if this saves operations.

    Terms that became equal have factors in common, and sums of these have parts in common.
    """
    if len(tape.operations) > LONG or not (reductions.factor and reductions.share):
        return tape
    return min(tape, _rewrite(take_factors(tape, reductions), reductions), key=count_own)


def _rewrite(tape: Tape, reductions: Reductions) -> Tape:
    ways = rewrite(tape, FIXED, share=reductions.share, order=reductions.order)
    found = min((way.ordered for way in ways), key=count_own)
    fewest = min([tape, *(way.plain for way in ways if reductions.order)], key=count_own)
    return found if count_own(found)[0] <= WORTH * count_own(fewest)[0] else fewest


@once
def count_own(tape: Tape) -> tuple[int, int]:
    """Count the operations of a kernel, and then its operations together with the setup's."""
    return count_varying(tape, FIXED), len(tape.operations)
