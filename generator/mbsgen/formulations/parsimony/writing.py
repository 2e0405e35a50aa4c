"""What every recursion of this folder begins with: segments, lumps and frames, as reductions and a plan want them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbsgen.formulations.links import Chain
from mbsgen.formulations.parsimony.motion import Kinematics
from mbsgen.formulations.parsimony.plan import Plan
from mbsgen.formulations.parsimony.regrouping import Lump, keep, regroup
from mbsgen.formulations.parsimony.segments import Segment
from mbsgen.formulations.reductions import Reductions


@dataclass(frozen=True)
class Writing:
    """A chain, ready for the recursions."""

    chain: Chain
    kinematics: Kinematics
    lumps: dict[int, Lump]


def begin(chain: Chain, segments: Sequence[Segment], plan: Plan, reductions: Reductions) -> Writing:
    """Regroup and place the segments of a chain. Raises NoSuchPlanError for a plan that does not fit."""
    lumps = regroup(chain.builder, segments, plan) if reductions.regroup else keep(chain.builder, segments)
    return Writing(chain, Kinematics(chain.builder, segments, plan, chain.state.q), lumps)
