"""Model file -> candidates, ready to be timed: generated, traced, differentiated and compiled; kept by content.

This takes minutes, on a machine that may be busy; timing takes seconds, on one that must be quiet. So what is prepared
is written to the user's cache, and found again by the model, the generator, the compilers and the files of this folder.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import casadi as ca

from benchmarks.angles import separate, write_source
from benchmarks.candidates import (
    AUTHORS,
    CASADI,
    LARGE,
    LARGEST,
    OURS,
    PINOCCHIO,
    SHORT,
    TAPE,
    Candidate,
    Sines,
    read_candidate,
    write_candidate,
)
from benchmarks.compilation import (
    EXPORTED,
    HERE,
    VARIANTS,
    VECTORS,
    BuildError,
    Workshop,
    describe_machine,
    of_model,
    run,
)
from benchmarks.mechanism import write_mechanism
from benchmarks.newton_euler import write_functions
from benchmarks.symbolic import adjoint_jacobian, count_arithmetic, eliminate, jacobian, read_tape
from mbsgen.manifest import Manifest
from mbsgen.model.tree import Tree
from mbsgen.pipeline import read_tree
from mbsrun.external import Mechanism
from mbsrun.forms import DIFFERENTIATED, VALUES
from mbsrun.library import compile_library
from mbsrun.measuring.functions import Block, Face, Function, Variant, dense, find_function
from mbsrun.models import Extent, find_folder, fingerprint

FUNCTIONS = (*VALUES, "jac_impl", "jac_exp2")  # what Pinocchio has in C++
SINES: tuple[Sines, ...] = ("libm", "header")
# Operations; in longer functions of CasADi the time of sines does not matter, and vectors are quicker with hardly an
# exception, so they are compiled once.
MIDDLE = 5_000
_FILES = ("angles.py", "compilation.py", "mechanism.py", "newton_euler.py", "preparation.py", "symbolic.py")
_EXTENT = Extent(targets=("python",))

Report = Callable[[str], None]  # takes what is being done
Named = list[tuple[str, ca.Function]]  # the kernel that a function stands in for, and the function


@dataclass(frozen=True)
class Sizes:
    """Dimensions of the arguments of a mechanism."""

    joints: int
    driven: int


@dataclass(frozen=True)
class Prepared:
    """The candidates for one mechanism, and the data for timing them."""

    model: str
    digest: str  # of all that it was made of
    sizes: Sizes
    mechanism: Path  # as Pinocchio reads it
    candidates: tuple[Candidate, ...]


def prepare(model: Path, workshop: Workshop, report: Report, *, hessians: bool = True) -> Prepared:
    """Find or make everything that is compared on a model. Raises InputError, BuildError, ValueError."""
    told = ("all", fingerprint(model, _EXTENT), str(workshop.c), hessians)

    def make(own: Workshop, tree: Tree, mechanism: Path) -> list[Candidate]:
        report("generating")
        folder = find_folder(model, _EXTENT)
        kernels = Mechanism(folder)
        report("compiling the generated kernels")
        candidates = describe_kernels(kernels, folder, _names(kernels.manifest, hessians))
        report("differentiating our equations by CasADi")
        tape = read_tape(folder, kernels.manifest, DIFFERENTIATED)
        candidates += make_functions(TAPE, _derive(tape, hessians), own, report)
        report("writing short recursions")
        short = list(_differentiate_short(write_functions(tree)))
        if hessians:
            short.append(("jac_adj1_impl", adjoint_jacobian(dict(short)["impl"], "jac_adj1_impl")))
        candidates += make_functions(SHORT, short, own, report)
        if workshop.includes is not None:
            traced = trace(workshop, mechanism, report)
            named = [*_list_traced(traced, (*VALUES, "semi_res")), *_derive(traced, hessians)]
            candidates += make_functions(CASADI, named, own, report)
            candidates += describe_pinocchio(len(tree.bodies), FUNCTIONS, compile_pinocchio(workshop))
        return candidates

    return _find_or_make(model, workshop, told, make)


@dataclass(frozen=True)
class Wanted:
    """The functions that peers are to compute."""

    values: tuple[str, ...]
    jacobians: tuple[str, ...] = ()
    traced: bool = True  # Pinocchio's by CasADi, too
    largest: int = 100  # joints up to which CasADi writes out -M^-1 d Phi


def prepare_peers(model: Path, workshop: Workshop, report: Report, wanted: Wanted) -> Prepared:
    """Find or make the peers of a model's kernels: short recursions, and Pinocchio. Raises InputError, BuildError."""

    def make(own: Workshop, tree: Tree, mechanism: Path) -> list[Candidate]:
        report("writing short recursions")
        is_small = len(tree.bodies) <= wanted.largest
        names = [*wanted.values, *(["jac_exp"] if "jac_exp2" in wanted.jacobians and is_small else [])]
        short = _differentiate_short(write_functions(tree, names), bool(wanted.jacobians))
        candidates = make_functions(SHORT, short, own, report)
        if workshop.includes is None:
            return candidates
        if wanted.traced:
            is_differentiated = bool(wanted.jacobians) and is_small
            traced = _list_traced(trace(workshop, mechanism, report), wanted.values, is_differentiated)
            candidates += make_functions(CASADI, traced, own, report)
        functions = [*wanted.values, *wanted.jacobians]
        return candidates + describe_pinocchio(len(tree.bodies), functions, compile_pinocchio(workshop))

    return _find_or_make(model, workshop, ("peers", hash_file(model), wanted), make)


