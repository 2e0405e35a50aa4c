"""Equations of contacts, springs and cables: short, in names, and equal to the kernels."""

from __future__ import annotations

import importlib.util
import random
from decimal import Decimal
from pathlib import Path

import pytest
import sympy as sp
from click.testing import CliRunner

from mbsgen.cli import cli
from mbsgen.equations import (
    FORMATS,
    Page,
    SizeError,
    build_numeric,
    build_symbolic,
    derive,
    show_lines,
    show_motion,
    write_lines,
)
from mbsgen.equations.motion import Naming, name_symbols
from mbsgen.formulations import coupling, impl
from mbsgen.formulations.reductions import ALL
from mbsgen.model.smooth import softplus, step
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import read, read_tree
from mbsgen.tape.interpreter import DECIMALS, evaluate, fifty_digits

BALL = """\
name: ball
gravity: [0, 0, -9.81]
parameters: {m: 1.3, R: 0.03}
bodies:
  - {name: cart, joint: {name: x, type: prismatic, axis: x, actuated: false}, mass: 0}
  - {name: lift, parent: cart, joint: {name: z, type: prismatic, axis: z, actuated: false}, mass: 0}
  - {name: ball, parent: lift, joint: {name: a, type: revolute, axis: y}, mass: m, inertia: [1e-3, 1e-3, 1e-3]}
contacts:
  - {name: ball, body: ball, radius: R, stiffness: 1e5, dissipation: 0.5, friction: {coefficient: 0.8, speed: 0.01}}
"""
ARM = """\
name: arm
gravity: [0, 0, -9.81]
parameters: {k: 100, m: 1.1, l: 0.9, L0: 0.3, c: 2}
bodies:
  - name: arm
    joint: {name: q1, type: revolute, axis: y, force: "-3*softplus(q - 0.1, 0.1) - max(q, 2*qd_q2) + min(q, 0.1)"}
    mass: m
    com: [0, 0, -l]
  - name: hand
    parent: arm
    joint: {name: q2, type: revolute, axis: y, position: [0, 0, -l], actuated: false}
    mass: m
    com: [0, 0, -l]
frames:
  - {name: tip, body: hand, position: [0, 0, -0.4], sensor: false}
wrenches:
  - name: wall
    body: hand
    frame: base
    position: [0, 0, -0.4]
    force: ["-9*step(x_tip + sin(t), 0.2)*vx_tip", 0, act]
signals: [act]
forces:
  - name: strut
    from: {body: base, position: [0.5, 0, 0]}
    to: {body: arm, position: [0, 0, -l/2]}
    stiffness: k
    rest: L0
    damping: c
  - name: rope
    type: cable
    from: {body: base, position: [0, 0, 1]}
    to: {body: hand, position: [0, 0, -0.2]}
    stiffness: 1e3
    rest: 1.8
    dissipation: 0.1
    width: 0.1
    force: act
  - {name: zero, from: {body: base, position: [0, 0, 1]}, to: {body: hand, position: [0, 0, -0.2]}, stiffness: 10}
  - name: muscle
    from: {body: base, position: [-0.5, 0, 0]}
    to: {body: arm, position: [0, 0, -l/2]}
    force: 30*exp(-length) - 2*rate*qd_q1
"""
GEAR = """\
name: gear
gravity: [0, 0, -9.81]
bodies:
  - {name: arm, joint: {name: q1, type: revolute, axis: y, actuated: false}, mass: 1, com: [0, 0, -1]}
  - name: hand
    parent: arm
    joint: {name: q2, type: revolute, axis: y, position: [0, 0, -1], follows: {joint: q1, ratio: 2, offset: 0.1}}
    mass: 1
    com: [0, 0, -1]
contacts:
  - {name: heel.1, body: hand, position: [0, 0, -1], radius: 0.2, plane: {position: [0, 0, -2]}, stiffness: 500}
"""
FALL = """\
name: fall
gravity: [0, 0, -9.81]
bodies:
  - {name: crate, joint: {type: floating}, mass: 1, inertia: [0.1, 0.1, 0.1]}
contacts:
  - name: crate
    body: crate
    size: [1, 0.8, 0.6]
    stiffness: 300
    exponent: 1
    width: 0.1
    friction: {coefficient: 0.5, speed: 0.1}
"""
SLEDS = """\
name: sleds
gravity: [0, 0, 0]
parameters: {R: 0.2}
bodies:
  - {name: a, joint: {type: prismatic, axis: x}, mass: 1}
  - {name: b, joint: {type: prismatic, axis: x, actuated: false}, mass: 2}
contacts:
  - name: bump
    body: a
    radius: 0.1
    sphere: {body: b, radius: R, position: [0, 0, 0.05]}
    stiffness: 1e3
    dissipation: 0.2
    friction: {coefficient: 0.3, speed: 0.01}
"""
MODELS = {"ball": BALL, "arm": ARM, "gear": GEAR, "sleds": SLEDS}


