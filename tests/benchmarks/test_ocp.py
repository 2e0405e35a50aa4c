"""The benchmark of optimal control: the peer solves the same program, and the table says so."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.newton_euler import write_functions
from benchmarks.ocp.__main__ import MODELS, list_variants, main, write_place
from benchmarks.ocp.peer import Peer, Shelf, list_settings, write_dynamics
from benchmarks.ocp.rows import (
    OURS,
    Figures,
    Loads,
    Row,
    read_figures,
    replace_rows,
    write_figures,
    write_page,
)
from mbsgen.pipeline import read_tree
from mbsrun.ocp.problem import Problem, Representation
from mbsrun.ocp.statement import read_problem
from tests.mbsrun.peer_arm import peer_arm


@pytest.fixture(scope="module")
def problem() -> Problem:
    return read_problem(MODELS / "arm_reach.ocp.yaml", lambda _: peer_arm())[0]


@pytest.fixture(scope="module")
def dynamics() -> dict[str, ca.Function]:
    return write_dynamics(write_functions(read_tree(MODELS / "arm_pendulum.yaml")))


def test_the_peer_has_the_same_mechanics(dynamics: dict[str, ca.Function]) -> None:
    """Residual, its other form, accelerations and the hand's place: those of the arm made by hand."""
    arm, rng = peer_arm(), np.random.default_rng(2)
    q, qd, qdd, u = rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 4)
    Phi = arm("impl", q=q, qd=qd, qdd=qdd, u=u)["Phi"]
    for name in ("impl", "semi"):
        assert dynamics[name](q, qd, qdd, u).full().ravel() == pytest.approx(Phi, abs=1e-12)
    found = dynamics["exp"](q, qd, u).full().ravel()
    assert np.abs(arm("impl", q=q, qd=qd, qdd=found, u=u)["Phi"]).max() < 1e-11
    symbol = ca.SX.sym("q", 6)
    place = ca.Function("place", [symbol], [write_place(symbol)])
    assert place(q).full().ravel() == pytest.approx(arm("sensors", q=q)["position"][:, 0], abs=1e-14)


@pytest.mark.parametrize("name", ["IMPL", "EXP1-O"])
def test_the_peer_has_the_program_of_the_paper(problem: Problem, dynamics: dict[str, ca.Function], name: str) -> None:
    """Table 3: 8812 variables, 8427 constraints, 72435 nonzeros; or 6412, 6027, 62519 for an ODE."""
    chosen = replace(problem, representation=Representation(name))
    symbol = ca.SX.sym("q", 6)
    place = ca.Function("place", [symbol], [write_place(symbol)])
    peer = Peer(chosen, dynamics, place, list_settings(chosen)["tuned"])
    sizes = (peer.variables, peer.constraints, peer.jacobian_nonzeros)
    assert sizes == ((8812, 8427, 72435) if name == "IMPL" else (6412, 6027, 62519))


def test_a_compiled_peer_is_kept_with_what_compiling_it_took(
    tmp_path: Path, problem: Problem, monkeypatch: pytest.MonkeyPatch, requires: Callable[[str], str]
) -> None:
    """Found again by its text, without the compiler, and solves as the interpreted one does."""
    requires("cc")
    q, qd, qdd, u = (ca.SX.sym(name, size) for name, size in (("q", 6), ("qd", 6), ("qdd", 6), ("u", 4)))
    light = {"impl": ca.Function("impl", [q, qd, qdd, u], [qdd - ca.vertcat(u, 0, 0) + ca.sin(q)])}
    place = ca.Function("place", [q], [q[:3]])
    chosen = replace(problem.with_target("hand", (0.1, 0.9, -1.9)), intervals=5, degree=2)
    shelf = Shelf(tmp_path)
    monkeypatch.setattr("benchmarks.ocp.peer.FLAGS", ["-O0"])
    first = Peer(chosen, light, place, list_settings(chosen)["tuned"], shelf)
    (library,) = tmp_path.glob("*.so")
    (record,) = tmp_path.glob("*.json")
    assert json.loads(record.read_text("utf-8"))["seconds"] > 0
    record.write_text('{"seconds": 1000}', "utf-8")
    monkeypatch.setattr("benchmarks.ocp.peer.FLAGS", ["-O0", "-DOTHER"])
    other = Peer(chosen, light, place, list_settings(chosen)["tuned"], shelf)
    monkeypatch.setattr("benchmarks.ocp.peer.FLAGS", ["-O0"])
    again = Peer(chosen, light, place, list_settings(chosen)["tuned"], shelf)
    assert other.seconds_building < 1000 <= again.seconds_building
    assert len(list(tmp_path.glob("*.so"))) == 2
    assert library.exists()
    assert first.jacobian_nonzeros == again.jacobian_nonzeros


def test_a_quick_run_measures_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], requires: Callable[[str], str]
) -> None:
    """Both find the same optimum from the same guess, under the same options in as many iterations."""
    requires("cc")
    assert main(["--quick", "--representation", "IMPL", "-o", str(tmp_path / "out")]) == 0
    rows = {row["way"]: row for row in json.loads((tmp_path / "out" / "ocp.json").read_text("utf-8"))["rows"]}
    ours, peer = rows["mbsgen"], rows["CasADi, interpreted, tuned"]
    assert peer["cost"] == pytest.approx(ours["cost"], rel=1e-6)
    assert abs(peer["iterations"] - ours["iterations"]) <= 2
    assert (peer["variables"], peer["constraints"]) == (ours["variables"], ours["constraints"])
    assert "CasADi, interpreted, defaults" in capsys.readouterr().out


def test_ours_are_all_forms_solvers_and_barriers(problem: Problem) -> None:
    """Of an ODE there is no integral form; the linear solver that is taken anyway is not named."""
    found = dict(list_variants(replace(problem, representation=Representation.EXP1_O)))
    names = ["", ", adaptive", ", mumps", ", mumps, adaptive"]
    assert list(found) == [f"mbsgen{form}{name}" for form in ("", ", shooting form") for name in names]
    told = found["mbsgen, shooting form, mumps, adaptive"].solver.options
    assert dict(told) == {"linear_solver": "mumps", "mu_strategy": "adaptive"}


def test_what_an_interrupted_run_kept_is_found(tmp_path: Path) -> None:
    """By what it is about; a representation that is measured again replaces its rows, and loads are told."""
    row = Row("IMPL", OURS, 1.0, 10, 9, "Solve_Succeeded", 4, 2.0, 0.5, 0.1)
    first = replace_rows(Figures("a machine", 2, 3.0), [row, replace(row, way="other")], Loads("IMPL", 0.5, 7.0))
    write_figures(first, tmp_path)
    assert read_figures(tmp_path / "ocp.json", "a machine") == first
    assert read_figures(tmp_path / "ocp.json", "another") is None
    page = (tmp_path / "ocp.md").read_text("utf-8")
    assert "0.5 to 7.0 processes" in page
    assert "disturbed" in page
    again = replace_rows(first, [row], Loads("IMPL", 0.5, 0.7))
    assert again.rows == (row,)
    assert again.representations == ["IMPL"]
    assert "disturbed" not in write_page(again)
