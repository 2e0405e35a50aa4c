"""Problems in phases in Python: the keys and checks of a file, copies, solutions by phase, and files."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import yaml

import mbsrun
from mbsgen.errors import MbsError
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal.phases import PhasedControl, SolvedPhases
from mbsrun.optimal.result import Unsolved
from mbsrun.results import UnknownNameError

MODEL = Path(__file__).parents[3] / "models" / "cart_pole.yaml"
KEYS: dict[str, Any] = {
    "intervals": 10,
    "scheme": "radau",
    "degree": 4,
    "bounds": {"inputs": [-20, 20]},
    "cost": {"inputs": 1},
    "start": {"pose": {}},
    "phases": [
        {"name": "pump", "horizon": 1},
        {"name": "catch", "horizon": 1, "end": {"pose": {"cart": 1, "pole": "pi"}, "velocity": "zero"}},
    ],
    "links": [{"from": "pump", "to": "catch"}],
}


@pytest.fixture(scope="module")
def swing() -> PhasedControl:
    return mbsrun.problem(MODEL, **KEYS)


@pytest.fixture(scope="module")
def solved(swing: PhasedControl) -> SolvedPhases:
    found = swing.solve()
    assert isinstance(found, SolvedPhases)
    return found


def test_a_problem_in_python_is_the_problem_of_its_file(swing: PhasedControl, tmp_path: Path) -> None:
    (tmp_path / "cart_pole.ocp.yaml").write_text(yaml.safe_dump({"model": str(MODEL), **KEYS}))
    read = mbsrun.read_problem(tmp_path / "cart_pole.ocp.yaml")
    assert isinstance(read, PhasedControl)
    assert read.value == swing.value


def test_two_phases_are_one_motion(solved: SolvedPhases) -> None:
    """A swing-up that is cut in two has the optimum of the whole."""
    keys = {key: x for key, x in KEYS.items() if key not in ("phases", "links")}
    whole = mbsrun.problem(MODEL, **keys | {"intervals": 20, "horizon": 2, "end": KEYS["phases"][1]["end"]})
    first, second = (solved[name].trajectory for name in solved.names)
    joined = {x: np.concatenate((getattr(first, x), getattr(second, x)[1:])) for x in ("t", "q", "qd")}
    joined |= {
        x: np.concatenate((getattr(first, x), getattr(second, x)))
        for x in ("u", "point_t", "point_q", "point_qd", "point_qdd")
    }
    found = whole.solve(guess=Trajectory(**joined), check=False)
    assert solved.cost == pytest.approx(found.cost, rel=1e-8)
    assert solved.names == ("pump", "catch")
    assert solved.durations == {"pump": 1.0, "catch": 1.0}
    pump, catch = solved["pump"], solved["catch"]
    assert (pump.t[-1], catch.t[0], catch.t[-1]) == (1.0, 1.0, 2.0)
    assert np.abs(pump["q"][-1] - catch["q"][0]).max() <= 1e-10
    assert catch["q_pole"][-1] == pytest.approx(np.pi)
    assert solved.links[0].violation <= 1e-8
    with pytest.raises(UnknownNameError, match="no phase 'leap'; there are pump, catch"):
        solved["leap"]


def test_phases_show_themselves(swing: PhasedControl, solved: SolvedPhases) -> None:
    for text in (repr(swing), swing._repr_html_()):
        assert "pump: grid" in text
        assert "pump to catch" in text
    for text in (repr(solved), solved._repr_html_()):
        assert "catch: defect" in text
        assert "take more intervals" in text
    assert len(solved.plot().figure.axes) == 10  # of two phases: q and qd in m and rad, u
    assert solved.animate()._repr_html_().startswith("<iframe")


def test_copies_and_files(swing: PhasedControl, solved: SolvedPhases, tmp_path: Path) -> None:
    solved.save(tmp_path / "s.json")
    assert swing.load(tmp_path / "s.json").cost == solved.cost
    nearer = swing.with_phase("catch", end={"pose": {"cart": 0.9}})
    found = nearer.solve(guess=solved, check=False)
    assert found["catch"]["q_cart"][-1] == pytest.approx(0.9)
    again = nearer.solve(guess=tmp_path / "s.json", check=False)
    assert again.cost == pytest.approx(found.cost, rel=1e-8)
    arrays = {name: solved["pump"][name] for name in ("t", "q_cart", "q_pole")}
    parts = {"pump": arrays, "catch": solved["catch"]}
    for guess in (parts, {"catch": solved["catch"].trajectory}):
        assert nearer.solve(guess=guess, check=False).cost == pytest.approx(found.cost, rel=1e-6)
    with pytest.raises(MbsError, match="there is no phase 'leap'"):
        nearer.solve(guess={"leap": solved["catch"]})
    assert swing.with_solver("ipopt", tolerance=1e-6).value.solver.tolerance == 1e-6
    assert swing.with_constants(w=2.0).data["constants"] == {"w": 2.0}
    stuck = nearer.with_changes(bounds={"inputs": [-0.01, 0.01]}).solve(check=False)
    assert isinstance(stuck, Unsolved)
    with pytest.raises(MbsError, match="cart_pole was not solved"):
        stuck["catch"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.with_phase("leap", horizon=2), "phases: there is no phase 'leap'; there are pump, catch"),
        (lambda p: p.with_phase("pump", horizn=2), r"phases\[0\].horizn: unknown key; did you mean `horizon`\?"),
        (
            lambda p: p.with_phase("catch", end={"pose": {"pol": 1}}),
            r"phases\[1\].end.pose.pol: the model has no coord",
        ),
        (lambda p: p.with_changes(links=[{"from": "pump", "to": "cach"}]), r"links\[0\].to: there is no phase .cach."),
        (
            lambda p: mbsrun.problem(p.plants.phases[0], phases=[{"name": "a"}]),
            "model: loaded kernels, for a problem in",
        ),
    ],
)
def test_faults_name_their_places(swing: PhasedControl, change: Any, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        change(swing)


def test_expressions_in_casadi_are_the_ones_of_a_file(swing: PhasedControl) -> None:
    """A price and a constraint of one phase each, in symbols and as text: the same program, and the same optimum."""
    pump, catch = swing.quantities("pump"), swing.quantities("catch")
    written = swing.with_cost("catch", catch.q_cart**2, 5, at="path").with_constraint("pump", pump.qd_cart, -2, 1.5)
    text = swing.with_phase("catch", cost={"running": [{"expression": "q_cart**2", "weight": 5}]})
    text = text.with_phase("pump", constraints=[{"expression": "qd_cart", "range": [-2, 1.5]}])
    found, other = written.solve(check=False), text.with_solver("ipopt").solve(check=False)
    assert isinstance(found, SolvedPhases)
    assert isinstance(other, SolvedPhases)
    assert found.cost == pytest.approx(other.cost, rel=1e-8)
    assert found["pump"]["qd_cart"].max() == pytest.approx(1.5, abs=1e-6)
    again = written.with_phase("catch", horizon=1.1)
    assert [len(phase.problem.functions) for phase in again.value.phases] == [1, 1]


def test_expressions_of_phases_are_checked(swing: PhasedControl) -> None:
    pump = swing.quantities("pump")
    for wrong, message in (
        (lambda: swing.with_cost("leap", pump.T), "phases: there is no phase 'leap'; there are pump, catch"),
        (lambda: swing.quantities("leap"), "there is no phase 'leap'"),
        (lambda: swing.with_cost("pump", pump.qd), "cost: an expression of 2 entries; give a scalar"),
        (lambda: swing.with_cost("pump", pump.T, at=cast(Any, "start")), "cost: at 'start'; give 'path' or 'end'"),
        (lambda: swing.with_cost("pump", pump.T, "much"), "cost: the weight is 'much'; give a number"),
        (lambda: swing.with_constraint("pump", 3.0, 0, 1), "found a value of type float"),
        (lambda: swing.with_constraint("pump", pump.qd, [0, 0, 0], 1), "2 entries, with the limits"),
    ):
        with pytest.raises(ProblemError, match=message):
            wrong()


def test_a_frame_holds_all_phases_in_sequence(solved: SolvedPhases, monkeypatch: pytest.MonkeyPatch) -> None:
    def make(columns: dict[str, Any], index: Any) -> Any:
        return columns, index

    pandas = SimpleNamespace(DataFrame=make, Index=lambda values, name: (values, name))
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    columns, (times, name) = solved.to_frame()
    assert name == "t"
    assert list(dict.fromkeys(columns["phase"])) == ["pump", "catch"]
    assert (np.diff(times) >= 0).all()
    assert {len(column) for column in columns.values()} == {len(times)}
    assert columns["q_pole"][-1] == pytest.approx(np.pi)
