"""The cost of a controller before it runs: memory, operations of an iteration, the largest stack.

The operations of an evaluation are counted: in kernels and formulas by the paper's convention, and two or three for
each term of the tables. The operations of the linear algebra are estimated by the sizes of dense matrices. A stage has
states x, inner variables y and others v, n = |x| + |v|:

    y = S (x, v)           |y| n^2 + 2 nnz(H) n    condensing, by rows of sparse matrices
    sweep backwards        n^3 / 3 + 2 |x| n^2     factorisation of v, products with the next stage's matrix
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cffi

from mbsgen.manifest import Manifest
from mbsrun.controllers import folder as folders
from mbsrun.controllers.emulation import Emulation
from mbsrun.controllers.sources import PLAIN
from mbsrun.library import CompileError, Compiler, compile_library, write_graphs
from mbsrun.ocp.evaluation.stages import formulas
from mbsrun.ocp.evaluation.stages.calls import name_called
from mbsrun.ocp.evaluation.stages.tables import FormulaFunction, Kind, Script, StageProgram
from mbsrun.stack import Rules, find_deepest, list_tasks, read_graphs


@dataclass(frozen=True)
class Operations:
    """Operations of one iteration."""

    values: int
    jacobians: int
    hessian: int
    algebra: int  # an estimate

    @property
    def total(self) -> int:
        """Sum them."""
        return self.values + self.jacobians + self.hessian + self.algebra


def count_operations(tables: StageProgram, manifest: Manifest) -> Operations:
    """Count the operations of an iteration: one evaluation of everything, and one solution of the linear system."""
    flops = [
        formulas.count_flops(function.formula, function.derivative).paper
        if isinstance(function, FormulaFunction)
        else manifest.kernel(name_called(function)).flops.paper
        for function in tables.functions
    ]
    stages = Counter(tables.kind_of_stage)

    def add(script: str) -> int:
        return sum(_count_script(getattr(tables.kinds[k], script), flops) * many for k, many in stages.items())

    algebra = sum(_estimate(tables.kinds[k]) * many for k, many in stages.items())
    return Operations(add("values"), add("jacobians"), add("second"), algebra)


def _count_script(script: Script, flops: list[int]) -> int:
    terms = [step.terms for step in script.steps if step.terms is not None]
    calls = [step.call for step in script.steps if step.call is not None]
    return sum((2 if t.by is None else 3) * t.to.size for t in terms) + sum(flops[call.function] for call in calls)


def _estimate(kind: Kind) -> int:
    n = kind.nx + kind.nv - kind.inner
    return kind.inner * n**2 + 2 * kind.hessian.row.size * n + n**3 // 3 + 2 * kind.nx * n**2


@dataclass(frozen=True)
class Figures:
    """The figures of the report, beside sizes and operations."""

    double: int  # bytes
    single: int
    stack: Mapping[str, int]  # bytes below each function of the interface, empty where the compiler does not say
    compiler: str
    iterations: int
    cost: float
    status: str
    emulation: Emulation | None = None


SINGLE = ("-O0", "-DMBS_STAGES_FLOAT")  # quick to compile, for counting bytes


def measure_single(place: Path, manifest: folders.Manifest, compiler: Compiler) -> int:
    """Return the bytes that a controller needs in single precision; it is compiled for this alone."""
    quick = replace(compiler, flags=(*compiler.flags, *SINGLE))
    library = compile_library(place, manifest.prefix, manifest.sources, quick, given=PLAIN)
    ffi = cffi.FFI()
    function = f"{manifest.symbols}_float_bytes"
    ffi.cdef(f"size_t {function}(void);")
    return int(getattr(ffi.dlopen(str(library)), function)())


def measure_stacks(place: Path, manifest: folders.Manifest, compiler: Compiler) -> Mapping[str, int]:
    """Return the bytes of stack below each function of the interface; none where the compiler writes no call graphs."""
    name = manifest.prefix
    try:
        graphs = read_graphs(write_graphs(place, name, manifest.sources, compiler, PLAIN))
    except CompileError:
        return {}
    callbacks = (*(f"{name}.c:find_{x}" for x in ("values", "jacobians", "hessian")), f"{name}.c:read_clock")
    pointers = {source: callbacks for source in manifest.sources if source.startswith("mbs_stages_")}
    pointers |= {"mbs_program.c": manifest.functions, f"{name}.c": ()}  # the clock is the caller's
    pointers["mbs_stages_recursion.c"] = list_tasks("mbs_stages_")
    rules = Rules(pointers, depth=2)
    roots = ["create", "solve", "prepare", "feedback", *(["predict"] if manifest.predicts else [])]
    return {root: find_deepest(graphs, [f"{manifest.symbols}_{root}"], rules).bytes for root in roots}
