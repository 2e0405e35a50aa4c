"""Models as they come: lengths that vanish, inertias from CAD, growing expressions, other units (F30 to F33)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from secrets import token_hex
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun.external import Mechanism
from mbsrun.kernel import KernelError
from mbsrun.models import Extent, find_folder
from studies.laboratory.case import Finding, Workspace, check, demand, find_worst, show_failure
from studies.laboratory.digits import EXPLICIT, KERNELS, RESIDUAL, relate, specimen
from studies.laboratory.mechanisms import describe_spatial, draw, write

Array = NDArray[np.float64]

STIFFNESS = 40.0  # N/m
LENGTHS = (0.0, 1e-3, 1e-100, 1e-170, 1e-300)  # m, between the ends of a spring
DIGITS = (3, 4, 6, 9)  # of the entries of inertias
PLATES = 20
SIZES = (2, 3, 4, 5)  # joints of chains whose expressions are written out
LONGER = (12, 24)  # joints of chains whose operations are counted
UNITS = ((1e3, 1e3), (1e-3, 1e-3), (1e9, 1e-3), (1e-6, 1e9))  # factors of numbers for lengths and masses: mm and g, ...
SMALL = (1e9, 1e-3)  # nm and t

_POINT = """
name: point
gravity: [0, 0, 0]
bodies:
  - {{name: x, joint: {{type: prismatic, axis: x}}}}
  - {{name: y, parent: x, joint: {{type: prismatic, axis: y}}}}
  - {{name: z, parent: y, joint: {{type: prismatic, axis: z}}, mass: 1}}
forces:
  - {{name: spring, from: {{body: base}}, to: {{body: z}}, stiffness: {stiffness}{more}}}
"""
_PLATE = """
name: plate_{mark}
gravity: [0, 0, -9.81]
bodies:
  - name: plate
    joint: {{type: revolute, axis: z}}
    mass: 1
    inertia: {inertia}
