"""The examples of the gallery: commands, and the files that they write and the gallery shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Example:
    """Commands that are run in a folder with the models."""

    name: str
    title: str
    text: str
    commands: str
    picture: str  # a file that they write, or a model's
    files: tuple[str, ...]  # for download; the first page of HTML, and the files of models, are shown
    notebook: tuple[str, ...] = ()  # cells of Python, run beside the first file of a model


def _write_cells(problem: str, *shown: str) -> tuple[str, ...]:
    """Return the cells of a notebook that solves a problem, and shows its solution by these methods."""
    return (
        f'import mbsrun\n\nproblem = mbsrun.read_problem("{problem.rpartition("/")[2]}.ocp.yaml")\nproblem',
        "solution = problem.solve(watch=True)\nsolution",
        *(f"solution.{name}()" for name in shown),
    )


def _draw(name: str, model: str, at: float) -> str:
    """Return the command that draws a model at a time [s] of its motion."""
    return f"mbsrun animate models/{model}.yaml build/{name} --at {at} --size 640x400 -o build/{name}.png\n"


def _simulate(name: str, title: str, text: str, model: str, options: str, at: float = 0.5) -> Example:
    """Return the simulation of a model, with a picture of it at a time [s]."""
    return Example(
        name,
        title,
        text,
        f"mbsrun simulate models/{model}.yaml {options} -o build/{name}\n{_draw(name, model, at)}",
        f"build/{name}.png",
        (
            f"build/{name}/animation.html",
            f"models/{model}.yaml",
            f"build/{name}/plots.png",
            f"build/{name}/trajectory.csv",
        ),
    )


def _solve(name: str, title: str, text: str, problem: str, model: str, at: float = 0.5) -> Example:
    """Return the optimal motion of a model, with a picture of it at a time [s]."""
    return Example(
        name,
        title,
        text,
        f"mbsrun solve models/{problem}.ocp.yaml -o build/{name}\n{_draw(name, model, at)}",
        f"build/{name}.png",
        (
            f"build/{name}/animation.html",
            f"models/{problem}.ocp.yaml",
            f"models/{model}.yaml",
            f"build/{name}/trajectories.png",
            f"build/{name}/solution.csv",
        ),
        _write_cells(problem, "plot", "draw", "animate"),
    )


def _play(model: str, title: str, text: str, options: str = "", before: str = "") -> Example:
    """Return a page that computes by the model's own C."""
    page, picture = f"build/{model}.html", f"build/{model}.png"
    commands = (
        f"mbsrun playground models/{model}.yaml{options} -o {page}\n"
        f"mbsrun simulate models/{model}.yaml --duration 0.1 -o build/{model}\n{_draw(model, model, 0)}"
    )
    return Example(f"play_{model}", title, text, before + commands, picture, (page, f"models/{model}.yaml"))


def _phases(name: str, title: str, text: str, problem: str, models: Sequence[str], at: float) -> Example:
    """Return an optimal motion in phases, with a picture of it at a time [s]."""
    return Example(
        name,
        title,
        text,
        f"mbsrun solve models/legged/{problem}.ocp.yaml -o build/{name}\n{_draw(name, f'legged/{models[0]}', at)}",
        f"build/{name}.png",
        (
            f"build/{name}/animation.html",
            f"models/legged/{problem}.ocp.yaml",
            *(f"models/legged/{model}.yaml" for model in models),
            f"build/{name}/trajectories.png",
        ),
    )


