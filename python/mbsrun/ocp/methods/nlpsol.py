"""Solvers that CasADi calls by `nlpsol`: made of a program's functions, called with the numbers of a solve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from mbsrun.ocp.evaluation.backends.casadi import Differentiated
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.methods.method import Answer, Instance, Iterate, Solver

# Sensitivities to parameters, which nobody asks for, and for which CasADi would differentiate the whole.
UNDIFFERENTIATED: Mapping[str, bool] = {"calc_lam_p": False, "no_nlp_grad": True}


def make(name: str, functions: Differentiated, settings: Mapping[str, Any], *, scale: float = 1.0) -> Solver:
    """Make a solver of CasADi's; it sees, and reports, the cost times `scale`."""
    x, p = ca.MX.sym("x", functions.variables), ca.MX.sym("p", functions.parameters)
    nlp: dict[str, Any] = {"x": x, "p": p, "f": scale * functions.objective(x, p), "g": functions.constraint(x, p)}
    callback = _Callback(functions, scale)
    quiet = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False}
    function = ca.nlpsol("ocp", name, nlp, {"iteration_callback": callback, **quiet, **settings})

    def solve(start: Instance) -> Answer:
        callback.begin(start)
        answer = function(
            x0=start.x, p=start.parameters, lbx=start.lower, ubx=start.upper, lbg=start.g_lower, ubg=start.g_upper
        )
        callback.end()
        return _read(function.stats(), answer, scale, callback.seen)

    return solve


def read_status(statistics: Mapping[str, Any]) -> str:
    """Return a solver's word for how it ended; where it has a number only, a word made of that."""
    status = statistics["return_status"]
    if isinstance(status, str):
        return status
    return SOLVED if statistics["success"] else f"Ended_With_Status_{status}"


def count_iterations(statistics: Mapping[str, Any], seen: int) -> int:
    """Count iterations; where a solver refuses a program at once, its own count is not set, and no iterate was seen."""
    count = int(statistics["iter_count"])
    return count if 0 <= count <= seen else max(0, seen - 1)


def _read(statistics: Mapping[str, Any], answer: Mapping[str, ca.DM], scale: float, seen: int) -> Answer:
    evaluating, cpu_evaluating = (
        sum(value for key, value in statistics.items() if key.startswith(f"t_{clock}_nlp_"))
        for clock in ("wall", "proc")
    )
    x, multipliers = answer["x"].full().ravel(), answer["lam_g"].full().ravel() / scale
    iterations = count_iterations(statistics, seen)
    return Answer(x, read_status(statistics), iterations, evaluating, cpu_evaluating, multipliers)


class _Callback(ca.Callback):
    """Shows a watch every iterate."""

    def __init__(self, functions: Differentiated, scale: float) -> None:
        """Make it for a program, of which the solver sees the cost times `scale`."""
        super().__init__()
        variables, constraints = functions.variables, functions.constraints
        sizes = {"x": variables, "f": 1, "g": constraints, "lam_x": variables, "lam_g": constraints}
        self._patterns = [ca.Sparsity.dense(sizes.get(name, functions.parameters)) for name in ca.nlpsol_out()]
        self._scale = scale
        self._start: Instance | None = None
        self.seen = 0  # iterates, with the start
        self._error: Exception | None = None
        self.construct("watch")

    def begin(self, start: Instance) -> None:
        """Count from 0 again."""
        self._start, self.seen, self._error = start, 0, None

    def end(self) -> None:
        """Raise what the watch raised, which CasADi would turn into a warning."""
        if self._error is not None:
            raise self._error

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._patterns[i]

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        if self._start is not None and self._start.watch is not None:
            violation = self._start.measure(arguments[2].full().ravel())
            try:
                self._start.watch(Iterate(self.seen, float(arguments[1]) / self._scale, violation))
            except Exception as error:
                self._error = error
                return [ca.DM(1)]  # asks the solver to stop
        self.seen += 1
        return [ca.DM(0)]
