"""Random problems of optimal control: their programs against `own_problem` and `own_sections`.

A motion is made that meets the equations of motion, and no other condition. The terms of the cost, and all numbers with
limits, are compared there: each number that the program limits is one that the file asks for, and the other way round.
Numbers have no order and no name in this comparison, so it needs nothing of the program's layout. Rows that are 0 there
are the equations of motion; their rank shows whether one is missing. At a point nearby, derivatives are compared with
differences.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem as Stated
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from tests.fuzz import loops, mechanisms
from tests.fuzz.formulas import write
from tests.fuzz.mechanisms import Tally
from tests.fuzz.own_motion import Motion, NoMotionError
from tests.fuzz.own_problem import Problem
from tests.fuzz.own_sections import Demand, Sections
from tests.fuzz.problem_derivatives import find_differing_backends, find_differing_tables, find_wrong_derivatives
from tests.fuzz.problem_drawing import Data, Drawing
from tests.fuzz.problem_names import Mechanical
from tests.fuzz.problem_solving import ease, find_wrong_solutions

Array = NDArray[np.float64]

CLOSED = 3  # one mechanism of this number has loops or driven joints, without quaternions
SHARED = 12  # problems of one mechanism, which is compiled once
BODIES = 3  # at most
WITH_SOLVES = 10  # one problem of this number is solved, after changes that make it feasible
WITH_TABLES = 3  # one problem of this number is written as tables of stages, which compiles its formulas
SAME = 1e-8  # relative, and absolute below 1: numbers that count as equal


@dataclass(frozen=True)
class Drawn:
    """A problem: its model, as data, and its file, with formulas."""

    model: Data
    data: Data
    seed: int


def draw(seed: int) -> tuple[Drawn, Plant]:
    """Draw a problem, and load the kernels of its mechanism. Raises MbsError for a mechanism that is refused."""
    model, plant = load_mechanism(seed // SHARED)
    return Drawn(model, Drawing(Mechanical.of(plant.manifest), seed).problem(), seed), plant


@lru_cache(maxsize=1)
def load_mechanism(number: int) -> tuple[Data, Plant]:
    """Draw a small mechanism with a sensor that the generator accepts, and load its kernels."""
    for attempt in range(SHARED * number, SHARED * (number + 1)):
        mechanism = loops.draw(attempt) if number % CLOSED == 0 else mechanisms.draw(attempt)
        model = mechanism.model
        if len(model["bodies"]) > BODIES or mechanism.scene:
            continue
        sensor = {"name": "hand", "body": model["bodies"][-1]["name"], "position": [0.1, -0.2, 0.3], "sensor": True}
        model["frames"] = [*model["frames"], sensor]
        file = Path(make_folder().name, f"{number}.yaml")
        file.write_text(yaml.safe_dump(model, sort_keys=False), encoding="utf-8")
        try:
            plant = load_on_demand(file)
        except InputError:
            continue
        manifest = plant.manifest
        if manifest.actuated and not (manifest.dependent and manifest.configuration):
            return model, plant
    raise NoMotionError("no mechanism is small, and accepted")


@lru_cache
def make_folder() -> tempfile.TemporaryDirectory[str]:
    """Make a folder for models, whose kernels are generated when they are first called."""
    return tempfile.TemporaryDirectory()


def state(drawn: Drawn, plant: Plant) -> tuple[Stated, Plant]:
    """Read the file of a problem as any user's. Raises InputError."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "problem.ocp.yaml")
        file.write_text(write_problem(drawn.data, Path(folder)), encoding="utf-8")
        return read_problem(file, lambda _: plant)


def write_problem(data: Data, folder: Path) -> str:
    """Write the recording of a problem into a folder; return the text of the problem's file."""
    given = {"references": data["references"].write(folder)} if "references" in data else {}
    return yaml.safe_dump(write({**data, **given}), sort_keys=False)