def hash_file(file: Path) -> str:
    """Name a file by its content."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


def _find_or_make(
    model: Path, workshop: Workshop, told: object, make: Callable[[Workshop, Tree, Path], list[Candidate]]
) -> Prepared:
    """Find what was prepared of a model under `told`, or make it."""
    tree = read_tree(model)
    own = of_model(workshop, tree.name)
    digest = _name((told, str(workshop.includes)))
    record = own.folder / f"prepared-{digest}.json"
    found = _read(record)
    if found is not None:
        return found
    own.folder.mkdir(parents=True, exist_ok=True)
    text = write_mechanism(tree)
    mechanism = own.folder / f"mechanism-{hashlib.sha256(text.encode()).hexdigest()[:16]}.txt"
    mechanism.write_text(text, encoding="utf-8")
    candidates = make(own, tree, mechanism)
    sizes = Sizes(len(tree.bodies), sum(body.joint.actuated for body in tree.bodies))
    prepared = Prepared(tree.name, digest, sizes, mechanism, tuple(candidates))
    _write(prepared, record)
    return prepared


def _name(told: object) -> str:
    """Name what is prepared by `told`, the compiler, and the files that it is made by."""
    digest = hashlib.sha256(repr((told, describe_machine(), ca.CasadiMeta.version())).encode())
    for file in (*(HERE / name for name in _FILES), *sorted((HERE / "cpp").iterdir())):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _read(record: Path) -> Prepared | None:
    """Read a record; None where there is none, or a library is gone."""
    if not record.exists():
        return None
    content = json.loads(record.read_text("utf-8"))
    candidates = tuple(map(read_candidate, content["candidates"]))
    mechanism = Path(content["mechanism"])
    if not all(file.exists() for file in (mechanism, *(c.code.library for c in candidates if c.code))):
        return None
    return Prepared(content["model"], content["digest"], Sizes(**content["sizes"]), mechanism, candidates)


def _write(prepared: Prepared, record: Path) -> None:
    content = {
        "model": prepared.model,
        "digest": prepared.digest,
        "sizes": asdict(prepared.sizes),
        "mechanism": str(prepared.mechanism),
        "candidates": [write_candidate(candidate) for candidate in prepared.candidates],
    }
    unfinished = record.with_suffix(f".{os.getpid()}")
    unfinished.write_text(json.dumps(content) + "\n", "utf-8")
    unfinished.replace(record)


# --- the generated kernels -----------------------------------------------------------------------------------------


def _names(manifest: Manifest, hessians: bool) -> list[str]:
    wanted = [*VALUES, "semi_res", *(f"jac_{name}" for name in DIFFERENTIATED)]
    if hessians:
        wanted += [f"jac_adj1_{name}" for name in DIFFERENTIATED]
    made = {kernel.name for kernel in manifest.kernels}
    return [name for name in wanted if name in made]


def describe_kernels(kernels: Mechanism, folder: Path, names: Sequence[str]) -> list[Candidate]:
    """List kernels as `mbsrun` compiles them, and with sines of the C library."""
    manifest = kernels.manifest
    sources = [source for name in names for source in manifest.kernel(name).sources]
    libraries: dict[Sines, Path] = {
        "header": kernels.compile(*names),
        "libm": compile_library(folder, manifest.prefix, sources, Variant(libm=True).compiler()),
    }
    return [describe_kernel(manifest, library, name, sines) for sines, library in libraries.items() for name in names]


def describe_kernel(manifest: Manifest, library: Path, name: str, sines: Sines = "header") -> Candidate:
    """Describe a kernel in a library."""
    kernel = manifest.kernel(name)
    flops = kernel.flops.arithmetic + kernel.flops.sqrt
    return Candidate(OURS, name, name, flops, find_function(library, kernel.symbol), sines, kernel.flops.guard)


# --- CasADi's C ----------------------------------------------------------------------------------------------------


def _derive(functions: dict[str, ca.Function], hessians: bool) -> Named:
    """Differentiate every function of DIFFERENTIATED by CasADi."""
    found = [(f"jac_{name}", jacobian(functions[name], f"jac_{name}")) for name in DIFFERENTIATED]
    if hessians:
        found += [
            (f"jac_adj1_{name}", adjoint_jacobian(functions[name], f"jac_adj1_{name}")) for name in DIFFERENTIATED
        ]
    return found


def trace(workshop: Workshop, mechanism: Path, report: Report) -> dict[str, ca.Function]:
    """Trace Pinocchio's algorithms with CasADi's symbols."""
    report("tracing Pinocchio with CasADi's symbols")
    traced = mechanism.with_suffix(".casadi")
    run((str(workshop.compile_tracer()), str(mechanism), str(traced)))
    return {function.name(): function for function in ca.FileDeserializer(str(traced)).unpack()}


def _list_traced(functions: dict[str, ca.Function], values: Sequence[str], jacobians: bool = True) -> Named:
    """List Pinocchio's values, and its analytic Jacobians."""
    found = [(name, eliminate(functions[name], f"value_{name}")) for name in values]
    if jacobians:
        found += [
            ("jac_impl", eliminate(functions["jac_impl_analytic"], "jac_impl_analytic")),
            ("jac_exp1", eliminate(functions["jac_exp_analytic"], "jac_exp1_analytic")),
        ]
    return found


