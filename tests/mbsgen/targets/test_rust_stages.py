"""Linear systems in Rust: solutions are NumPy's, exchanges are LAPACK's, and lost pivots are found in any units."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import lapack

from mbsgen import resources
from tests.mbsgen.targets.compilation import run

Array = NDArray[np.float64]
Found = tuple[bool, list[int], Array]
Solve = Callable[[list[tuple[str, Array, Array, float, list[list[int]]]]], list[Found]]
KINDS = ("general", "transposed", "symmetric", "tree")
ROUNDING = 1e-15
THRESHOLD = 1e-6


@pytest.fixture(scope="module")
def solve(tmp_path_factory: pytest.TempPathFactory) -> Solve:
    """Compile the stages as they lie in a crate; return a function that runs them on many problems."""
    if shutil.which("rustc") is None:
        pytest.skip("needs rustc")
    folder = tmp_path_factory.mktemp("stages")
    shutil.copy(resources.folder("templates") / "rust" / "stages.rs.j2", folder / "stages.rs")
    shutil.copy(Path(__file__).with_name("stages.rs"), folder / "main.rs")
    run("rustc", "--edition", "2021", "-A", "warnings", "-o", folder / "main", folder / "main.rs")

    def call(problems: list[tuple[str, Array, Array, float, list[list[int]]]]) -> list[Found]:
        lines = []
        for kind, A, B, threshold, above in problems:
            starts = np.cumsum([0, *map(len, above)] if above else [0] * (len(A) + 1))
            ancestors = [k for each in above for k in each]
            numbers = [threshold, *A.ravel(), *B.ravel()]
            words = [kind, len(A), B.shape[1], len(ancestors), *starts, *ancestors, *(f"{x:.17e}" for x in numbers)]
            lines.append(" ".join(map(str, words)))
        done = subprocess.run(folder / "main", input="\n".join(lines), capture_output=True, text=True, check=True)
        found = []
        for line, (_, _, B, _, _) in zip(done.stdout.splitlines(), problems, strict=True):
            flag, exchanges, numbers = line.split(";")
            X = np.array(numbers.split(), dtype=np.float64).reshape(B.shape)
            found.append((flag == "true", [int(k) for k in exchanges.split()], X))
        return found

    return call


def draw(rng: np.random.Generator, kind: str) -> tuple[str, Array, Array, float, list[list[int]]]:
    """Draw a system of one kind; symmetric ones are indefinite, many with zeros on the diagonal."""
    n, width = int(rng.integers(1, 8)), int(rng.integers(1, 4))
    A, above = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-2, 2, (n, 1)), list[list[int]]()
    if kind == "symmetric":
        A = A + A.T
        A[np.diag_indices(n)] *= rng.choice([0.0, 0.1, 1.0], n) if n > 1 else 1.0
    if kind == "tree":
        for k in range(n):
            parent = int(rng.integers(-1, k))
            above.append([] if parent < 0 else [*above[parent], parent])
        factor = np.diag(rng.uniform(0.5, 2, n))
        for k, each in enumerate(above):
            factor[k, each] = rng.normal(size=len(each))
        A = factor.T @ factor
    return kind, A, rng.normal(size=(n, width)), 1e-12, above


@pytest.mark.parametrize("kind", KINDS)
def test_solutions_are_numpys(kind: str, solve: Solve) -> None:
    rng = np.random.default_rng(KINDS.index(kind))
    problems = [draw(rng, kind) for _ in range(200)]
    for (_, A, B, _, _), (is_regular, exchanges, X) in zip(problems, solve(problems), strict=True):
        condition = np.linalg.cond(A)
        if condition > 1e9:
            continue
        wanted = np.linalg.solve(A.T if kind == "transposed" else A, B)
        assert is_regular
        assert np.abs(X - wanted).max() <= 100 * len(A) * ROUNDING * condition * np.abs(wanted).max()
        if kind == "symmetric":
            pivots: Any = lapack.dsytf2(A, lower=1)[1] if hasattr(lapack, "dsytf2") else lapack.dsytrf(A, lower=1)[1]
            assert exchanges == [p - 1 if p > 0 else p for p in pivots.tolist()]
        elif kind != "tree":
            assert exchanges == lapack.dgetrf(A)[1].tolist()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_a_pivot_is_lost_relative_to_its_scale(kind: str, unit: float, solve: Solve) -> None:
    """Of [[1, 1], [1, 1 + d]] d remains, in any units; it is lost up to the threshold, and where it is no number."""
    above = [[], [0]] if kind == "tree" else []
    for left, is_kept in ((2 * THRESHOLD, True), (0.5 * THRESHOLD, False), (np.nan, False)):
        A = unit * np.array([[1.0, 1.0], [1.0, 1.0 + left]])
        A = A[::-1, ::-1] if kind == "tree" else A  # from the last row on
        assert solve([(kind, A, np.ones((2, 1)), THRESHOLD, above)])[0][0] is is_kept


def test_a_step_is_short_relative_to_the_unknown(solve: Solve) -> None:
    """By SHORT, 1e-8 here, of the unknown after the step, where that is above 1."""
    for unknown, change, is_short in (
        ([0.5, -3.0], [0.9e-8, -2.9e-8], True),
        ([0.5, -3.0], [1.1e-8, 0.0], False),
        ([0.5, -3.0], [0.0, 3.1e-8], False),
        ([-0.5, 3.0], [-1.1e-8, 0.0], False),
        ([0.5, 1.0], [np.nan, 0.0], False),
    ):
        A = np.zeros((2, 2))
        A[0] = change
        ((found, _, moved),) = solve([("step", A, np.array(unknown)[:, None], 0.0, [])])
        assert found is is_short
        np.testing.assert_array_equal(moved[:, 0], np.array(unknown) + change)
