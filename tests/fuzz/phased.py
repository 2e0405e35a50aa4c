"""Random problems of two phases with a link: sums of two problems that `problems` compares, and the rows of the link.

Both phases have independent motions. So each row that carries a state over has their distance as its value.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import yaml

from mbsgen.errors import InputError
from mbsrun.ocp.checks import ProblemError
from mbsrun.ocp.phases.guess import solve_links
from mbsrun.ocp.phases.linking import Defined
from mbsrun.ocp.phases.solution import Guess
from mbsrun.ocp.phases.solve import PhasedSolver
from mbsrun.ocp.phases.statement import read_phased_problem
from mbsrun.ocp.plant import Plant
from tests.fuzz.formulas import Formula, draw_quantity, write
from tests.fuzz.mechanisms import Tally
from tests.fuzz.own_motion import NoMotionError
from tests.fuzz.own_problem import Problem
from tests.fuzz.own_sections import Demand, Sections
from tests.fuzz.problem_derivatives import find_wrong_derivatives
from tests.fuzz.problem_drawing import Data, Drawing
from tests.fuzz.problem_names import Mechanical, spell
from tests.fuzz.problems import SAME, SHARED, compare_numbers, convert, load_mechanism

LIMITS = (-1.3, 1.7)
WEIGHT = 0.37
ATTEMPTS = 20  # problems drawn for a phase


def draw(seed: int) -> tuple[Data, Plant]:
    """Draw a problem of two phases. Raises NoMotionError where the mechanism is closed, driven, or turns freely."""
    _, plant = load_mechanism(seed // SHARED)
    manifest = plant.manifest
    if manifest.configuration or manifest.dependent or manifest.driven:
        raise NoMotionError("links are drawn for trees without quaternions")
    own, pick = Mechanical.of(manifest), random.Random(f"{seed} phases")
    first, second = (_draw_phase(own, f"{seed} {name}") for name in "ab")
    constants = first.pop("constants")
    second.pop("constants")
    second["start"] = {"pose": {}}
    names = [f"q_{spell(x)}" for x in own.positions] + [f"qd_{spell(x)}" for x in own.velocities]
    names += ["x_hand", "vz_hand", "T", *(f"u_{spell(x)}" for x in own.inputs)]
    sides = [f"{side}_{name}" for side in ("end", "start") for name in names]
    link: Data = {
        "from": "a",
        "to": "b",
        "conditions": [{"expression": draw_quantity(pick, sides), "range": [*LIMITS]}],
        "cost": [{"expression": draw_quantity(pick, sides), "weight": WEIGHT}],
        "map": {x: None for x in second.get("states", {}) if x not in first.get("states", {})},
    }
    phases = [{"name": "a", **first}, {"name": "b", **second}]
    return {"model": "model.yaml", "constants": constants, "phases": phases, "links": [link]}, plant


def _draw_phase(own: Mechanical, seed: str) -> Data:
    """Draw a problem without numbers of the whole horizon, which phases share."""
    for attempt in range(ATTEMPTS):
        data = Drawing(own, f"{seed} {attempt}").problem()
        is_soft = any("soft" in part for part in data["constraints"])
        if not ("unknowns" in data or "largest" in data["cost"] or is_soft):
            return {key: value for key, value in data.items() if key not in ("model", "solver")}
    raise NoMotionError("every problem has numbers of the whole horizon")


def examine(data: Data, plant: Plant, seed: int) -> str:
    """Compare a problem of phases with this program. Raises InputError, ProblemError where it is refused."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "problem.ocp.yaml")
        file.write_text(yaml.safe_dump(write(data), sort_keys=False), encoding="utf-8")
        stated, plants = read_phased_problem(file, lambda _: plant)
    solver, own = PhasedSolver(stated, plants), Mechanical.of(plant.manifest)
    sections = []
    for phase in data["phases"]:
        problem = Problem({**phase, "constants": data["constants"]}, own, plant, f"{seed} {phase['name']}")
        sections.append(Sections(problem, problem.move(), plant.manifest))
    whole, motions = solver.transcription, [part.motion for part in sections]
    guess = [convert(motion, phase.problem) for motion, phase in zip(motions, stated.phases, strict=True)]
    x = whole.pack(stated, Guess(tuple(guess), ()))
    defined = [Defined(whole.see(part.variables), whole.see_rows(part.rows)) for part in whole.defined]
    functions, p = solver.program.casadi, whole.parameters(stated)
    x = solve_links(
        x,
        tuple(defined),
        lambda x: functions.constraint(x, p).full().ravel(),
        lambda x: functions.jacobian(x, p).sparse(),
    )
    (link,) = data["links"]
    known = {f"end_{name}": value for name, value in sections[0].last.items()}
    known |= {f"start_{name}": value for name, value in sections[1].first.items()}
    costs = sum(sum(part.list_costs().values()) for part in sections)
    costs += WEIGHT * float(link["cost"][0]["expression"].evaluate(known)[0])
    found, faults = float(functions.objective(x, p)), []
    if abs(found - costs) > SAME * (1 + abs(costs)):
        faults.append(f"the cost is {found:.9g}, not {costs:.9g}")
    g, bounds = functions.constraint(x, p).full().ravel(), whole.constraint_bounds(stated)
    numbers = [
        (float(value), float(low), float(high))
        for values, (lower, upper) in ((x, whole.variable_bounds(stated)), (g, bounds))
        for value, low, high in zip(values, lower, upper, strict=True)
        if np.isfinite((low, high)).any() and not (low == high and abs(value - low) <= SAME * (1 + abs(low)))
    ]
    missing, left = compare_numbers(numbers, list(_list_demands(sections, link, known)))
    faults += [*missing, *(f"{value:.9g} in [{low:.9g}, {high:.9g}] is not asked for" for value, low, high in left)]
    faults += find_wrong_derivatives(functions, p, bounds, x, np.random.default_rng(seed))
    return "; ".join(faults)


def _list_demands(sections: list[Sections], link: Data, known: dict[str, np.ndarray]) -> Iterator[Demand]:
    """List the limits of both phases, without the start of the second one, and the conditions of the link."""
    first, second = sections
    own, condition = first.own, link["conditions"][0]["expression"]
    starts = {f"start {x}" for x in (*own.positions, *own.velocities)}
    yield from first.list_demands()
    yield from (x for x in second.list_demands() if x.title not in starts)
    assert isinstance(condition, Formula)
    yield Demand("the condition of the link", condition.evaluate(known), LIMITS)
    before, after = first.motion, second.motion
    distances = [*(after.q[0] - before.q[-1]), *(after.qd[0] - before.qd[-1])]
    kept = [x for x in after.states if x in before.states and x not in link["map"] and x[0] != "@"]
    distances += [after.states[x][0] - before.states[x][-1] for x in kept]
    yield Demand("the distance of a state over the link", np.array(distances), (0.0, 0.0))


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine problems of phases from a seed on."""
    tally = Tally()
    for number in range(seed, seed + count):
        try:
            data, plant = draw(number)
            finding = examine(data, plant, number)
        except (InputError, ProblemError, NoMotionError) as error:
            tally.refused.append((number, str(error).splitlines()[0]))
        except Exception as error:
            tally.findings.append((number, f"{type(error).__name__}: {error}"))
        else:
            tally.agreed += not finding
            if finding:
                tally.findings.append((number, finding))
        if keep is not None and tally.findings and tally.findings[-1][0] == number:
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"phases_{number}.ocp.yaml").write_text(yaml.safe_dump(write(data), sort_keys=False), "utf-8")
        show(number, tally)
    return tally
