"""The outcome of a case as a record keeps it: numbers and a solution's file, by a hash of all that they follow from."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from dataclasses import asdict, dataclass

from pydantic import TypeAdapter

from mbsrun.ocp.cases.cases import Case, Outcome
from mbsrun.ocp.problem.phases import PhasedProblem, Plants
from mbsrun.ocp.showing.phase_summary import list_phased_shortcomings
from mbsrun.ocp.solution.phases import PhasedSolution, dump_phased_solution
from mbsrun.ocp.solution.solution import dump_solution


@dataclass(frozen=True)
class Told:
    """An outcome in plain numbers and texts."""

    status: str
    iterations: int
    cpu_seconds: float
    cost: float | None = None  # None: no solution
    defect: float | None = None  # the largest of the re-simulation; None: not known
    short: tuple[str, ...] = ()  # in what the solution falls short
    reason: str = ""  # why there is no solution, and what to do
    packed: str = ""  # the text of solution.json, compressed

    @property
    def is_good(self) -> bool:
        """Return whether there is a solution that does not fall short."""
        return self.cost is not None and not self.short

    @property
    def solution(self) -> str:
        """Return the text of solution.json; empty where there is no solution."""
        return zlib.decompress(base64.b64decode(self.packed)).decode() if self.packed else ""


def tell(outcome: Outcome) -> Told:
    """Return what is kept of an outcome."""
    run = outcome.run
    if not isinstance(outcome, PhasedSolution):
        return Told(run.status, run.iterations, run.cpu_seconds, reason=f"{outcome.finding}; {outcome.remedy}")
    is_single = outcome.problem.is_single
    text = dump_solution(outcome.single) if is_single else dump_phased_solution(outcome)
    checks = [phase.resimulation for phase in outcome.phases]
    defects = [None if check is None else check.defect for check in checks]
    return Told(
        run.status,
        run.iterations,
        run.cpu_seconds,
        outcome.cost,
        None if None in defects else max(defect for defect in defects if defect is not None),
        tuple(list_phased_shortcomings(outcome)),
        packed=base64.b64encode(zlib.compress(text.encode())).decode(),
    )


def write_told(told: Told) -> str:
    """Return the text that a record keeps."""
    return json.dumps(asdict(told))


def read_told(text: str) -> Told:
    """Read it back."""
    found = json.loads(text)
    return Told(**{**found, "short": tuple(found["short"])})


def name_case(case: Case, plants: Plants) -> str:
    """Return the key of a case: a hash of its models and its problem, threads left out, which change no result."""
    parts = TypeAdapter(PhasedProblem).dump_python(case.problem, mode="json", exclude={"solver": {"threads": True}})
    models = [plant.manifest.mechanism or plant.manifest.model_hash for plant in plants.every]
    told = json.dumps({"models": models, "problem": parts, "checked": case.is_checked}, sort_keys=True)
    return f"case {hashlib.sha256(told.encode()).hexdigest()}"
