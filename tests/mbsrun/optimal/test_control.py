"""Problems in Python: the keys and checks of a file, copies with changes, solutions as arrays by name, and files."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbsrun
from mbsgen.errors import InputError, MbsError
from mbsrun.ocp.cases.programs import KEPT, Programs
from mbsrun.ocp.problem.phases import Plants, list_one
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.runs import Progress
from mbsrun.ocp.solving.solve import solve as solve_value
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.progress import Board, draw_curve, find_display
from mbsrun.optimal.result import MissingPackageError, Solved, Unsolved
from mbsrun.results import UnknownNameError

MODELS = Path(__file__).parents[3] / "models"
SWING = {
    "horizon": 2,
    "intervals": 20,
    "degree": np.int64(3),
    "bounds": {"inputs": [-20.0, np.inf]},
    "end": {"pose": {"cart": 1, "pole": "pi"}, "velocity": "zero"},
}


@pytest.fixture(scope="module")
def swing() -> OptimalControl:
    return mbsrun.problem(MODELS / "cart_pole.yaml", **SWING)


@pytest.fixture(scope="module")
def solved(swing: OptimalControl) -> Solved:
    found = swing.solve()
    assert isinstance(found, Solved)
    return found


def test_a_problem_in_python_is_the_problem_of_its_file(tmp_path: Path) -> None:
    read = mbsrun.read_problem(MODELS / "cart_pole_swing_up.ocp.yaml")
    keys = {key: value for key, value in read.data.items() if key != "model"}
    made = mbsrun.problem(MODELS / "cart_pole.yaml", name="cart_pole_swing_up", **keys)
    assert made.value == read.value
    broken = tmp_path / "b.ocp.yaml"
    broken.write_text(f"horizn: 2\nmodel: {MODELS / 'cart_pole.yaml'}\nintervals: 2\n")
    with pytest.raises(InputError, match=r"b\.ocp\.yaml:1: horizn: unknown key; did you mean `horizon`"):
        mbsrun.read_problem(broken)


def test_numbers_of_numpy_and_infinite_bounds_are_those_of_a_file(swing: OptimalControl) -> None:
    assert swing.value.degree == 3
    assert swing.value.bounds.u == ((-20.0, np.inf),)
    assert swing.value.end.coordinates == ((0, 1.0), (1, np.pi))


def test_all_faults_of_a_problem_are_in_one_error(swing: OptimalControl) -> None:
    with pytest.raises(mbsrun.ProblemError) as error:
        swing.with_changes(horizon=-1, degre=3, start={"pose": {"pol": 1}}, cost={"running": [{"expression": "q_x"}]})
    assert [finding[0] for finding in error.value.findings] == [
        "cost.running[0].expression",
        "degre",
        "horizon",
        "start.pose.pol",
    ]
    with pytest.raises(ProblemError, match="found a value of type object; give numbers") as error:
        swing.with_changes(horizon=object(), end={"pose": {1: object()}})
    assert len(error.value.findings) == 3
    hidden = np.ma.array([-5.0, 5.0], mask=[True, False])
    with pytest.raises(ProblemError, match=r"bounds.inputs: some entries are masked, so they have no numbers; fill"):
        swing.with_changes(bounds={"inputs": hidden})


def test_changes_merge_mappings_and_replace_the_rest(swing: OptimalControl) -> None:
    changed = swing.with_changes(end={"pose": {"cart": 0.5}}, bounds={"inputs": (-5, 5)}, horizon=3)
    assert changed.value.end.coordinates == ((0, 0.5), (1, np.pi))
    assert (changed.value.horizon, changed.value.bounds.u) == (3.0, ((-5.0, 5.0),))
    assert changed.with_changes(bounds=None).value.bounds.u == ((-np.inf, np.inf),)
    assert swing.value.horizon == 2.0
    target = swing.with_target("mass", x=0.2, y=0, z=0.1).with_target("mass", radius=0.3, azimuth=0, height=0)
    assert target.value.end.sensors == (("mass", (0.3, 0.0, 0.0)),)
    assert swing.with_solver("mbs", tolerance=1e-6).value.solver.tolerance == 1e-6
    priced = swing.with_changes(constants={"w": 2}, cost={"running": [{"expression": "w*q_cart**2"}]})
    assert priced.with_constants(w=3).value.constants == (("w", 3.0),)


def test_copies_of_one_structure_share_a_program(swing: OptimalControl, solved: Solved) -> None:
    """The optimum of the copy is the optimum of the same problem, made anew."""
    known = dict(swing.programs._solvers)
    copy = swing.with_changes(end={"pose": {"cart": 1.1}})
    found = copy.solve(guess=solved, check=False)
    assert dict(swing.programs._solvers) == known
    fresh = solve_value(copy.value, swing.plant, guess=solved.trajectory)
    assert isinstance(fresh, Solution)
    assert found.cost == fresh.cost.total != solved.cost


def test_the_latest_programs_are_kept(swing: OptimalControl, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    make = "mbsrun.ocp.cases.programs.PhasedSolver"
    monkeypatch.setattr(make, lambda whole, _: made.append(whole.phases[0].problem.intervals))
    programs = Programs()
    variants = [list_one(swing.with_changes(intervals=n).value) for n in range(2, 4 + KEPT)]
    for value in (*variants, variants[-1], variants[0]):
        programs.find(value, Plants((swing.plant,)))
    assert made == [*range(2, 4 + KEPT), 2]


def test_quantities_have_names(solved: Solved, tmp_path: Path) -> None:
    """Arrays by name are the columns of the table; the pole's mass is where its angle puts it."""
    solved.to_csv(tmp_path / "table.csv")
    with (tmp_path / "table.csv").open() as file:
        titles, *rows = csv.reader(file)
    table = dict(zip(titles, np.array(rows, dtype=float).T, strict=True))
    for title, name in {
        "t [s]": "t",
        "q[pole] [rad]": "q_pole",
        "qdd[cart] [m/s^2]": "qdd_cart",
        "x[mass] [m]": "x_mass",
    }.items():
        assert np.abs(table[title] - solved[name]).max() <= 1e-14
    x, z = solved.evaluate("q_cart + 0.5*sin(q_pole)"), solved.evaluate("-0.5*cos(q_pole)")
    assert np.abs(solved["x_mass"] - x).max() + np.abs(solved["z_mass"] - z).max() <= 1e-14
    vx = solved.evaluate("qd_cart + 0.5*cos(q_pole)*qd_pole")
    assert np.abs(solved["vx_mass"] - vx).max() <= 1e-13
    assert solved["q"].shape == (len(solved.t), 2)
    assert solved.evaluate("T - t")[0] == solved.horizon == 2.0
    assert "u_cart" in solved
    assert "q_x" not in solved
    place: Any = 0
    with pytest.raises(UnknownNameError, match=r"a quantity has a name, such as \w+; found 0"):
        solved[place]
    with pytest.raises(UnknownNameError, match=r"^there is no quantity \"q_pol\"; did you mean q_pole\?$"):
        solved["q_pol"]


