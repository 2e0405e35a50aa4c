"""Solves by teams of workers: the bits of a solve without a team, however the stages are divided."""

from __future__ import annotations

import os
import re
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.resources import folder
from mbsrun.library import find_compiler
from mbsrun.ocp.evaluation.stages.interface import read_declarations
from mbsrun.stack import TASKS
from tests.csrc.stage_arm import arm
from tests.csrc.stage_problems import chain, collocated, fastest, nonlinear, steep, too_weak, turning
from tests.csrc.stage_quadratics import SIZES, condensed, random_problem
from tests.csrc.stages import STRICT, Answer, Array, Library, Problem, Quadratic, Solver, sources

THREADS = folder("csrc") / "threads"
Case = Callable[[], Problem | Quadratic]


def bounded(seed: int) -> Quadratic:
    """Inequalities, equalities and bounds, and stages that change in size."""
    return random_problem(np.random.default_rng(seed), SIZES, bounds=0.5)


CASES: dict[str, Case] = {
    **{problem.name: (lambda problem=problem: problem) for problem in nonlinear()},  # type: ignore[misc]
    "bounds and rows": lambda: bounded(1),
    "condensed": lambda: condensed(bounded(2)),
    "arm, 4 points": lambda: arm(np.random.default_rng(0), 5, 2, 1, 4),
    "no reach": too_weak,
    "collocated, no reach": lambda: collocated(12, 0.05, 2.0),
    "free horizon": lambda: fastest(11),
    "curvature is added": lambda: chain(9),
    "other pivots": turning,
    "inner variables follow": steep,
}


