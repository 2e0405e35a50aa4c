"""The Rust crate: cargo runs its own tests, and its numbers are the C's to the last bit."""

from __future__ import annotations

import struct
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mbsgen.pipeline import Options, generate
from mbsgen.targets.parts import divide
from mbsgen.targets.rust import stages as rust_stages
from mbsgen.targets.rust.crate import name_item, write_string
from mbsrun import load
from tests.mbsgen.targets.compilation import Requires, run

MODELS = Path(__file__).parents[3] / "models"
HOSTILE = """\
name: fn
gravity: [0, 0, -9.81]
parameters:
  type: {value: 2.5, kind: runtime}
  Some: {value: 0.15, kind: runtime}
bodies:
  - name: crate
    joint: {name: self, type: revolute, axis: y, damping: 0.1}
    mass: type
    com: [0.1, 0, -0.5]
    inertia: [0.1, Some, 0.1]
  - name: match
    parent: crate
    joint: {name: loop, type: prismatic, axis: [1, 0, 1], position: [0, 0, -1]}
    mass: 1.5
    com: [0, 0.2, 0]
    inertia: [0.1, 0.2, 0.3]
frames:
  - {name: mod, body: match, position: [0, 0, -0.4]}
"""
EXAMPLE = """\
fn show(values: &[f64]) {
    for x in values {
        println!("{:016x}", x.to_bits());
    }
}

fn main() {
    let mut model = fn_model::Model::new().unwrap();
    model.parameters[fn_model::p::index::type_] *= 1.25;
    model.update().unwrap();
    assert_eq!(fn_model::q::NAMES, ["self", "loop"]);
    let (q, qd, u, qdd) = ([0.3, -0.8], [1.2, -0.7], [0.5, -0.25], [3.0, -1.0]);
    show(&model.impl_(&q, &qd, &qdd, &u).unwrap());
    show(&model.exp1(&q, &qd, &u).unwrap());
    show(&model.exp2(&q, &qd, &u).unwrap());
    show(&model.sensors(&q).unwrap());
    for row in model.jac_exp2(&q, &qd, &u).unwrap().jac_qdd_q.rows() {
        show(&row);
    }
    show(&model.exp1(&[2.0e5, -0.8], &qd, &u).unwrap());
    println!("{}", model.exp1(&[f64::NAN, f64::NAN], &qd, &u).unwrap_err());
}
"""
LINKAGE = """\
fn main() {
    let model = four_bar_model::Model::new().unwrap();
    let q = [1.0, -0.4, 1.6];
    let found = model.project_plain(&q, &[2.0, 0.1, 0.2]).unwrap();
    let closed = model.close(&q).unwrap();
    let slope = model.jac_close(&closed).unwrap();
    for x in found.closed.iter().chain(&found.closed_qd).chain(&closed).chain(slope.rows().as_flattened()) {
        println!("{:016x}", x.to_bits());
    }
    println!("{}", model.close(&[f64::NAN; 3]).unwrap_err());
}
"""


def _run_example(crate: Path, text: str, cargo: str, *flags: str) -> list[str]:
    (crate / "examples").mkdir(exist_ok=True)
    (crate / "examples" / "values.rs").write_text(text, encoding="utf-8")
    run(cargo, "test", "--offline", "--quiet", *flags, cwd=crate)
    return run(cargo, "run", "--offline", "--quiet", *flags, "--example", "values", cwd=crate).splitlines()


