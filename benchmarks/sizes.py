"""Chains of 1 to 1000 joints -> a chart of time, operations, errors and costs of making; `python -m benchmarks.sizes`.

Four formulations as generated C (M of long chains by loops over tables), matrices by calls in a loop with LAPACK,
equations interpreted without a compiler, and Pinocchio in C++. Errors are of accelerations against 50 digits, the
largest relative to the largest acceleration.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks.candidates import PINOCCHIO, Candidate
from benchmarks.compilation import BuildError, Workshop, describe_flags, describe_machine, find_cache, find_includes
from benchmarks.growth import Made, Mechanism, make_kernels
from benchmarks.mechanism import write_mechanism
from benchmarks.preparation import Sizes, compile_pinocchio, describe_pinocchio, load_mechanism
from benchmarks.study import Entry, draw_states, load
from mbsgen.errors import MbsError
from mbsgen.interpreted import Interpreted
from mbsgen.pipeline import read_tree
from mbsgen.roles import choose_quickest
from mbsrun.measuring.fronts import DIGIT, Dot
from mbsrun.measuring.growth import Growth
from mbsrun.measuring.mechanisms import write_chain
from mbsrun.measuring.pictures import draw_panels
from mbsrun.measuring.store import Store
from mbsrun.measuring.timing import Watch, measure_rounds
from mbsrun.models import fingerprint_generator
from studies.laboratory.digits import relate
from studies.laboratory.interpretation import LongChain, eliminate

Array = NDArray[np.float64]
States = Mapping[str, Array]

SIZES = (1, 2, 3, 4, 6, 8, 12, 16, 32, 64, 128, 256, 512, 1000)
ACCELERATIONS, TORQUES, MASS = "accelerations", "torques", "mass matrix"
TITLES = {ACCELERATIONS: "Accelerations", TORQUES: "Torques", MASS: "Mass matrix and bias"}
TASKS = {"impl": TORQUES, "semi": MASS, "exp1": ACCELERATIONS, "exp2": ACCELERATIONS}
STRAIGHT = {"impl": "IMPL", "semi": "SEMI", "exp1": "EXP1", "exp2": "EXP2"}
LONGEST = {"impl": 1000, "semi": 1000, "exp1": 64, "exp2": 1000}  # of EXP1: beyond, a minute of compiling and more
PINOCCHIOS = {
    "impl": "Pinocchio, RNEA",
    "semi": "Pinocchio, CRBA",
    "exp1": "Pinocchio, CRBA and Cholesky",
    "exp2": "Pinocchio, ABA",
}
LOOPED, INTERPRETED = "in loops", "interpreted"
REASONS = {
    ACCELERATIONS: "In EXP2 each joint waits for the one before it; in EXP1 more operations are independent of each "
    "other. So EXP2 is taken where it has a tenth fewer operations.",
    MASS: "M has a column for each joint, and loops compute each by a whole call of IMPL. A recursion over composite "
    "bodies, as Pinocchio's, takes a few operations for each entry.",
}
NUMBERS = 64_000  # coordinates of all states of a time, so that few joints have many states
PASS_NS = 3e7  # of one function in a round, at most, unless one call takes longer
NEAR = 1.2  # times the quickest way: further off, the page says so
CALLS = 3  # of slow ways, of which the quickest counts


@dataclass(frozen=True)
class Point:
    """One way to compute one result of a chain."""

    joints: int
    task: str
    way: str
    ns: float
    flops: int | None = None
    error: float | None = None
    generated_s: float | None = None  # processor time
    compiled_s: float | None = None  # processor time
    source_kb: float | None = None
    compiled_mb: float | None = None  # of memory
    faster: float | None = None  # than the quickest of Pinocchio's ways, in the same rounds: the median


class Chain:
    """A chain with its states, and exact accelerations in the first state."""

    def __init__(self, size: int, folder: Path) -> None:
        """Write the model file."""
        self.size, self.path = size, write_chain(size, folder)
        self.states = draw_states(Sizes(size, size), int(np.clip(NUMBERS // size, 32, 512)))
        self.first = {name: x[:1] for name, x in self.states.items()}
        self._exact: Array | None = None

    @property
    def exact(self) -> Array:
        """Return the accelerations of the first state."""
        if self._exact is None:
            given = ("q", "qd", "qdd", "u")
            (found,) = LongChain(self.path, self.size).find_exact({name: self.first[name] for name in given})
            self._exact = found.rounded
        return self._exact

    def find_error(self, task: str, qdd: Array) -> float | None:
        """Return the error of accelerations in the first state."""
        return relate(qdd.ravel(), self.exact) if task == ACCELERATIONS else None


def measure_chain(size: int, folder: Path, workshop: Workshop, rounds: int) -> list[Point]:
    """Measure all ways for one length. Raises BuildError, MbsError."""
    chain = Chain(size, folder)
    with tempfile.TemporaryDirectory() as cache:
        made = {
            name: make_kernels(Mechanism(chain.path, size, (name,), ()), Path(cache) / name)
            for name, longest in LONGEST.items()
            if size <= longest
        }
        points = _time(chain, made, _find_peers(chain, workshop), rounds)
        (impl,) = (c for c in made["impl"].candidates if c.function == "impl")
        loops = load(impl, _list_columns(chain))
        assert loops is not None, "it is compiled"
        points += _loop(chain, loops, rounds)
    return points + [_interpret(chain, name) for name in ("impl", "exp2")]


def _find_peers(chain: Chain, workshop: Workshop) -> list[Candidate]:
    """Return Pinocchio's algorithms, its library loaded with the chain; none without its headers."""
    if workshop.includes is None:
        return []
    text = chain.path.with_suffix(".txt")
    text.write_text(write_mechanism(read_tree(chain.path)), encoding="utf-8")
    libraries = compile_pinocchio(workshop)
    for library in libraries.values():
        load_mechanism(library, text)
    return describe_pinocchio(chain.size, tuple(TASKS), libraries)


