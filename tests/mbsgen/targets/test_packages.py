"""The generated folder in other builds: CMake as part of a project and installed, pkg-config, a plain compiler."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mbsgen.targets.compilation import Requires, run
from tests.sample import write_sample

PROGRAM = """\
#include <sample.h>

int main(void)
{
    mbs_real p[sample_PARAMETERS];
    sample_default_parameters(p);
    return sizeof(mbs_real) != EXPECTED || p[1] != (mbs_real)2.5 || sample_impl_n_in() != 5;
}
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A program that uses the sample's library: exits with 0 if all is as it should be."""
    source = tmp_path / "program.c"
    source.write_text(PROGRAM)
    return source


def build(cmake: str, source: Path, target: Path, *options: str) -> None:
    run(cmake, "-S", source, "-B", target, *options)
    run(cmake, "--build", target)


def install(cmake: str, tmp_path: Path, *options: str) -> Path:
    """Build and check the sample, install it, and move what was installed to another place."""
    build(cmake, write_sample(tmp_path / "sample"), tmp_path / "build", *options)
    run(tmp_path / "build" / "sample_check")
    run(cmake, "--install", tmp_path / "build", "--prefix", tmp_path / "first")
    return (tmp_path / "first").rename(tmp_path / "moved")


@pytest.mark.usefixtures("program")
@pytest.mark.parametrize("options", [(), ("-DBUILD_SHARED_LIBS=ON",)], ids=["static", "shared"])
def test_an_installed_library_is_found_wherever_it_is_moved(
    options: tuple[str, ...], tmp_path: Path, requires: Requires
) -> None:
    cmake, place = requires("cmake"), install(requires("cmake"), tmp_path, *options)
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.14)\n"
        "project(program C)\n"
        "find_package(sample REQUIRED)\n"
        "add_executable(program program.c)\n"
        "target_compile_definitions(program PRIVATE EXPECTED=8)\n"
        "target_link_libraries(program PRIVATE sample::sample)\n"
    )
    build(cmake, tmp_path, tmp_path / "user", f"-DCMAKE_PREFIX_PATH={place}")
    run(tmp_path / "user" / "program")


def test_pkg_config_finds_an_installed_library(program: Path, tmp_path: Path, requires: Requires) -> None:
    place = install(requires("cmake"), tmp_path)
    query = ("env", f"PKG_CONFIG_PATH={place / 'lib' / 'pkgconfig'}", requires("pkg-config"), "sample")
    flags, version = run(*query, "--cflags", "--libs").split(), run(*query, "--modversion").strip()
    assert version == "1.2.3"
    run(requires("gcc"), "-std=c99", "-DEXPECTED=8", program, *flags, "-o", tmp_path / "program")
    run(tmp_path / "program")


@pytest.mark.usefixtures("program")
def test_a_project_takes_the_folder_in_and_chooses_the_precision(tmp_path: Path, requires: Requires) -> None:
    """Two models side by side; the one in single precision takes its users along."""
    write_sample(tmp_path / "sample")
    write_sample(tmp_path / "other", "test")
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.14)\n"
        "project(program C)\n"
        "add_subdirectory(sample)\n"
        "add_subdirectory(other)\n"
        "target_compile_definitions(sample PUBLIC MBS_REAL=float)\n"
        "add_executable(program program.c)\n"
        "target_compile_definitions(program PRIVATE EXPECTED=4)\n"
        "target_link_libraries(program PRIVATE sample::sample)\n"
    )
    build(requires("cmake"), tmp_path, tmp_path / "build")
    run(tmp_path / "build" / "program")
    assert not list((tmp_path / "build").rglob("*_check"))


def test_cmake_runs_the_check_program(tmp_path: Path, requires: Requires) -> None:
    cmake = requires("cmake")
    build(cmake, write_sample(tmp_path / "sample"), tmp_path / "build")
    told = run(cmake, "--build", tmp_path / "build", "--target", "test")
    assert "sample_check" in told
    assert "100% tests passed" in told


def test_a_project_asks_for_a_version(tmp_path: Path, requires: Requires) -> None:
    """find_package(NAME VERSION): this version, and older ones of the same minor version, are found."""
    cmake, place = requires("cmake"), install(requires("cmake"), tmp_path)
    found = {}
    for version in ("1.2", "1.2.0", "1.2.4", "1.3", "2"):
        user = tmp_path / f"user {version}"
        user.mkdir()
        (user / "CMakeLists.txt").write_text(
            "cmake_minimum_required(VERSION 3.14)\n"
            "project(user NONE)\n"
            f"find_package(sample {version} QUIET)\n"
            'message(STATUS "found ${sample_FOUND} ${sample_VERSION}.")\n'
        )
        told = run(cmake, "-S", user, "-B", user / "build", f"-DCMAKE_PREFIX_PATH={place}")
        found[version] = "found 1 1.2.3." in told
    assert found == {"1.2": True, "1.2.0": True, "1.2.4": False, "1.3": False, "2": False}
