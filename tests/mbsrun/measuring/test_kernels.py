"""Charts of kernels: the reference against closed forms, what kernels err by against bounds, stores that go on."""

from __future__ import annotations

import csv
from pathlib import Path

import mpmath
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.forms import FUNCTIONS
from mbsrun.measuring import kernels
from mbsrun.measuring.candidates import compile_kernel
from mbsrun.measuring.charts import draw_kernels
from mbsrun.measuring.functions import Variant
from mbsrun.measuring.kernels import (
    ACCELERATIONS,
    MASS,
    PRECISE,
    RESIDUAL,
    SINGLE,
    SLOPES_R,
    USUAL,
    VALUES,
    KernelScope,
)
from mbsrun.measuring.mechanisms import CLOSING, Subject, draw_states, write_chain
from mbsrun.measuring.points import KernelPoint, write_points
from mbsrun.measuring.reference import Reference
from mbsrun.measuring.store import Store
from mbsrun.models import Extent

U = {"float64": 2.0**-53, "float32": 2.0**-24}
ENGINE = Path(__file__).parents[3] / "models" / "slider_crank.yaml"
LITTLE = KernelScope((), (USUAL, SINGLE), 2, 2)


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    """Drive the crank of the engine with one cylinder."""
    path, text = tmp_path_factory.mktemp("engine") / "engine.yaml", ENGINE.read_text(encoding="utf-8")
    text = text.replace("{type: revolute, axis: y}", "{type: revolute, axis: y, actuated: false}", 1)
    path.write_text(text.replace("independent: [crank]", "driven: [crank]"), encoding="utf-8")
    return Subject(path, Extent(FUNCTIONS, 1, optional=CLOSING))


def quiet(*_: object) -> None:
    """Ignore progress."""


def test_the_reference_is_the_closed_form_of_a_cart_with_a_rod(cart: Path) -> None:
    """(m + M) xdd - M a (cos t tdd - sin t td^2) = u - k x - d xd + Fx; M a = 0.32, (I + M a^2) = 0.168."""
    state = {
        "q": [0.25, 0.5],
        "qd": [0.75, -1.5],
        "qdd": [2.0, -3.0],
        "u": [4.0],
        "w": [0.5, 0.0, 0.25],
        "theta": [1.5],
        "p": [7.0],
    }
    moment = Reference(cart).at({name: np.array(values) for name, values in state.items()})
    with mpmath.workdps(40):
        g, a, mass = mpmath.mpf(9.81), mpmath.mpf(0.4), mpmath.mpf(0.8)
        sine, cosine = mpmath.sin(0.5), mpmath.cos(0.5)
        turn = mpmath.mpf(0.04) + mass * a * a
        couple = -mass * a * cosine
        x = (mpmath.mpf(1.5) + mass) * 2 + couple * -3 + mass * a * sine * mpmath.mpf(2.25)
        x -= 4 - 7 * mpmath.mpf(0.25) - mpmath.mpf(0.4) * mpmath.mpf(0.75) + mpmath.mpf(0.5)
        t = couple * 2 + turn * -3 + mass * a * g * sine
        t -= -mpmath.mpf(0.5) * cosine * mpmath.mpf(0.5) + mpmath.mpf(0.5) * sine * mpmath.mpf(0.25)
        assert [float(abs(f - e)) for f, e in zip(moment.residual(), (x, t), strict=True)] == pytest.approx(
            [0, 0], abs=1e-30
        )
        assert float(abs(moment.M[0][1] - couple)) < 1e-30
        (slope,) = moment.slopes("theta")  # of the residual by m: xdd, and nothing
        assert [float(v) for v in slope] == pytest.approx([2.0, 0.0], abs=1e-25)
        left = moment.residual(qdd=moment.qdd)
        assert max(abs(v) for v in left) < mpmath.mpf("1e-45")


def test_kernels_of_all_kinds_keep_their_digits(cart: Path, tmp_path: Path) -> None:
    """A few roundings in each result: 30 u at most where nothing is ill-conditioned, in both precisions.

    Differences cannot: theirs are off by a thousand times more.
    """
    points = kernels.measure_kernels(cart, tmp_path / "out", LITTLE, quiet)
    exact = [p for p in points if p.precision == kernels.EXACT]
    assert {(p.task, p.error) for p in exact} == {(RESIDUAL, 0.0), (ACCELERATIONS, 0.0)}
    assert all(p.ns is not None and p.ns.shortest > 0 for p in exact)
    generated = [p for p in points if "differences" not in p.way and p not in exact]
    assert {p.task for p in generated} == {*kernels.KERNELS, *kernels.SLOPES} - {*kernels.OF_LOOPS}
    assert {p.precision for p in generated} == set(U)
    for p in generated:
        assert p.error is not None
        assert p.error <= 30 * U[p.precision], p
        assert p.backward is None or p.backward <= 10 * U[p.precision], p
        assert p.ns is not None
        assert 0 < p.ns.shortest <= p.ns.median
        assert p.failed == 0
    assert any("CasADi" in p.way for p in generated)
    for p in points:
        if "differences" in p.way:
            assert p.error is not None
            assert 1000 * U[p.precision] < p.error < 1, p