def _load(page: Page, folder: Path) -> dict[str, sp.Matrix]:
    file = folder / "equations.py"
    file.write_text(FORMATS["python"](page), encoding="utf-8")
    specification = importlib.util.spec_from_file_location("equations", file)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return vars(module)


def _draw(naming: Naming, tree: Tree, seed: int) -> dict[str, sp.Float]:
    """Draw a state, by names: near the ground, so that contacts press and cables pull."""
    draw = random.Random(seed)
    given = {p.symbol.name: p.value for p in tree.parameters if p.kind is Kind.RUNTIME}
    columns = (naming.q, naming.qd, naming.qdd, naming.u, naming.signals)
    state = {x.name: draw.uniform(-0.2, 0.3) for column in columns for x in column}
    return {name: sp.Float(repr(value), 50) for name, value in (state | given).items()}


def _evaluate_kernel(file: Path, naming: Naming, at: dict[str, sp.Float]) -> list[float]:
    """Evaluate the residual of the usual tree, in 50 digits."""
    tape = coupling.write(impl.build, None, read_tree(file), ALL)
    arguments = {i.name: [Decimal(str(at[x.name])) for x in naming.name(i.port, i.sparsity.nnz)] for i in tape.inputs}
    with fifty_digits():
        return [float(x) for x in evaluate(tape, arguments, DECIMALS)["Phi"]]


@pytest.mark.parametrize("form", ["whole", "lines"])
@pytest.mark.parametrize("is_symbolic", [True, False], ids=["symbols", "numbers"])
@pytest.mark.parametrize("name", MODELS)
def test_printed_equations_are_the_kernels(name: str, is_symbolic: bool, form: str, tmp_path: Path) -> None:
    """The kernels know no named function: they compute exp and log of the same numbers."""
    file = tmp_path / "model.yaml"
    file.write_text(MODELS[name], encoding="utf-8")
    tree = (build_symbolic if is_symbolic else build_numeric)(read(file))
    naming = name_symbols(tree)
    found = _load(show_motion(derive(tree)) if form == "whole" else show_lines(write_lines(tree)), tmp_path)
    if form == "whole":
        zero = sp.zeros(len(naming.qd), 1)
        qdd = sp.Matrix(naming.qdd)
        residual = found["M"] * qdd + found.get("c", zero) + found.get("G", zero) - found.get("Q", zero)
    else:
        residual = found["Phi"]
    for seed in range(4):
        at = _draw(naming, tree, seed)
        values = {x: at[x.name] for x in residual.free_symbols}
        expected = _evaluate_kernel(file, naming, at)
        for value, other in zip(residual, expected, strict=True):
            assert float(sp.N(value.subs(values), 40)) == pytest.approx(other, rel=1e-12, abs=1e-12)


def test_a_ball_on_the_ground_fits_on_a_page(tmp_path: Path) -> None:
    file = tmp_path / "ball.yaml"
    file.write_text(BALL, encoding="utf-8")
    motion = derive(build_symbolic(read(file)))
    text = FORMATS["text"](show_motion(motion))
    for line in (
        "Q[2] = N_ball",
        "Q[3] = R*drag_ball*slip_ball_x + u_a",
        "gap_ball = -R + z",
        "depth_ball = softplus(-gap_ball, 0.0001)",
        "slip_ball_x = -R*a_d + x_d",
    ):
        assert f"  {line}\n" in text
    assert max(map(len, text.splitlines())) < 120
    assert "slip_ball_z" not in text
    assert not motion.expand(motion.applied).free_symbols & {line.name for line in motion.named}
    latex = FORMATS["latex"](show_motion(motion))
    assert r"\mathrm{depth}_{\mathrm{ball}} = \operatorname{softplus}" in latex
    assert latex == FORMATS["latex"](show_motion(derive(build_symbolic(read(file)))))