def examine(drawn: Drawn, plant: Plant) -> str:
    """Compare a problem with this program; return what differs. Raises InputError where it is refused."""
    stated, equipped = state(drawn, plant)
    comparison, sections = compare(drawn, plant, stated, equipped)
    faults = [comparison.run(sections)]
    solver, x, rng = comparison.solver, comparison.x, np.random.default_rng(drawn.seed)
    bounds = solver.transcription.constraint_bounds(stated)
    faults += find_wrong_derivatives(solver.program.casadi, comparison.p, bounds, x, rng)
    faults += find_differing_backends(stated, solver, x, rng)
    if drawn.seed % WITH_TABLES == 0:
        faults += find_differing_tables(stated, solver, solver.plant, x, rng)
    if has_multipliers(drawn.data, sections):
        faults += [f"by multipliers: {fault}" for fault in find_faults_of_multipliers(drawn, plant, sections)]
    if drawn.seed % WITH_SOLVES == 0:
        eased = replace(drawn, data=ease(drawn.data, sections.problem, sections.motion, sections))
        faults += find_wrong_solutions(*state(eased, plant))
    return "; ".join(fault for fault in faults if fault)


def has_multipliers(data: Data, sections: Sections) -> bool:
    """Return whether a problem can have all coordinates of a closed mechanism as variables."""
    is_standard = data.get("form", "standard") == "standard" and data["integrator"] == "collocation"
    return sections.own.is_closed and is_standard and data["scheme"] == "radau"


def find_faults_of_multipliers(drawn: Drawn, plant: Plant, sections: Sections) -> list[str]:
    """Compare a problem with all coordinates as variables: its costs and limits are the same, its equations are not.

    The motion is one of the reduced form, so the equations of motion have residuals, and are left out.
    """
    stated, equipped = state(replace(drawn, data={**drawn.data, "loops": "multipliers"}), plant)
    comparison = Comparison(stated, Solver(stated, equipped), sections.motion)
    faults = comparison.run_without_equations(sections)
    solver, x, rng = comparison.solver, comparison.x, np.random.default_rng(drawn.seed)
    bounds = solver.transcription.constraint_bounds(stated)
    faults += find_wrong_derivatives(solver.program.casadi, comparison.p, bounds, x, rng)
    faults += find_differing_backends(stated, solver, x, rng)
    if drawn.seed % WITH_TABLES == 0:
        faults += find_differing_tables(stated, solver, solver.plant, x, rng)
    return faults


def compare(drawn: Drawn, plant: Plant, stated: Stated, equipped: Plant) -> tuple[Comparison, Sections]:
    """Prepare the comparison of the program of a stated problem with a drawn one."""
    own = Problem(drawn.data, Mechanical.of(plant.manifest), plant, drawn.seed)
    motion = own.move()
    return Comparison(stated, Solver(stated, equipped), motion), Sections(own, motion, plant.manifest)