def _differentiate_short(functions: dict[str, ca.Function], jacobians: bool = True) -> Named:
    """List the short recursions that are there, and the Jacobians of residual and accelerations."""
    found = [(name, eliminate(functions[name], f"value_{name}")) for name in VALUES if name in functions]
    if jacobians:
        found.append(("jac_impl", jacobian(functions["impl"], "jac_impl")))
    if "jac_exp" in functions:
        found.append(("jac_exp1", eliminate(functions["jac_exp"], "jac_exp")))
    return found


def make_functions(
    author: str, named: Iterable[tuple[str, ca.Function]], workshop: Workshop, report: Report = lambda _: None
) -> list[Candidate]:
    """Write CasADi's functions as C, with both kinds of sines, and compile all but the largest."""
    own = of_model(workshop, author.lower().replace(" ", "_"))
    own.folder.mkdir(parents=True, exist_ok=True)
    listed = list(named)
    small = [(target, function) for target, function in listed if function.n_instructions() <= LARGEST]
    jobs = [job for target, function in small for job in _list_jobs(target, function, own.folder)]
    report(f"compiling: {AUTHORS[author]}")
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        compiled = list(pool.map(lambda job: job.make(author, own), jobs))
    large = [(target, function) for target, function in listed if function.n_instructions() > LARGEST]
    return compiled + [Candidate(author, target, f.name(), count_arithmetic(f), None) for target, f in large]


