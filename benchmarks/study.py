"""One mechanism, everything that is compared on it: generate, trace, differentiate, compile, check, time."""

from __future__ import annotations

import ctypes
import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.afternoon import write_functions
from benchmarks.candidates import (
    AUTHORS,
    CASADI,
    LARGEST,
    OURS,
    PINOCCHIO,
    SHORT,
    TAPE,
    Call,
    Candidate,
    Code,
    Face,
    dense,
    load_code,
)
from benchmarks.compilation import VARIANTS, BuildError, Workshop, of_model, run
from benchmarks.mechanism import is_chain, write_mechanism
from benchmarks.symbolic import adjoint_jacobian, count_arithmetic, eliminate, jacobian, read_tape
from benchmarks.timing import Sizes, Stopwatch, draw_states, find_disagreements, measure_rounds, one_core
from mbsgen.manifest import Manifest
from mbsgen.pipeline import Options, generate, read_tree
from mbsrun import load

VALUES = ("impl", "semi", "exp1", "exp2")
DIFFERENTIATED = ("impl", "semi_res", "exp1", "exp2")
STATES = 512  # 100 kB for an arm: more than the first cache holds, less than the second
CHECKED = 5  # states at which all must agree

Report = Callable[[str], None]  # tells what is being done


def _say_nothing(_text: str) -> None:
    pass


@dataclass(frozen=True)
class Depth:
    """How much is measured."""

    rounds: int = 200
    hessians: bool = True


@dataclass(frozen=True)
class Measurement:
    """What was found of one candidate."""

    candidate: Candidate
    times: NDArray[np.float64] | None  # ns per call, by round; None: it was counted only


@dataclass(frozen=True)
class Study:
    """What was found on one mechanism."""

    model: str
    measurements: tuple[Measurement, ...]


class DisagreementError(Exception):
    """Candidates that do not compute the same: their times mean nothing."""


def study(model: Path, workshop: Workshop, depth: Depth, report: Report) -> Study:
    """Measure everything on a model. Raises InputError, BuildError, DisagreementError, ArithmeticError."""
    tree = read_tree(model)
    own = of_model(workshop, tree.name)
    own.folder.mkdir(parents=True, exist_ok=True)
    mechanism = own.folder / "mechanism.txt"
    mechanism.write_text(write_mechanism(tree), encoding="utf-8")

    report("generating")
    product = generate(model, own.folder / "generated", Options(python=True))
    report("compiling the generated kernels")
    names = _names(product.manifest, depth)
    library = load(own.folder / "generated").compile(*names)
    candidates = [describe_kernel(product.manifest, library, name) for name in names]
    report("differentiating our equations by CasADi")
    tape = read_tape(own.folder / "generated", product.manifest, DIFFERENTIATED)
    candidates += _make_functions(TAPE, _derive(tape, depth), own, report)
    if is_chain(tree):  # which is all that it was written for
        candidates += _make_functions(SHORT, _differentiate_short(write_functions(tree)), own, report)
    if workshop.includes is not None:
        report("compiling Pinocchio")
        peer = workshop.compile_pinocchio()
        report("tracing Pinocchio with CasADi's symbols")
        functions = _trace(workshop, mechanism)
        candidates += _make_functions(CASADI, _differentiate_traced(functions, depth), own, report)
        candidates += describe_pinocchio(product.manifest, peer, mechanism)
    return Study(tree.name, measure(candidates, product.manifest, workshop, depth.rounds, report))


def _names(manifest: Manifest, depth: Depth) -> list[str]:
    wanted = [*VALUES, "semi_res", *(f"jac_{name}" for name in DIFFERENTIATED)]
    if depth.hessians:
        wanted += [f"jac_adj1_{name}" for name in DIFFERENTIATED]
    made = {kernel.name for kernel in manifest.kernels}
    return [name for name in wanted if name in made]


def describe_kernel(manifest: Manifest, library: Path, name: str) -> Candidate:
    kernel = manifest.kernel(name)
    flops = kernel.flops.arithmetic + kernel.flops.sqrt
    return Candidate(OURS, name, name, flops, load_code(library, kernel.symbol))


Named = list[tuple[str, ca.Function]]  # the kernel that a function stands in for, and the function


def _derive(functions: dict[str, ca.Function], depth: Depth) -> Named:
    """Differentiate every function of DIFFERENTIATED by CasADi."""
    found = [(f"jac_{name}", jacobian(functions[name], f"jac_{name}")) for name in DIFFERENTIATED]
    if depth.hessians:
        found += [
            (f"jac_adj1_{name}", adjoint_jacobian(functions[name], f"jac_adj1_{name}")) for name in DIFFERENTIATED
        ]
    return found


def trace_values(workshop: Workshop, mechanism: Path) -> list[Candidate]:
    """List Pinocchio's algorithms as CasADi writes them in C, without derivatives. Raises BuildError."""
    functions = _trace(workshop, mechanism)
    named = [(name, eliminate(functions[name], f"value_{name}")) for name in VALUES]
    return _make_functions(CASADI, named, replace(workshop, folder=mechanism.parent))


