"""`mbsrun sweep --over`: combinations of values, a record that goes on, tables, pictures and solutions."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import distributed
import pytest

from mbsrun.cli import main
from mbsrun.commands import cases
from mbsrun.ocp.cases.cases import CaseSolver
from mbsrun.ocp.solution.solution import read_solution

MODEL = Path(__file__).parents[3] / "models" / "cart_pole.yaml"
PROBLEM = f"""model: {MODEL}
horizon: 2
intervals: 10
scheme: radau
degree: 3
cost: {{inputs: 1}}
start: {{pose: {{}}}}
bounds: {{inputs: [-20, 20]}}
end: {{pose: {{cart: 1, pole: pi}}, velocity: zero}}
refine: {{accuracy: 1e-4}}
"""


class Result(NamedTuple):
    """The end of a command."""

    exit_code: object
    stdout: str
    stderr: str


Sweep = Callable[..., Result]


@pytest.fixture
def sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Sweep:
    """Run the command in an empty folder with the problem."""
    (tmp_path / "swing.ocp.yaml").write_text(PROBLEM)
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Result:
        monkeypatch.setattr(sys, "argv", ["mbsrun", "sweep", "swing.ocp.yaml", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        return Result(end.value.code, *capsys.readouterr())

    return call


def read_rows(path: str) -> list[dict[str, str]]:
    with Path(path).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_all_combinations_are_solved_and_written(sweep: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    given = ("--over", "end.pose.cart", "0.9:1.1:2", "--over", "horizon", "2, 2*1.1", "--solutions", "found")
    first = sweep(*given)
    assert first.exit_code == 0, first.stderr
    assert "4 of 4 cases solved" in first.stdout
    rows = read_rows("swing.sweep.csv")
    assert [(row["end.pose.cart"], row["horizon"]) for row in rows] == [
        ("0.9", "2"),
        ("0.9", "2.2"),
        ("1.1", "2"),
        ("1.1", "2.2"),
    ]
    assert all(0 < float(row["defect"]) <= 1e-4 for row in rows)
    solution = read_solution(Path("found/00003.json"))
    assert solution.cost.total == float(rows[3]["cost"])
    assert solution.trajectory.t[-1] == pytest.approx(2.2)
    assert Path("swing.sweep.png").stat().st_size > 1000
    monkeypatch.setattr(CaseSolver, "solve", None)  # nothing is solved again
    again = sweep(*given)
    assert (again.exit_code, again.stdout) == (0, first.stdout)


def test_a_sweep_goes_on_where_its_time_was_over(sweep: Sweep) -> None:
    given = ("--over", "end.pose.cart", "0.9,1.0,1.1", "-o", "some.record")
    short = sweep(*given, "--minutes", "0")
    assert short.exit_code == 1
    assert "2 cases are not solved yet; repeat the command" in short.stderr
    rest = sweep(*given, "--workers", "2")
    assert rest.exit_code == 0, rest.stderr
    alone = sweep(*given[:2], "0.9,1.0,1.1", "-o", "other.record", "--threads", "2")
    assert [row["cost"] for row in read_rows("some.record.csv")] == [
        row["cost"] for row in read_rows("other.record.csv")
    ]
    assert alone.exit_code == 0


def test_a_cluster_solves_cases(sweep: Sweep) -> None:
    """Its workers get the generated C; costs have the same digits as in this process."""
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        there = sweep(
            "--over", "end.pose.cart", "0.9,1.1", "-o", "there.record", "--scheduler", cluster.scheduler_address
        )
    assert there.exit_code == 0, there.stderr
    assert sweep("--over", "end.pose.cart", "0.9,1.1").exit_code == 0
    costs = [[row["cost"] for row in read_rows(path)] for path in ("there.record.csv", "swing.sweep.csv")]
    assert costs[0] == costs[1]


def test_neighbours_give_the_same_costs_in_any_way(sweep: Sweep) -> None:
    """In this process and in two, and where the record goes on in the middle of a tree."""
    over = ("--over", "end.pose.cart", "0.9:1.1:3")
    assert sweep(*over, "-o", "cold.sweep").exit_code == 0
    assert sweep(*over, "--neighbours", "-o", "one.sweep").exit_code == 0
    assert sweep(*over, "--neighbours", "--workers", "2", "-o", "two.sweep").exit_code == 0
    cold, one, two = (read_rows(f"{name}.sweep.csv") for name in ("cold", "one", "two"))
    assert [float(x["cost"]) for x in one] == pytest.approx([float(x["cost"]) for x in cold], rel=1e-7)
    assert [(x["cost"], x["iterations"]) for x in two] == [(x["cost"], x["iterations"]) for x in one]
    middle = sweep("--over", "end.pose.cart", "1.0", "--neighbours", "-o", "again.sweep")
    assert middle.exit_code == 0
    assert sweep(*over, "--neighbours", "-o", "again.sweep").exit_code == 0
    assert [x["cost"] for x in read_rows("again.sweep.csv")] == [x["cost"] for x in one]


def test_a_table_lists_cases_and_a_case_may_fail(sweep: Sweep) -> None:
    Path("cases.csv").write_text("horizon,end.pose.cart,solver.max_iterations\n,1.1,\n2,,\n,,3\n")
    result = sweep("--cases", "cases.csv")
    assert result.exit_code == 1
    assert "2 of 3 cases solved" in result.stdout
    good, _, bad = read_rows("swing.sweep.csv")
    assert (good["horizon"], good["end.pose.cart"], good["remark"]) == ("", "1.1", "")
    assert bad["cost"] == ""
    assert bad["status"] == "Maximum_Iterations_Exceeded"
    assert "raise solver.max_iterations" in bad["remark"]
    assert not Path("swing.sweep.png").exists()  # of three keys


@pytest.mark.parametrize(
    ("arguments", "told"),
    {
        "an unknown key": (["--over", "end.pose.cat", "1"], 'end.pose.cat: the model has no coordinate "cat"'),
        "no numbers": (["--over", "horizon", "1:2"], "give FROM:TO:COUNT, or values with commas"),
        "a name": (["--over", "horizon", "long"], 'horizon: unknown name "long"'),
        "a key twice": (["--over", "horizon", "1", "--over", "horizon", "2"], "horizon is given twice"),
        "too many": (
            ["--over", "horizon", "1:2:1000", "--over", "intervals", "1:2:1000"],
            "1000000 cases; give at most",
        ),
        "two lists": (["--over", "horizon", "1", "--cases", "x.csv"], "give one of them"),
        "options of targets": (["--over", "horizon", "1", "--radius", "1"], "--radius: for a grid of targets"),
        "two kinds of workers": (
            ["--over", "horizon", "1", "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"],
            "a cluster has its own workers",
        ),
        "neighbours on a cluster": (
            ["--over", "horizon", "1", "--scheduler", "tcp://127.0.0.1:1", "--neighbours"],
            "on a cluster, no case starts from the solution of another one",
        ),
        "options of cases": (["--workers", "2"], "--workers needs --over or --cases; give one of them"),
        "no table": (["--cases", "nowhere.csv"], "nowhere.csv: there is no such file"),
        "an empty table": (["--cases", "swing.ocp.yaml.csv"], "found 0 cases"),
        "ragged rows": (["--cases", "ragged.csv"], "ragged.csv:3: found 1 cells; give 2"),
        "a column twice": (["--cases", "twice.csv"], "twice.csv:1: a key is given twice"),
    }.values(),
)
def test_bad_arguments_get_one_sentence(sweep: Sweep, arguments: list[str], told: str) -> None:
    Path("swing.ocp.yaml.csv").write_text("horizon\n")
    Path("ragged.csv").write_text("horizon,intervals\n1,2\n1\n")
    Path("twice.csv").write_text("horizon,horizon\n1,2\n")
    result = sweep(*arguments)
    assert result.exit_code == 2
    assert told in result.stderr.replace("\n", " ")
    assert not Path("swing.sweep").exists()


def test_tables_of_spreadsheets_are_read(tmp_path: Path) -> None:
    """With a mark of their encoding, semicolons and remarks; a row of empty cells is a case, too."""
    table = tmp_path / "cases.csv"
    table.write_text("\ufeff# cases\nhorizon;end.pose.cart\r\n2;1.1\n;\n\n", encoding="utf-8")
    assert cases.read_table(table) == ({"horizon": 2, "end.pose.cart": 1.1}, {})


def test_values_are_numbers_expressions_or_names() -> None:
    assert cases.read_values("k", "0:pi/2:3") == pytest.approx([0, 0.7853981633974483, 1.5707963267948966])
    assert cases.read_values("k", "2*3, impl") == [6, "impl"]
