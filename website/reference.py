"""The reference of the Python interface, from docstrings."""

from __future__ import annotations

from pathlib import Path

MODULES = {  # the title of a page, and its modules
    "Kernels": ("mbsrun", "mbsrun.kernel", "mbsrun.external", "mbsrun.closure"),
    "Optimal control": (
        "mbsrun.ocp.problem.problem",
        "mbsrun.ocp.statement.statement",
        "mbsrun.ocp.guessing.guess",
        "mbsrun.ocp.solving.solve",
        "mbsrun.ocp.solution.solution",
        "mbsrun.ocp.solving.resimulation",
        "mbsrun.ocp.ground.trajectory",
    ),
    "Simulation": ("mbsrun.simulation.statement", "mbsrun.simulation.motion"),
    "Equations": ("mbsgen.equations.motion",),
    "Models": ("mbsgen.model.construction", "mbsgen.model.reader", "mbsgen.model.writer", "mbsgen.manifest"),
}
FIRST = (  # names of mbsrun: functions in the order in which users need them, then what they return
    *("load", "simulate", "simulate_many", "rollout", "read_problem", "problem", "controller", "identify", "excite"),
    *("Mechanism", "Simulated", "Motions", "OptimalControl", "Controller", "ProblemError"),
)
PAGES = [{title: f"api/{title.lower().replace(' ', '_')}.md"} for title in MODULES]


def write(target: Path) -> None:
    """Write a page for each group of modules."""
    (target / "api").mkdir(parents=True, exist_ok=True)
    for page, (title, modules) in zip(PAGES, MODULES.items(), strict=True):
        lines = [f"# {title}", ""]
        for module in modules:
            lines += [f"## {module}", "", f"::: {module}", "    options:", "      show_root_heading: false"]
            if module == "mbsrun":
                lines += ["      group_by_category: false", f"      members: [{', '.join(FIRST)}]"]
            lines.append("")
        (target / page[title]).write_text("\n".join(lines), encoding="utf-8")
