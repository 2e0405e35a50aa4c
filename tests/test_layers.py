"""Each layer imports only what stands before it: read off the import statements, and off a running interpreter."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Package:
    """A package of the project, and whom its modules may know."""

    source: Path  # the folder of its `__init__.py`
    layers: tuple[str, ...]  # from low to high; modules side by side in one do not know each other
    foreign: tuple[str, ...]  # what no module of it imports
    guests: tuple[str, ...] = ()  # what every module may import all the same
    lazy: dict[str, str] = field(default_factory=dict)  # module: what it alone may import, within a function
    above: str = ""  # the package that it is a part of

    @property
    def name(self) -> str:
        """Return the dotted name by which modules import the package."""
        return f"{self.above}.{self.source.name}" if self.above else self.source.name


MBSGEN = Package(
    source=ROOT / "generator" / "mbsgen",
    layers=(
        "errors quick_classes quick_imports resources roles style algebra",
        "manifest expressions",
        "machine",
        "documents help",
        "robots",
        "model",
        "importing",
        "tape",
        "procedure",
        "formulations",
        "assembly.mechanism assembly.results",
        "assembly.poses assembly.choice",
        "assembly.readings",
        "assembly.loops assembly.findings",
        "assembly",
        "request",
        "derivatives",
        "targets",
        "families",
        "approximation.moments approximation.states",
        "approximation.cuts",
        "approximation.effects",
        "approximation.slopes",
        "approximation.choice",
        "approximation",
        "scene_tables verification.states",
        "evidence",
        "verification.geometry",
        "verification.loops",
        "verification.functions",
        "verification.derivatives",
        "verification.verify",
        "verification",
        "equations.sums",
        "equations.named",
        "equations.motion",
        "equations.lines",
        "equations.printing",
        "equations",
        "arrows",
        "picture report drawing appearance output renumbering scaling oracle interpreted closed_comparison formulas",
        "comparison opensim_script",
        "osim_comparison",
        "subjects.osim subjects.posing subjects.segments subjects.settings",
        "subjects.plain",
        "subjects.reading subjects.scaling",
        "subjects.schema",
        "subjects",
        "pipeline",
        "browser",
        "commands",
        "cli",
        "__main__",
    ),
    foreign=("casadi", "mbsrun"),
)
MBSRUN = Package(
    source=ROOT / "python" / "mbsrun",
    layers=(
        "trust limits forms reading smoothness stack",
        "cache",
        "library models bare",
        "webassembly",
        "binding environment",
        "many",
        "kernel",
        "external",
        "ocp.ground.factors ocp.ground.functions ocp.ground.grid ocp.ground.linear ocp.ground.memory "
        "ocp.ground.plant ocp.ground.schemes ocp.ground.status ocp.ground.trajectory",
        "ocp.ground.formulas ocp.ground.integrators ocp.ground.no_mechanism ocp.ground.program "
        "ocp.ground.representations",
        "ocp.ground.inputs",
        "ocp.ground",
        "appearance",
        "skeleton quaternions",
        "closure quantities metabolics jets differentiation",
        "results curves",
        "animation",
        "recordings.recording",
        "recordings.lines recordings.splines",
        "recordings.tables recordings.c3d recordings.markers recordings.storage",
        "recordings.reading recordings.references recordings.fitting recordings.pictures",
        "recordings",
        "subjects",
        "simulation",
        "rollouts",
        "motions",
        "faces faces.operators",
        "faces.face",
        "faces.stepping",
        "jax.foreign torch.calls",
        "jax.primitives",
        "jax.functions torch.functions",
        "jax torch",
        "cuda.nvrtc",
        "cuda.driver cuda.images",
        "cuda.arrays",
        "cuda.functions",
        "cuda",
        "fmu",
        "linearisation.equations",
        "linearisation.pictures",
        "linearisation",
        "identification.settings",
        "identification.unknowns",
        "identification.equations identification.result",
        "identification.structure identification.reading identification.physical",
        "identification.estimation identification.writing identification.pictures",
        "identification.identify",
        "identification.excitation",
        "identification",
        "ocp.problem.problem",
        "ocp.problem.conditions ocp.problem.contacts ocp.problem.design ocp.problem.driving ocp.problem.given "
        "ocp.problem.phases ocp.problem.rewriting ocp.problem.structure",
        "ocp.problem.touching",
        "ocp.problem",
        "ocp.evaluation.elimination ocp.evaluation.stages",
        "ocp.evaluation.backends",
        "ocp.evaluation.values",
        "ocp.evaluation",
        "ocp.methods.options",
        "ocp.methods.method",
        "ocp.methods.nlpsol ocp.methods.scaling ocp.methods.stages",
        "ocp.methods.stacks",
        "ocp.methods.ipopt",
        "ocp.methods.sqp",
        "ocp.methods",
        "ocp.solution.record",
        "ocp.solution.solution",
        "ocp.solution.phases ocp.solution.table",
        "ocp.solution",
        "ocp.transcription.addition ocp.transcription.layout",
        "ocp.transcription.chain ocp.transcription.closing ocp.transcription.quantities",
        "ocp.transcription.writing",
        "ocp.transcription.transcription",
        "ocp.transcription.clashes ocp.transcription.scales ocp.transcription.sides",
        "ocp.transcription.linking ocp.transcription.standing",
        "ocp.transcription.delays ocp.transcription.impacts",
        "ocp.transcription.phases",
        "ocp.transcription",
        "ocp.statement.checks ocp.statement.orienting",
        "ocp.statement.phase_checks ocp.statement.sections ocp.statement.surplus",
        "ocp.statement.muscles ocp.statement.phase_sections ocp.statement.referring",
        "ocp.statement.parts",
        "ocp.statement.restating",
        "ocp.statement.statement",
        "ocp.statement.phases",
        "ocp.statement",
        "ocp.guessing.mirror ocp.guessing.state_guess",
        "ocp.guessing.guess",
        "ocp.guessing.sizes",
        "ocp.guessing.phases ocp.guessing.recorded ocp.guessing.starts",
        "ocp.guessing.recorded_phases",
        "ocp.guessing",
        "ocp.solving.answers ocp.solving.assembly ocp.solving.branches ocp.solving.margins "
        "ocp.solving.optimality ocp.solving.placing ocp.solving.preparation ocp.solving.singularities "
        "ocp.solving.stepping",
        "ocp.solving.riding",
        "ocp.solving.following ocp.solving.judging ocp.solving.polishing ocp.solving.resimulation ocp.solving.stacked",
        "ocp.solving.runs",
        "ocp.solving.phases",
        "ocp.solving.nearby ocp.solving.solve",
        "ocp.solving.certificate ocp.solving.fixing",
        "ocp.solving",
        "ocp.optima.held ocp.optima.lifting ocp.optima.status ocp.optima.symmetric",
        "ocp.optima.interior ocp.optima.thinning",
        "ocp.optima.point",
        "ocp.optima.movement",
        "ocp.optima.neighbours ocp.optima.questions",
        "ocp.optima.family ocp.optima.sensitivity",
        "ocp.optima",
        "ocp.searching.refinement ocp.searching.study",
        "ocp.searching.attempts",
        "ocp.searching.trials",
        "ocp.searching.search",
        "ocp.searching.executor",
        "ocp.searching.cluster",
        "ocp.searching.multistart",
        "ocp.searching.phases",
        "ocp.searching",
        "ocp.showing.pictures ocp.showing.summary",
        "ocp.showing.phase_pictures ocp.showing.phase_summary",
        "ocp.showing.files",
        "ocp.showing",
        "ocp.cases.programs",
        "ocp.cases.placing",
        "ocp.cases.cases",
        "ocp.cases.told",
        "ocp.cases.dispatch",
        "ocp.cases",
        "ocp",
        "optimal.display optimal.plain optimal.describing optimal.recalling",
        "optimal.progress optimal.result",
        "optimal.quantities optimal.guessing optimal.simulation",
        "optimal.expressions optimal.naming",
        "optimal.many optimal.derivatives",
        "optimal.layers optimal.continuation optimal.scenarios",
        "optimal.phases",
        "optimal.control",
        "optimal",
        "peers.peer",
        "peers",
        "controllers.folder controllers.refusals",
        "controllers.fields controllers.arrays controllers.sources",
        "controllers.loading",
        "controllers.emulation",
        "controllers.report controllers.writing",
        "controllers.making",
        "controllers",
        "playground.machine playground.scene",
        "playground.page",
        "playground",
        "tracking.trial tracking.controller",
        "tracking.added",
        "tracking.compiled tracking.plant tracking.solving tracking.statement",
        "tracking.loop tracking.mechanisms",
        "tracking.analysis",
        "tracking.pictures",
        "tracking.record",
        "tracking schemas",
        "measuring.points measuring.functions measuring.mechanisms measuring.reference measuring.sections "
        "measuring.store",
        "measuring.timing measuring.captions measuring.fronts measuring.page",
        "measuring.growth",
        "measuring.pictures",
        "measuring.candidates",
        "measuring.fidelity measuring.kernels measuring.motions measuring.solves",
        "measuring.optima",
        "measuring.advice measuring.explorer measuring.panels",
        "measuring.charts measuring.overview measuring.surveys",
        "measuring",
        "commands.console",
        "commands.searching commands.failures commands.columns commands.derived",
        "commands.animated commands.robots commands.studies",
        "commands.recorded",
        "commands.cases commands.starts",
        "commands.advise commands.animate commands.cache commands.chart commands.continue_ commands.controller "
        "commands.cuda commands.excite commands.fit_motion commands.fmu commands.identify commands.inverse "
        "commands.inverse_dynamics commands.lab commands.linearise commands.playground commands.range "
        "commands.scale commands.simulate commands.solve commands.study commands.sweep commands.track",
        "commands",
        "cli",
        "__main__",
    ),
    foreign=("sympy", "mbsgen", "studies", "benchmarks"),
    guests=(
        "mbsgen.errors",
        "mbsgen.quick_classes",
        "mbsgen.quick_imports",
        "mbsgen.resources",
        "mbsgen.manifest",
        "mbsgen.machine",
        "mbsgen.roles",
        "mbsgen.expressions",
        "mbsgen.help",
        "mbsgen.robots",
        "mbsgen.documents",
        "mbsgen.style",
    ),
    # a model file given for a generated folder; formulas and controllers in C, and their folders; equations in 50
    # digits
    lazy={
        "models": "mbsgen.pipeline",
        "ocp.evaluation.stages.formulas": "mbsgen.formulas",
        "fmu": "mbsgen.targets",
        "commands.fmu": "mbsgen.targets",
        "cuda.images": "mbsgen.targets",
        "controllers.writing": "mbsgen.targets",
        "controllers.making": "mbsgen.targets",
        "controllers.sources": "mbsgen.targets",
        "controllers.emulation": "mbsgen.targets",
        "commands.controller": "mbsgen.output",
        "measuring.reference": "mbsgen.oracle",
    },
)
DOCQUIER = Package(
    source=ROOT / "studies" / "docquier",
    layers=(
        "growth spread export published optima markdown",
        "results differentiated nonzeros earlier",
        "judges",
        "claims",
        "judgement figures",
        "questions robustness tables",
        "summary",
        "campaign",
        "command",
        "__main__",
    ),
    foreign=("sympy", "mbsgen", "benchmarks", "mbsrun.cli", "studies.laboratory"),
    guests=MBSRUN.guests,
    lazy={"growth": "mbsgen.scaling"},  # operations of chains
    above="studies",
)
LABORATORY = Package(
    source=ROOT / "studies" / "laboratory",
    layers=(
        "case mechanisms",
        "ends",
        "digits integration optimisation runs",
        "interpretation",
        "chains compilation derivatives events expressions inertias limits locks loops modelling orientations",
        "cases maps stability",
        "stability_map",
        "command",
    ),
    foreign=("sympy", "mbsgen", "benchmarks", "mbsrun.cli", "studies.docquier"),
    guests=MBSRUN.guests,
    lazy={"interpretation": "mbsgen.interpreted"},
    above="studies",
)
EXTRAS = ("jax", "torch")  # parts of mbsrun that need a library which is installed for them alone
PACKAGES = (MBSGEN, MBSRUN, DOCQUIER, LABORATORY)


@dataclass(frozen=True)
class Import:
    """An import statement: module `importer` of a package imports `target`, a dotted name."""

    importer: str  # without the package's name: "ocp.solve"; empty for the package's `__init__`
    target: str
    line: int
    lazy: bool  # within a function

    def __str__(self) -> str:
        return f"{self.importer or '__init__'}:{self.line} imports {self.target}"


def read_modules(package: Package) -> dict[str, list[Import]]:
    """Read the imports of every module of a package."""
    modules = {}
    for file in sorted(package.source.rglob("*.py")):
        *folders, name = file.relative_to(package.source).with_suffix("").parts
        module = ".".join(folders if name == "__init__" else [*folders, name])
        tree = ast.parse(file.read_text(encoding="utf-8"), str(file))
        lazy = {id(node) for function in ast.walk(tree) if is_function(function) for node in ast.walk(function)}
        modules[module] = [
            Import(module, target, statement.lineno, id(statement) in lazy)
            for statement in ast.walk(tree)
            if isinstance(statement, ast.Import | ast.ImportFrom)
            for target in targets(statement, (*package.name.split("."), *folders))
        ]
    return modules


def is_function(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)


def targets(statement: ast.Import | ast.ImportFrom, folder: tuple[str, ...]) -> Iterator[str]:
    """Name what a statement of a module in `folder` imports; `from a import b` is `a.b`, since b may be a module."""
    if isinstance(statement, ast.Import):
        yield from (alias.name for alias in statement.names)
    else:
        origin = folder[: len(folder) + 1 - statement.level] if statement.level else ()
        origin += (statement.module,) if statement.module else ()
        yield from (".".join((*origin, alias.name)) for alias in statement.names)


def covers(name: str, target: str) -> bool:
    """Return whether `target` is `name` or lies in it."""
    return target == name or target.startswith(name + ".")


def find_faults(package: Package) -> list[str]:
    """List the imports that the order of the layers forbids, and the modules that have no place in it."""
    level = {name: i for i, layer in enumerate(package.layers) for name in layer.split()}

    def layer(module: str) -> str | None:
        return max((name for name in level if covers(name, module)), key=len, default=None)

    def allows(found: Import) -> bool:
        own = package.name
        if covers(own, found.target):
            here, there = layer(found.importer), layer(found.target.removeprefix(own + "."))
            if there is None or here is None:  # the package's `__init__` is its face: above all, and known to none
                return not found.importer or found.target == f"{own}.__version__"
            return here == there or level[there] < level[here]
        if any(covers(name, found.target) for name in package.guests):
            return True
        if found.lazy and covers(package.lazy.get(found.importer, "-"), found.target):
            return True
        return not any(covers(name, found.target) for name in package.foreign)

    modules = read_modules(package)
    homeless = [f"{module} has no place in the order" for module in modules if module and layer(module) is None]
    return homeless + [str(found) for imports in modules.values() for found in imports if not allows(found)]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_every_module_imports_only_what_stands_before_it(package: Package) -> None:
    assert find_faults(package) == []


IMPORT_ALL = """
import importlib, sys
strangers = sys.argv[1].split()
for module in sys.argv[2:]:
    importlib.import_module(module)
