"""The Julia module: each call has the signature of the C header, and Julia computes the same where it is installed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from mbsgen import manifest
from mbsgen.pipeline import Options, generate, make
from mbsgen.targets.julia import write_string
from mbsrun import load
from tests.mbsgen.targets.compilation import run

JULIA = shutil.which("julia")
MODELS = Path(__file__).parents[3] / "models"
CALL = re.compile(r"ccall\(\s*\(:(\w+), LIBRARY\), Cint, \(([^)]*)\),\s*(.*?)\s*\)\n", re.DOTALL)
FUNCTION = re.compile(r"^function (\w+!?)\((.*)\)$|^function (as_input)", re.MULTILINE)
PROGRAM = """
include("planar_arm.jl")
using .planar_arm_model
arm = planar_arm_model.Model()
arm.parameters[1] *= 1.5
planar_arm_model.update!(arm)
q, qd, u = [0.3, -0.8], [1.0, 2.0], [0.5, -0.25]
println.(planar_arm_model.exp1(arm, q, qd, u).qdd)
println.(vec(Matrix(planar_arm_model.jac_exp1(arm, q, qd, u).jac_qdd_q)))
"""


@pytest.fixture(params=["planar_arm", "four_bar"])
def files(request: pytest.FixtureRequest) -> dict[str, str]:
    functions = ("impl", "exp1", "sensors") + ("close",) * (request.param == "four_bar")
    options = Options(runtime=request.param == "planar_arm", targets=("julia",), functions=functions, derivatives=1)
    return dict(make(MODELS / f"{request.param}.yaml", options).files)


def test_each_call_passes_what_the_header_declares(files: dict[str, str]) -> None:
    """Names and sizes of the arguments, in their order, from both files."""
    prefix = next(name for name in files if name.endswith(".jl")).removesuffix(".jl")
    module, header = files[f"{prefix}.jl"], files[f"{prefix}.h"]
    symbols = manifest.Manifest.model_validate_json(files[manifest.FILE_NAME]).symbols
    calls = [(name.replace(symbols, prefix), types, text) for name, types, text in CALL.findall(module)]
    declared = {
        name: [re.split(r"[\s*]+", argument.strip())[-1] for argument in arguments.split(",")]
        for name, arguments in re.findall(r"^int (\w+_compute_\w+)\(([^;]*)\);", header, re.MULTILINE)
    }
    assert {name for name, _, _ in calls} == declared.keys()
    for name, types, text in calls:
        passed = re.findall(r'as_input\([\w.]+, (\d+), "(\w+)"\)|(?<![\w.])(\w+)(?![\w(.])', re.sub(r"\s+", " ", text))
        if name.endswith("_setup"):  # p, and the room of the model for h
            assert (types.count("Ptr{Cdouble}"), len(declared[name])) == (2, 2)
            continue
        names = [quoted or plain for _, quoted, plain in passed]
        assert names == declared[name]
        assert types.count("Ptr{Cdouble}") == len(names)
        kernel = name.split("_compute_")[1]
        sizes = [
            size or re.findall(rf"    {plain} = zeros\((\d+)\)", _cut(module, kernel))[0] for size, _, plain in passed
        ]
        prefix = name.split("_compute_")[0]
        macros = [re.search(rf"#define {prefix}_{kernel}_NNZ_{x} (\d+)", header) for x in names]
        assert sizes == [found[1] for found in macros if found]


def _cut(module: str, kernel: str) -> str:
    """Return the function of a kernel."""
    start = module.index(f"function {kernel}(")
    return module[start : module.index("\nend\n", start)]


def test_blocks_and_brackets_are_closed(files: dict[str, str]) -> None:
    module = next(text for name, text in files.items() if name.endswith(".jl"))
    code = re.sub(r"#.*", "", re.sub(r'"(\\.|[^"\\])*"', '""', module))
    opened = re.findall(r"^(?:function|module|mutable struct|struct)\b", code, re.MULTILINE)
    assert len(opened) == len(re.findall(r"^end$", code, re.MULTILINE))
    assert all(code.count(a) == code.count(b) for a, b in ("()", "[]", "{}"))
    assert len(FUNCTION.findall(module)) == len(set(FUNCTION.findall(module))) == module.count("\nfunction ")


def test_strings_hold_any_text() -> None:
    assert write_string('a$b"\\\n\U0001f600') == '"a\\U00000024b\\U00000022\\U0000005c\\U0000000a\\U0001f600"'


if JULIA:  # elsewhere the signatures alone are compared

    def test_julia_computes_the_same(tmp_path: Path) -> None:
        out = tmp_path / "planar_arm"
        options = Options(runtime=True, targets=("julia",), functions=("exp1",), derivatives=1)
        generate(MODELS / "planar_arm.yaml", out, options)
        run("cmake", "-S", out, "-B", out / "build", "-DBUILD_SHARED_LIBS=ON")
        run("cmake", "--build", out / "build")
        (out / "program.jl").write_text(PROGRAM, encoding="utf-8")
        arm = load(out)
        name = next(iter(arm.parameters))
        arm = arm.with_parameters(**{name: 1.5 * arm.parameters[name]})
        state: dict[str, Any] = {"q": [0.3, -0.8], "qd": [1.0, 2.0], "u": [0.5, -0.25]}
        expected = [*arm.exp1(**state)["qdd"], *arm("jac_exp1", **state)["jac_qdd_q"].ravel(order="F")]
        printed = run(str(JULIA), out / "program.jl").split()
        assert list(map(float, printed)) == pytest.approx(expected, rel=1e-12)
