"""Random problems of two phases with one link or a cycle of two: sums of problems that `problems` compares, and links.

Both phases have independent motions. So each row that carries a state over has their distance as its value.
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.guessing.phases import solve_links
from mbsrun.ocp.problem.phases import PhasedProblem, Plants
from mbsrun.ocp.solution.phases import Guess
from mbsrun.ocp.solving.phases import PhasedSolver
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.transcription.linking import Defined
from tests.fuzz import own_delays
from tests.fuzz.formulas import write
from tests.fuzz.mechanisms import Tally
from tests.fuzz.own_links import HIT, POINT, Crossing, Linking
from tests.fuzz.own_motion import Motion, NoMotionError
from tests.fuzz.own_problem import Problem
from tests.fuzz.own_sections import Demand, Sections
from tests.fuzz.problem_derivatives import find_wrong_derivatives
from tests.fuzz.problem_drawing import Data, Drawing
from tests.fuzz.problem_names import Mechanical
from tests.fuzz.problems import SAME, SHARED, compare_numbers, convert, load_mechanism, make_folder

Array = NDArray[np.float64]

ATTEMPTS = 40  # problems drawn for a phase
DELAYED = 0.4  # of problems


@dataclass(frozen=True)
class Drawn:
    """A problem of two phases, their model, and the model of impacts."""

    data: Data
    plant: Plant
    hit: Plant


def draw(seed: int) -> Drawn:
    """Draw a problem of two phases. Raises NoMotionError where the mechanism is closed, driven, or turns freely."""
    _, plant = load_mechanism(seed // SHARED)
    manifest = plant.manifest
    if manifest.configuration or manifest.dependent or manifest.driven:
        raise NoMotionError("links are drawn for trees without quaternions")
    own, pick, hit = Mechanical.of(manifest), random.Random(f"{seed} phases"), load_hit(seed // SHARED)
    delays = random.Random(f"{seed} delays")
    is_delayed = delays.random() > 1 - DELAYED
    first, second = ({"name": name, **_draw_phase(own, f"{seed} {name}", is_delayed=is_delayed)} for name in "ab")
    constants = first.pop("constants")
    second.pop("constants")
    linking = Linking(own, hit, pick)
    pairs = [(first, second), (second, first)][: pick.choice([1, 2])]
    if is_delayed:
        own_delays.fit(first, second, own.inputs, delays)
    for _, target in pairs:
        target["start"] = {"pose": {}}
        own_delays.link(target, delays)
    links = [linking.draw(source, target) for source, target in pairs]
    return Drawn({"model": "model.yaml", "constants": constants, "phases": [first, second], "links": links}, plant, hit)


@lru_cache(maxsize=1)
def load_hit(number: int) -> Plant:
    """Load a mechanism with an open force at its sensor."""
    model, _ = load_mechanism(number)
    (place,) = (x for x in model["frames"] if x["name"] == POINT)
    own = {"name": POINT, "body": place["body"], "position": [*place["position"]]}
    wrench = own | {"frame": "base", "force": "input"}
    file = Path(make_folder().name, f"{number}_hit.yaml")
    changed = {**model, "wrenches": [*model.get("wrenches", ()), wrench]}
    file.write_text(yaml.safe_dump(changed, sort_keys=False), encoding="utf-8")
    return load_on_demand(file)


def _draw_phase(own: Mechanical, seed: str, *, is_delayed: bool) -> Data:
    """Draw a problem without numbers of the whole horizon, which phases share."""
    for attempt in range(ATTEMPTS):
        data = Drawing(own, f"{seed} {attempt}").problem()
        is_soft = any("soft" in part for part in data["constraints"])
        has_numbers = "references" in data or "unknowns" in data or "largest" in data["cost"] or is_soft
        if not has_numbers and (own_delays.can_fit(data) or not is_delayed):
            return {key: value for key, value in data.items() if key not in ("model", "solver")}
    raise NoMotionError("every problem has numbers of the whole horizon")


def examine(drawn: Drawn, seed: int, stated: tuple[PhasedProblem, Plants] | None = None) -> str:
    """Compare a problem of phases, or another stated one, with this program.

    Raises InputError, ProblemError where it is refused.
    """
    data, own = drawn.data, Mechanical.of(drawn.plant.manifest)
    solver, sections = PhasedSolver(*(stated or state(drawn))), []
    problem = solver.problem
    for phase in data["phases"]:
        own_problem = Problem({**phase, "constants": data["constants"]}, own, drawn.plant, f"{seed} {phase['name']}")
        sections.append(Sections(own_problem, own_problem.move(), drawn.plant.manifest))
    crossings = [_cross(link, sections, drawn.hit) for link in data["links"]]
    whole, functions = solver.transcription, solver.program.casadi
    p, x = whole.parameters(problem), pack(solver, [part.motion for part in sections])
    costs = sum(sum(part.list_costs().values()) for part in sections) + sum(crossing.cost for crossing in crossings)
    found, faults = float(functions.objective(x, p)), []
    if abs(found - costs) > SAME * (1 + abs(costs)):
        faults.append(f"the cost is {found:.9g}, not {costs:.9g}")
    g, bounds = functions.constraint(x, p).full().ravel(), whole.constraint_bounds(problem)
    numbers = [
        (float(value), float(low), float(high))
        for values, (lower, upper) in ((x, whole.variable_bounds(problem)), (g, bounds))
        for value, low, high in zip(values, lower, upper, strict=True)
        if np.isfinite((low, high)).any() and not (low == high and abs(value - low) <= SAME * (1 + abs(low)))
    ]
    missing, left = compare_numbers(numbers, list(_list_demands(sections, crossings)))
    faults += [*missing, *(f"{value:.9g} in [{low:.9g}, {high:.9g}] is not asked for" for value, low, high in left)]
    faults += find_wrong_derivatives(functions, p, bounds, x, np.random.default_rng(seed))
    return "; ".join(faults)


def state(drawn: Drawn) -> tuple[PhasedProblem, Plants]:
    """Read the file of a problem as any user's. Raises InputError."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "problem.ocp.yaml")
        file.write_text(yaml.safe_dump(write(drawn.data), sort_keys=False), encoding="utf-8")
        return read_phased_problem(file, lambda path: drawn.hit if path.name == HIT else drawn.plant)


