"""Build the examples of csrc/ as their first lines say, with the generated arm, and compare what they print."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbsgen.pipeline import Options, generate
from mbsrun import load
from mbsrun.models import find_folder
from tests.mbsgen.targets.compilation import run

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "csrc" / "examples"
FLAGS = "CFLAGS=-std=c99 -O2 -Wall -Wextra -Wpedantic -Werror"
Array = NDArray[np.float64]


@pytest.fixture
def arm_folder() -> Path:
    """Find the generated folder of the arm in the cache of this run."""
    return find_folder(ROOT / "models" / "arm_pendulum.yaml")


@pytest.fixture
def make(requires: Callable[[str], str], arm_folder: Path, tmp_path: Path) -> Callable[[str], str]:
    """Build an example by its Makefile, and run it."""

    def build(name: str) -> str:
        run(requires("make"), "-f", EXAMPLES / name / "Makefile", f"MODEL={arm_folder}", FLAGS, cwd=tmp_path)
        return run(tmp_path / name, cwd=tmp_path)

    return build


def test_inverse_dynamics(make: Callable[[str], str]) -> None:
    """The first state of the arm's reference, to the rounding of its kernel."""
    state = json.loads((ROOT / "tests" / "reference" / "seed_arm_docquier.json").read_text())["states"][0]
    source = (EXAMPLES / "inverse_dynamics" / "main.c").read_text()
    for name in ("q", "qd", "qdd"):
        assert f"{name}[JOINTS] = {{{', '.join(map(str, state[name]))}}}" in source
    found = [float(x) for x in re.findall(r"joint \d: (\S+) N m", make("inverse_dynamics"))]
    assert found == pytest.approx([float(x) for x in state["exact50"]["tau_id"]], rel=1e-13)