"""


def measure_vanishing_length(workspace: Workspace) -> list[Finding]:
    """F30: a spring whose ends meet has force 0 and slope -k; with a rest length it has no direction: a status."""
    plant = _load(workspace, _POINT.format(stiffness=STIFFNESS, more=""), tuple(KERNELS.values()))
    findings = []
    for length in LENGTHS:
        state: dict[str, Any] = {"q": [length, 0, 0], "qd": [0, 0, 0], "u": [0, 0, 0]}
        force, slope, remark = STIFFNESS * length, STIFFNESS * np.eye(3), f"length {length:g} m"
        for way, kernel in RESIDUAL.items():
            found = plant(kernel, **state, qdd=[0, 0, 0])["Phi"].ravel()
            off = float(np.abs(found - [force, 0, 0]).max()) / (force or 1)
            findings.append(check(way, "error of the force", off, 1e-15, remark))
            off = float(np.abs(plant.jac(kernel, **state, qdd=[0, 0, 0])["jac_Phi_q"] - slope).max()) / STIFFNESS
            findings.append(check(way, "error of its slope", off, 1e-15, remark))
        for way, kernel in EXPLICIT.items():
            off = float(np.abs(plant.jac(kernel, **state)["jac_qdd_q"] + slope).max()) / STIFFNESS
            findings.append(check(way, "error of its slope", off, 1e-15, remark))
    x = ca.SX.sym("x", 3)
    norm = ca.norm_2(x)
    by_norm = ca.Function("slope", [x], [ca.jacobian(-STIFFNESS * norm * (x / norm), x)])
    lost = int(np.isnan(np.array(by_norm([0, 0, 0]))).sum())
    remark = "derivative of k |r| r/|r| by CasADi"
    findings.append(show_failure("by the norm", "entries that are not a number", lost, 0, remark))
    return [*findings, *_check_directions(workspace)]


def _check_directions(workspace: Workspace) -> list[Finding]:
    plant = _load(workspace, _POINT.format(stiffness=STIFFNESS, more=", rest: 0.5"), tuple(KERNELS.values()))
    findings = []
    for way, kernel in KERNELS.items():
        state: dict[str, Any] = {"q": [0, 0, 0], "qd": [0, 0, 0], "u": [0, 0, 0]}
        state |= {"qdd": [0, 0, 0]} if way in RESIDUAL else {}
        try:
            plant(kernel, **state)
        except KernelError as error:
            findings.append(demand(way, "status names the spring", "spring" in str(error), str(error)))
        else:
            findings.append(demand(way, "status names the spring", False, "status 0"))
    return findings


def measure_rounded_inertias(workspace: Workspace) -> list[Finding]:
    """F31: plates in any attitude, to few digits: taken, with a warning where rounding makes them impossible."""
    rng = np.random.default_rng(31)
    findings = []
    for digits in DIGITS:
        taken, silent = 0, 0
        for _ in range(PLATES):
            a, b = rng.uniform(0.2, 1, 2)
            Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            rounded = np.array(
                [[float(f"{x:.{digits - 1}e}") for x in row] for row in Q @ np.diag([a, b, a + b]) @ Q.T]
            )
            outcome = _submit(workspace, rounded)
            taken += outcome is not None
            silent += outcome is False and _find_excess(rounded) > 1e-9
        remark = f"{digits} digits"
        findings.append(check("check of models", "refused plates", PLATES - taken, 0, remark))
        findings.append(check("check of models", "impossible plates without a warning", silent, 0, remark))
    # a decimal point that is missing: 1.676 kg m2 beside 2.7e-3 kg m2
    wrong = np.array(
        [[2.6619e-3, -3.1029e-5, 9.34e-6], [-3.1029e-5, 2.3025e-3, 1.51466e-4], [9.34e-6, 1.51466e-4, 1.676359]]
    )
    is_refused = _submit(workspace, wrong) is None
    findings.append(
        demand("check of models", "refusal of a missing decimal point", is_refused, "taken" * (not is_refused))
    )
    passed = int(np.linalg.eigvalsh(wrong)[0] > 0)
    remark = "positive definite, but no body has these moments"
    return [*findings, show_failure("Cholesky's decomposition as a test", "impossible bodies taken", passed, 0, remark)]


def _submit(workspace: Workspace, J: Array) -> bool | None:
    """Return whether a body with this inertia brings a warning; None where it is refused.

    Its name is new, since a model that was generated before brings no warning again.
    """
    pairs = (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))
    inertia = "{" + ", ".join(
        f"{name}: {J[r, c]!r}".replace("np.float64(", "").replace(")", "") for name, r, c in pairs
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            find_folder(
                write(workspace.folder, _PLATE.format(mark=token_hex(4), inertia=inertia + "}")), Extent(("impl",), 0)
            )
        except InputError:
            return None
    return any("rounding" in str(warning.message) for warning in caught)


def _find_excess(J: Array) -> float:
    a, b, c = np.linalg.eigvalsh(J)
    return float((c - a - b) / c)


def measure_growth(workspace: Workspace, sizes: Sequence[int] = SIZES) -> list[Finding]:
    """F32: operations for accelerations of spatial chains; without shared values, Lagrange's equations explode."""
    findings: list[Finding] = []
    lengths: list[float] = []
    for size in sizes:
        chosen = specimen(workspace, describe_spatial(size), *EXPLICIT.values())
        states = draw(size, [size])
        lagrange, length = derive(size)
        lengths.append(length)
        found = np.array(lagrange(*(states[name][0] for name in ("q", "qd", "u")))).ravel()
        for way, kernel in EXPLICIT.items():
            off = relate(chosen.evaluate(kernel, states)[1][0]["qdd"][:, 0], found)
            findings.append(check(way, "difference from Lagrange's equations", off, 1e-10, f"{size} links"))
    manifests = [specimen(workspace, describe_spatial(n), *EXPLICIT.values()).subject.manifest for n in LONGER]
    for way, limit in (("EXP1", 3.0), ("EXP2", 1.4)):
        counts = [manifest.kernel(EXPLICIT[way]).flops.arithmetic for manifest in manifests]
        orders = np.diff(np.log(counts)) / np.diff(np.log(LONGER))
        remark = ", ".join(f"{n}: {c}" for n, c in zip(LONGER, counts, strict=True))
        findings.append(check(way, "order of the number of operations", find_worst(orders), limit, remark))
    orders = np.diff(np.log(lengths)) / np.diff(np.log(sizes))
    remark = ", ".join(f"{n}: {c:.2g}" for n, c in zip(sizes, lengths, strict=True))
    way = "Lagrange's equations, written out"
    return [*findings, show_failure(way, "order of the number of operations", float(orders.min()), 3.0, remark)]


