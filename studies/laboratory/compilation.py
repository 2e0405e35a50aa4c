"""Effects of compilers on kernels: flags, and the state of the processor (F14)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np

from mbsgen.errors import MbsError
from mbsrun.library import Compiler, compile_library, find_compiler
from mbsrun.measuring.candidates import compile_kernel
from mbsrun.measuring.functions import Variant
from studies.laboratory.case import Finding, Workspace, check, demand, show_failure
from studies.laboratory.digits import KERNELS, specimen
from studies.laboratory.mechanisms import describe_spatial, draw

FAST = "-ffast-math"
SUM = """
double rest(double a, double b)
{
    const double s = a + b, part = s - a;
    return (a - (s - part)) + (b - part);
}
int fails(double pivot)
{
    return !(pivot > 0);
}
"""
CALL = """
import ctypes, json, math, sys
library = ctypes.CDLL(sys.argv[1])
library.rest.restype, library.rest.argtypes = ctypes.c_double, [ctypes.c_double] * 2
library.fails.argtypes = [ctypes.c_double]
print(json.dumps([library.rest(1.0, SMALL), library.fails(math.nan)]))
"""
SMALL = 1e-20
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


def measure_fast_math(workspace: Workspace) -> list[Finding]:
    """F14: with fast-math, the rest of a sum vanishes, and a pivot that is no number passes its test."""
    usual = find_compiler(os.environ)
    findings = []
    for way, compiler in (("usual flags", usual), (FAST, replace(usual, flags=(*usual.flags, FAST)))):
        lost, passes = _call_apart(workspace, compiler)
        judge = show_failure if way == FAST else check
        findings.append(judge(way, "error of the rest of a sum", lost, 1e-13))
        findings.append(judge(way, "pivots that are no number and pass", passes, 0))
    return findings


def _call_apart(workspace: Workspace, compiler: Compiler) -> tuple[float, float]:
    """Compile, and call in another process, whose arithmetic the library may change."""
    place = workspace.folder / "fast_math"
    place.mkdir(parents=True, exist_ok=True)
    (place / "sum.c").write_text(SUM, encoding="utf-8")
    library = compile_library(place, "sum", ["sum.c"], compiler)
    command = [sys.executable, "-c", CALL.replace("SMALL", repr(SMALL)), str(library)]
    found, fails = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return abs(found - SMALL) / SMALL, float(not fails)