@pytest.fixture(autouse=True)
def separate_roundings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile the C without fused multiplications and additions, which Rust never makes."""
    monkeypatch.setenv("CFLAGS", "-ffp-contract=off")


def _read_bits(lines: list[str]) -> list[float]:
    return [struct.unpack(">d", bytes.fromhex(line))[0] for line in lines]


def test_a_crate_without_the_standard_library_has_the_bits_of_the_c(tmp_path: Path, requires: Requires) -> None:
    """With names that are keywords, a changed parameter, and an angle of many turns."""
    (tmp_path / "model.yaml").write_text(HOSTILE, encoding="utf-8")
    out = tmp_path / "fn"
    functions = ("impl", "exp1", "exp2", "sensors")
    generate(tmp_path / "model.yaml", out, Options(targets=("rust",), functions=functions, derivatives=1))
    lines = _run_example(out / "rust", EXAMPLE, requires("cargo"), "--no-default-features")
    model = load(out).with_parameters(type=2.5 * 1.25)
    q, qd, u = np.array([0.3, -0.8]), np.array([1.2, -0.7]), np.array([0.5, -0.25])
    expected = [
        *model.impl(q=q, qd=qd, u=u, qdd=[3.0, -1.0])["Phi"],
        *model.exp1(q=q, qd=qd, u=u)["qdd"],
        *model.exp2(q=q, qd=qd, u=u)["qdd"],
        *np.ravel(model.sensors(q=q)["position"]),
        *np.ravel(model("jac_exp2", q=q, qd=qd, u=u)["jac_qdd_q"]),
        *model.exp1(q=[2e5, -0.8], qd=qd, u=u)["qdd"],
    ]
    assert _read_bits(lines[:-1]) == expected
    assert lines[-1] == "exp1 failed with status 1"


def test_stages_compute_as_in_c(tmp_path: Path, requires: Requires, monkeypatch: pytest.MonkeyPatch) -> None:
    """Iterations and linear systems of a closed loop, with tapes in parts of a few lines as long tapes have them."""
    monkeypatch.setattr(rust_stages, "divide", partial(divide, length=12))
    out = tmp_path / "four_bar"
    functions = ("close", "project_plain", "exp1")
    generate(MODELS / "four_bar.yaml", out, Options(targets=("rust",), functions=functions, derivatives=1))
    lines = _run_example(out / "rust", LINKAGE, requires("cargo"))
    linkage, q = load(out), [1.0, -0.4, 1.6]
    found = linkage.project_plain(q=q, qd=[2.0, 0.1, 0.2])
    closed = linkage.close(q=q)["closed"]
    slope = linkage("jac_close", q=closed)["jac_closed_q"]
    expected = [*found["closed"], *found["closed_qd"], *closed, *np.ravel(slope)]
    assert _read_bits(lines[:-1]) == expected
    assert lines[-1].startswith("close failed with status ")


def test_names_are_identifiers_and_strings_of_any_text() -> None:
    assert [name_item(x) for x in ("loop", "Self", "3a", "knee")] == ["loop_", "Self_", "_3a", "knee"]
    assert write_string('a"\\\n\u00e9') == '"a\\u{22}\\u{5c}\\u{a}\\u{e9}"'


def test_a_crate_in_single_precision_has_the_bits_of_the_c(tmp_path: Path, requires: Requires) -> None:
    """With and without the standard library; a third of a turn and many of them, and the crate's own tests."""
    (tmp_path / "model.yaml").write_text(HOSTILE, encoding="utf-8")
    out = tmp_path / "fn"
    generate(tmp_path / "model.yaml", out, Options(targets=("rust",), functions=("impl", "exp2"), derivatives=1))
    (out / "main.c").write_text(SINGLE_C, encoding="utf-8")
    names = ("default_parameters", "setup", "impl", "exp2", "jac_exp2")
    files = [str(out / name) for name in ("main.c", *(f"fn_{name}.c" for name in names))]
    flags = ("-std=c99", "-O2", "-ffp-contract=off", "-DMBS_REAL=float")
    run(requires("cc"), *flags, *files, "-lm", "-o", str(out / "main"), cwd=out)
    expected = run(str(out / "main"), cwd=out).splitlines()
    for features in (("--features", "f32"), ("--no-default-features", "--features", "f32")):
        found = _run_example(out / "rust", SINGLE, requires("cargo"), *features)
        assert found == expected


SINGLE = """\
fn main() {
    let model = fn_model::Model::new().unwrap();
    let (qd, u) = ([1.2, -0.7], [0.5, -0.25]);
    for turn in [0.3, -1.9, 500.0] {
        let q: [f32; 2] = [turn, -0.8];
        let found = model.impl_(&q, &qd, &[3.0, -1.0], &u).unwrap();
        for x in found.iter().chain(&model.exp2(&q, &qd, &u).unwrap()) {
            println!("{:08x}", x.to_bits());
        }
        for x in model.jac_exp2(&q, &qd, &u).unwrap().jac_qdd_q.nonzeros {
            println!("{:08x}", x.to_bits());
        }
    }
}
"""
SINGLE_C = r"""
#include <stdio.h>
#include <string.h>

#include "fn.h"

static void show(int n, const float *values)
{
    int i;
    for (i = 0; i < n; ++i) {
        unsigned bits;
        memcpy(&bits, values + i, sizeof bits);
        printf("%08x\n", bits);
    }
}

int main(void)
{
    const float turns[3] = {0.3f, -1.9f, 500.0f}, qd[2] = {1.2f, -0.7f}, u[2] = {0.5f, -0.25f}, qdd[2] = {3, -1};
    float p[2], h[64], found[2], slopes[3][4];
    int i;
    fn_default_parameters(p);
    if (fn_compute_setup(p, h) != 0)
        return 1;
    for (i = 0; i < 3; ++i) {
        const float q[2] = {turns[i], -0.8f};
        if (fn_compute_impl(q, qd, qdd, u, h, found) != 0)
            return 1;
        show(2, found);
        if (fn_compute_exp2(q, qd, u, h, found) != 0)
            return 1;
        show(2, found);
        if (fn_compute_jac_exp2(q, qd, u, h, slopes[0], slopes[1], slopes[2]) != 0)
            return 1;
        show(fn_jac_exp2_NNZ_jac_qdd_q, slopes[0]);
    }
    return 0;
}
"""