def test_errors_tell_precisions_apart(tmp_path: Path) -> None:
    """Single precision errs by more than a hundred thousand times what double precision does."""
    subject = Subject(write_chain(3, tmp_path), Extent(("impl", "semi_res"), 0))
    points = kernels.measure_task(subject, RESIDUAL, LITTLE, Store(tmp_path / "points.jsonl", KernelPoint))
    double, single = ([p.error or 0.0 for p in points if p.precision == x] for x in U)
    assert min(single) > 1e5 * max(double)


def test_double_double_lies_between_doubles_and_50_digits(tmp_path: Path) -> None:
    """Its errors are a few u^2, forward and backward, so none of them can come from results rounded to doubles."""
    subject = Subject(write_chain(3, tmp_path), Extent(FUNCTIONS, 0, targets=("double-double",)))
    scope, store = KernelScope((), (USUAL, PRECISE), 2, 3), Store(tmp_path / "points.jsonl", KernelPoint)
    points: list[KernelPoint] = []
    for task, way in ((RESIDUAL, "impl"), (MASS, "semi"), (ACCELERATIONS, "exp1")):
        found = [p for p in kernels.measure_task(subject, task, scope, store) if p.way == way]
        double, precise = (next(p for p in found if p.precision == x) for x in ("float64", "double-double"))
        assert 0 < (precise.error or 0.0) < 1e-30 < 1e-17 < (double.error or 0.0)
        assert precise.backward is None or 0 < precise.backward < 1e-30
        assert precise.ns is not None
        assert double.ns is not None
        assert precise.ns.shortest > 2 * double.ns.shortest
        points += found
    assert all(path.stat().st_size > 5_000 for path in draw_kernels(points, tmp_path))


def test_flags_reach_the_compiler(tmp_path: Path) -> None:
    """Without contraction and with the C library's sines other roundings are made, so other digits come out.

    Kernels with few sines call the C library's in any case.
    """
    subject = Subject(write_chain(4, tmp_path), Extent(("impl", "semi_res"), 0))
    scope = KernelScope((), (USUAL, Variant(contract=False), Variant(libm=True), Variant(level="-O0")), 1, 24)
    points = kernels.measure_task(subject, RESIDUAL, scope, Store(tmp_path / "points.jsonl", KernelPoint))
    points = [p for p in points if p.precision != kernels.EXACT]
    assert len({p.flags for p in points}) == 4
    errors = {flags: [p.error_median for p in points if p.flags == flags] for flags in {p.flags for p in points}}
    assert errors["-O3"] != errors["-O3 no fma"]
    assert errors["-O3"] != errors["-O3 libm"]


def test_failures_are_points_and_are_drawn(locked: Path, tmp_path: Path) -> None:
    """Elimination fails 1e-7 rad from a Cardan joint's lock; the point names the joint, has no error, and is drawn."""
    subject = Subject(locked, VALUES)
    store = Store(tmp_path / "points.jsonl", KernelPoint)
    points = kernels.measure_task(subject, ACCELERATIONS, LITTLE, store)
    failed = next(p for p in points if p.way == "exp1" and p.precision == "float64")
    assert failed.failed == failed.states
    assert (failed.error, failed.ns) == (None, None)
    assert "q" in failed.finding
    good = kernels.measure_task(subject, RESIDUAL, LITTLE, store)
    assert all(p.failed == 0 and p.error is not None for p in good)
    paths = draw_kernels([*good, *points], tmp_path)
    assert [path.name for path in paths if path.suffix == ".png" and "narrow" not in path.name] == [
        "kernels.png",
        "kernels_backward.png",
    ]
    assert all(path.stat().st_size > 5_000 for path in paths)
    table, _ = write_points([*good, *points], tmp_path, "kernels")
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(good) + len(points)
    assert any(row["way"] == "exp1" and row["error"] == "" and row["finding"] for row in rows)