sys.exit(", ".join(name for name in strangers if name in sys.modules) or None)
"""


def is_extra(module: str) -> bool:
    return any(covers(extra, module) for extra in EXTRAS)


@pytest.mark.parametrize(
    ("package", "strangers"),
    [(MBSGEN, ("casadi",)), (MBSRUN, ("sympy", "jax", "torch")), (DOCQUIER, ("sympy",)), (LABORATORY, ("sympy",))],
    ids=["mbsgen", "mbsrun", "studies.docquier", "studies.laboratory"],
)
def test_importing_a_whole_package_leaves_strangers_out(package: Package, strangers: tuple[str, ...]) -> None:
    """A module of another's could bring one in; so all modules are imported, and the interpreter is asked.

    The face of a library of arrays needs the library, and with it all that the library needs.
    """
    names = (f"{package.name}.{module}" for module in read_modules(package) if module and not is_extra(module))
    wanted = [name for name in (*names, *package.guests) if not name.endswith("__main__")]
    command = [sys.executable, "-c", IMPORT_ALL, " ".join(strangers), *wanted]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr  # the strangers that were imported


PLANTED = {
    "beside": ("library", "from mbsrun.models import f\n", ["library:1 imports mbsrun.models.f"]),
    "nothing": ("library", "import numpy\nfrom mbsgen.manifest import Manifest\n", []),
    "downward": ("kernel", "from mbsrun import library\nfrom mbsrun.library import load\n", []),
    "upward": ("library", "\nfrom mbsrun.kernel import Kernel\n", ["library:2 imports mbsrun.kernel.Kernel"]),
    "module": ("library", "from mbsrun import kernel\n", ["library:1 imports mbsrun.kernel"]),
    "plain": ("library", "import mbsrun.kernel\n", ["library:1 imports mbsrun.kernel"]),
    "relative": ("ocp/problem/problem", "from ...cli import main\n", ["ocp.problem.problem:1 imports mbsrun.cli.main"]),
    "sibling": ("ocp/ground/program", "from .. import problem\n", ["ocp.ground.program:1 imports mbsrun.ocp.problem"]),
    "in ocp": ("ocp/guessing/guess", "from .. import solving\n", ["ocp.guessing.guess:1 imports mbsrun.ocp.solving"]),
    "face": ("__init__", "from mbsrun.cli import main\n", []),
    "through the face": ("library", "from mbsrun import load\n", ["library:1 imports mbsrun.load"]),
    "version": ("library", "from mbsrun import __version__\n", []),
    "stranger": ("cli", "def f():\n    import sympy.core\n", ["cli:2 imports sympy.core"]),
    "namesake": ("cli", "import sympy_of_another_name\n", []),
    "generator": ("cli", "from mbsgen import tape\n", ["cli:1 imports mbsgen.tape"]),
    "lazy": ("models", "def f():\n    from mbsgen.pipeline import generate\n", []),
    "eager": ("models", "from mbsgen.pipeline import generate\n", ["models:1 imports mbsgen.pipeline.generate"]),
    "elsewhere": ("cli", "def f():\n    import mbsgen.pipeline\n", ["cli:2 imports mbsgen.pipeline"]),
    "typing": ("cli", "if TYPE_CHECKING:\n    import sympy\n", ["cli:2 imports sympy"]),
    "homeless": ("attic", "", ["attic has no place in the order"]),
}


@pytest.mark.parametrize(("module", "text", "faults"), PLANTED.values(), ids=PLANTED.keys())
def test_the_check_finds_what_is_planted(tmp_path: Path, module: str, text: str, faults: list[str]) -> None:
    file = tmp_path / "mbsrun" / f"{module}.py"
    file.parent.mkdir(parents=True)
    file.write_text(text, encoding="utf-8")
    planted = Package(tmp_path / "mbsrun", MBSRUN.layers, MBSRUN.foreign, MBSRUN.guests, MBSRUN.lazy)
    assert find_faults(planted) == faults


def test_no_test_file_is_imported() -> None:
    """Code that two test files share is in a module beside them: otherwise one depends on the other's import."""
    found = [
        f"{file.relative_to(ROOT)}:{statement.lineno} imports {target}"
        for folder in ("tests", "benchmarks", "studies")
        for file in sorted((ROOT / folder).rglob("*.py"))
        for statement in ast.walk(ast.parse(file.read_text(encoding="utf-8"), str(file)))
        if isinstance(statement, ast.Import | ast.ImportFrom)
        for target in targets(statement, ())
        if any(part.startswith("test_") for part in target.split(".")[:-1])
    ]
    assert found == []
