"""The pages of error messages: one for each class, with messages that running commands printed."""

from __future__ import annotations

import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROD = """\
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - name: rod
    joint: {name: hinge, type: revolute, axis: y}
    mass: 0.5
    com: [0, 0, -0.6]
    inertia: [0.06, 0.06, 0]
"""
SWING = """\
model: model.yaml
horizon: 1
intervals: 10
scheme: radau
degree: 3
cost: {inputs: 1}
start: {pose: {hinge: 0}}
end: {pose: {hinge: 1}, velocity: zero}
"""


OPEN = (
    ROD
    + """\
loops:
  - {name: pin, type: hinge, axis: y, from: {body: rod, position: [0, 0, -1]}, to: {body: base, position: [0, 0, -5]}}
assembly: {hinge: 0}
"""
)
ROBOT = """\
<robot name="door">
  <link name="frame"/>
  <link name="leaf"><inertial><mass value="heavy"/></inertial></link>
  <joint name="hinge" type="revolt"><parent link="frame"/><child link="leaf"/></joint>
</robot>
"""


@dataclass(frozen=True)
class Case:
    """Files, and a command that complains about them."""

    title: str
    command: str
    says: str  # a part of the message
    model: str = ROD
    problem: str = SWING
    robot: str = ROBOT
    environment: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Class:
    """A class of messages."""

    name: str
    title: str
    text: str
    cases: tuple[Case, ...]


CLASSES = (
    Class(
        "models",
        "Faults of a model file",
        "A message has the file, the line, the path within the file, the finding, and a remedy. All faults of a file "
        "are printed at once, and nothing is written. The exit code is 2.",
        (
            Case(
                "A name that nothing has", "mbsgen check model.yaml", "joint.type", ROD.replace("revolute", "revolut")
            ),
            Case(
                "An inertia that no body can have",
                "mbsgen check model.yaml",
                "no body has",
                ROD.replace("[0.06, 0.06, 0]", "[1, 2, 9]"),
            ),
            Case(
                "Two faults at once",
                "mbsgen check model.yaml",
                "no direction",
                ROD.replace("mass: 0.5", "mass: 0.5 +").replace("axis: y", "axis: [0, 0, 0]"),
            ),
        ),
    ),
    Class(
        "problems",
        "Faults of a problem file",
        "The model and the problem are checked together. The exit code is 2.",
        (
            Case(
                "A coordinate that the model lacks",
                "mbsrun solve problem.yaml",
                "end.pose.hing",
                problem=SWING.replace("hinge: 1", "hing: 1"),
            ),
            Case(
                "Parts that do not go together",
                "mbsrun solve problem.yaml",
                "shooting has none",
                problem=SWING + "form: shooting\nrepresentation: EXP1-A\n",
            ),
        ),
    ),
    Class(
        "solves",
        "Solves that find no solution",
        "A search that did not converge is never a solution: nothing is written, and the exit code is 1.",
        (
            Case(
                "Conditions that clash",
                "mbsrun solve problem.yaml",
                "not solved",
                problem=SWING + "bounds: {inputs: {hinge: [-0.01, 0.01]}}\n",
            ),
            Case(
                "Too few iterations",
                "mbsrun solve problem.yaml",
                "not solved",
                problem=SWING + "solver: {max_iterations: 1}\n",
            ),
        ),
    ),
    Class(
        "robots",
        "Faults of files in URDF, MJCF, SDF and OpenSim",
        "A message has the line and the element. Omissions are warnings. The exit code is 2.",
        (Case("An unknown type of joint", "mbsgen check robot.urdf", "revolt"),),
    ),
    Class(
        "loops",
        "Loops that cannot close",
        "Loops are closed before anything is written. The message has the distance that is left. The exit code is 2.",
        (Case("A pin out of reach", "mbsgen generate model.yaml -o out", "does not close", model=OPEN),),
    ),
    Class(
        "simulations",
        "Simulations that stop",
        "The part that was reached is written, and marked as incomplete; the exit code is 1. An input without a value "
        "is a fault of the settings, with the exit code 2.",
        (
            Case(
                "An input without a value",
                "mbsrun simulate model.yaml --duration 1 --input hinge=sqrt(0.5-t) -o out",
                "no finite value",
            ),
            Case("Too many steps", "mbsrun simulate model.yaml --duration 1 --max-steps 3 -o out", "3 steps"),
        ),
    ),
    Class(
        "compilers",
        "C compilers that are missing or unfit",
        "mbsgen writes C without a compiler; simulation and optimal control compile it. Where the PATH has none, "
        "`pip install '.[compiler]'` brings one. Flags that change arithmetic are refused. The exit code is 2.",
        (
            Case(
                "A compiler that cannot be run",
                "mbsrun simulate model.yaml --duration 1 --input hinge=0 -o out",
                "cannot run my-cc",
                environment=(("CC", "my-cc"),),
            ),
            Case(
                "Arithmetic that is not IEEE's",
                "mbsrun simulate model.yaml --duration 1 --input hinge=0 -o out",
                "is not accepted",
                environment=(("CFLAGS", "-ffast-math"),),
            ),
        ),
    ),
    Class(
        "arguments",
        "Arguments of commands",
        "Options are checked by the rules of files. The exit code is 2.",
        (
            Case("A number that is none", "mbsrun simulate model.yaml --duration two", "duration"),
            Case(
                "A coordinate that the model lacks", "mbsrun simulate model.yaml --duration 1 --pose elbow=1", "elbow"
            ),
        ),
    ),
)
PAGES = [{each.title: f"messages/{each.name}.md"} for each in CLASSES]


def write(target: Path, programs: Path, most: int | None = None) -> None:
    """Run the commands, of each class `most` or all, and write a page for each class.

    `programs` is a folder of the project's commands.
    """
    (target / "messages").mkdir(parents=True, exist_ok=True)
    for each in CLASSES:
        lines = [f"# {each.title}", "", each.text, ""]
        for case in each.cases[:most]:
            lines += [f"## {case.title}", "", "``` { .text .wrap }", f"$ {_show(case)}", run(case, programs), "```", ""]
        (target / "messages" / f"{each.name}.md").write_text("\n".join(lines), encoding="utf-8")


def _show(case: Case) -> str:
    return " ".join([*(f"{name}={value}" for name, value in case.environment), case.command])


def run(case: Case, programs: Path) -> str:
    """Return the message of a case. Raises RuntimeError for another message."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "model.yaml").write_text(case.model, encoding="utf-8")
        (Path(folder) / "problem.yaml").write_text(case.problem, encoding="utf-8")
        (Path(folder) / "robot.urdf").write_text(case.robot, encoding="utf-8")
        program, *arguments = case.command.split()
        line = [str(programs / program), *arguments]
        environment = {**os.environ, **dict(case.environment)}
        done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False, env=environment)
    if done.returncode == 0 or case.says not in done.stderr:
        raise RuntimeError(f"{case.title}: {case.command} does not say {case.says!r}, but {done.stderr!r}")
    return done.stderr.strip()
