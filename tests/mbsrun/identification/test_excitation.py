"""Exciting motions: exact gradients, limits, and deviations that identifications then have."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mbsrun import cli
from mbsrun.identification import IdentificationError, Settings, Wishes, excite, identify
from mbsrun.identification.excitation import _Design
from mbsrun.identification.identify import prepare
from mbsrun.identification.structure import find_structure
from mbsrun.identification.unknowns import list_unknowns
from mbsrun.models import read_numbers
from mbsrun.recordings import Recording, read_recording
from tests.mbsrun.identification.motions import PANDA, ROOT, TWO_LINK, open_model, record, swing

ALL = Settings(unknown=("inertia", "damping", "friction", "stribeck", "armature", "offset"))


def make_design(path: Path, settings: Settings, wishes: Wishes) -> _Design:
    kernels, numbers = open_model(path), read_numbers(path, {})
    unknowns = list_unknowns(kernels.manifest, numbers, settings)
    setting = prepare(kernels, numbers, settings)
    return _Design.of(setting, find_structure(setting, unknowns), kernels, wishes)


@pytest.mark.parametrize("criterion", ["D", "E", "A", "C"])
@pytest.mark.parametrize("path", [TWO_LINK, PANDA], ids=["two links", "panda"])
def test_gradients_are_those_of_central_differences(path: Path, criterion: str) -> None:
    number = {TWO_LINK: "Jyy[lower]", PANDA: "Sy[link6] - Sz[link7]"}[path] if criterion == "C" else ""
    wishes = Wishes(criterion=criterion, number=number)
    design = make_design(path, ALL if path == TWO_LINK else Settings(), wishes)
    rng = np.random.default_rng(1)
    x = design.draw(rng).ravel() * 1.5  # beyond some limits, where barriers are parabolas
    way, h = rng.normal(size=x.size), 1e-6
    slope = (design.evaluate(x + h * way, 0.2)[0] - design.evaluate(x - h * way, 0.2)[0]) / (2 * h)
    assert design.evaluate(x, 0.2)[1] @ way == pytest.approx(slope, rel=2e-5)


def test_a_motion_keeps_its_limits_and_makes_numbers_surer() -> None:
    """At rest at both ends; an identification has the expected deviations, which are less than of other motions."""
    found = excite(TWO_LINK, Settings(), Wishes(starts=2))
    assert max(found.shares.values()) <= 1
    assert max(found.shares.values()) > 0.9
    for rate in (found.qd, found.qdd):
        assert np.abs(rate[[0, -1]]).max() < 1e-9
    assert found.value > found.before + 5
    kernels = open_model(TWO_LINK)
    made = record(kernels, found.t, (found.q, found.qd, found.qdd), 0.0)
    values, rng = made.values.copy(), np.random.default_rng(1)
    values[:, -2:] += 0.3 * rng.standard_normal((len(found.t), 2))
    settings = Settings(noise={"shoulder": 0.3, "elbow": 0.3})
    result = identify(TWO_LINK, [Recording("made.csv", made.times, made.columns, values)], settings)
    own = np.array([x.deviation for x in result.base])
    np.testing.assert_allclose(own, 0.3 * found.deviations / np.sqrt(100), rtol=0.02)
    t = np.arange(1000) / 100
    other = identify(TWO_LINK, [record(kernels, t, swing(2, t, 3), 1e-3)], settings)
    assert np.prod([x.deviation for x in other.base]) > 10 * np.prod(own)


def test_one_number_is_made_surest() -> None:
    """Criterion C determines its number better than D does, by the noise that is given of each torque."""
    noise = {"shoulder": 0.01, "elbow": 3.0}
    whole = excite(TWO_LINK, Settings(), Wishes(starts=2))
    number = whole.names[0]
    found = {}
    for name, motion in {
        "D": whole,
        "C": excite(TWO_LINK, Settings(noise=noise), Wishes(starts=2, criterion="C", number=number)),
    }.items():
        made = record(open_model(TWO_LINK), motion.t, (motion.q, motion.qd, motion.qdd), 0.0)
        found[name] = identify(TWO_LINK, [made], Settings(noise=noise)).base[0]
    assert found["C"].name == found["D"].name == number
    assert found["C"].deviation < 0.9 * found["D"].deviation


def test_the_command_writes_a_table_that_plays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[object, str, str]:
        monkeypatch.setattr("sys.argv", ["mbsrun", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capsys.readouterr()

    code, out, err = run("excite", str(TWO_LINK), "--starts", "1", "--criterion", "E", "-o", "moves")
    assert code == 0, err
    assert "at their limits" in out
    table, summary = read_recording(Path("moves/motion.csv")), json.loads(Path("moves/excitation.json").read_text())
    assert len(table.times) == 1001
    motions = [word for pair in summary["motion"].items() for word in ("--motion", "=".join(pair))]
    code, _, err = run("inverse", str(TWO_LINK), *motions, "--duration", "10", "--output-step", "0.01", "-o", "i.csv")
    assert code == 0, err
    other = read_recording(Path("i.csv"))
    for name in ("q[elbow]", "qdd[elbow]", "u[shoulder]"):
        np.testing.assert_allclose(table.column(name), other.column(name), atol=1e-8)
    code, _, err = run("animate", str(TWO_LINK), "moves/motion.csv", "-o", "moves.html")
    assert code == 0, err
    code, _, err = run("identify", str(TWO_LINK), "moves/motion.csv", "-o", "found")
    assert code == 0, err


@pytest.mark.parametrize(
    ("name", "finding"),
    [("five_bar", "has loops"), ("satellite", "has quaternions"), ("cart_pole", "without a drive cannot follow")],
)
def test_mechanisms_that_no_motion_is_designed_for_are_refused(name: str, finding: str) -> None:
    with pytest.raises(IdentificationError, match=finding):
        excite(ROOT / "models" / f"{name}.yaml")


def test_wishes_that_cannot_be_are_refused(tmp_path: Path) -> None:
    with pytest.raises(IdentificationError, match="no criterion is named F; there are D, E, A, C"):
        excite(TWO_LINK, wishes=Wishes(criterion="F"))
    with pytest.raises(IdentificationError, match="two harmonics at least"):
        excite(TWO_LINK, wishes=Wishes(harmonics=1))
    with pytest.raises(IdentificationError, match="it holds code"):
        excite(tmp_path)
    for wishes in (Wishes(criterion="C"), Wishes(number="Jyy[lower]")):
        with pytest.raises(IdentificationError, match="give C and a number"):
            excite(TWO_LINK, wishes=wishes)
    with pytest.raises(IdentificationError, match=r"no base parameter is named m\[upper\]; there are Jyy"):
        excite(TWO_LINK, wishes=Wishes(criterion="C", number="m[upper]"))
    with pytest.raises(IdentificationError, match="noise of elbow must be positive"):
        excite(TWO_LINK, Settings(noise={"elbow": 0.0}))
    weak = TWO_LINK.read_text("utf-8").replace(
        "limits: [-2.5, 2.5], max_speed: 5, max_force: 30", "limits: [1, 2], max_force: 0.5"
    )
    assert "0.5}" in weak
    (tmp_path / "weak.yaml").write_text(weak, "utf-8")
    with pytest.raises(IdentificationError, match=r"no motion was found within the limits: .*u\[shoulder\] by"):
        excite(tmp_path / "weak.yaml", wishes=Wishes(starts=1, harmonics=2))
