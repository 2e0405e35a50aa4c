"""Estimators: against SciPy and statsmodels; coverage of intervals; bodies that can be built; nonlinear unknowns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mbsrun.identification import Settings, identify
from mbsrun.identification.estimation import Part, compress, estimate, solve, validate
from mbsrun.identification.physical import find_bodies, make_pseudo, read_pseudo
from mbsrun.identification.unknowns import Unknown, list_unknowns
from mbsrun.identification.writing import write_model
from mbsrun.models import read_numbers
from mbsrun.recordings import Recording, Treatment
from tests.mbsrun.identification.motions import PANDA, TWO_LINK, count_inside, open_model, record, swing
from tests.recordings_made import DAMPING, DRY, FOLDER, LINKS

Array = NDArray[np.float64]


def draw(seed: int, outliers: bool = False) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    A, x = rng.normal(size=(400, 1, 5)), np.arange(1.0, 6.0)
    b = A @ x + 0.3 * rng.standard_normal((400, 1))
    if outliers:
        b[::20] += 9
    return A, b, x


def test_least_squares_are_those_of_statsmodels() -> None:
    import statsmodels.api as sm

    A, b, _ = draw(1)
    found = estimate([Part(0, A, b)], {})
    theirs = sm.OLS(b[:, 0], A[:, 0]).fit()
    np.testing.assert_allclose(found.x, theirs.params, rtol=1e-10)
    np.testing.assert_allclose(found.covariance, theirs.cov_params(), rtol=1e-6, atol=1e-12)
    assert found.freedom == theirs.df_resid


def test_hubers_loss_is_that_of_statsmodels() -> None:
    import statsmodels.api as sm

    A, b, x = draw(2, outliers=True)
    found = estimate([Part(0, A, b)], {}, "huber")
    theirs = sm.RLM(b[:, 0], A[:, 0], M=sm.robust.norms.HuberT()).fit(cov="H1", tol=1e-10)
    np.testing.assert_allclose(found.x, theirs.params, rtol=2e-3)  # they take the deviation from the median of |r|
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(theirs.bcov_scaled), rtol=2e-2)
    assert np.abs(found.x - x).max() < 0.2 < np.abs(estimate([Part(0, A, b)], {}).x - x).max() + 0.2


def test_weights_follow_the_noise_of_each_torque() -> None:
    """As SciPy solves it with the true weights, within what these are uncertain by."""
    rng = np.random.default_rng(3)
    A, x, s = rng.normal(size=(500, 2, 4)), np.arange(4.0), np.array([1.0, 0.05])
    b = A @ x + s * rng.standard_normal((500, 2))
    found = estimate([Part(0, A[:200], b[:200]), Part(1, A[200:], b[200:])], {})
    np.testing.assert_allclose(found.sigma, s, rtol=0.1)

    def rest(z: Array) -> Array:
        return np.asarray(((A @ z - b) / s).ravel())

    weighted = least_squares(rest, np.zeros(4), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    jac = np.asarray(weighted.jac)
    np.testing.assert_allclose(found.x, weighted.x, atol=2e-4)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(jac.T @ jac), rtol=0.2, atol=1e-7)


def test_columns_that_depend_on_others_are_left_open() -> None:
    A, b, _ = draw(4)
    wide = np.concatenate((A, A[..., :1] + 2 * A[..., 1:2], np.zeros_like(A[..., :1])), axis=2)
    x, covariance, determined = solve(compress([Part(0, wide, b)]).R, np.ones(1))
    assert determined == (0, 1, 2, 3, 4)
    assert not x[5:].any()
    assert not covariance[5:].any()


def test_a_part_that_is_left_out_is_predicted() -> None:
    parts = [Part(k, *draw(k)[:2]) for k in range(3)]
    out, own = validate(compress(parts), [0, 1, 2], {})
    rest = np.concatenate([p.A[:, 0] for p in parts[1:]]), np.concatenate([p.b[:, 0] for p in parts[1:]])
    x = np.linalg.lstsq(*rest, rcond=None)[0]
    expected = np.sqrt(np.mean((parts[0].A[:, 0] @ x - parts[0].b[:, 0]) ** 2))
    assert out[0, 0] == pytest.approx(expected, rel=1e-10)
    assert (out > own).all()


def test_noise_that_lasts_widens_the_deviations() -> None:
    """Of a mean of an autoregression with 0.9, by the root of (1 + 0.9)/(1 - 0.9), in the limit of many rows."""
    rng, e = np.random.default_rng(5), np.zeros(40000)
    for k, x in enumerate(rng.standard_normal(e.size - 1), 1):
        e[k] = 0.9 * e[k - 1] + x
    A = np.ones((e.size, 1, 1))
    found = estimate([Part(0, A, e[:, None])], {})
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(10 / np.sqrt(e.size), rel=0.1)


def test_the_recorded_links_are_found() -> None:
    """Two links in closed form, angles and torques with noise: every number within four of its deviations."""
    settings = Settings(unknown=("inertia", "damping", "friction"), treatment=Treatment(cutoff=5.0))
    found = identify(TWO_LINK, [FOLDER / "two_link.csv"], settings)
    J1, S1, J2, S2, m2, l = LINKS.values()
    truth = {
        "Jyy[upper]": J1 + m2 * l**2,
        "Sz[upper]": -(S1 + m2 * l),
        "Sx[upper]": 0.0,
        "Jyy[lower]": J2,
        "Sz[lower]": -S2,
        "Sx[lower]": 0.0,
    }
    truth |= {f"damping[{x}]": d for x, d in zip(("shoulder", "elbow"), DAMPING, strict=True)}
    truth |= {f"friction[{x}]": d for x, d in zip(("shoulder", "elbow"), DRY, strict=True)}
    assert len(found.base) == len(truth)
    for name, value in truth.items():
        own = found.find(name)
        assert abs(own.value - value) < 4 * own.deviation, name
    assert found.torques[0].deviation < 0.05 * found.torques[0].size
    assert found.torques[0].left_out < 1.2 * found.torques[0].deviation


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """100 recordings of the same motion with other noise: 95 % of the ellipsoids, within three deviations of that."""
    found = count_inside(TWO_LINK, swing(2, np.arange(300) / 30, 3), 0.05, range(100))
    assert 0.95 - 3 * 0.0218 <= found.ellipsoids <= 1
    assert found.intervals == pytest.approx(0.95, abs=0.04)


def test_further_frictions_offsets_and_currents_are_found() -> None:
    kernels, t = open_model(TWO_LINK), np.arange(2000) / 100
    q, qd, qdd = swing(2, t, 3)
    slope = np.tanh(qd / 0.02)
    more = 0.3 * qd + 0.5 * slope + 0.4 * np.exp(-((qd / 0.15) ** 2)) * slope + 0.07 * qdd
    made = record(kernels, t, (q, qd, qdd), 0.002, more=more)
    values = made.values.copy()
    values[:, -1] += 0.25  # an offset of the second torque
    words = ("inertia", "damping", "friction", "stribeck", "armature", "offset")
    found = identify(TWO_LINK, [Recording("made.csv", t, made.columns, values)], Settings(unknown=words))
    expected = {"damping": 0.3, "friction": 0.5, "stribeck": 0.4, "fall": 0.15, "armature": 0.07, "offset": 0.25}
    for kind, value in expected.items():
        own = found.find(f"{kind}[elbow]")
        assert own.value == pytest.approx(value, abs=5 * own.deviation)
        assert own.deviation < 0.03 * value
    values[:, -1] /= 0.8  # now a current
    settings = Settings(
        unknown=("motor", "inertia"), bodies=("lower",), currents={"elbow": "u[elbow]"}, joints=("elbow",)
    )
    plain = record(kernels, t, (q, qd, qdd), 0.002)
    columns = plain.values.copy()
    columns[:, -1] /= 0.8
    found = identify(TWO_LINK, [Recording("made.csv", t, plain.columns, columns)], settings)
    own = found.find("motor[elbow]")
    assert own.value == pytest.approx(0.8, abs=5 * own.deviation)


def test_encoders_are_told_where_gravity_shows_them() -> None:
    """The angle of the elbow's encoder turns the lower link's centre alone, so that it cannot be determined from it."""
    kernels, t = open_model(TWO_LINK), np.arange(1000) / 100
    made = record(kernels, t, swing(2, t, 3), 1e-3)
    values = made.values.copy()
    values[:, 1] += 0.05
    shifted = [Recording("made.csv", t, made.columns, values)]
    found = identify(TWO_LINK, shifted, Settings(unknown=("encoder",), joints=("elbow",)))
    assert found.find("encoder[elbow]").value == pytest.approx(0.05, abs=1e-3)
    found = identify(TWO_LINK, shifted, Settings(unknown=("encoder", "inertia"), joints=("elbow",)))
    assert found.undetermined == ("encoder[elbow]",)


def test_a_parameter_of_the_model_is_found() -> None:
    path = FOLDER / "pendulum.yaml"
    kernels, t = open_model(path), np.arange(1000) / 100
    made = record(kernels.with_parameters(inertia=0.05, friction=0.2), t, swing(1, t, 3), 1e-3)
    found = identify(path, [made], Settings(unknown=(), fitted=("inertia", "friction")))
    assert found.find("inertia").value == pytest.approx(0.05, abs=4 * found.find("inertia").deviation)
    assert found.find("friction").value == pytest.approx(0.2, abs=4 * found.find("friction").deviation)
    assert found.torques[0].deviation < 0.002 * found.torques[0].size
    assert found.parameters == {name: found.find(name).value for name in ("inertia", "friction")}


def test_gaps_and_several_recordings_and_positions_alone() -> None:
    kernels, t = open_model(TWO_LINK), np.arange(500) / 50
    made = [record(kernels, t, swing(2, t, seed), 0.01, seed, rates=False, name=f"{seed}.csv") for seed in (3, 4, 5)]
    values = made[0].values.copy()
    values[100:150] = np.nan
    values[300, 2] = np.nan  # a torque alone
    found = identify(TWO_LINK, [Recording("gaps.csv", t, made[0].columns, values), *made[1:]])
    assert [trace.left_out for trace in found.traces] == [50, 0, 0]
    assert found.groups == ("gaps.csv", "4.csv", "5.csv")
    for x in found.base:
        assert abs(x.value - x.before) < 4 * x.deviation


# --- bodies ---


def test_pseudo_inertias_are_read_back() -> None:
    moments = np.array([2.0, 0.1, 0.2, -0.3, 1.0, 0.1, 0.2, 1.5, -0.1, 1.2])
    np.testing.assert_allclose(read_pseudo(make_pseudo(moments)), moments, rtol=1e-14)


def test_an_estimate_beyond_all_bodies_leads_to_the_nearest_one() -> None:
    """A body of which Jxx is measured too large: of Jxx <= Jyy + Jzz the bound is taken, as SLSQP finds."""
    names = ("m", "Sx", "Sy", "Sz", "Jxx", "Jxy", "Jxz", "Jyy", "Jyz", "Jzz")
    x0 = np.array([1.0, 0, 0, 0, 0.3, 0, 0, 0.2, 0, 0.2])
    unknowns = [
        Unknown(f"{n}[b]", "inertia", v, "", "b", body=0, moment=k)
        for k, (n, v) in enumerate(zip(names, x0, strict=True))
    ]
    beta = x0.copy()
    beta[4] = 0.5
    deviations = np.array([0.01] * 4 + [0.02] * 6)
    found = find_bodies(unknowns, np.eye(10), x0, beta, np.diag(deviations**2), None, free=False)
    assert found.is_moved
    assert np.linalg.eigvalsh(make_pseudo(found.x))[0] > 0
    # the nearest point of Jxx = Jyy + Jzz: equal deviations share the excess of 0.1
    np.testing.assert_allclose(found.x[[4, 7, 9]], [0.5 - 0.1 / 3, 0.2 + 0.1 / 3, 0.2 + 0.1 / 3], atol=2e-4)
    assert found.distance == pytest.approx(0.1 / 3 * np.sqrt(3) / 0.02, rel=1e-2)
    free = find_bodies(unknowns, np.eye(10), x0, beta, np.diag(deviations**2), None, free=True)
    np.testing.assert_allclose(free.x, beta, atol=1e-9)


def test_a_prior_opinion_pulls_towards_the_model() -> None:
    kernels, t = open_model(TWO_LINK), np.arange(100) / 10
    made = record(kernels, t, swing(2, t, 3), 0.3)
    plain, firm = (identify(TWO_LINK, [made], Settings(prior=w)) for w in (None, 1e-4))
    far, near = (max(abs(v - x.value) for v, x in zip(y.values, y.unknowns, strict=True)) for y in (plain, firm))
    assert near < 1e-2 * far


def test_a_pandas_payload_is_weighed() -> None:
    """The hand's link alone is unknown: ten seconds at 100 Hz with 5 % of noise determine its mass within 1 %."""
    kernels, t = open_model(PANDA), np.arange(1000) / 100
    q, qd, qdd = swing(7, t, 3)
    q = q + np.array([0, 0, 0, -1.5, 0, 1.8, 0])
    found = identify(PANDA, [record(kernels, t, (q, qd, qdd), 0.05)], Settings(bodies=("link7",)))
    mass = found.find("m[link7]")
    assert mass.deviation < 0.01 * mass.value
    assert abs(mass.value - mass.before) < 4 * mass.deviation