def pack(solver: PhasedSolver, motions: list[Motion]) -> Array:
    """Return the variables at motions of the phases; links give theirs."""
    stated, whole, functions = solver.problem, solver.transcription, solver.program.casadi
    guess = [convert(motion, phase.problem) for motion, phase in zip(motions, stated.phases, strict=True)]
    defined = [Defined(whole.see(part.variables), whole.see_rows(part.rows)) for part in whole.defined]
    p = whole.parameters(stated)
    return solve_links(
        whole.pack(stated, Guess(tuple(guess), ())),
        tuple(defined),
        lambda x: functions.constraint(x, p).full().ravel(),
        lambda x: functions.jacobian(x, p).sparse(),
    )


def _cross(link: Data, sections: list[Sections], hit: Plant) -> Crossing:
    """Follow a link; its impact has the parameters of the phase before it."""
    before, after = (sections["ab".index(link[key])] for key in ("from", "to"))
    values = before.data.get("parameters", {})
    plant = hit.with_parameters(**{name: before.problem.number(x) for name, x in values.items()})
    return Crossing(link, before, after, plant)


def _list_demands(sections: list[Sections], crossings: list[Crossing]) -> Iterator[Demand]:
    """List the limits of both phases, without starts that links give, and of the links."""
    own = sections[0].own
    starts = {f"start {x}" for x in (*own.positions, *own.velocities)}
    for part in sections:
        is_given = any(crossing.after is part for crossing in crossings)
        yield from (x for x in part.list_demands() if not (is_given and x.title in starts))
    for crossing in crossings:
        yield from crossing.list_demands()


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine problems of phases from a seed on."""
    tally = Tally()
    for number in range(seed, seed + count):
        try:
            drawn = draw(number)
            finding = examine(drawn, number)
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
            (keep / f"phases_{number}.ocp.yaml").write_text(yaml.safe_dump(write(drawn.data), sort_keys=False), "utf-8")
        show(number, tally)
    return tally
