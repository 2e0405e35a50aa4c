"""Equations to read: equal to the kernels in 50 digits, in the textbook's form, and printed in every language."""

from __future__ import annotations

import importlib.util
import operator
import random
import xml.etree.ElementTree as ET
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
import sympy as sp
from click.testing import CliRunner

from mbsgen.cli import cli
from mbsgen.equations import (
    FORMATS,
    Motion,
    SizeError,
    build_symbolic,
    derive,
    show_lines,
    show_motion,
    sums,
    write_lines,
)
from mbsgen.formulations import closure, impl
from mbsgen.formulations.results import poses
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import read, read_tree
from mbsgen.tape.interpreter import DECIMALS, evaluate, fifty_digits
from mbsgen.tape.types import LITERALS, Op, Tape
from tests.shipped import FOLDER

SMALL = (
    "pendulum",
    "double_pendulum",
    "cart_pole",
    "branched",
    "leg",
    "satellite",
    "four_bar",
    "slider_crank",
    "delta",
)
LAWS = """\
name: a_lever
gravity: [0, 0, -9.81]
parameters:
  k: 30
  m1: 2
bodies:
  - name: plate
    joint:
      name: turn_2
      type: revolute
      axis: y
      stiffness: k
      rest: 0.2
      damping: 0.3
      friction: {torque: 4, speed: 0.02}
    mass: m1
    com: [0.1, 0, -0.2]
    inertia: [0.1, 0.2, 0.1]
"""


def _values(tree: Tree, motion: Motion, seed: int) -> dict[sp.Symbol, sp.Float]:
    """Draw a state; run-time parameters have the values of the model."""
    draw = random.Random(seed)
    given = {p.symbol.name: p.value for p in tree.parameters if p.kind is Kind.RUNTIME}
    found = {x: sp.Float(repr(given[x.name]), 50) for x in motion.naming.parameters}
    symbols = motion.residual.free_symbols | motion.h.free_symbols | motion.position.free_symbols
    others = sorted({*symbols, *motion.naming.q, *motion.naming.qd, *motion.naming.qdd} - set(found), key=str)
    return found | {x: sp.Float(repr(draw.uniform(-1, 1)), 50) for x in others}


def _compare(motion: Motion, tape: Tape, name: str, expected: sp.Matrix, at: dict[sp.Symbol, sp.Float]) -> None:
    arguments = {
        i.name: [Decimal(str(at.get(x, 0))) for x in motion.naming.name(i.port, i.sparsity.nnz)] for i in tape.inputs
    }
    with fifty_digits():
        results = evaluate(tape, arguments, DECIMALS)
    output = next(o for o in tape.outputs if o.name == name)
    found = dict(zip(output.sparsity.entries, results[name], strict=True))
    for r in range(expected.rows):
        for c in range(expected.cols):
            value = float(sp.N(expected[r, c].subs(at), 40))
            assert value == pytest.approx(float(found.get((r, c), 0)), rel=1e-12, abs=1e-13), (r, c)


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("is_symbolic", [True, False], ids=["symbols", "numbers"])
def test_equations_are_the_kernels(name: str, is_symbolic: bool) -> None:
    """The reduced recursion shares no plan with the textbook's, which equations are derived from."""
    model = read(FOLDER / f"{name}.yaml")
    tree = build_symbolic(model) if is_symbolic else read_tree(model)
    motion = derive(tree)
    at = _values(tree, motion, seed=3)
    _compare(motion, impl.build(tree), "Phi", motion.residual, at)
    assert (motion.M - motion.M.T).is_zero_matrix
    assert not motion.M.free_symbols & {*motion.naming.qd, *motion.naming.qdd}
    assert not motion.g.free_symbols & {*motion.naming.qd, *motion.naming.qdd, *motion.naming.u}
    if tree.is_constrained:
        _compare(motion, closure.build(tree), "gap", motion.h, at)
    if tree.sensors:
        _compare(motion, poses.build_sensors(tree), "position", motion.position, at)


def test_the_jacobian_of_loops_is_the_derivative() -> None:
    motion = derive(build_symbolic(read(FOLDER / "four_bar.yaml")))
    assert (motion.h.jacobian(sp.Matrix(motion.naming.q)) - motion.J).applyfunc(sp.expand).is_zero_matrix


