"""Generated kernels on a bare Cortex-M7 under QEMU, in single precision, against the host's in double precision."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks import microcontroller
from benchmarks.microcontroller import ARM, run_kernels
from mbsrun import bare, load
from mbsrun.models import find_folder
from tests.mbsgen.targets.compilation import STRICT

NAMES = ("impl", "semi", "exp1", "exp2", "sensors", "jac_impl", "jac_exp1", "jac_exp2", "adj1_impl", "jac_adj1_impl")


def test_kernels_of_the_arm_agree_with_the_host(
    requires: Callable[[str], str], tmp_path: Path, rng: np.random.Generator
) -> None:
    """To 30 roundings of the largest result, at a state whose mass matrix has a condition of some 200.

    Instructions follow the flops: multiplications and additions may fuse; operands are loaded and stored; a sine with
    its cosine takes less than 200.
    """
    for tool in bare.PACKAGES:
        requires(tool)
    arm = load(find_folder(ARM))
    kernels = [arm.describe(name) for name in NAMES]
    sizes = {a.name: a.nnz for kernel in kernels for a in kernel.inputs if a.nnz}
    given = {name: np.float32(rng.uniform(-1, 1, size)).astype(float) for name, size in sizes.items()}
    found = run_kernels(tmp_path, kernels, given, (*STRICT, "-Wno-unused-function"))
    assert found.status == 0
    for kernel in kernels:
        results = arm(kernel.name, sparse=True, **{a.name: given[a.name] for a in kernel.inputs if a.nnz})
        expected = np.concatenate([results[a.name].ravel() for a in kernel.outputs])
        error = np.abs(np.array(found.numbers(f"{kernel.name}.results")) - expected).max()
        assert error <= 30 * np.finfo(np.float32).eps * np.abs(expected).max(), kernel.name
        (count,) = found.numbers(kernel.name)
        flops = kernel.flops
        assert flops.arithmetic / 2 <= count <= 4 * flops.arithmetic + 100 * flops.trig


def test_the_page_has_what_programs_need(requires: Callable[[str], str], tmp_path: Path) -> None:
    """Both precisions of the example find the same motion; a controller solves, and makes a step in each period."""
    for tool in bare.PACKAGES:
        requires(tool)
    out = tmp_path / "page.md"
    microcontroller.main(["--problems", "cart_pole_balance", "--out", str(out)])
    rows = [line.strip("| ").split(" | ") for line in out.read_text("utf-8").splitlines() if line.startswith("|")]
    effort = next(row for row in rows if row[0] == "effort")
    assert float(effort[1]) == pytest.approx(float(effort[2]), rel=1e-5)
    assert [row[2:5:2] for row in rows if row[0] == "`cart_pole_balance`"] == [["solved", "10 of 10"]]
    assert {row[0] for row in rows} >= {f"`{name}`" for name in microcontroller.KERNELS}