def test_falling_arm(make: Callable[[str], str], arm_folder: Path) -> None:
    """Another integrator, with accelerations from the residual's Jacobian; both err by less than 1e-7 in a second."""
    rows = [[float(x) for x in row] for row in list(csv.reader(make("falling_arm").splitlines()))[1:]]
    found, arm = np.array(rows), load(arm_folder)

    def derive(_: float, x: Array) -> Array:
        rest = {"q": x[:6], "qd": x[6:], "qdd": np.zeros(6), "u": np.zeros(4)}
        qdd = np.linalg.solve(arm.jac_impl(**rest)["jac_Phi_qdd"], -arm.impl(**rest)["Phi"])
        return np.concatenate([x[6:], qdd])

    expected = solve_ivp(derive, (0, 1), found[0, 1:], "DOP853", found[:, 0], rtol=1e-10, atol=1e-10).y.T
    assert found.shape == (101, 13)
    assert np.ptp(found[:, 2]) > 1  # it does fall
    np.testing.assert_allclose(found[:, 1:], expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_gravity_torques(requires: Callable[[str], str], arm_folder: Path, tmp_path: Path) -> None:
    """About the shoulder: the weight of each body, at its distance along x from there; the arm is stretched out."""
    cmake = requires("cmake")
    requires("g++")
    run(cmake, "-S", EXAMPLES / "gravity_torques", "-B", tmp_path, f"-DMODEL={arm_folder}", cwd=tmp_path)
    run(cmake, "--build", tmp_path, cwd=tmp_path)
    told = run(tmp_path / "gravity_torques", cwd=tmp_path)
    found = re.findall(r"q2 = *(\S+) rad: \S+ (\S+)", told)
    assert len(found) == 5
    moment = 9.81 * (2.5 * 0.1 + 2 * (0.3 + 0.1) + 0.5 * (0.6 + 0.1) + 1 * 0.7)  # in the arm's direction
    upright = 9.81 * 0.2  # the pendulum, across it
    for angle, torque in ((float(a), float(t)) for a, t in found):
        assert torque == pytest.approx(-moment * np.cos(angle) - upright * np.sin(angle), rel=1e-9)


def test_many_arms(requires: Callable[[str], str], arm_folder: Path, tmp_path: Path) -> None:
    """As many at once as the processor can; the last arm is NumPy's, and all are the single ones."""
    cmake, folder = requires("cmake"), tmp_path / "lanes"
    options = Options(functions=("impl",), derivatives=0, targets=("lanes",))
    generate(ROOT / "models" / "arm_pendulum.yaml", folder, options)
    built = tmp_path / "built"
    flags = "-DCMAKE_C_FLAGS=-Wall -Wextra -Wpedantic -Werror"
    run(cmake, "-S", EXAMPLES / "many_arms", "-B", built, f"-DMODEL={folder}", flags, cwd=tmp_path)
    run(cmake, "--build", built, cwd=tmp_path)
    text = run(built / "many_arms", cwd=tmp_path)
    at_once, failures, difference = re.findall(
        r"(\d+) arms at once\n(\d+) failures, differences up to (\S+) N m", text
    )[0]
    assert (int(at_once) in (2, 4, 8), int(failures)) == (True, 0)
    assert float(difference) < 1e-12
    joints = np.arange(6)
    last = {"q": 0.999 + 0.1 * joints, "qd": np.full(6, 0.001), "qdd": 0.5 * joints, "u": np.zeros(4)}
    first, sixth = re.findall(r"the last arm: (\S+) (\S+) N m", text)[0]
    assert [float(first), float(sixth)] == pytest.approx(
        load(arm_folder).impl(**last)["Phi"][[0, 5]], rel=1e-9, abs=1e-9
    )


ONE = """#include "pendulum_many.h"
#include <stdlib.h>
double {name}(void)
{{
    static const mbs_real q[8] = {{1, 1, 1, 1, 1, 1, 1, 1}}, zero[1] = {{0}};
    static mbs_real Phi[8];
    static int status[8];
    const mbs_given in[] = {{{{q, 1, 1, 0}}, {{zero, 0, 1, 0}}, {{zero, 0, 1, 0}}, {{zero, 0, 1, 0}}}};
    const mbs_found out[] = {{{{Phi, 1, 1, 1, 1, 0}}}};
    void *room = malloc(pendulum_room_of_many(4, in, 1, out));
    const double failed = (double)pendulum_many_impl(8, 0, 8, in, out, room, status);
    free(room);
    return failed ? -1 : Phi[7];
}}
"""
BOTH = """#include <stdio.h>
double light(void);
double heavy(void);
int main(void) { printf("%.17g %.17g\\n", light(), heavy()); return 0; }
"""


def test_two_models_of_one_name_keep_their_own_kernels_in_lanes(requires: Callable[[str], str], tmp_path: Path) -> None:
    """A linker takes the first of two functions of one name: each model's versions carry the model's tag.

    So do the versions of derivatives, which the library calls, too.
    """
    cmake, made = requires("cmake"), list[Path]()
    text = (ROOT / "models" / "pendulum.yaml").read_text(encoding="utf-8")
    for name, mass in (("light", 2), ("heavy", 5)):
        model, folder = tmp_path / f"{name}.yaml", tmp_path / name
        model.write_text(text.replace("  m: 2\n", f"  m: {mass}\n"), encoding="utf-8")
        generate(model, folder, Options(functions=("impl",), derivatives=1, targets=("lanes",)))
        run(cmake, "-S", folder, "-B", folder / "built", "-DCMAKE_C_FLAGS=-DMBS_WITHOUT_PLAIN_NAMES", cwd=tmp_path)
        run(cmake, "--build", folder / "built", "--target", "pendulum", cwd=tmp_path)
        (tmp_path / f"{name}.c").write_text(ONE.format(name=name), encoding="utf-8")
        run("cc", "-c", f"-I{folder}", f"{name}.c", cwd=tmp_path)
        made += (folder / "built").rglob("libpendulum.a")
    (tmp_path / "both.c").write_text(BOTH, encoding="utf-8")
    run("cc", "both.c", "light.o", "heavy.o", *made, "-lm", "-o", "both", cwd=tmp_path)
    light, heavy = map(float, run(tmp_path / "both", cwd=tmp_path).split())
    assert [light, heavy] == pytest.approx([9.81 * np.sin(1), 2.5 * 9.81 * np.sin(1)])
