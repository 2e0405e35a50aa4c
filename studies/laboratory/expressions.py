"""How equations are written: force laws, inverses, sums of angles (F10 to F13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from studies.laboratory.case import Finding, Workspace, check, show_failure
from studies.laboratory.digits import EXPLICIT, KERNELS, RESIDUAL, Specimen, U, relate, specimen
from studies.laboratory.mechanisms import describe_spatial, describe_straight, draw

Array = NDArray[np.float64]

ROUNDING = U["float64"]
BACKWARD = 10 * ROUNDING  # the residual that elimination leaves, by the terms of the equations
STIFFNESS, REST = 100.0, 0.7
_SPRING = f"""
name: spring
gravity: [0, 0, 0]
parameters: {{k: {STIFFNESS}, rest: {REST}}}
bodies:
  - name: arm
    joint:
      type: revolute
      axis: z
      actuated: false
      force: -k*((cos(q) - cos(rest))**2 + (sin(q) - sin(rest))**2)
    mass: 1
    com: [0.5, 0, 0]
    inertia: [0.1, 0.1, 0.1]
"""
SINE = -0.8522008497671888  # of 1e22
_PENDULUM = """
name: sine
gravity: [0, -1, 0]
bodies:
  - name: bob
    joint: {name: q1, type: revolute, axis: z}
    mass: 1
    com: [0, -1, 0]
"""
WRITTEN = {"one sine of the sum": (), "addition theorems": ("share_frames",)}
SIZES = (1e2, 1e4, 1e6, 1e8, 1e10, 1e12)  # of angles, rad


def measure_spring(workspace: Workspace, distance: float) -> list[Finding]:
    """F10: the square of a length is not multiplied out, so it is as right as the differences written by hand."""
    q = REST + distance * (1 + np.arange(20) / 20)
    states = {"q": q[:, None], "qd": np.zeros((20, 1)), "qdd": np.zeros((20, 1)), "u": np.zeros((20, 0))}
    chosen = specimen(workspace, _SPRING, *KERNELS.values())
    exact = chosen.find_exact(states)
    forces = np.array([float(x.moment.residual()[0]) for x in exact])
    by_hand = STIFFNESS * ((np.cos(q) - np.cos(REST)) ** 2 + (np.sin(q) - np.sin(REST)) ** 2)
    bound = 10 * float((np.abs(by_hand - forces) / forces).max())
    findings = []
    for way, kernel in KERNELS.items():
        result = "Phi" if way in RESIDUAL else "qdd"
        values = np.array([found[result][0, 0] for found in chosen.evaluate(kernel, states)[1]])
        wanted = forces if result == "Phi" else np.array([x.rounded[0] for x in exact])
        error = float((np.abs(values - wanted) / np.abs(wanted)).max())
        findings.append(
            check(way, "error of the force", error, bound, "ten times what the law errs by as written by hand")
        )
    sums = STIFFNESS * (2 - 2 * np.cos(q) * np.cos(REST) - 2 * np.sin(q) * np.sin(REST))
    for way, values in (("multiplied out", sums), ("simplified to 2 - 2 cos", STIFFNESS * (2 - 2 * np.cos(q - REST)))):
        error = float((np.abs(values - forces) / forces).max())
        findings.append(show_failure(way, "error of the force", error, bound, "what the generator must not write"))
    return findings


def measure_inverse(workspace: Workspace, size: int) -> list[Finding]:
    """F11: equations are eliminated, not multiplied by an adjugate: few divisions, and the errors of elimination."""
    chosen = specimen(workspace, describe_spatial(size), *EXPLICIT.values())
    states = draw(size, range(5))
    findings = []
    exact = chosen.find_exact(states)
    for way, kernel in EXPLICIT.items():
        divisions = chosen.subject.manifest.kernel(kernel).flops.div
        findings.append(check(way, "divisions", divisions, 2 * size))
        for found, truth in zip(chosen.evaluate(kernel, states)[1], exact, strict=True):
            bound = 10 * ROUNDING * float(np.linalg.cond(truth.M))
            findings.append(check(way, "error", relate(found["qdd"][:, 0], truth.rounded), bound))
    return findings


def measure_determinants(workspace: Workspace, size: int) -> list[Finding]:
    """F11: Cramer's rule, with determinants multiplied out, leaves a residual in a straight chain; elimination none."""
    chosen, states = specimen(workspace, describe_straight(size), *EXPLICIT.values()), draw(size, range(5), q=0.0)
    exact = chosen.find_exact(states)
    findings = [
        check(way, "backward error", truth.leave(found["qdd"][:, 0]), BACKWARD)
        for way, kernel in EXPLICIT.items()
        for found, truth in zip(chosen.evaluate(kernel, states)[1], exact, strict=True)
    ]
    bias = chosen.evaluate("impl", {**states, "qdd": 0 * states["q"]})[1]
    solved = [divide_determinants(truth.M, -c["Phi"][:, 0]) for truth, c in zip(exact, bias, strict=True)]
    left = max(truth.leave(qdd) for truth, qdd in zip(exact, solved, strict=True))
    return [*findings, show_failure("determinants multiplied out", "backward error", left, BACKWARD)]


def divide_determinants(A: Array, b: Array) -> Array:
    """Solve A x = b by Cramer's rule."""
    whole = multiply_out(A)
    columns = (np.column_stack((A[:, :i], b, A[:, i + 1 :])) for i in range(len(b)))
    return np.array([multiply_out(column) / whole for column in columns])