def test_a_load_that_is_fixed_to_a_link_is_found_in_its_own_frame(tmp_path: Path) -> None:
    """All numbers but the mass along the joint's axis, and its products, are determined; the load is written."""
    load = """  - name: load
    parent: lower
    joint: {type: fixed, position: [0.1, 0.05, -0.4], orientation: [{axis: x, angle: 0.4}, {axis: z, angle: -0.7}]}
    mass: MASS
    com: [0.05, 0.02, -0.1]
    inertia: [0.004, 0.003, 0.002]
frames:"""
    files = {mass: tmp_path / f"{mass}.yaml" for mass in ("0.7", "1e-3")}
    for mass, file in files.items():
        file.write_text(TWO_LINK.read_text("utf-8").replace("frames:", load.replace("MASS", mass)), "utf-8")
    t = np.arange(1000) / 100
    made = record(open_model(files["0.7"]), t, swing(2, t, 3), 0.001)
    found = identify(files["1e-3"], [made], Settings(bodies=("load",)))
    truth = list_moments(files["0.7"], "load")
    beta = found.G @ truth
    for x, value in zip(found.base, beta, strict=True):
        assert abs(x.value - value) < 4 * x.deviation, x.name
    assert len(found.base) == 4  # two first moments, one tensor about the elbow's axis, the mass on the shoulder's arm
    again = tmp_path / "found.yaml"
    again.write_text(write_model(found, files["1e-3"]), "utf-8")
    after = identify(again, [made], Settings(bodies=("load",)))
    assert after.torques[0].before == pytest.approx(found.torques[0].deviation, rel=1e-3)