def test_a_double_pendulum_is_the_textbooks() -> None:
    """Two thin rods: Lagrange's equations, derived here from kinetic and potential energy."""
    motion = derive(build_symbolic(read(FOLDER / "double_pendulum.yaml")))
    l1, l2, m1, m2, g = sp.symbols("l1 l2 m1 m2 g", real=True)
    q, qd = sp.Matrix(motion.naming.q), sp.Matrix(motion.naming.qd)

    def place(a: sp.Expr, b: sp.Expr) -> sp.Matrix:
        return sp.Matrix([-a * sp.sin(q[0]) - b * sp.sin(q[0] + q[1]), -a * sp.cos(q[0]) - b * sp.cos(q[0] + q[1])])

    middles = ((m1, place(l1 / 2, 0)), (m2, place(l1, l2 / 2)))
    rates = [(m, p.jacobian(q) * qd) for m, p in middles]
    kinetic = sum(m * (v.T * v)[0] / 2 for m, v in rates)
    kinetic += m1 * l1**2 / 24 * qd[0] ** 2 + m2 * l2**2 / 24 * (qd[0] + qd[1]) ** 2
    potential = sum(m * g * p[1] for m, p in middles)
    M = sp.hessian(kinetic, qd)
    lagrange = sp.Matrix([kinetic]).jacobian(qd).T.jacobian(q) * qd - sp.Matrix([kinetic]).jacobian(q).T
    assert (M - motion.M).applyfunc(sp.simplify).is_zero_matrix
    assert (lagrange - motion.c).applyfunc(sp.simplify).is_zero_matrix
    assert (sp.Matrix([potential]).jacobian(q).T - motion.g).applyfunc(sp.simplify).is_zero_matrix
    assert str(motion.g[1]) == "g*l2*m2*sin(q1 + q2)/2"


@pytest.mark.parametrize("page", ["motion", "lines"])
def test_python_gives_the_same_objects(page: str, tmp_path: Path) -> None:
    tree = build_symbolic(read(FOLDER / "satellite.yaml"))
    motion, lines = derive(tree), write_lines(tree)
    text = FORMATS["python"](show_motion(motion) if page == "motion" else show_lines(lines))
    file = tmp_path / "equations.py"
    file.write_text(text, encoding="utf-8")
    found = _load(file)
    at = _values(tree, motion, seed=5)
    expected = {"M": motion.M, "c": motion.c, "Q": motion.applied} if page == "motion" else {"Phi": motion.residual}
    for name, value in expected.items():
        differences = (found[name] - value).subs(at)
        assert max(abs(float(x)) for x in differences) < 1e-12, name


def _load(file: Path) -> dict[str, sp.Matrix]:
    specification = importlib.util.spec_from_file_location("equations", file)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return vars(module)


@pytest.mark.parametrize("language", FORMATS)
def test_names_and_laws_are_escaped(language: str, tmp_path: Path) -> None:
    file = tmp_path / "lever.yaml"
    file.write_text(LAWS, encoding="utf-8")
    tree = build_symbolic(read(file))
    text = FORMATS[language](show_motion(derive(tree)))
    if language == "html":
        root = ET.fromstring(_without_entities(text))
        assert len(list(root.iter("math"))) >= 4
        assert "<script" not in text
    if language == "python":
        compile(text, "equations", "exec")
    if language == "latex":
        assert r"\dot{\mathrm{turn}}_{2}" in text
    if language == "text":
        assert "G[1] = k*(turn_2 - 1/5) + 1.962*m1*sin(turn_2) - 0.981*m1*cos(turn_2)" in text
        assert "c[1] = 3*turn_2_d/10 + 4*tanh(50*turn_2_d)" in text
    assert text == FORMATS[language](show_motion(derive(tree)))


