"""Base parameters: counts of known robots, a closed form, ranks by singular values, loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsrun.identification.equations import Setting, write_rows
from mbsrun.identification.settings import FALL, IdentificationError, Settings
from mbsrun.identification.structure import Structure, draw_states, find_structure
from mbsrun.identification.unknowns import Unknown, list_speeds, list_unknowns
from mbsrun.models import read_numbers
from tests.mbsrun.identification.motions import PANDA, ROOT, TWO_LINK, open_model


def find(path: Path, settings: Settings | None = None) -> tuple[Setting, tuple[Unknown, ...], Structure]:
    own, kernels, numbers = settings or Settings(), open_model(path), read_numbers(path, {})
    unknowns = list_unknowns(kernels.manifest, numbers, own)
    setting = Setting(kernels, list_speeds(kernels.manifest, numbers, own), ())
    return setting, unknowns, find_structure(setting, unknowns)


@pytest.mark.parametrize(
    ("path", "count"),
    [
        (PANDA, 43),  # C. Gaz et al., IEEE Robotics and Automation Letters 4, 2019
        (ROOT / "models" / "six_axis.yaml", 36),  # of a wrist with three axes through a point, as Puma 560's
        (TWO_LINK, 6),  # of a vertical plane: a moment about each joint and two first moments of each link
    ],
    ids=["panda", "six axes", "two links"],
)
def test_base_parameters_are_as_many_as_published(path: Path, count: int) -> None:
    assert len(find(path)[2].kept) == count


def test_two_links_have_the_sums_of_the_textbook() -> None:
    """J1 + l^2 m2 and S1 + l m2, for a second link at l = 0.4 m along -z (W. Khalil, E. Dombre, 2002, chapter 9)."""
    _, _, structure = find(TWO_LINK)
    assert structure.names == (
        "Jyy[upper] + 0.16 m[lower]",
        "Sx[upper]",
        "Sz[upper] - 0.4 m[lower]",
        "Jyy[lower]",
        "Sx[lower]",
        "Sz[lower]",
    )
    assert {"m[upper]", "Jxx[upper]", "Sy[lower]"} <= set(structure.unfelt)


@pytest.mark.parametrize("name", ["five_bar", "delta", "satellite", "branched"])
def test_the_rank_is_that_of_singular_values_and_other_states_confirm_the_sums(name: str) -> None:
    """With loops, quaternions and joints that follow others: A = A_kept G at states that were not used."""
    setting, unknowns, structure = find(ROOT / "models" / f"{name}.yaml")
    states = draw_states(setting, 60, seed=9)
    A, _ = write_rows(setting, states, unknowns, np.full(len(setting.manifest.coordinates), FALL))
    rows = A.reshape(-1, len(unknowns))
    values = np.linalg.svd(rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-9), compute_uv=False)
    assert int((values > 1e-8 * values[0]).sum()) == len(structure.kept)
    np.testing.assert_allclose(rows[:, structure.kept] @ structure.G, rows, atol=1e-7 * np.abs(rows).max())


def test_a_rotor_of_the_first_joint_is_one_with_the_link_and_others_are_told() -> None:
    _, _, structure = find(TWO_LINK, Settings(unknown=("inertia", "armature", "damping", "friction", "offset")))
    assert "Jyy[upper] + armature[shoulder] + 0.16 m[lower]" in structure.names
    assert {"armature[elbow]", "damping[elbow]", "friction[elbow]", "offset[elbow]"} <= set(structure.names)


def test_numbers_that_no_force_depends_on_are_refused() -> None:
    path = ROOT / "models" / "recorded" / "two_link.yaml"
    kernels, settings = open_model(path), Settings()
    unknowns = list_unknowns(kernels.manifest, read_numbers(path, {}), settings)
    unfelt = [x for x in unknowns if x.name in ("Jxx[upper]", "m[upper]")]
    with pytest.raises(IdentificationError, match=r"no force depends on Jxx\[upper\], m\[upper\]"):
        find_structure(Setting(kernels, np.ones(2), ()), unfelt)