def test_a_contact_of_spheres_names_the_distance_of_its_centres(tmp_path: Path) -> None:
    file = tmp_path / "sleds.yaml"
    file.write_text(SLEDS, encoding="utf-8")
    text = FORMATS["text"](show_motion(derive(build_symbolic(read(file)))))
    for line in ("gap_bump = -R + length_bump - 1/10", "slip_bump_z = rate_bump/(20*length_bump)"):
        assert f"  {line}\n" in text
    assert max(map(len, text.splitlines())) < 120


SHELF = """\
name: shelf
gravity: [0, 0, -9.81]
bodies:
  - {name: cart, joint: {name: x, type: prismatic, axis: x, actuated: false}, mass: 0}
  - {name: ball, parent: cart, joint: {name: z, type: prismatic, axis: z, actuated: false}, mass: 1.3}
contacts:
  - {name: hit, body: ball, radius: 0.03, box: {size: [0.4, 0.3, 0.2]}, stiffness: 1e5, width: 1e-3,
     friction: {coefficient: 0.8, speed: 0.01}}
"""


def test_a_contact_with_a_box_names_the_parts_of_its_distance(tmp_path: Path) -> None:
    """In lines that can be read: the gap is the part outside less the part inside, and the radius."""
    file = tmp_path / "shelf.yaml"
    file.write_text(SHELF, encoding="utf-8")
    text = FORMATS["text"](show_motion(derive(build_symbolic(read(file)))))
    for line in ("at_hit_z = z", "beyond_hit_z = -at_hit_z + softplus(2*at_hit_z, 0.001) - 1/10"):
        assert f"  {line}\n" in text
    assert max(map(len, text.splitlines())) < 200


def test_many_points_are_written_line_by_line(tmp_path: Path) -> None:
    """A crate has eight corners; each has its own numbers, and the residual is the kernel's."""
    file = tmp_path / "fall.yaml"
    file.write_text(FALL, encoding="utf-8")
    tree = build_numeric(read(file))
    lines = write_lines(tree)
    assert {f"N_crate.{k}" for k in range(1, 9)} <= {x.name.name for x in lines.lines}
    found = _load(show_lines(lines), tmp_path)
    at = _draw(lines.naming, tree, 5)
    values = {x: at[x.name] for x in found["Phi"].free_symbols}
    expected = _evaluate_kernel(file, lines.naming, at)
    for value, other in zip(found["Phi"], expected, strict=True):
        assert float(sp.N(value.subs(values), 40)) == pytest.approx(other, rel=1e-12, abs=1e-12)


def test_numbers_of_forces_count_as_terms(tmp_path: Path) -> None:
    """The whole equations of a crate would fill pages with the numbers that its eight corners name."""
    file = tmp_path / "fall.yaml"
    file.write_text(FALL, encoding="utf-8")
    with pytest.raises(SizeError, match="numbers of contacts and force elements have more than 300 terms"):
        derive(build_numeric(read(file)), 300)
    run = CliRunner().invoke(cli, ["equations", str(file)], catch_exceptions=False)
    assert run.output.startswith("Equations of motion of fall, line by line")


def test_jacobians_go_through_the_numbers_of_forces(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(ARM, encoding="utf-8")
    tree = build_symbolic(read(file))
    motion = derive(tree)
    at = _draw(motion.naming, tree, 4)
    for symbols in (motion.naming.q, motion.naming.qd, motion.naming.parameters):
        found = motion.expand(motion.jacobian(motion.applied, symbols))
        expected = motion.expand(motion.applied).jacobian(sp.Matrix(symbols))
        for one, other in zip(found, expected, strict=True):
            values = {x: at[x.name] for x in one.free_symbols | other.free_symbols}
            a, b = (float(sp.N(x.doit().subs(values), 40)) for x in (one, other))
            assert a == pytest.approx(b, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("function", [softplus, step])
def test_smooth_functions_know_their_derivatives(function: type[sp.Function]) -> None:
    x, w = sp.symbols("x w", real=True)
    for at in ((0.3, 0.2), (-0.7, 0.4)):
        values = dict(zip((x, w), map(sp.Float, at), strict=True))
        definition = w * sp.log(1 + sp.exp(x / w)) if function is softplus else 1 / (1 + sp.exp(-x / w))
        assert float(function(x, w).subs(values)) == pytest.approx(float(definition.subs(values)), rel=1e-14)
        for symbol in (x, w):
            slope = function(x, w).diff(symbol).subs(values)
            assert float(slope) == pytest.approx(float(definition.diff(symbol).subs(values)), rel=1e-13)
    assert float(function(sp.Integer(9000), sp.Integer(1)).doit()) == (9000.0 if function is softplus else 1.0)