def multiply_out(A: Array) -> float:
    """Compute a determinant as the sum of all products, by rows: minors of the first rows, by the columns they take."""
    minors = {0: 1.0}
    for row in A:
        further: dict[int, float] = {}
        for taken, minor in minors.items():
            for j in (j for j in range(len(A)) if not taken >> j & 1):
                sign = -1.0 if (taken >> j).bit_count() % 2 else 1.0
                further[taken | 1 << j] = further.get(taken | 1 << j, 0.0) + sign * minor * float(row[j])
        minors = further
    return minors[(1 << len(A)) - 1]


def measure_sums(workspace: Workspace, parallel: int) -> list[Finding]:
    """F12: the last joint's torque at rest is the cosine, or the sine, of a sum of angles."""
    findings = []
    for label, without in WRITTEN.items():
        for com in ("[1, 0, 0]", "[0, 1, 0]"):
            chosen = specimen(workspace, _describe_arm(parallel, com), "impl", without=without)
            for size in SIZES:
                angles = _draw_angles(parallel, size)
                lost, bounds = _measure_torques(chosen, angles), 4 * ROUNDING * (1 + np.abs(angles).sum(axis=1))
                worst = int((lost / bounds).argmax())
                findings.append(
                    check(label, "error of any angles", lost[worst], bounds[worst], f"up to {size:.0e} rad")
                )
            lost = _measure_torques(chosen, _draw_angles(parallel, 2 * np.pi))
            findings.append(check(label, "error within a turn", lost.max(), (10 if parallel == 2 else 20) * ROUNDING))
    huge = _measure_torques(
        specimen(workspace, _describe_arm(parallel, "[1, 0, 0]"), "impl"), _draw_angles(parallel, 1e8)
    )
    remark = "angles of 1e8 rad"
    findings.append(show_failure("one sine of huge sums", "error", huge.max(), 20 * ROUNDING, remark))
    return findings


def measure_huge(workspace: Workspace) -> list[Finding]:
    """F13: M and c some 16 million turns away."""
    findings = []
    for label, without in WRITTEN.items():
        chosen = specimen(workspace, _describe_arm(3, "[1, 0, 0]"), "semi", without=without)
        states = draw(4, range(10))
        states["q"] = states["q"] + 2 * np.pi * np.round(1e8 / (2 * np.pi))
        bounds = 4 * ROUNDING * (1 + np.abs(states["q"]).sum(axis=1)) if not without else np.full(10, 1e-13)
        for bound, truth, found in zip(
            bounds, chosen.find_exact(states), chosen.evaluate("semi", states)[1], strict=True
        ):
            bias = np.array([[float(x)] for x in truth.moment.bias])
            error = max(relate(found["M"], truth.M), relate(found["c"], bias))
            findings.append(check(label, "error of M and c", error, bound))
    return findings


def measure_sine(workspace: Workspace) -> list[Finding]:
    """F13: the argument is reduced by all digits of pi (Ng, 1992); the torque of a pendulum is its sine."""
    chosen = specimen(workspace, _PENDULUM, "impl")
    states = {name: np.zeros((1, 1)) for name in ("qd", "qdd", "u")} | {"q": np.array([[1e22]])}
    torque = chosen.evaluate("impl", states)[1][0]["Phi"][0, 0]
    error = abs(float(torque) - SINE) / abs(SINE)
    short = abs(float(np.sin(np.fmod(1e22, 2 * np.pi))) - SINE) / abs(SINE)
    way = "the remainder by 2 pi in double precision"
    return [
        check("IMPL", "error of sin(1e22)", error, 4 * ROUNDING),
        show_failure(way, "error of sin(1e22)", short, 4 * ROUNDING),
    ]


def _measure_torques(chosen: Specimen, angles: Array) -> Array:
    """Find the errors of the last joint's torque at rest."""
    zero = np.zeros((len(angles), angles.shape[1] + 1))
    states = {"q": np.column_stack((np.full(len(angles), 0.3), angles)), "qd": zero, "qdd": zero, "u": zero}
    found = chosen.evaluate("impl", states)[1]
    moments = [chosen.reference.at({name: x[k] for name, x in states.items()}) for k in range(len(angles))]
    return np.array(
        [
            abs(float(m.residual()[-1] - m.context.mpf(float(f["Phi"][-1, 0]))))
            for m, f in zip(moments, found, strict=True)
        ]
    )


def _describe_arm(parallel: int, com: str) -> str:
    """Describe a turret with links on parallel axes; the last is 1 kg at 1 m, and gravity is 1 m/s2."""
    lines = [
        "name: arm\ngravity: [0, -1, 0]\nbodies:",
        "  - {name: b1, joint: {name: q1, type: revolute, axis: y}, mass: 0.5, com: [0.1, 0, 0.1], "
        "inertia: [0.1, 0.2, 0.3]}",
    ]
    for k in range(2, parallel + 2):
        mass, place = ("1", com) if k > parallel else ("0.3", "[0.1, 0.2, 0]")
        joint = f"name: b{k}, parent: b{k - 1}, joint: {{name: q{k}, type: revolute, axis: z, position: [0.5, 0, 0]}}"
        lines.append(f"  - {{{joint}, mass: {mass}, com: {place}, inertia: [0.1, 0.2, 0.3]}}")
    return "\n".join(lines) + "\n"


def _draw_angles(parallel: int, size: float) -> Array:
    """Draw angles, and angles of which the first two fold the arm."""
    rng = np.random.default_rng(parallel)
    drawn = [rng.uniform(-size, size, parallel) for _ in range(25)]
    return np.array(drawn + [np.array([x[0], 1e-6 - x[0], *x[2:]]) for x in drawn])