@dataclass(frozen=True)
class _Job:
    """One way to compile one function that CasADi has written as C."""

    target: str
    function: ca.Function
    source: Path
    symbol: str
    variant: str
    sines: Sines
    flags: tuple[str, ...]

    def make(self, author: str, workshop: Workshop) -> Candidate:
        """Compile it."""
        library = workshop.compile_c(self.source, self.symbol, self.flags)
        code = Function(library, self.symbol, describe_face(self.function))
        way = f"{self.symbol}{self.variant}"
        return Candidate(author, self.target, way, count_arithmetic(self.function), code, self.sines)


def _list_jobs(target: str, function: ca.Function, folder: Path) -> list[_Job]:
    name, size = function.name(), function.n_instructions()
    if size > LARGE:
        return [_Job(target, function, _write_source(function, folder), name, ", -O1", "libm", ("-O1", *EXPORTED))]
    sources: list[tuple[Sines, str, Path, tuple[str, ...]]] = [
        ("libm", name, _write_source(function, folder), EXPORTED)
    ]
    separated = separate(function) if size <= MIDDLE else None
    if separated is not None:
        outer = f"{name}_header"
        sources.append(("header", outer, write_source(separated, outer, folder), ("-DCASADI_SYMBOL_EXPORT=static",)))
    return [
        _Job(target, function, source, symbol, variant, sines, ("-O3", *visibility, *VARIANTS[variant]))
        for sines, symbol, source, visibility in sources
        for variant in (VARIANTS if size <= MIDDLE else (VECTORS,))
    ]


def _write_source(function: ca.Function, folder: Path) -> Path:
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    generator.generate(f"{folder}{os.sep}")
    return folder / f"{function.name()}.c"


def describe_face(function: ca.Function) -> Face:
    """Describe what a function in CasADi's contract takes and returns."""
    blocks = []
    for i, name in enumerate(function.name_out()):
        pattern = function.sparsity_out(i)
        rows, cols = pattern.get_triplet()
        blocks.append(Block(name, pattern.size1(), pattern.size2(), tuple(zip(rows, cols, strict=True))))
    return Face(tuple(function.name_in()), tuple(blocks), function.sz_iw(), function.sz_w())


# --- Pinocchio -----------------------------------------------------------------------------------------------------


def compile_pinocchio(workshop: Workshop) -> dict[Sines, Path]:
    """Compile Pinocchio's algorithms with each kind of sines."""
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        return dict(zip(SINES, pool.map(workshop.compile_pinocchio, SINES), strict=True))


def load_mechanism(library: Path, mechanism: Path) -> None:
    """Load a mechanism into Pinocchio's library. Raises BuildError."""
    if ctypes.CDLL(str(library)).pin_load(os.fsencode(mechanism)):
        raise BuildError(f"Pinocchio cannot read {mechanism}")


def describe_pinocchio(n: int, names: Iterable[str], libraries: dict[Sines, Path]) -> list[Candidate]:
    """List Pinocchio's algorithms in C++, for n joints; it has FUNCTIONS alone."""
    inverse, forward = ("q", "qd", "qdd", "u"), ("q", "qd", "u")
    faces = {
        "impl": Face(inverse, (dense("Phi", n, 1),)),
        "semi": Face(("q", "qd"), (dense("M", n, n), dense("c", n, 1))),
        "exp1": Face(forward, (dense("qdd", n, 1),)),
        "exp2": Face(forward, (dense("qdd", n, 1),)),
        "jac_impl": Face(inverse, tuple(dense(f"jac_Phi_{x}", n, n) for x in ("q", "qd", "qdd"))),
        "jac_exp2": Face(forward, tuple(dense(f"jac_qdd_{x}", n, n) for x in ("q", "qd", "Q"))),
    }
    return [
        Candidate(PINOCCHIO, name, f"pin_{name}", None, Function(library, f"pin_{name}", faces[name]), sines)
        for name in names
        for sines, library in libraries.items()
    ]
