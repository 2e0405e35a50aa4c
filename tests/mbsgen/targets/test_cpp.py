"""The C++ class: compiled with strict flags in a project that finds the installed package, and compared with NumPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.pipeline import Options, generate
from mbsrun import load
from tests.mbsgen.targets.compilation import Requires, run

MODELS = Path(__file__).parents[3] / "models"
EIGEN = Path("/usr/include/eigen3")
FUNCTIONS = ("impl", "exp1", "semi", "sensors")
PROGRAM = """\
#include <cstdio>
#include <vector>

#include <planar_arm.hpp>

int main()
{
    planar_arm_model arm;
    const std::vector<mbs_real> q = {0.3, -0.8}, qd = {1.0, 2.0}, u = {0.5, -0.25};
    arm.parameters[0] *= 1.5;
    arm.update();
    const auto qdd = arm.exp1(q, qd, u);
    const auto back = arm.impl(q, qd, qdd, u);
    const auto J = arm.jac_impl(q, qd, qdd, u);
    std::printf("%.17g %.17g %.17g %.17g\\n", qdd[0], qdd[1], back[0], back[1]);
    for (const mbs_real entry : J.jac_Phi_q.full())
        std::printf("%.17g ", entry);
    try {
        arm.exp1(std::vector<mbs_real>{1.0}, qd, u);
    } catch (const std::invalid_argument &error) {
        std::printf("\\n%s\\n", error.what());
    }
#ifdef MBS_WITH_EIGEN
    const Eigen::Vector2d e = Eigen::Vector2d(0.3, -0.8);
    const Eigen::Matrix2d K = arm.jac_impl(e, qd, qdd, u).jac_Phi_q.eigen();
    std::printf("%.17g %.17g\\n", K(0, 1), K(1, 0));
#endif
    return 0;
}
"""
STRICT = ["-std=c++17", "-O1", "-Werror", "-Wall", "-Wextra", "-pedantic", "-Wshadow", "-Wconversion"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    out = tmp_path / "planar_arm"
    options = Options(runtime=True, targets=("cpp",), functions=FUNCTIONS, derivatives=1)
    generate(MODELS / "planar_arm.yaml", out, options)
    (tmp_path / "program.cpp").write_text(PROGRAM, "utf-8")
    return out


def check(printed: str, folder: Path) -> None:
    arm = load(folder)
    name = next(iter(arm.parameters))
    arm = arm.with_parameters(**{name: 1.5 * arm.parameters[name]})
    state: dict[str, Any] = {"q": [0.3, -0.8], "qd": [1.0, 2.0], "u": [0.5, -0.25]}
    qdd = arm.exp1(**state)["qdd"]
    lines = printed.splitlines()
    assert np.array(lines[0].split(), dtype=float) == pytest.approx([*qdd, 0, 0], abs=1e-12)
    J = arm.jac("impl", **state, qdd=qdd)["jac_Phi_q"]
    assert np.array(lines[1].split(), dtype=float) == pytest.approx(J.ravel(order="F"), rel=1e-12)
    assert lines[2] == "q has 1 entries, not 2"
    if len(lines) > 3:
        assert np.array(lines[3].split(), dtype=float) == pytest.approx([J[0, 1], J[1, 0]], rel=1e-12)


def test_another_project_finds_the_package(folder: Path, tmp_path: Path, requires: Requires) -> None:
    cmake = requires("cmake")
    requires("g++")
    run(cmake, "-S", folder, "-B", tmp_path / "build")
    run(cmake, "--build", tmp_path / "build")
    run(cmake, "--install", tmp_path / "build", "--prefix", tmp_path / "place")
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.14)\n"
        "project(program CXX)\n"
        "find_package(planar_arm REQUIRED)\n"
        "add_executable(program program.cpp)\n"
        "target_compile_features(program PRIVATE cxx_std_17)\n"
        "target_link_libraries(program PRIVATE planar_arm::planar_arm)\n"
    )
    run(cmake, "-S", tmp_path, "-B", tmp_path / "user", f"-DCMAKE_PREFIX_PATH={tmp_path / 'place'}")
    run(cmake, "--build", tmp_path / "user")
    check(run(tmp_path / "user" / "program"), folder)


def test_the_class_compiles_without_a_warning(folder: Path, tmp_path: Path, requires: Requires) -> None:
    if not EIGEN.exists():
        pytest.skip(f"{EIGEN} is not there: libeigen3-dev")
    objects = []
    for source in sorted(folder.glob("planar_arm_*.c")):
        if not source.name.endswith("_check.c"):
            objects.append(tmp_path / f"{source.stem}.o")
            run(requires("gcc"), "-O1", "-c", source, "-o", objects[-1])
    flags = ["-DMBS_WITH_EIGEN", "-isystem", str(EIGEN)]
    program = tmp_path / "program"
    run(requires("g++"), *STRICT, *flags, f"-I{folder}", tmp_path / "program.cpp", *objects, "-lm", "-o", program)
    check(run(program), folder)


def test_functions_without_derivatives_and_parameters(tmp_path: Path, requires: Requires) -> None:
    """A model of a closed loop, whose functions have other arguments, is a class as well."""
    out = tmp_path / "four_bar"
    generate(MODELS / "four_bar.yaml", out, Options(targets=("cpp",), derivatives=0))
    (tmp_path / "all.cpp").write_text('#include "four_bar.hpp"\nint main() { return sizeof(four_bar_model) == 0; }\n')
    run(requires("g++"), *STRICT, f"-I{out}", "-c", tmp_path / "all.cpp", "-o", tmp_path / "all.o")