def _time(chain: Chain, made: Mapping[str, Made], peers: Sequence[Candidate], rounds: int) -> list[Point]:
    """Time kernels and peers in turn; of a peer with either kind of sines, the quicker counts."""
    ours = [c for name, m in made.items() for c in m.candidates if c.function == name]
    entries = [entry for c in (*ours, *peers) if (entry := load(c, chain.states)) is not None]
    rows = np.array(list(measure_rounds([_watch(e) for e in entries], rounds)))
    points: dict[str, Point] = {}
    for entry, times in zip(entries, rows.T, strict=True):
        name, ns = entry.candidate.function, times.min()
        task, is_peer = TASKS[name], entry.candidate.author == PINOCCHIO
        way = PINOCCHIOS[name] if is_peer else STRAIGHT[name]
        error = chain.find_error(task, entry.evaluate(0)["qdd"]) if task == ACCELERATIONS else None
        point = Point(chain.size, task, way, float(ns), entry.candidate.flops, error)
        if not is_peer:
            generated, source, compiled, memory = made[name].costs[name]
            point = replace(
                point, generated_s=generated, compiled_s=compiled, compiled_mb=memory, source_kb=source / 1e3
            )
            others = [row for e, row in zip(entries, rows.T, strict=True) if _is_peer(e, task)]
            if others:
                point = replace(point, faster=float(np.median(np.min(others, axis=0) / times)))
        if way not in points or ns < points[way].ns:
            points[way] = point
    return list(points.values())


def _is_peer(entry: Entry, task: str) -> bool:
    return entry.candidate.author == PINOCCHIO and TASKS[entry.candidate.function] == task


def _watch(entry: Entry) -> Watch:
    """Bind a function to all states, or to the first ones where calls are slow."""
    few = [x[:2] for x in entry.inputs]
    ns = Watch(entry.code, few).measure(1)
    states = int(np.clip(PASS_NS / ns, 1, len(entry.inputs[0])))
    return Watch(entry.code, [x[:states] for x in entry.inputs])


def _list_columns(chain: Chain) -> dict[str, Array]:
    """List the states of residuals that give M column by column in the first state, and the bias last."""
    n = chain.size
    q, qd, u = (np.tile(chain.first[name], (n + 2, 1)) for name in ("q", "qd", "u"))
    return {"q": q, "qd": qd * _last(n), "qdd": np.vstack((np.eye(n), np.zeros((2, n)))), "u": u * _last(n)}


def _last(n: int) -> Array:
    """Return a column that keeps the velocities and inputs of the last of n + 2 states."""
    return np.vstack((np.zeros((n + 1, 1)), [[1.0]]))


def _loop(chain: Chain, columns: Entry, rounds: int) -> list[Point]:
    """Time M and the bias by n + 2 calls of IMPL's C, and accelerations by elimination in M with LAPACK."""
    n = chain.size
    found = np.array([columns.evaluate(k)["Phi"].ravel() for k in range(n + 2)])
    M, bias = (found[:n] - found[n]).T, found[n + 1]
    (ns,) = np.array(list(measure_rounds([Watch(columns.code, columns.inputs)], rounds))).min(axis=0)
    solve = _time_call(lambda: eliminate(M, -bias))
    qdd = eliminate(M, -bias).x
    error = None if qdd is None else chain.find_error(ACCELERATIONS, qdd)
    called = float(ns) * (n + 2)
    return [
        Point(n, MASS, f"SEMI, {LOOPED}", called),
        Point(n, ACCELERATIONS, f"EXP1, {LOOPED}", called + solve, error=error),
    ]