class Comparison:
    """A program at a motion."""

    def __init__(self, stated: Stated, solver: Solver, motion: Motion) -> None:
        self.stated, self.solver, self.motion = stated, solver, motion
        self.transcription, self.functions = solver.transcription, solver.program.casadi
        self.x = self.transcription.pack(convert(motion, stated))
        self.p = self.transcription.parameters(stated)
        self.faults: list[str] = []

    def run(self, sections: Sections) -> str:
        """Compare everything; return what differs."""
        self.compare_motion()
        self.compare_costs(sections.list_costs())
        zeros = self.compare_demands(sections.list_demands(), sections.find_attitudes())
        self.compare_rank(zeros)
        return "; ".join(self.faults)

    def run_without_equations(self, sections: Sections) -> list[str]:
        """Compare the motion, its cost, and its limits, where the equations of motion are others."""
        self.compare_motion()
        self.compare_costs(sections.list_costs())
        missing, _ = compare_numbers(self.list_numbers(), sections.list_demands())
        return [*self.faults, *missing]

    def list_numbers(self) -> list[Limited]:
        """List all variables and rows that have limits."""
        g = self.functions.constraint(self.x, self.p).full().ravel()
        parts = (
            (self.x, *self.transcription.variable_bounds(self.stated)),
            (g, *self.transcription.constraint_bounds(self.stated)),
        )
        every = [x for part in parts for x in zip(*(values.tolist() for values in part), strict=True)]
        return [x for x in every if np.isfinite(x[1:]).any()]

    def compare_motion(self) -> None:
        """Compare the states that the program has, or finds, with the motion."""
        found = self.transcription.unpack(self.functions.complete(self.x))
        for name in ("q", "qd", "point_q", "point_qd", "t", "point_t"):
            self.judge(name, getattr(found, name), getattr(self.motion, name))

    def compare_costs(self, wanted: dict[str, float]) -> None:
        """Compare the terms of the cost that are not 0, in any order."""
        terms = self.functions.terms(self.x, self.p).full().ravel() * self.stated.cost.weights
        self.judge("cost", np.array(float(self.functions.objective(self.x, self.p))), np.array(sum(wanted.values())))
        left = [(value, name) for value, name in zip(terms, self.stated.cost.names, strict=True) if abs(value) > SAME]
        for name, value in wanted.items():
            if abs(value) <= SAME:
                continue
            near = min(left, key=lambda term: abs(term[0] - value), default=(np.inf, ""))
            if abs(near[0] - value) > SAME * (1 + abs(value)):
                self.faults.append(f"cost: no term is {name} = {value:.9g}")
            else:
                left.remove(near)
        self.faults += [f"cost: {name} = {value:.9g} is not asked for" for value, name in left]

    def compare_demands(self, demands: Sequence[Demand], attitudes: Sequence[float]) -> NDArray[np.int64]:
        """Compare the numbers with limits; return the rows that hold the equations of motion."""
        x, p, own = self.x, self.p, self.transcription
        g = self.functions.constraint(x, p).full().ravel()
        lower, upper = own.constraint_bounds(self.stated)
        zeros = (lower == upper) & (abs(g - lower) <= SAME * (1 + abs(lower)))
        least, most = own.variable_bounds(self.stated)
        known = (least == most) & (abs(x - least) <= SAME)
        numbers = [
            (float(value), float(low), float(high))
            for values, lows, highs, left in ((x, least, most, ~known), (g, lower, upper, ~zeros))
            for value, low, high in zip(values[left], lows[left], highs[left], strict=True)
            if np.isfinite(low) or np.isfinite(high)
        ]
        faults, left = compare_numbers(numbers, demands)
        self.faults += faults
        if attitudes and len(left) == 3 * len(attitudes):
            self.judge("attitudes", np.array(sum(value**2 for value, *_ in left)), np.array(sum(attitudes)))
            left = []
        self.faults += [f"{value:.9g} in [{low:.9g}, {high:.9g}] is not asked for" for value, low, high in left]
        return np.flatnonzero(zeros)

    def compare_rank(self, zeros: NDArray[np.int64]) -> None:
        """Check that the equations of motion leave as many variables free as a motion has."""
        J = self.functions.jacobian(self.x, self.p).full()[zeros]
        left = len(self.x) - int(np.linalg.matrix_rank(J, tol=1e-9)) if len(zeros) else len(self.x)
        layout, stated = self.transcription.layout, self.stated
        starts = layout.mesh.shape[1] + len(stated.every_state)
        inputs = (
            layout.every_input.size
            + sum(x.expression is None for x in stated.every_component) * self.motion.point_t.size
        )
        common = (layout.horizon is not None) + len(np.union1d(layout.unknowns, layout.design))
        wanted = starts + inputs + common - self.count_lengths(zeros)
        if left != wanted:
            self.faults.append(f"the equations of motion leave {left} variables free, not {wanted}")

    def count_lengths(self, zeros: NDArray[np.int64]) -> int:
        """Count the equations of motion that are conditions on the start."""
        rows = self.transcription.rows
        kept = list(self.transcription.program.kept_rows)
        every = (rows.start, rows.lengths, rows.extras.start, rows.start_closure, rows.driven_start)
        own = {kept.index(i) for part in every for i in part}
        return len(own & set(zeros.tolist()))

    def judge(self, name: str, found: Array, wanted: Array) -> None:
        """Compare arrays."""
        if found.shape != wanted.shape:
            self.faults.append(f"{name} has the shape {found.shape}, not {wanted.shape}")
            return
        off = float((abs(found - wanted) / (1 + abs(wanted))).max(initial=0))
        if not off <= SAME:
            self.faults.append(f"{name} by {off:.1e}")


