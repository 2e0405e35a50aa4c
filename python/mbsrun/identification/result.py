"""The result of an identification: base parameters with their uncertainty, numbers of bodies and joints, residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mbsrun.identification.unknowns import Unknown

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Base:
    """A number that the recordings determine: a sum of unknown numbers."""

    name: str  # the sum in words
    unit: str
    value: float
    before: float  # with the model's numbers
    deviation: float  # standard deviation; NaN where the recordings do not determine it
    low: float  # of the interval of 95 %
    high: float

    @property
    def is_determined(self) -> bool:
        """Return whether the recordings determine it."""
        return bool(np.isfinite(self.deviation))


@dataclass(frozen=True)
class Torque:
    """The residuals of a torque."""

    joint: str
    unit: str
    size: float  # root mean square of the measured one
    before: float  # of the residuals with the model's numbers
    deviation: float  # of the residuals
    correlation: float  # of residuals with the next ones
    left_out: float  # of the residuals in parts that were left out of the estimate


@dataclass(frozen=True, eq=False)
class Trace:
    """Measured and computed torques of a recording; of rows that are no torque, forces that balance."""

    name: str
    t: Array  # (K,)
    measured: Array  # (K, torques)
    computed: Array  # (K, torques)
    left_out: int  # samples


@dataclass(frozen=True, eq=False)
class Identification:
    """The numbers of a mechanism that recordings determine."""

    model: str
    base: tuple[Base, ...]
    correlations: Array  # of the base parameters, (base, base); NaN where they are not determined
    covariance: Array  # of the base parameters, (base, base); 0 there
    unfelt: tuple[str, ...]  # numbers that no motion determines
    undetermined: tuple[str, ...]  # base parameters that these recordings do not determine
    unknowns: tuple[Unknown, ...]  # with the model's values
    values: Array  # (unknowns,): of the nearest bodies with the base parameters
    G: Array  # (base, unknowns)
    torques: tuple[Torque, ...]
    groups: tuple[str, ...]  # that the cross validation leaves out
    validation: Array  # root mean squares of left out residuals, (groups, torques)
    traces: tuple[Trace, ...]
    condition: float  # of the scaled information
    distance: float  # of the written bodies from the estimate [standard deviations]
    is_moved: bool  # whether the estimate belongs to no body that can be built
    freedom: int  # rows less unknowns
    speeds: Mapping[str, float] = field(default_factory=dict)  # of dry friction, by joint
    parameters: Mapping[str, float] = field(default_factory=dict)  # of the model, new values

    def __repr__(self) -> str:
        """Return the model and the counts."""
        determined = sum(x.is_determined for x in self.base)
        return f"Identification({self.model}: {determined} of {len(self.base)} base parameters)"

    def find(self, name: str) -> Base:
        """Return a base parameter by its whole name, or by the number that it begins with."""
        for x in self.base:
            if name in (x.name, x.name.split(" + ")[0].split(" - ")[0]):
                return x
        raise KeyError(f"no base parameter {name!r}; there are {', '.join(x.name for x in self.base)}")
