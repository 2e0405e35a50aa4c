"""Generated kernels on a bare Cortex-M7 under QEMU, in single precision, against the host's in double precision."""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Kernel
from mbsrun import bare, load
from mbsrun.models import find_folder
from tests.mbsgen.targets.compilation import STRICT

MODEL = Path(__file__).parents[2] / "models" / "arm_pendulum.yaml"
NAMES = ("impl", "semi", "exp1", "exp2", "sensors", "jac_impl", "jac_exp1", "jac_exp2", "adj1_impl", "jac_adj1_impl")
Array = NDArray[np.float64]


def write_main(kernels: list[Kernel], prefix: str, given: dict[str, Array]) -> str:
    """Write a program that calls the kernels, counts their instructions, and prints their nonzero results."""
    calls: list[str] = []
    for kernel in kernels:
        inputs = [f"in_{a.name}" for a in kernel.inputs if a.nnz]
        outputs = [a for a in kernel.outputs if a.nnz]
        starts = [0, *accumulate(a.nnz for a in outputs)]
        results = [f"result + {at}" for at in starts[:-1]]
        calls += [
            "began = mbs_bare_instructions();",
            f"failed |= {kernel.function}({', '.join([*inputs, *results])});",
            f'mbs_bare_print_integer("{kernel.name}", (long)(mbs_bare_instructions() - began));',
            f'for (i = 0; i < {starts[-1]}; ++i) mbs_bare_print_float("{kernel.name}.results", result[i]);',
        ]
    numbers = [
        f"static const mbs_real in_{name}[] = {{{', '.join(f'MBS_C({x!r})' for x in map(float, values))}}};"
        for name, values in given.items()
    ]
    most = max(sum(a.nnz for a in kernel.outputs) for kernel in kernels)
    headers = [f'#include "{prefix}.h"', '#include "mbs_bare.h"']
    body = [f"static mbs_real result[{most}];", "int main(void)", "{", "unsigned long began;", "int i, failed = 0;"]
    return "\n".join([*headers, *numbers, *body, *calls, "return failed;", "}", ""])


def test_kernels_of_the_arm_agree_with_the_host(
    requires: Callable[[str], str], tmp_path: Path, rng: np.random.Generator
) -> None:
    """To 30 roundings of the largest result, at a state whose mass matrix has a condition of some 200.

    Instructions follow the flops: multiplications and additions may fuse; operands are loaded and stored; a sine with
    its cosine takes less than 200.
    """
    for tool in bare.PACKAGES:
        requires(tool)
    folder = find_folder(MODEL)
    arm = load(folder)
    kernels = [arm.describe(name) for name in NAMES]
    sizes = {a.name: a.nnz for kernel in kernels for a in kernel.inputs if a.nnz}
    given = {name: np.float32(rng.uniform(-1, 1, size)).astype(float) for name, size in sizes.items()}
    main = tmp_path / "main.c"
    main.write_text(write_main(kernels, "arm_pendulum", given), "utf-8")
    sources = sorted({folder / file for kernel in kernels for file in kernel.sources})
    flags = (*STRICT, "-Wno-unused-function", "-DMBS_REAL=float", f"-I{folder}")
    image = bare.build([main, *sources], tmp_path / "image", flags)
    found = bare.run(image.path)
    assert found.status == 0
    for kernel in kernels:
        results = arm(kernel.name, sparse=True, **{a.name: given[a.name] for a in kernel.inputs if a.nnz})
        expected = np.concatenate([results[a.name].ravel() for a in kernel.outputs])
        error = np.abs(np.array(found.numbers(f"{kernel.name}.results")) - expected).max()
        assert error <= 30 * np.finfo(np.float32).eps * np.abs(expected).max(), kernel.name
        (count,) = found.numbers(kernel.name)
        flops = kernel.flops
        assert flops.arithmetic / 2 <= count <= 4 * flops.arithmetic + 100 * flops.trig