def list_moments(path: Path, *bodies: str) -> Array:
    """List the moments of some bodies, or of all, in the order of the unknowns."""
    unknowns = list_unknowns(open_model(path).manifest, read_numbers(path, {}), Settings(bodies=bodies))
    return np.array([x.value for x in unknowns])


def test_bodies_of_a_standard_table_lie_beyond_their_joints(tmp_path: Path) -> None:
    text = """name: table
gravity: [0, -9.81, 0]
bodies:
  - {name: one, joint: {type: dh, convention: standard, a: 0.4}, mass: 2, com: [-0.2, 0, 0], inertia: [0, 0.03, 0.03]}
  - name: two
    parent: one
    joint: {type: dh, convention: standard, a: 0.3}
    mass: 1
    com: [-0.1, 0, 0]
    inertia: [0, 0.01, 0.01]
"""
    (tmp_path / "table.yaml").write_text(text, "utf-8")
    (tmp_path / "guess.yaml").write_text(text.replace("mass: 1", "mass: 2"), "utf-8")
    t = np.arange(500) / 50
    made = record(open_model(tmp_path / "table.yaml"), t, swing(2, t, 3), 0.001)
    found = identify(tmp_path / "guess.yaml", [made])
    assert {x.owner for x in found.unknowns} == {"one", "two"}
    truth = found.G @ list_moments(tmp_path / "table.yaml")
    for x, value in zip(found.base, truth, strict=True):
        assert abs(x.value - value) < 4 * x.deviation, x.name