def derive(size: int) -> tuple[ca.Function, float]:
    """Derive accelerations by Lagrange's equations, and count their operations if no value is used twice."""
    q, qd, u = (ca.SX.sym(name, size) for name in ("q", "qd", "u"))
    turn, place = ca.SX.eye(3), ca.SX.zeros(3)
    kinetic, potential, spin = ca.SX(0), ca.SX(0), ca.SX.zeros(3)
    inertia = ca.diag(ca.DM([1 / 1200, 1 / 12, 1 / 12]))
    for k in range(size):
        place = place + turn @ ca.DM([1, 0, 0]) if k else place
        axis = "zyx"[k % 3]
        unit = ca.DM([float(axis == x) for x in "xyz"])
        spin = spin + turn @ unit * qd[k]
        turn = turn @ _rotate(unit, q[k])
        com = place + turn @ ca.DM([0.5, 0, 0])
        v, w = ca.jtimes(com, q, qd), turn.T @ spin
        kinetic += (ca.dot(v, v) + ca.dot(w, inertia @ w)) / 2
        potential += 9.81 * com[1]
    momentum = ca.gradient(kinetic, qd)
    M = ca.jacobian(momentum, qd)
    right = u - ca.jtimes(momentum, q, qd) + ca.gradient(kinetic - potential, q)
    found = ca.Function("lagrange", [q, qd, u], [ca.solve(M, right)])
    return found, _write_out(found)


def _rotate(axis: ca.DM, angle: ca.SX) -> ca.SX:
    K = ca.skew(axis)
    return ca.SX.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * (K @ K)


def _write_out(function: ca.Function) -> float:
    """Count the operations of all results, each written as one expression of inputs."""
    sizes: dict[int, float] = {}
    total = 0.0
    for k in range(function.n_instructions()):
        operation, taken = function.instruction_id(k), function.instruction_input(k)
        if operation in (ca.OP_CONST, ca.OP_INPUT):
            sizes[function.instruction_output(k)[0]] = 0.0
        elif operation == ca.OP_OUTPUT:
            total += sizes[taken[0]]
        else:
            sizes[function.instruction_output(k)[0]] = 1.0 + sum(sizes[i] for i in taken)
    return total


def measure_units(workspace: Workspace) -> list[Finding]:
    """F33: the same machine in other units: the same accelerations, and no status; a rank by numbers changes."""
    n = 4
    states = draw(n, range(5))
    first = specimen(workspace, _describe_machine(1.0, 1.0), *EXPLICIT.values())
    exact = first.find_exact(states)
    findings = []
    for length, mass in UNITS:
        chosen = specimen(workspace, _describe_machine(length, mass), *EXPLICIT.values())
        motion = np.array([length, 1, 1, length])  # the units of the coordinates: slides are the first and the last
        force = mass * length**2 / motion
        scaled = {"q": states["q"] * motion, "qd": states["qd"] * motion, "u": states["u"] * force}
        remark = f"lengths times {length:g}, masses times {mass:g}"
        for way, kernel in EXPLICIT.items():
            for status, found, truth in zip(*chosen.evaluate(kernel, scaled), exact, strict=True):
                if status:
                    findings.append(demand(way, "error", False, f"{remark}: status at {chosen.joint(int(status))}"))
                else:
                    findings.append(
                        check(way, "error", relate(found["qdd"][:, 0] / motion, truth.rounded), 1e-12, remark)
                    )
        if (length, mass) == SMALL:
            lost = max(n - int(np.linalg.matrix_rank(x.M * np.outer(force, 1 / motion))) for x in exact)
            findings.append(show_failure("rank of M by numbers", "joints said to be without inertia", lost, 0, remark))
    return findings


def _describe_machine(length: float, mass: float) -> str:
    """Describe a slide, two turns and a slide, in other units of length and mass; gravity goes with the length."""
    J = mass * length**2
    text = f"name: machine\ngravity: [0, {-9.81 * length!r}, 0]\nbodies:\n"
    kinds = ("prismatic, axis: x", "revolute, axis: z", "revolute, axis: y", "prismatic, axis: x")
    for k, kind in enumerate(kinds, 1):
        parent = f"    parent: b{k - 1}\n" if k > 1 else ""
        place = f", position: [{0.5 * length!r}, 0, 0]" if k > 1 else ""
        text += f"  - name: b{k}\n{parent}    joint: {{name: q{k}, type: {kind}{place}}}\n    mass: {mass!r}\n"
        text += f"    com: [{0.2 * length!r}, {0.1 * length!r}, 0]\n"
        text += f"    inertia: [{0.02 * J!r}, {0.03 * J!r}, {0.04 * J!r}]\n"
    return text


def _load(workspace: Workspace, text: str, functions: tuple[str, ...]) -> Mechanism:
    return Mechanism(find_folder(write(workspace.folder, text), Extent(functions, 1)))