def test_a_solution_is_read_back(swing: OptimalControl, solved: Solved, tmp_path: Path) -> None:
    solved.save(tmp_path / "s.json")
    again = swing.load(tmp_path / "s.json")
    assert again.cost == solved.cost
    assert np.array_equal(again["u_cart"], solved["u_cart"])
    numbers = {name: solved[name] for name in (*(x for x in solved.names if x[0] != "v"), "kinetic", "t")}
    assert swing.solve(guess=numbers, check=False).is_solved  # what follows from the motion is left out
    other = mbsrun.problem(MODELS / "pendulum.yaml", horizon=1)
    with pytest.raises(InputError, match="give a solution for this mechanism"):
        other.solve(guess=tmp_path / "s.json")


def test_a_frame_has_a_column_for_each_name(solved: Solved, monkeypatch: pytest.MonkeyPatch) -> None:
    def make(columns: dict[str, Any], index: Any) -> tuple[dict[str, Any], Any]:
        return columns, index

    pandas = SimpleNamespace(DataFrame=make, Index=lambda values, name: (values, name))
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    columns, (times, name) = solved.to_frame()
    assert name == "t"
    assert np.array_equal(times, solved.t)
    assert list(columns) == [name for name in solved.names if name != "t"]
    more, _ = solved.to_frame("kinetic", "reaction_z_*")
    assert [name for name in more if name not in columns] == ["kinetic", "reaction_z_cart", "reaction_z_pole"]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingPackageError, match=r"pandas is not installed; run .*: pip install '\.\[notebook\]'"):
        solved.to_frame()


def test_a_solve_without_a_solution_says_why(swing: OptimalControl) -> None:
    found = swing.with_changes(end={"pose": {"cart": 1.9}}, bounds={"inputs": [-0.1, 0.1]}).solve()
    assert isinstance(found, Unsolved)
    assert not found.is_solved
    assert found.reason in f"{found._rows['finding']}; {found._rows['remedy']}"
    for name in ("t", "cost", "plot", "trajectory", "solution"):
        with pytest.raises(MbsError, match="cart_pole was not solved"):
            getattr(found, name)
    with pytest.raises(MbsError, match="cart_pole was not solved"):
        found["q_cart"]
    assert not hasattr(found, "nothing")
    assert "not solved" in repr(found)