def _interpret(chain: Chain, name: str) -> Point:
    """Time equations that NumPy interprets in one state."""
    equations = Interpreted(chain.path, name)
    found = equations.compute(chain.first)
    error = chain.find_error(TASKS[name], found["qdd"]) if name == "exp2" else None
    ns = _time_call(lambda: equations.compute(chain.first))
    return Point(chain.size, TASKS[name], f"{STRAIGHT[name]}, {INTERPRETED}", ns, error=error)


def _time_call(call: Callable[[], object]) -> float:
    """Return the shortest time of some calls [ns]."""
    found = []
    for _ in range(CALLS):
        before = time.perf_counter_ns()
        call()
        found.append(time.perf_counter_ns() - before)
    return float(min(found))


# --- what is written -----------------------------------------------------------------------------------------------


def make_panels(points: Sequence[Point]) -> list[Growth]:
    """Return panels of times, operations, errors and costs of making, against the number of joints."""
    tasks = {task: [p for p in points if p.task == task] for task in (ACCELERATIONS, TORQUES, MASS)}
    of_c = [p for p in points if p.generated_s is not None]
    made = [replace(p, ns=1e9 * ((p.generated_s or 0) + (p.compiled_s or 0))) for p in of_c]
    timed = [
        Growth(TITLES[task], _draw(own, "ns"), "joints", "time of a call", rises="ns") for task, own in tasks.items()
    ]
    errors = Growth(TITLES[ACCELERATIONS], _draw(tasks[ACCELERATIONS], "error"), "joints", "largest error, relative")
    operations = Growth("Generated C", _draw(of_c, "flops"), "joints", "operations of a call", are_rivals=False)
    making = Growth("Generated C", _draw(made, "ns"), "joints", "processor time to generate and compile", rises="ns")
    panels = [
        *timed,
        replace(errors, verb="is the most accurate", alike=DIGIT),
        operations,
        replace(making, are_rivals=False),
    ]
    return [replace(panel, known=tuple(STRAIGHT.values())) for panel in panels]


def _draw(points: Sequence[Point], number: str) -> tuple[Dot, ...]:
    """Return the dots of one number; errors of 0, and what is not known, are left out."""
    costs = {p: getattr(p, number) for p in points}
    return tuple(Dot(p.way, "", p.joints, float(cost)) for p, cost in costs.items() if cost)


def write_title(points: Sequence[Point]) -> str:
    """State where straight-line C is the fastest, by the accelerations."""
    times = {(p.way, p.joints): p.ns for p in points if p.task == ACCELERATIONS}
    ratios = [
        (n, min(ns for (way, k), ns in times.items() if k == n and way in PINOCCHIOS.values()) / times["EXP2", n])
        for n in sorted({p.joints for p in points})
        if (PINOCCHIOS["exp2"], n) in times
    ]
    if not ratios:
        return "The price of size: chains of many joints"
    least, most = (choose(ratios, key=lambda x: x[1]) for choose in (min, max))
    return (
        f"Straight-line C computes accelerations {least[1]:.2g} ({_count(least[0])}) to {most[1]:.2g} "
        f"({_count(most[0])}) times faster than Pinocchio"
    )


def _count(joints: int) -> str:
    return "one joint" if joints == 1 else f"{joints} joints"


def write_page(points: Sequence[Point], machine: str, rounds: int) -> str:
    """Write the points as a page."""
    columns = ("ns", "faster", "flops", "error", "generated s", "compiled s", "C kB", "MB")
    lines = [
        f"# Chains of {points[0].joints} to {points[-1].joints} joints",
        "",
        f"![{write_title(points)}](sizes.png)",
        "",
        f"{machine}; C with `{describe_flags()}`, of more than 2 MB with `-O1`.",
        f"Times are the shortest of {rounds} rounds; of interpreted equations and LAPACK, of {CALLS} calls. *Faster*: "
        "how many times faster than the quickest of Pinocchio's ways, the median of the ratios in the same rounds. So "
        "other programs on the machine disturb it little.",
        "",
        "The generated C of IMPL, EXP1 and EXP2 has no loops: its size, and the time to compile it, grow with the",
        "operations. EXP1 ends where its C would compile for minutes. From some hundred joints on, SEMI computes M by",
        "loops over tables. *In loops*: M and the bias by n + 2 calls of IMPL's C; accelerations by elimination in M",
        "with LAPACK. *Interpreted*: the equations by NumPy, without a compiler.",
        "Pinocchio uses our header's sines, or the C library's, if they are quicker.",
        "",
        "Errors are of the accelerations in one state, against 50 digits, relative to the largest one. A broken line",
        "marks the size from which on another way is the best. The time to generate includes the check of each",
        "function in 50 digits; MB are of the compiler.",
        "",
        "By themselves, accelerations are computed in the form that `exp` takes by their operations.",
        "",
        *write_gaps(points),
        "## All figures",
        "",
        f"| joints | | | {' | '.join(columns)} |",
        "|---:|---|---|" + "---:|" * len(columns),
        *(f"| {p.joints} | {p.task} | {p.way} | {' | '.join(_write_cells(p))} |" for p in points),
    ]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Gap:
    """The way that is taken by itself for a task, beside the quickest one."""

    own: Point
    quickest: Point

    @property
    def times(self) -> float:
        """Return how many times longer the way takes by itself."""
        return self.own.ns / self.quickest.ns