Limited = tuple[float, float, float]  # a number, and its limits


def compare_numbers(numbers: Sequence[Limited], demands: Sequence[Demand]) -> tuple[list[str], list[Limited]]:
    """Return the demands that no number meets, and the numbers that no demand names."""
    used, faults = [False] * len(numbers), []
    table = np.array(numbers).reshape(-1, 3)
    for demand in demands:
        low, high = demand.limits
        fits = np.flatnonzero(match(table[:, 1], low) & match(table[:, 2], high))
        for value in demand.values:
            if low == high and abs(value - low) <= SAME * (1 + abs(low)):
                continue
            hits = [i for i in fits if abs(table[i, 0] - value) <= SAME * (1 + abs(value))]
            for i in hits:
                used[i] = True
            if not hits and not demand.is_optional:
                faults.append(f"no limits [{low:.9g}, {high:.9g}] of {demand.title} = {value:.9g}")
    return faults, [number for number, is_used in zip(numbers, used, strict=True) if not is_used]


def match(values: Array, limit: float) -> NDArray[np.bool_]:
    """Return which limits are the same."""
    return np.asarray(np.isclose(values, limit, rtol=SAME, atol=SAME))


def convert(motion: Motion, stated: Stated) -> Trajectory:
    """Return a motion as the program takes it, by the names that the problem adds."""
    names, added = stated.added, motion.states
    N, d = motion.point_t.shape
    is_constant = stated.inputs == "constant"

    def gather(names: Sequence[str], of: dict[str, Array], shape: tuple[int, ...]) -> Array:
        return np.stack([of[name] for name in names], axis=-1) if names else np.zeros((*shape, 0))

    controls = gather(names.controls, motion.controls, (N, d))
    return Trajectory(
        t=motion.t,
        q=motion.q,
        qd=motion.qd,
        u=motion.u[:, 0] if is_constant else motion.u.mean(axis=1),
        point_t=motion.point_t,
        point_q=motion.point_q,
        point_qd=motion.point_qd,
        point_qdd=motion.point_qdd,
        states=gather(names.states, added, (N + 1,)),
        point_states=gather(names.states, motion.point_states, (N, d)),
        controls=controls[:, 0] if is_constant else controls.mean(axis=1),
        point_controls=np.zeros((N, d, 0)) if is_constant else controls,
        point_u=motion.u if not is_constant or stated.forces else np.zeros((N, d, 0)),
        point_w=motion.w,
        unknowns=np.array([motion.unknowns[name] for name in names.unknowns]),
    )


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine problems from a seed on."""
    tally = Tally()
    for number in range(seed, seed + count):
        drawn: Drawn | None = None
        try:
            drawn, plant = draw(number)
            finding = examine(drawn, plant)
        except (InputError, ProblemError) as error:
            tally.refused.append((number, str(error).splitlines()[0]))
        except NoMotionError as error:
            tally.refused.append((number, f"the independent program: {error}"))
        except Exception as error:
            tally.findings.append((number, f"{type(error).__name__}: {error}"))
        else:
            if finding:
                tally.findings.append((number, finding))
            else:
                tally.agreed += 1
        if tally.findings and tally.findings[-1][0] == number and keep is not None and drawn is not None:
            keep_files(keep, drawn, tally.findings[-1][1])
        show(number, tally)
    return tally


def keep_files(folder: Path, drawn: Drawn, finding: str) -> None:
    """Keep a problem and its model, with the finding."""
    own = folder / f"problem_{drawn.seed}"
    own.mkdir(parents=True, exist_ok=True)
    (own / "model.yaml").write_text(yaml.safe_dump(drawn.model, sort_keys=False), encoding="utf-8")
    text = f"# seed {drawn.seed}: {finding}\n{write_problem(drawn.data, own)}"
    (own / "problem.ocp.yaml").write_text(text, encoding="utf-8")
