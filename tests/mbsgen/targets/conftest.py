"""Whole models as they are written for users: the arm, and a random tree with run-time parameters."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen.formulations.reductions import Reductions
from mbsgen.pipeline import generate, write_families
from mbsgen.request import Options
from tests.golden import ROOT
from tests.random_trees import random_tree
from tests.sample import write_sample


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generate the arm."""
    out = tmp_path_factory.mktemp("generated") / "arm"
    generate(ROOT / "models" / "arm_pendulum.yaml", out)
    return out


@pytest.fixture(scope="session")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generate a tree of four bodies, branched, with both kinds of joints."""
    found = random_tree(5, 4, runtime=True)
    parameters = {p.name: p.value for p in found.parameters}
    return write_sample(tmp_path_factory.mktemp("tree"), "tree", write_families(found), parameters)


@pytest.fixture(scope="session")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generate some functions of a slider-crank, with all its numbers at run time."""
    out = tmp_path_factory.mktemp("closed") / "slider_crank"
    options = Options(runtime=True, functions=("impl", "exp1", "loops", "impl_red"), reductions=Reductions(trials=1))
    generate(ROOT / "models" / "slider_crank.yaml", out, options)
    return out
