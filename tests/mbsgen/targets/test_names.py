"""Mangling gives identifiers, different ones for different names, and no symbol twice over all models."""

from __future__ import annotations

import itertools
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbsgen.targets.names import MAX_LENGTH, mangle
from tests.mbsgen.targets.hostile import HOSTILE

KERNELS = ("impl", "sensors", "frames", "setup", "semi", "semi_res", "exp1", "exp2")
ORDERS = ("", "jac_", "adj1_", "jac_adj1_")
ACCOUNTS = ("", "_n_in", "_n_out", "_name_in", "_name_out", "_sparsity_in", "_sparsity_out", "_diff_in", "_work")


def demangle(prefix: str) -> str:
    """Read the escapes back: what can be read back without loss is injective."""
    return re.sub(r"Z(Z|[0-9a-f]+z)", lambda m: "Z" if m[1] == "Z" else chr(int(m[1][:-1], 16)), prefix)


def symbols(prefix: str) -> set[str]:
    """List every external name of a model, file names' stems included."""
    faces = {f"{o}{prefix}_{k}{a}" for o in ORDERS for k in KERNELS for a in ACCOUNTS}
    typed = {f"{prefix}_compute_{o}{k}" for o in ORDERS for k in KERNELS}
    return faces | typed | {f"{prefix}_default_parameters"}


@given(st.text(min_size=1))
def test_a_prefix_is_an_identifier_and_can_be_read_back(name: str) -> None:
    prefix = mangle(name)
    assert re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", prefix, re.ASCII)
    assert len(prefix) <= MAX_LENGTH
    assert prefix.startswith("Zs") or demangle(prefix) == name


@given(st.text(alphabet="aZz_2d5f6jcompute", min_size=1), st.text(alphabet="aZz_2d5f6jcompute", min_size=1))
def test_different_names_have_different_prefixes(one: str, other: str) -> None:
    assert (mangle(one) == mangle(other)) == (one == other)


@pytest.mark.parametrize("name", ["math", "Math", "string", "m", "c", "test", "ALL_BUILD", "install"])
def test_a_model_hides_no_header_library_or_target(name: str) -> None:
    """`#include <math.h>`, `-lm` and `make test` go on to mean what they do."""
    assert mangle(name) == f"Z{ord(name[0]):x}z{name[1:]}"


def test_plain_names_are_kept() -> None:
    assert [mangle(name) for name in ("arm_pendulum", "UR5", "q2x")] == ["arm_pendulum", "UR5", "q2x"]


def test_no_symbol_belongs_to_two_models() -> None:
    found = {name: symbols(mangle(name)) for name in HOSTILE}
    shared = [(a, b) for a, b in itertools.combinations(HOSTILE, 2) if found[a] & found[b]]
    assert shared == []


def test_no_target_of_cmake_belongs_to_two_models() -> None:
    """A library and its check program, side by side in one project."""
    targets = [target for name in HOSTILE for target in (mangle(name), f"{mangle(name)}_check")]
    assert len(set(targets)) == len(targets)


@pytest.mark.parametrize("name", ["a" * 200, "机械臂" * 40])
def test_long_names_stay_apart_by_their_digest(name: str) -> None:
    assert mangle(name) != mangle(name + "x")
    assert len(mangle(name)) <= MAX_LENGTH