def _trace(workshop: Workshop, mechanism: Path) -> dict[str, ca.Function]:
    traced = mechanism.with_name("traced.casadi")
    run((str(workshop.compile_tracer()), str(mechanism), str(traced)))
    return {function.name(): function for function in ca.FileDeserializer(str(traced)).unpack()}


def _differentiate_traced(functions: dict[str, ca.Function], depth: Depth) -> Named:
    values = [(name, eliminate(functions[name], f"value_{name}")) for name in (*VALUES, "semi_res")]
    analytic = [
        (f"jac_{name}", eliminate(functions[f"jac_{way}_analytic"], f"jac_{name}_analytic"))
        for name, way in (("impl", "impl"), ("exp1", "exp"))
    ]
    return values + analytic + _derive(functions, depth)


def _differentiate_short(functions: dict[str, ca.Function]) -> Named:
    return [
        ("impl", eliminate(functions["impl"], "value_impl")),
        ("exp1", eliminate(functions["exp"], "value_exp")),
        ("jac_impl", jacobian(functions["impl"], "jac_impl")),
        ("jac_exp1", eliminate(functions["jac_exp"], "jac_exp")),
    ]


def _make_functions(author: str, named: Named, workshop: Workshop, report: Report = _say_nothing) -> list[Candidate]:
    """Write CasADi's functions as C, one file each, and compile those that are not too large."""
    own = of_model(workshop, author.lower().replace(" ", "_"))
    own.folder.mkdir(parents=True, exist_ok=True)
    small = [(target, function) for target, function in named if function.n_instructions() <= LARGEST]
    sources = [_write_source(function, own.folder) for _, function in small]
    report(f"compiling: {AUTHORS[author]}")
    jobs = [(*entry, source, variant) for entry, source in zip(small, sources, strict=True) for variant in VARIANTS]

    def make(job: tuple[str, ca.Function, Path, str]) -> Candidate:
        target, function, source, variant = job
        name = function.name()
        code = load_code(own.compile_c(source, name, VARIANTS[variant]), name)
        return Candidate(author, target, f"{name}{variant}", count_arithmetic(function), code)

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        compiled = list(pool.map(make, jobs))
    large = [(target, function) for target, function in named if function.n_instructions() > LARGEST]
    return compiled + [Candidate(author, target, f.name(), count_arithmetic(f), None) for target, f in large]


def _write_source(function: ca.Function, folder: Path) -> Path:
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    generator.generate(f"{folder}{os.sep}")
    return folder / f"{function.name()}.c"


def describe_pinocchio(manifest: Manifest, library: Path, mechanism: Path) -> list[Candidate]:
    """List Pinocchio's algorithms in C++; what has no counterpart is left out."""
    if ctypes.CDLL(str(library)).pin_load(os.fsencode(mechanism)):
        raise BuildError(f"Pinocchio cannot read {mechanism}")
    n = len(manifest.coordinates)
    square = {"impl": ("q", "qd", "qdd"), "exp2": ("q", "qd", "Q")}
    results = {
        "impl": [dense("Phi", n, 1)],
        "semi": [dense("M", n, n), dense("c", n, 1)],
        "exp1": [dense("qdd", n, 1)],
        "exp2": [dense("qdd", n, 1)],
        "jac_impl": [dense(f"jac_Phi_{x}", n, n) for x in square["impl"]],
        "jac_exp2": [dense(f"jac_qdd_{x}", n, n) for x in square["exp2"]],
    }
    candidates = []
    for name, blocks in results.items():
        if all(kernel.name != name for kernel in manifest.kernels):
            continue
        face = Face(tuple(a.name for a in manifest.kernel(name).inputs), tuple(blocks))
        candidates.append(Candidate(PINOCCHIO, name, f"pin_{name}", None, Code(library, f"pin_{name}", face)))
    return candidates


def measure(
    candidates: Sequence[Candidate],
    manifest: Manifest,
    workshop: Workshop,
    rounds: int,
    report: Report = _say_nothing,
) -> tuple[Measurement, ...]:
    """Check that candidates agree, then time them in turn. Raises DisagreementError, ArithmeticError."""
    pool = draw_states(Sizes(len(manifest.coordinates), len(manifest.actuated)), STATES)
    calls = [Call(candidate, candidate.code, pool) for candidate in candidates if candidate.code is not None]
    report("checking that all agree")
    together = defaultdict(list)
    for call in calls:
        together[call.candidate.function].append(call)
    faults = [fault for state in range(CHECKED) for fault in find_disagreements(together, state)]
    if faults:
        raise DisagreementError("\n".join(faults))
    stopwatch = Stopwatch(workshop.compile_timing())
    found = []
    with one_core():
        for k, times in enumerate(measure_rounds(stopwatch, calls, rounds), 1):
            found.append(times)
            report(f"timing: round {k} of {rounds}")
    times_of = dict(zip((id(call.candidate) for call in calls), np.array(found).T, strict=True))
    return tuple(Measurement(candidate, times_of.get(id(candidate))) for candidate in candidates)
