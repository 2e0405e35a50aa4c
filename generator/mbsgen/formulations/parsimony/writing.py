"""The start of every recursion of this folder: bodies regrouped and placed in the frames of a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mbsgen.formulations.chain import Chain
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.plan import Plan
from mbsgen.formulations.parsimony.regrouping import RegroupedInertia, keep, regroup
from mbsgen.formulations.parsimony.segments import Segment
from mbsgen.formulations.reductions import Reductions


@dataclass(frozen=True)
class Writing:
    """A chain, ready for the recursions."""

    chain: Chain
    kinematics: Kinematics
    inertias: Mapping[int, RegroupedInertia]


def begin(chain: Chain, segments: Sequence[Segment], plan: Plan, reductions: Reductions) -> Writing:
    """Regroup and place the segments of a chain. Raises NoSuchPlanError for a plan that does not fit."""
    inertias = regroup(chain.builder, segments, plan) if reductions.regroup else keep(chain.builder, segments)
    return Writing(chain, Kinematics(chain.builder, segments, plan, chain.state.q), inertias)