def test_a_study_that_was_killed_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bundles that were kept are not measured again; the one whose line was cut off is, and no other."""
    subject = Subject(write_chain(2, tmp_path), Extent(("impl", "semi", "semi_res"), 0))
    path = tmp_path / "points.jsonl"
    first = [kernels.measure_task(subject, task, LITTLE, Store(path, KernelPoint)) for task in (RESIDUAL, MASS)]
    measured: list[str] = []
    measure = kernels.KernelTask.measure

    def watch(task: kernels.KernelTask, variants: tuple[Variant, ...]) -> list[KernelPoint]:
        measured.append(task.task)
        return measure(task, variants)

    monkeypatch.setattr(kernels.KernelTask, "measure", watch)
    path.write_text(path.read_text(encoding="utf-8")[:-20], encoding="utf-8")
    again = [kernels.measure_task(subject, task, LITTLE, Store(path, KernelPoint)) for task in (RESIDUAL, MASS)]
    assert measured == [MASS]
    assert again[0] == first[0]
    once_more = [kernels.measure_task(subject, task, LITTLE, Store(path, KernelPoint)) for task in (RESIDUAL, MASS)]
    assert (once_more, measured) == (again, [MASS])
    other = KernelScope((), (USUAL, SINGLE), 3, 2)
    kernels.measure_task(subject, RESIDUAL, other, Store(path, KernelPoint))
    assert measured == [MASS, RESIDUAL]


def test_states_are_the_same_in_both_precisions_and_within_limits(cart: Path) -> None:
    subject = Subject(cart, VALUES)
    states = draw_states(subject.kernels, 50)
    for name in ("q", "qd", "qdd", "u", "w"):
        assert (states[name] == states[name].astype(np.float32)).all()
    assert np.abs(states["q"][:, 0]).max() <= 1
    again = draw_states(subject.kernels, 50)
    assert all((states[name] == again[name]).all() for name in states)


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give the model file"):
        kernels.measure_kernels(tmp_path, tmp_path / "out", kernels.QUICK, quiet)
    assert not (tmp_path / "out").exists()


def test_derivatives_are_of_what_the_residual_takes(cart: Path) -> None:
    """The reference differentiates by every input of the kernel, parameters that are differentiated included."""
    subject = Subject(cart, VALUES)
    states = draw_states(subject.kernels, 1)
    moment = Reference(cart).at({name: values[0] for name, values in states.items()})
    assert set(kernels._expect(SLOPES_R, moment)) == {f"jac_Phi_{x}" for x in ("q", "qd", "qdd", "u", "w", "theta")}


def test_states_of_loops_are_closed(engine: Subject) -> None:
    """The piston is above the crank's axis by r cos q + sqrt(l^2 - r^2 sin^2 q); its velocity is the derivative."""
    states = draw_states(engine.kernels, 40)
    (q, _, z), (qd, _, zd) = states["q"].T, states["qd"].T
    root = np.sqrt(0.14**2 - (0.045 * np.sin(q)) ** 2)
    assert z == pytest.approx(0.045 * np.cos(q) + root, abs=4 * U["float32"])
    assert zd == pytest.approx(-0.045 * np.sin(q) * (1 + 0.045 * np.cos(q) / root) * qd, abs=1e-6)
    assert np.ptp(q) > 4
    assert (states["yd"][:, 0] == qd).all()


def test_kernels_of_loops_keep_their_digits(engine: Subject) -> None:
    """All forms of a driven mechanism with a loop: a few roundings, as without loops, and no failure.

    Accelerations by q are a difference of M^-1 J^T dlam and M^-1 dPhi, which are a thousand times larger: M of the rod
    is 2e-3 kg m2. They lose these digits.
    """
    tasks = kernels.list_tasks(engine.manifest, derivatives=True)
    assert {*kernels.KERNELS, *kernels.SLOPES} == set(tasks)
    for task in tasks:
        way = kernels.KernelTask(engine, task, KernelScope(judged=2))
        judged = {name: x[:2] for name, x in way.states.items()}
        prefix = "jac_" if task in kernels.SLOPES else ""
        for name in kernels.KERNELS[kernels.SLOPES.get(task, task)]:
            candidate = compile_kernel(engine, prefix + name, Variant(level="-O0"))
            errors = [way._compare(k, found) for k, found in enumerate(candidate.evaluate(judged)[1])]
            assert len(errors) == 2
            for found in errors:
                assert found.error < (1e4 if task == kernels.SLOPES_A else 60) * U["float64"], (task, name)
                assert (found.backward or 0.0) < 60 * U["float64"], (task, name)
            expected = set(way.expected[0])
            blocks = {f"jac_{of}_{by}" for of in ("qdd", "lam", "tau") for by in ("q", "qd", "a", "w")}
            assert task != kernels.SLOPES_A or expected == blocks