@pytest.fixture(scope="module")
def threads(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The team of threads, compiled as strictly as the solver."""
    library = tmp_path_factory.mktemp("threads") / "threads.so"
    command = [*find_compiler(os.environ).command, *STRICT, "-O2", "-fPIC", "-shared", "-pthread"]
    files = [f"-I{sources()[0].parent}", str(THREADS / "mbs_threads.c"), "-o", str(library)]
    subprocess.run([*command, *files], check=True)
    return library


class Threads:
    """Teams of threads for a solver in C."""

    def __init__(self, library: Library, compiled: Path) -> None:
        self.ffi = library.ffi
        if "mbs_threads" not in self.ffi.list_types()[0]:
            self.ffi.cdef(read_declarations((THREADS / "mbs_threads.h").read_text("utf-8")))
        self.lib: Any = self.ffi.dlopen(str(compiled))
        self.kept: list[Any] = []

    def start(self, workers: int) -> Any:
        memory = np.zeros(self.lib.mbs_threads_bytes(workers) + 64, dtype=np.uint8)
        base = memory.ctypes.data + -memory.ctypes.data % 64
        pool = self.lib.mbs_threads_start(self.ffi.cast("void *", base), workers)
        assert self.lib.mbs_threads_count(pool) == workers
        spread = self.ffi.addressof(self.lib, "mbs_threads_spread")
        self.kept += [memory, pool]
        return self.ffi.new("mbs_stages_team *", [workers, spread, pool, self.ffi.NULL])

    def stop(self, team: Any) -> None:
        self.lib.mbs_threads_stop(team.pool)


def make_hostile(library: Library, workers: int) -> tuple[Any, Any]:
    """A team of one thread that takes stages from the last one on, each by another worker; and what must live."""

    def spread(_: Any, count: int, task: Any, data: Any) -> None:
        for k in reversed(range(count)):
            task(data, k, k + 1, (7 * k) % workers)

    ffi = library.ffi
    given = ffi.callback("void(void *, int, mbs_stages_task, void *)", spread)
    return ffi.new("mbs_stages_team *", [workers, given, ffi.NULL, ffi.NULL]), given


def list_teams(library: Library, compiled: Path) -> Iterator[Any]:
    """Make teams, one after the other."""
    for workers in (1, 2, 5):
        team, kept = make_hostile(library, workers)
        yield team
        del kept
    pool = Threads(library, compiled)
    for workers in (1, 2, 3):
        team = pool.start(workers)
        yield team
        pool.stop(team)


def collect(answer: Answer, library: Library) -> tuple[Any, ...]:
    """All that a solve returns, as bytes."""
    result: Any = library.ffi.buffer(library.ffi.new("mbs_stages_result *", answer.result))
    return answer.status, answer.path, bytes(result), *(part.tobytes() for part in answer.point)


@pytest.mark.parametrize("name", CASES)
def test_teams_give_the_bits_of_the_caller_alone(library: Library, threads: Path, name: str) -> None:
    """Iterates, multipliers, figures, and the path to them."""
    follow = int(name == "inner variables follow")
    alone = collect(Solver(library, CASES[name]()).solve(follow=follow), library)
    for team in list_teams(library, threads):
        solver = Solver(library, CASES[name](), team=team)
        assert collect(solver.solve(follow=follow), library) == alone
        solver.set(w=solver.problem.guess)
        assert collect(solver.solve(follow=follow), library) == alone


class Faulty:
    """Gives no numbers in some calls for a stage: a fault that does not depend on the order of stages."""

    def __init__(self, function: str, stages: tuple[int, ...], calls: range) -> None:
        self.function, self.calls, self.counts = function, calls, dict.fromkeys(stages, 0)

    def __call__(self, function: str, _: int, stage: int) -> bool:
        if function != self.function or stage not in self.counts:
            return False
        self.counts[stage] += 1
        return self.counts[stage] in self.calls


@pytest.mark.parametrize("calls", [range(1, 2), range(4, 5), range(4, 1000)], ids=["first", "once", "from then on"])
@pytest.mark.parametrize("function", ["values", "jacobians", "hessian"])
def test_the_first_stage_without_numbers_is_named(library: Library, threads: Path, function: str, calls: range) -> None:
    """Status, stage, iterate and figures are the same as in the caller's thread alone, where the second of two stages
    that fail is not reached.
    """
    problem, stages = nonlinear()[0], (3,) if calls == range(4, 5) else (3, 9)
    alone = collect(Solver(library, problem, Faulty(function, stages, calls)).solve(), library)
    assert (alone[0] == "callback failed") == (function != "values" or calls != range(4, 5))
    for team in list_teams(library, threads):
        solver = Solver(library, problem, Faulty(function, stages, calls), team)
        answer = solver.solve()
        assert answer.status != "callback failed" or answer.result.stage == 3
        assert collect(answer, library) == alone


def move(solver: Solver, first: Array, periods: int) -> list[bytes]:
    """Control in real time; return what each period gives."""
    found = []
    for k in range(periods):
        _, prepared = solver.prepare(shift=k > 0)
        before = bytes(solver.library.ffi.buffer(solver.library.ffi.new("mbs_stages_realtime *", prepared)))
        status, v, _ = solver.feedback(first + 0.01 * k)
        assert status == "stepped"
        found += [before, v.tobytes(), solver.get("w").tobytes(), solver.get("y").tobytes()]
    return found


def test_steps_in_real_time_have_the_bits_of_the_caller_alone(library: Library, threads: Path) -> None:
    """With inner variables, bounds, and a first state that deviates."""
    problem = condensed(bounded(4))
    first = problem.guess[: problem.sizes[0][0]]
    problem.lower[: first.size] = problem.upper[: first.size] = first
    alone = Solver(library, problem)
    alone.solve()
    expected = move(alone, first, 4)
    for team in list_teams(library, threads):
        solver = Solver(library, problem, team=team)
        solver.solve()
        assert move(solver, first, 4) == expected


def test_two_solvers_with_teams_share_nothing(library: Library, threads: Path) -> None:
    problems = [arm(np.random.default_rng(i), 6, 2, 1, 2) for i in (0, 1)]
    alone = [collect(Solver(library, p).solve(), library) for p in problems]
    pool = Threads(library, threads)
    teams = [pool.start(2) for _ in problems]
    solvers = [Solver(library, p, team=team) for p, team in zip(problems, teams, strict=True)]
    found: list[list[Any]] = [[], []]

    def work(i: int) -> None:
        for _ in range(3):
            solvers[i].set(w=problems[i].guess)
            found[i].append(collect(solvers[i].solve(), library))

    callers = [threading.Thread(target=work, args=(i,)) for i in (0, 1)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    for team in teams:
        pool.stop(team)
    assert found == [[alone[0]] * 3, [alone[1]] * 3]


@pytest.mark.parametrize("wrong", ["workers", "spread"])
def test_a_team_without_workers_is_refused(library: Library, wrong: str) -> None:
    team, _kept = make_hostile(library, 2)
    solver = Solver(library, nonlinear()[0], team=team)
    setattr(team, wrong, 0 if wrong == "workers" else library.ffi.NULL)
    assert library.lib.mbs_stages_bytes(solver.c) == 0


def test_a_team_needs_memory_for_each_worker_alone(library: Library) -> None:
    """Each worker has the same memory to work in, and a solver without a team has one of these."""
    sizes = []
    for workers in (1, 2, 3):
        team, _kept = make_hostile(library, workers)
        sizes.append(Solver(library, condensed(bounded(2)), team=team).bytes)
    alone = Solver(library, condensed(bounded(2))).bytes
    assert sizes[0] == alone
    assert 0 < sizes[1] - sizes[0] <= alone / 5
    assert abs((sizes[2] - sizes[1]) - (sizes[1] - sizes[0])) <= 16


def test_bounds_of_stacks_know_all_tasks() -> None:
    """Each function that is handed on to be called for all stages."""
    call = re.compile(r"(?:mbs_stages_for_all\(|= evaluate\()[^,;]*, (\w+), ")
    found = {path.name: set(call.findall(path.read_text("utf-8"))) - {"mbs_stages_task", "task"} for path in sources()}
    assert {file: names for file, names in found.items() if names} == {
        file: set(names) for file, names in TASKS.items()
    }


@pytest.mark.parametrize("sanitizer", ["thread", "address,undefined"])
def test_sanitizers_find_nothing_in_threads(tmp_path: Path, sanitizer: str) -> None:
    """A separate program: teams of 1 to 4 that solve again and again, started and stopped; a callback that fails."""
    program = tmp_path / "program.c"
    program.write_text(PROGRAM, "utf-8")
    flags = [*STRICT, "-O1", "-g", f"-fsanitize={sanitizer}", "-fno-sanitize-recover=all", "-pthread"]
    files = [str(program), str(THREADS / "mbs_threads.c"), *map(str, sources())]
    command = [*find_compiler(os.environ).command, *flags, f"-I{sources()[0].parent}", f"-I{THREADS}", *files]
    made = subprocess.run(
        [*command, "-lm", "-o", str(tmp_path / "program")], capture_output=True, text=True, check=False
    )
    if "cannot find" in made.stderr:
        pytest.skip(f"the compiler has no sanitizer of {sanitizer}")
    assert made.returncode == 0, made.stderr
    done = subprocess.run([str(tmp_path / "program")], capture_output=True, text=True, check=False)
    if "unexpected memory mapping" in done.stderr:
        pytest.skip("the sanitizer does not know this system's memory")
    assert done.returncode == 0, done.stderr


PROGRAM = r"""
#include "mbs_threads.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
/* x1' = x2, x2' = a by Euler's method, with the inner variable a = u - sin x1; least u u, |u| <= 2, to 1 and to rest */
typedef mbs_stages_real real;
enum { N = 60 };
static int values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    const int *spoiled = context;
    (void)g;
    if (*spoiled >= 0 && (k == *spoiled || k == *spoiled + 7))
        return 1;
    if (k == N) {
        e[0] = x[0] - 1;
        e[1] = x[1];
        return 0;
    }
    *f = v[1] * v[1];
    e[0] = v[0] - v[1] + sin(x[0]);
    d[0] = x[0] + x[1] / 20;
    d[1] = x[1] + v[0] / 20;
    return 0;
}
static int jacobians(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    (void)context, (void)g;
    if (k == N) {
        e[0] = e[3] = 1;
        return 0;
    }
    f[3] = 2 * v[1];
    e[0] = cos(x[0]);
    e[2] = 1;
    e[3] = -1;
    d[0] = d[3] = 1;
    d[2] = d[5] = 1. / 20;
    return 0;
}
static int hessian(void *context, int k, const real *x, const real *v, real factor, const real *ye, const real *yd,
                   const real *yg, real *h)
{
    (void)context, (void)v, (void)yd, (void)yg;
    if (k == N)
        return 0;
    h[0] = -ye[0] * sin(x[0]);
    h[15] = 2 * factor;
    return 0;
}
static real first[4 * N + 2], lower[4 * N + 2], upper[4 * N + 2];
/* Solve by some workers; -1: another result than the first one. */
static int check(int workers, int spoiled)
{
    static mbs_stages_size size[N + 1];
    mbs_stages_problem problem = {0};
    mbs_stages_team team = {0};
    mbs_stages_result result;
    mbs_stages *solver;
    void *memory = NULL, *pool = NULL;
    size_t bytes = mbs_threads_bytes(workers) + 64;
    int k, i, wrong;
    for (k = 0; k <= N; ++k) {
        size[k].nx = 2;
        size[k].nv = k < N ? 2 : 0;
        size[k].ne = k < N ? 1 : 2;
        size[k].inner = k < N;
        for (i = 4 * k; i < 4 * k + (k < N ? 4 : 2); ++i) {
            lower[i] = i < 2 ? 0 : i % 4 == 3 ? -2 : -1e20;
            upper[i] = i < 2 ? 0 : i % 4 == 3 ? 2 : 1e20;
        }
    }
    problem.stages = N + 1;
    problem.size = size;
    problem.values = values;
    problem.jacobians = jacobians;
    problem.hessian = hessian;
    problem.context = &spoiled;
    problem.lower = lower;
    problem.upper = upper;
    pool = malloc(bytes);
    team.workers = workers;
    team.spread = mbs_threads_spread;
    team.pool = mbs_threads_start((char *)pool + (64 - (size_t)pool % 64) % 64, workers);
    problem.team = &team;
    bytes = mbs_stages_bytes(&problem);
    memory = malloc(bytes);
    solver = mbs_stages_create(&problem, memory, bytes);
    for (i = 0; i < 2; ++i) {
        const mbs_stages_point point = mbs_stages_iterate(solver);
        memset(point.w, 0, (size_t)point.variables * sizeof(real));
        result = mbs_stages_solve(solver, NULL);
    }
    wrong = result.status != (spoiled < 0 ? MBS_STAGES_SOLVED : MBS_STAGES_CALLBACK_FAILED);
    wrong |= spoiled >= 0 && result.stage != spoiled;
    if (spoiled < 0 && workers == 1)
        memcpy(first, mbs_stages_iterate(solver).w, sizeof first);
    wrong |= spoiled < 0 && memcmp(first, mbs_stages_iterate(solver).w, sizeof first) != 0;
    mbs_threads_stop(team.pool);
    free(pool);
    free(memory);
    return wrong;
}
int main(void)
{
    int workers, round, wrong = 0;
    for (round = 0; round < 3; ++round)
        for (workers = 1; workers <= 4; ++workers)
            wrong |= check(workers, -1) | check(workers, 20 + round);
    return wrong;
}
"""