def test_problems_and_solutions_show_themselves(swing: OptimalControl, solved: Solved) -> None:
    marked = mbsrun.problem(MODELS / "cart_pole.yaml", name="<b>&", **SWING)
    assert "&lt;b&gt;&amp;" in marked._repr_html_()
    assert "<b>" not in marked._repr_html_()
    for text in (repr(swing), swing._repr_html_()):
        for part in ("20 intervals", "q_pole = 3.14159", "velocity 0", "1 * inputs", "coordinates cart, pole"):
            assert part in text
    assert "-20 <= u_cart" in repr(swing)
    size = solved.solution.size
    assert f"{size.variables} variables, {size.constraints} constraints" in repr(swing)
    assert " variables" not in repr(marked)
    for text in (repr(solved), solved._repr_html_()):
        for part in ("Solve_Succeeded", f"{solved.cost:.10g}", "of constraints", "in an interval, at most"):
            assert part in text
    assert solved.shortcomings[0] in repr(solved)  # 20 intervals of degree 3 are too few
    assert solved.plot("x_mass", "u_cart")._repr_png_().startswith(b"\x89PNG")
    labels = [axes.get_ylabel() for axes in solved.plot().figure.axes]
    assert labels == ["$q$ [m]", "$q$ [rad]", r"$\dot{q}$ [m/s]", r"$\dot{q}$ [rad/s]", "$u$ [N]"]
    drawn = solved.plot("x_mass", "u_cart", "q_cart").figure.axes
    assert [(axes.get_title(loc="left"), axes.get_ylabel()) for axes in drawn] == [("", "[m]"), ("u_cart", "[N]")]
    assert 'srcdoc="&lt;!DOCTYPE html' in solved.animate()._repr_html_()


def test_progress_is_shown_where_a_notebook_runs(swing: OptimalControl, monkeypatch: pytest.MonkeyPatch) -> None:
    """The display is replaced, not repeated; the last state shows all iterations."""
    shown: list[str] = []
    handle = SimpleNamespace(update=lambda board: shown.append(board._repr_html_()))

    def display(board: Board, display_id: bool) -> SimpleNamespace:
        assert display_id
        shown.append(board._repr_html_())
        return handle

    assert find_display() is None
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: object()))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    found = swing.solve(watch=True, check=False)
    assert isinstance(found, Solved)
    assert f"iteration {found.solution.run.iterations}" in shown[-1]
    assert shown[-1].count("<polyline") == 1


def test_a_watch_sees_every_iteration(swing: OptimalControl) -> None:
    seen: list[Progress] = []
    found = swing.solve(watch=seen.append, check=False)
    assert [progress.iteration for progress in seen] == list(range(found.solution.run.iterations + 1))


def test_a_curve_needs_two_points() -> None:
    assert draw_curve([1.0, 0.0]) == ""
    assert 'points="0.0,2.0 360.0,88.0"' in draw_curve([1.0, 1e-8])


def test_a_solve_refines_the_grid_if_the_problem_asks(swing: OptimalControl) -> None:
    asked = swing.with_changes(refine={"accuracy": 1e-4})
    found = asked.solve()
    assert found.defect <= 1e-4
    assert len(found.solution.refinement.rounds) > 1
    assert len(found.t) == len(found["q_pole"]) > len(swing.solve(check=False).t)
    assert asked.solve(check=False).defect is None


def test_a_guess_is_made_of_arrays_by_name(swing: OptimalControl, solved: Solved) -> None:
    """From the arrays of a solution, a solve ends in its optimum; two numbers of each coordinate will do."""
    arrays = {name: solved[name] for name in solved.names}
    again = swing.solve(guess=arrays, check=False)
    assert again.cost == pytest.approx(solved.cost, rel=1e-7)
    assert again.solution.run.iterations < solved.solution.run.iterations
    methods = {"__iter__": lambda _: iter(arrays), "__getitem__": lambda _, name: arrays[name]}
    Frame = type("Frame", (), {"index": arrays.pop("t"), **methods})
    assert swing.solve(guess=Frame(), check=False).cost == again.cost
    assert swing.solve(guess={"t": [0, 2], "q_cart": [0, 1], "q_pole": [0, 3]}, check=False).is_solved
    with pytest.raises(InputError, match=r'no column is named "q\[pole\]"'):
        swing.solve(guess={"t": [0, 2], "q_cart": [0, 1]})
    with pytest.raises(ProblemError) as error:
        swing.solve(guess={"t": [0, 0], "q_cart": [0, 1, 2], "q_pol": [0, 1], "u_cart": "much"})
    assert [place for place, *_ in error.value.findings] == ["guess.q_pol", "guess.u_cart", "guess.t", "guess.q_cart"]


