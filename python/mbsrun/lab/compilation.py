"""Effects of compilers on kernels: flags, and the state of the processor (F14)."""

from __future__ import annotations

import os

import numpy as np

from mbsgen.errors import MbsError
from mbsrun.lab.case import Finding, Workspace, check, demand
from mbsrun.lab.digits import KERNELS, specimen
from mbsrun.lab.mechanisms import describe_spatial, draw
from mbsrun.library import find_compiler
from mbsrun.measuring.candidates import compile_kernel
from mbsrun.measuring.functions import Variant

REFUSED = ("-ffast-math", "-Ofast", "-funsafe-math-optimizations", "-ffinite-math-only", "-fassociative-math")
VARIANTS = tuple(
    Variant(level=level, contract=contract) for level in ("-O0", "-O2", "-O3") for contract in (True, False)
)


def measure_flags(workspace: Workspace) -> list[Finding]:
    """F14: optimisation and contraction change results by roundings only."""
    chosen, states = specimen(workspace, describe_spatial(5), *KERNELS.values()), draw(5, range(8))
    findings = []
    for way, kernel in KERNELS.items():
        found = [compile_kernel(chosen.subject, kernel, variant).evaluate(states)[1] for variant in VARIANTS]
        for variant, results in zip(VARIANTS, found, strict=True):
            off = max(
                float(np.abs(x[name] - first[name]).max() / np.abs(first[name]).max())
                for x, first in zip(results, found[0], strict=True)
                for name in first
            )
            findings.append(check(way, "change by flags", off, 1e-13, variant.label))
    return findings


def measure_refusals(workspace: Workspace) -> list[Finding]:
    """F14: flags that give up IEEE arithmetic are refused; numbers below 1e-308 survive in the loading process."""
    findings = []
    for flag in REFUSED:
        try:
            find_compiler({**os.environ, "CFLAGS": flag})
        except MbsError:
            findings.append(demand("flags of compilers", "refusal", True, f"{flag} is refused"))
        else:
            findings.append(demand("flags of compilers", "refusal", False, f"{flag} is accepted"))
    chosen = specimen(workspace, describe_spatial(2), *KERNELS.values())
    for way, kernel in KERNELS.items():
        chosen.evaluate(kernel, draw(2, [1]))
        half = float(np.array([1e-310])[0] * 0.5)
        findings.append(demand(way, "small numbers after loading", half > 0, f"1e-310 / 2 = {half:.3g}"))
    return findings
