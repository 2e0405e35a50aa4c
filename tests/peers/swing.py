"""Swing a pendulum up in Dymos, by the component of its model, and print partials' errors and the least cost.

The cost is the integral of u^2; controls are polynomials in each of the segments.
"""

from __future__ import annotations

import sys
import warnings

warnings.simplefilter("ignore")  # of the peers

import dymos as dm  # noqa: E402
import numpy as np  # noqa: E402
import openmdao.api as om  # noqa: E402

from mbsrun.peers.dymos import make_component  # noqa: E402


def measure_partials(component: type) -> float:
    """Return the largest difference from central differences at random points."""
    problem = om.Problem()
    problem.model.add_subsystem("motion", component(num_nodes=4))
    problem.setup()
    rng = np.random.default_rng(0)
    for name in ("q_q1", "qd_q1", "u_q1"):
        problem.set_val(f"motion.{name}", rng.uniform(-1, 1, 4))
    problem.run_model()
    found = problem.check_partials(method="fd", form="central", step=1e-6, out_stream=None)["motion"]
    return max(float(np.abs(x["J_fwd"] - x["J_fd"]).max()) for x in found.values())


def solve(component: type, angle: float, horizon: float) -> float:
    """Return the cost of the cheapest motion from rest at 0 to rest at an angle."""
    problem = om.Problem()
    problem.driver = om.ScipyOptimizeDriver(optimizer="SLSQP", tol=1e-8, maxiter=100, disp=False)
    phase = dm.Phase(ode_class=component, transcription=dm.Radau(num_segments=3, order=7))
    trajectory = problem.model.add_subsystem("trajectory", dm.Trajectory())
    trajectory.add_phase("swing", phase)
    phase.set_time_options(fix_initial=True, fix_duration=True, units=None)
    phase.add_state("q_q1", rate_source="qd_q1", fix_initial=True, fix_final=True)
    phase.add_state("qd_q1", rate_source="qdd_q1", fix_initial=True, fix_final=True)
    phase.add_control("u_q1", continuity=False, rate_continuity=False)
    phase.add_calc_expr("rate = u_q1**2")
    phase.add_state("effort", rate_source="rate", fix_initial=True)
    phase.add_objective("effort", loc="final")
    problem.setup()
    phase.set_time_val(0.0, horizon)
    phase.set_state_val("q_q1", [0.0, angle])
    phase.set_state_val("qd_q1", [0.0, 0.0])
    phase.set_state_val("effort", [0.0, 1.0])
    phase.set_control_val("u_q1", [1.0, 1.0])
    problem.run_driver()
    return float(problem.get_val("trajectory.swing.timeseries.effort")[-1, 0])


if __name__ == "__main__":
    motion = make_component(sys.argv[1])
    print(measure_partials(motion), solve(motion, float(sys.argv[2]), float(sys.argv[3])))