_MECHANISMS = (
    _simulate(
        "pendulum",
        "A pendulum",
        "It falls from the horizontal, with friction in its hinge.",
        "pendulum",
        "--duration 5 --pose q1=1.5",
    ),
    _simulate(
        "double_pendulum",
        "A double pendulum",
        "Chaos in two coordinates. The drift of the energy is the error of the integration.",
        "double_pendulum",
        "--duration 8 --pose q1=2 --pose q2=1",
    ),
    _simulate(
        "branched",
        "A gantry, a tree with branches",
        "Two trolleys on one bridge. Their lifts are held by feedback, and the loads sway.",
        "branched",
        "--duration 6 --pose 'left lift=1' --pose 'right lift=1.6' --pose 'left trolley=1.5' "
        "--pose 'right trolley=-1.5' --pose 'left load=0.5' --pose 'right load=-0.4' --input 'bridge=400*cos(t)' "
        "--input 'left lift=-520 - 500*(q_left_lift - 1) - 300*qd_left_lift' "
        "--input 'right lift=-520 - 500*(q_right_lift - 1.6) - 300*qd_right_lift'",
    ),
    _simulate(
        "quadruped",
        "A quadruped in free fall",
        "Eighteen coordinates; it turns, and its legs swing.",
        "quadruped",
        "--duration 0.4 --velocity trunk.ry=2 --velocity 'front left thigh=4' --velocity 'rear right thigh=-4'",
        at=0.2,
    ),
    _simulate(
        "satellite",
        "A satellite with a quaternion",
        "It turns freely about an axis that is not stable.",
        "satellite",
        "--duration 20 --velocity hull.rx=0.01 --velocity hull.ry=1",
    ),
    _simulate("four_bar", "A four-bar linkage", "A closed loop, cut at one hinge.", "four_bar", "--duration 4"),
    _simulate("slider_crank", "A slider-crank", "The loop has one degree of freedom.", "slider_crank", "--duration 2"),
    _simulate(
        "five_bar",
        "A five-bar linkage",
        "Two motors on the base move one point in the plane.",
        "five_bar",
        "--duration 2",
    ),
    _simulate("delta", "A Delta robot", "Three arms with closed loops, released at rest.", "delta", "--duration 1"),
    _simulate(
        "stewart",
        "A Stewart platform",
        "Six legs carry a platform, which sinks without their forces.",
        "stewart",
        "--duration 0.16",
        at=0.1,
    ),
    _simulate(
        "wishbone", "A wheel on two wishbones", "A suspension with spring and damper.", "wishbone", "--duration 3"
    ),
    _simulate(
        "excavator", "An excavator's bucket", "Cylinders and a linkage move the bucket.", "excavator", "--duration 2"
    ),
    _simulate(
        "compressor",
        "A compressor",
        "The motion of the crank is given; the table holds its torque.",
        "compressor",
        "--driven 'crank=40 deg + 150*t' --duration 0.1",
        at=0.05,
    ),
)
_OPTIMA = (
    _solve(
        "swing_up",
        "A cart-pole swings up",
        "The problem of Kelly's tutorial: from hanging to standing in two seconds, with the least force.",
        "cart_pole_swing_up",
        "cart_pole",
    ),
    _solve(
        "balance", "A cart-pole keeps its balance", "Back to the middle of the track.", "cart_pole_balance", "cart_pole"
    ),
    _solve(
        "muscles",
        "Two muscles lift an arm",
        "Muscles of Hill's type, driven by excitations, at the least effort.",
        "muscles/lift",
        "muscles/arm",
    ),
    _solve("acrobot", "An acrobot swings up", "One motor, at the elbow.", "acrobot_swing_up", "acrobot"),
    _solve(
        "planar_reach",
        "A planar arm reaches a point",
        "With bounds of joints and torques.",
        "planar_arm_reach",
        "planar_arm",
    ),
    _solve(
        "planar_fastest",
        "A planar arm in the shortest time",
        "The horizon is free; torques jump between their bounds.",
        "planar_arm_fastest",
        "planar_arm",
        at=0.3,
    ),
    _solve(
        "six_axis",
        "A six-axis robot reaches past an obstacle",
        "Joint limits, torques and a target in space.",
        "six_axis_reach",
        "six_axis",
    ),
    _solve(
        "arm_pendulum",
        "The arm of the paper",
        "An arm with four motors brings a pendulum to a given place, and to rest.",
        "arm_reach",
        "arm_pendulum",
    ),
    _solve(
        "leg_step", "A leg makes a step", "Over an obstacle, with a rotor behind a gear.", "leg_step", "leg", at=0.12
    ),
    _solve(
        "satellite_turn",
        "A satellite turns",
        "From one attitude to another, with a quaternion.",
        "satellite_turn",
        "satellite",
    ),
    _solve(
        "five_bar_reach",
        "A five-bar linkage moves",
        "Optimal control of a closed loop.",
        "five_bar_reach",
        "five_bar",
        at=0.15,
    ),
    _solve("delta_pick", "A Delta robot picks", "Three closed loops in space.", "delta_pick", "delta", at=0.15),
    _solve(
        "design",
        "A spring, and where the elbow is",
        "Design and motion are chosen together: the spring's stiffness and rest, and the length of the upper arm.",
        "design/lifting_arm",
        "design/lifting_arm",
    ),
)
_TOOLS = (
    Example(
        "equations",
        "The equations of a double pendulum",
        "As a textbook prints them.",
        "mbsgen equations models/double_pendulum.yaml\nmbsgen show models/double_pendulum.yaml -o build/tree.png\n"
        "mbsrun simulate models/double_pendulum.yaml --duration 0.1 --pose q1=0.5 --pose q2=0.5 -o build/equations\n"
        + _draw("equations", "double_pendulum", 0),
        "build/equations.png",
        ("models/double_pendulum.yaml", "build/tree.png"),
        (
            'import mbsrun\n\npendulum = mbsrun.load("double_pendulum.yaml")',
            "equations = pendulum.symbolic()\nequations.M",
            "equations.jacobian(equations.g, equations.naming.q)",
            'state = {"q": [0.3, -0.2], "qd": [1, 0], "qdd": [0, 2]}\nequations.evaluate(equations.residual, **state)',
            'pendulum.impl(**state, u=[])["Phi"]',
        ),
    ),
    Example(
        "linearise",
        "Poles of a cart-pole, and a controller for it",
        "Linear equations about the upright pose, their modes, and the gains of a linear-quadratic regulator.",
        "mbsrun linearise models/cart_pole.yaml --pose pole=pi --regulate 0.1 -o build/linear\n",
        "build/linear/poles.png",
        ("models/cart_pole.yaml",),
    ),
    Example(
        "accuracy",
        "Speed against accuracy",
        "What a digit costs: kernels of one model by formulation and precision.",
        "mbsrun chart kernels models/cart_pole.yaml --quick --size 2 --size 5 -o build/chart\n",
        "build/chart/kernels.png",
        ("models/cart_pole.yaml",),
    ),
)
_PLAYGROUNDS = (
    _play("six_axis", "A six-axis robot to play with", "Sliders move the joints; tables show torques and their cost."),
    _play("quadruped", "A quadruped to play with", "Eighteen coordinates, in four formulations."),
    _play(
        "cart_pole",
        "A cart-pole, and its controller, to play with",
        "A predictive controller in C swings the pole up, in the page itself; a regulator holds it.",
        " --controller build/swing_up --pose pole=pi --regulate 0.1",
        "mbsrun controller models/cart_pole_swing_up.ocp.yaml -o build/swing_up\n",
    ),
)
_WHOLE = (
    _phases(
        "walker",
        "A five-link walker",
        "One step, with an impact after which the legs change names, repeated forever.",
        "walker",
        ("walker", "walker_free"),
        at=0.2,
    ),
    _phases(
        "bound",
        "A quadruped bounds",
        "Four phases of free duration, with friction under the feet.",
        "bound",
        ("bounder",),
        at=0.2,
    ),
    _phases(
        "pick_and_place",
        "An arm picks a mass up, and places it",
        "The payload is a parameter of each phase.",
        "pick_and_place",
        ("carrier",),
        at=0.4,
    ),
    Example(
        "brachistochrone",
        "The brachistochrone",
        "A problem without a mechanism: states and a control alone. The time is the published one to all digits.",
        "mbsrun solve models/classics/brachistochrone.ocp.yaml -o build/brachistochrone\n",
        "build/brachistochrone/trajectories.png",
        ("models/classics/brachistochrone.ocp.yaml", "build/brachistochrone/solution.csv"),
        _write_cells("brachistochrone", "plot"),
    ),
    Example(
        "identification",
        "A pendulum's inertia from a recorded swing",
        "Inertia and friction are unknowns, chosen such that the motion follows noisy measurements.",
        "mbsrun solve models/recorded/pendulum_inertia.ocp.yaml -o build/identification\n",
        "build/identification/trajectories.png",
        ("models/recorded/pendulum_inertia.ocp.yaml", "build/identification/solution.csv"),
    ),
    Example(
        "markers",
        "Coordinates from recorded markers",
        "Inverse kinematics along a file of marker positions, and the forces of the motion found.",
        "mbsrun fit-motion models/recorded/arm.yaml models/recorded/swing.trc --smooth 1e-9 -o build/markers\n"
        "mbsrun inverse-dynamics models/recorded/arm.yaml build/markers/motion.csv --noise 5e-3 -o build/forces\n",
        "build/markers/motion.png",
        ("models/recorded/arm.yaml", "models/recorded/swing.trc", "build/markers/motion.csv"),
    ),
    Example(
        "torques",
        "Inertias and frictions from recorded torques",
        "A recording of two links with motors determines sums of their inertias, and the frictions, with intervals.",
        "mbsrun identify models/recorded/two_link.yaml models/recorded/two_link.csv --unknown inertia,damping,friction "
        "--cutoff 5 -o build/torques\n",
        "build/torques/residuals.png",
        ("build/torques/identification.html", "models/recorded/two_link.yaml", "build/torques/identified.yaml"),
    ),
    Example(
        "exciting",
        "A motion that determines inertias",
        "Fourier series within the limits of the joints, from which inertias and frictions are determined best.",
        "mbsrun excite models/recorded/two_link.yaml --unknown inertia,damping,friction -o build/exciting\n"
        "mbsrun animate models/recorded/two_link.yaml build/exciting/motion.csv -o build/exciting/animation.html\n",
        "build/exciting/motion.png",
        ("build/exciting/animation.html", "models/recorded/two_link.yaml", "build/exciting/motion.csv"),
    ),
)
EXAMPLES: Sequence[Example] = (*_MECHANISMS, *_OPTIMA, *_WHOLE, *_TOOLS, *_PLAYGROUNDS)