def _without_entities(text: str) -> str:
    for entity in ("InvisibleTimes", "ApplyFunction"):
        text = text.replace(f"&{entity};", "")
    return (
        text.replace("<!DOCTYPE html>", "")
        .replace('<meta charset="utf-8">', "")
        .replace('<meta name="viewport" content="width=device-width, initial-scale=1">', "")
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_sum_is_what_it_is_made_of(seed: int) -> None:
    """Random expressions of sums against SymPy's numbers, and identities that vanish."""
    draw = random.Random(seed)
    a, b = (sums.variable(sp.Symbol(x, real=True)) for x in "ab")
    sine, cosine = sums.SUMS.functions[Op.SIN], sums.SUMS.functions[Op.COS]
    one = sums.constant(LITERALS.mpf(1))
    assert (sine(a) * sine(a) + cosine(a) * cosine(a) - one).terms == {}
    assert (sine(a + b) - sine(a) * cosine(b) - cosine(a) * sine(b)).terms == {}
    pool = [a, b, sine(a), cosine(b), cosine(a - b), sums.constant(LITERALS.mpf("0.3"))]
    expressions = [x.expression for x in pool]
    for _ in range(12):
        i, j, kind = draw.randrange(len(pool)), draw.randrange(len(pool)), draw.choice("+-*")
        operate: Callable[[Any, Any], Any] = {"+": operator.add, "-": operator.sub, "*": operator.mul}[kind]
        pool.append(operate(pool[i], pool[j]))
        expressions.append(operate(expressions[i], expressions[j]))
    at = {sp.Symbol("a", real=True): 0.37, sp.Symbol("b", real=True): -1.2}
    for found, other in zip(pool, expressions, strict=True):
        assert float(found.expression.subs(at)) == pytest.approx(float(other.subs(at)), rel=1e-12, abs=1e-12)


def test_long_equations_are_refused_or_written_line_by_line() -> None:
    tree = build_symbolic(read(FOLDER / "leg.yaml"))
    with pytest.raises(SizeError, match="more than 10 terms"):
        derive(tree, 10)
    assert derive(tree).terms > 10  # the limit holds for one call
    run = CliRunner().invoke(cli, ["equations", str(FOLDER / "six_axis.yaml")], catch_exceptions=False)
    assert "line by line" in run.output


def test_the_command_writes_what_the_suffix_says(tmp_path: Path) -> None:
    model, runner = str(FOLDER / "pendulum.yaml"), CliRunner()
    for suffix, start in ((".py", '"""Equations'), (".tex", "% Equations"), (".md", "# Equations"), (".html", "<!DOC")):
        out = tmp_path / f"page{suffix}"
        run = runner.invoke(cli, ["equations", model, "-o", str(out)], catch_exceptions=False)
        assert run.exit_code == 0
        assert out.read_text(encoding="utf-8").startswith(start)
    run = runner.invoke(cli, ["equations", model, "-o", str(tmp_path / "page.doc")])
    assert run.exit_code != 0
    assert "give --format" in run.output
    assert not (tmp_path / "page.doc").exists()


COLLISION = """
name: collision
gravity: [0, 0, -9.81]
parameters: {arm: 0.3}
bodies:
  - {name: arm, joint: {type: revolute, axis: y, force: act - arm*q + sin(t)}, mass: 1, com: [arm, 0, 0]}
signals: [act]
"""


def test_a_parameter_is_no_coordinate_of_the_same_name(tmp_path: Path) -> None:
    """l^2 q'' + l q - 9.81 l cos q = u + act + sin t, where the parameter l and the joint have one name."""
    file = tmp_path / "collision.yaml"
    file.write_text(COLLISION)
    motion = derive(build_symbolic(read(file)))
    q, l, u, act, t = sp.symbols("arm p_arm u_arm act t", real=True)
    expected = l**2 * motion.naming.qdd[0] + l * q - sp.Rational(981, 100) * l * sp.cos(q) - u - act - sp.sin(t)
    difference = motion.residual[0] - expected
    for start in (0.2, 0.7):
        values = {x: start + 0.1 * k for k, x in enumerate(sorted(expected.free_symbols, key=str))}
        assert difference.free_symbols <= values.keys()
        assert abs(difference.evalf(subs=values, chop=True)) < 1e-12


CLASH = """\
name: clash
gravity: [0, 0, -9.81]
parameters: {M: 2, c: 0.3, l: 0.5, Q: 1.5}
bodies:
  - {name: cart, joint: {name: h, type: prismatic, axis: x, stiffness: c, rest: 0.1}, mass: M}
  - name: pole
    parent: cart
    joint: {name: a, type: revolute, axis: -y, actuated: false}
    mass: Q
    com: [0, 0, -l]
"""


def test_numbers_with_the_names_of_matrices_have_others_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of one call hold one page; a note explains each other name, and no number is called M, c or Q."""
    monkeypatch.chdir(tmp_path)
    Path("clash.yaml").write_text(CLASH, "utf-8")
    outputs = ["-o", "a.txt", "-o", "a.tex", "-o", "a.html", "-o", "a.md", "-o", "a.py"]
    done = CliRunner().invoke(cli, ["equations", "clash.yaml", "--form", "whole", *outputs])
    assert done.exit_code == 0, done.output
    text = Path("a.txt").read_text("utf-8")
    assert "M_p is the number M of the model" in text
    assert "M[1,1] = M_p + Q_p" in text
    for file in ("a.tex", "a.html", "a.md"):
        assert "M_p is the number M of the model" in Path(file).read_text("utf-8")
    known: dict[str, object] = {}
    exec(Path("a.py").read_text("utf-8"), known)  # noqa: S102  # it is a module that was just written
    mass = known["M"]
    assert isinstance(mass, sp.MatrixBase)
    assert str(mass[0, 0]) in ("M + Q", "Q + M")
    both = CliRunner().invoke(cli, ["equations", "clash.yaml", "--format", "text", *outputs])
    assert (both.exit_code, "leave it out" in both.output) == (2, True)