def find_gaps(points: Sequence[Point]) -> list[Gap]:
    """Compare what is taken by itself with the quickest way, by task and size.

    Accelerations are by the form that `exp` takes, and matrices by generated C where there is some.
    """
    gaps = []
    for task in TITLES:
        for size in sorted({p.joints for p in points}):
            ways = [p for p in points if (p.task, p.joints) == (task, size)]
            straight = [p for p in ways if p.flops is not None]
            looped = [p for p in ways if LOOPED in p.way]
            if straight or looped:
                own = _find_own(straight) if straight else looped[0]
                gaps.append(Gap(own, min(ways, key=lambda p: p.ns)))
    return gaps


def _find_own(straight: Sequence[Point]) -> Point:
    """Return the generated function that is called for a task."""
    forms = {name: p for name, way in STRAIGHT.items() for p in straight if p.way == way}
    return forms[choose_quickest({name: p.flops or 0 for name, p in forms.items()})] if len(forms) > 1 else straight[0]


def write_gaps(points: Sequence[Point]) -> list[str]:
    """State for each task where the way that is taken by itself is beyond NEAR times the quickest one, and why."""
    lines = ["## Beside the quickest way", ""]
    for task, title in TITLES.items():
        gaps = [gap for gap in find_gaps(points) if gap.own.task == task]
        far = [gap for gap in gaps if gap.times > NEAR]
        if gaps and not far:
            lines.append(f"- {title}: at most {max(g.times for g in gaps):.2g} times the quickest way, at every size.")
        elif far:
            found = ", ".join(
                f"{g.times:.2g} times {g.quickest.way} ({_count(g.own.joints)}, by {g.own.way})" for g in far
            )
            lines.append(f"- {title}: within {NEAR} times the quickest way, except {found}. {REASONS.get(task, '')}")
    return [*lines, ""]


def _write_cells(p: Point) -> tuple[str, ...]:
    cells: tuple[tuple[float | None, str], ...] = (
        (p.ns, ",.0f"),
        (p.faster, ".3g"),
        (p.flops, ",d"),
        (p.error, ".0e"),
        (p.generated_s, ".1f"),
        (p.compiled_s, ".1f"),
        (p.source_kb, ",.0f"),
        (p.compiled_mb, ",.0f"),
    )
    return tuple("" if value is None else format(value, form) for value, form in cells)


@click.command()
@click.option("-o", "--out", default=Path("build/bench"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--rounds", default=30, show_default=True, type=click.IntRange(min=1))
@click.option("--size", "sizes", multiple=True, type=click.IntRange(1, 1000), help="Joints; by default 1 to 1000.")
def main(out: Path, rounds: int, sizes: tuple[int, ...]) -> None:
    """Measure chains of many lengths; write sizes.md, sizes.json and the chart to a folder."""
    out.mkdir(parents=True, exist_ok=True)
    workshop, console = Workshop(find_cache(), find_includes()), Console(stderr=True)
    facts = (describe_machine(), rounds, fingerprint_generator().hex(), str(workshop.includes))
    store, points = Store(out / "sizes.jsonl", Point), list[Point]()
    try:
        for size in sizes or SIZES:
            with console.status(f"{size} joints"), tempfile.TemporaryDirectory() as folder:
                measure = partial(measure_chain, size, Path(folder), workshop, rounds)
                points += store.find_or_measure((*facts, size), measure)
    except (MbsError, BuildError, ArithmeticError) as error:
        raise click.ClickException(str(error)) from None
    content = {"machine": facts[0], "rounds": rounds, "points": [asdict(p) for p in points]}
    (out / "sizes.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (out / "sizes.md").write_text(write_page(points, facts[0], rounds), encoding="utf-8")
    written = draw_panels(write_title(points), make_panels(points), out, "sizes")
    console.print(f"wrote {out / 'sizes.md'}, sizes.json, {', '.join(path.name for path in written)}")


if __name__ == "__main__":
    main()