def test_a_guess_by_name_may_give_unknowns_a_number(swing: OptimalControl) -> None:
    """The number decides which of two values is found; a row over time that does not vary will do."""
    free = swing.with_changes(
        unknowns={"k": {"guess": 0.5}}, constraints=[{"expression": "k**2", "range": [4, 4], "at": "end"}]
    )
    line = {"t": [0, 2], "q_cart": [0, 1], "q_pole": [0, 3]}
    assert free.solve(guess={**line, "k": 1.9}, check=False).unknowns["k"] == pytest.approx(2)
    assert free.solve(guess={**line, "k": [-1.9, -1.9]}, check=False).unknowns["k"] == pytest.approx(-2)
    for wrong in ([1, 2], np.nan, "two", []):
        with pytest.raises(ProblemError, match=r"guess.k: no finite number, or several"):
            free.solve(guess={**line, "k": wrong})


def test_a_number_of_a_guess_that_is_not_finite_is_named(swing: OptimalControl, solved: Solved, tmp_path: Path) -> None:
    """Nothing of a guess is left out in silence: arrays, trajectories, and columns of files that lack an end."""
    with pytest.raises(ProblemError, match=r"guess.u_cart: nan at t = 1 s, number 1"):
        swing.solve(guess={"t": [0, 1, 2], "q_cart": [0, 0, 1], "q_pole": [0, 1, 3], "u_cart": [0, np.nan, 1]})
    q = solved.trajectory.q.copy()
    q[3, 1] = np.nan
    with pytest.raises(ProblemError, match=r"guess.q\[3, 1\]: found nan"):
        swing.solve(guess=replace(solved.trajectory, q=q))
    file = tmp_path / "motion.csv"
    file.write_text("t,q[cart],q[pole],u[cart]\n0,0,0,1\n1,0,1,1\n2,1,3,\n", "utf-8")
    with pytest.raises(InputError, match=r'column "u\[cart\]": it has no number at t = 2 s'):
        swing.solve(guess=file)


def test_a_guess_of_another_mechanism_is_refused(swing: OptimalControl, solved: Solved) -> None:
    """A motion of the acrobot has as many coordinates as a cart-pole's, of other names."""
    acrobot = mbsrun.problem(MODELS / "acrobot.yaml", horizon=1, intervals=3).solve(check=False)
    with pytest.raises(ProblemError, match=r"guess: its coordinates are shoulder, hip; cart_pole has cart, pole"):
        swing.solve(guess=acrobot)
    narrow = replace(solved.trajectory, u=np.zeros((solved.trajectory.u.shape[0], 2)))
    with pytest.raises(ProblemError, match=r"guess\.u: shape \(\d+, 2\); cart_pole has 1 columns of it"):
        swing.solve(guess=narrow)
    wrong: Any
    for wrong in (3, np.zeros((4, 2)), [0, 1]):
        with pytest.raises(ProblemError, match=f"guess: found a value of type {type(wrong).__name__}; give a solution"):
            swing.solve(guess=wrong)


@pytest.mark.parametrize(
    ("starts", "more", "place"), [(0, {}, "starts"), (1.5, {}, "starts"), (1, {"hops": -1}, "hops")]
)
def test_counts_of_a_search_are_whole(swing: OptimalControl, starts: Any, more: dict[str, Any], place: str) -> None:
    with pytest.raises(ProblemError, match=f"{place}: found .*; give a whole number"):
        swing.search(starts, **more)


def test_values_of_cases_are_lists(swing: OptimalControl) -> None:
    values: Any
    for values in (1, "12"):
        with pytest.raises(ProblemError, match=r"over\.end\.pose\.cart: found .*; give a list of values"):
            swing.solve_many({"end.pose.cart": values})


def test_a_search_from_many_starts_returns_the_best(swing: OptimalControl, tmp_path: Path) -> None:
    seen: list[int] = []
    found = swing.search(2, seed=1, record=tmp_path / "s.sqlite", watch=lambda starts: seen.append(len(starts.results)))
    assert seen == [0, 1, 2]
    assert found.cost == found.solution.starts.best.cost
    assert found.defect is not None
    written = swing.with_cost(swing.quantities().u_cart ** 2)
    with pytest.raises(ProblemError, match="search: the problem has expressions in CasADi, which no file holds"):
        written.search(2, record=tmp_path / "s.sqlite")
    assert swing.search(1, minutes=0).status == "Out_Of_Time"
