"""Files of every kind that is read, mutated: bytes, words, numbers, and the structure of YAML and JSON.

A file is accepted, or refused by an error whose text is complete (MbsError). Faults are: another exception, more than
LIMIT seconds, a new process or connection, a file written outside of the named folder, and an output of a refused file.
"""

from __future__ import annotations

import copy
import json
import random
import re
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import yaml

from mbsgen import manifest
from mbsgen.errors import MbsError
from mbsgen.formulations.reductions import Reductions
from mbsgen.importing import import_model
from mbsgen.pipeline import Options, generate, make, read_tree
from mbsrun.external import Mechanism
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.solution.solution import CostTerms, Run, Size, Solution, Violation, read_solution, write_solution
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.recordings import Treatment, fit, read_column, read_recording
from mbsrun.simulation.statement import read_statement
from mbsrun.tracking.statement import TrialStatement
from tests.shipped import CLOSED

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "models"
LIMIT = 20  # seconds of the processor, which other programs do not lengthen
SMALL = 4  # bodies of a model that is generated too
WITH_LOOPS = Extent(
    ("impl", "sensors", "loops", "loop_rates", "loop_jacobian"), derivatives=1
)  # for problems, whose starts are closed
WITH_CONTACTS = Extent(("impl", "sensors", "motion", "semi"), derivatives=1)  # whose points and forces are compared
ONE_TRIAL = Reductions(trials=1)
OUT = "out"  # what is written beside an input

NASTY_NUMBERS = (
    "0", "-0", "1", "-1", "1e308", "1e309", "-1e308", "1e-308", "1e-320", "1e-60", "9" * 40, "9" * 400, "0x10", "1_000",
    ".inf", "-.inf", ".nan", "NaN", "Infinity", "1e", "0.1.2", "2**16**16", "1/0", "0/0", "sqrt(-1)", "exp(1e9)",
    "90 deg", "1e308*1e308", "123456789012345678901234567890", "4.9e-324", "1e150", "1e151", "10**16",
)  # fmt: skip
NASTY_WORDS = (
    "", " ", "\t", "\n", "~", "null", "true", "no", "on", "base", "pi", "sin", "q", "qd", "ä", "\u202e", "\u0000",
    "a" * 300, "../../etc/passwd", "/etc/passwd", "__import__('os').system('touch owned')",
    "!!python/object/apply:os.system [touch owned]",
    "*a", "&a x", "<<", "{", "[", "]", "- - -", "%YAML 1.1", "---", "...", "|", ">", "? a", "lambda: 0", "x.__class__",
    "$(touch owned)", "`touch owned`", "<!ENTITY a 'b'>", "&amp;", "]]>", "\ud7ff", "😀",
)  # fmt: skip
FUNCTIONS = ("impl", "semi_res", "condition", "frames", "Phi", "qdd", "jac_impl", "adj1_step", "setup", "lin_impl")
KEYS = (
    "name",
    "parent",
    "joint",
    "type",
    "axis",
    "mass",
    "parameters",
    "locked",
    "kind",
    "value",
    "functions",
    "results",
    "loops",
    "constraints",
    "equation",
    "driven",
    "independent",
    "assembly",
    "from",
    "length",
    "states",
    "controls",
    "inputs",
    "soft",
    "largest",
    "delay",
    "phases",
    "links",
    "impact",
    "map",
    "contacts",
    "wrenches",
    "unknowns",
    "references",
    "rate",
)


Sources = tuple[tuple[str, bytes], ...]  # names and contents of files


@dataclass(frozen=True)
class Kind:
    """A kind of file: what ships of it, and what a program does with one. The other files of a folder stay."""

    sources: Callable[[], Sources]
    use: Callable[[Path], None]
    beside: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """A file that was not taken well."""

    seed: int
    text: str


@dataclass(frozen=True)
class Tally:
    """The outcomes of the files."""

    accepted: int
    refused: int
    findings: tuple[Finding, ...]


class HangError(BaseException):
    """Raised after LIMIT seconds; nothing catches it on its way."""


# --- mutations -------------------------------------------------------------------------------------------------------


def mutate(content: bytes, rng: random.Random) -> bytes:
    """Change a file in one to four ways."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice((_change_bytes, _change_words, _change_words, _change_structure, _change_structure))(
            content, rng
        )
    return content


def _change_bytes(content: bytes, rng: random.Random) -> bytes:
    place = rng.randrange(len(content) + 1)
    end = min(len(content), place + rng.choice((1, 1, 1, 4, 40)))
    match rng.randrange(5):
        case 0:
            return content[:place] + content[end:]
        case 1:
            return content[:place] + rng.randbytes(rng.choice((1, 1, 3))) + content[place:]
        case 2:
            return content[:place] + rng.randbytes(1) + content[place + 1 :]
        case 3:
            return content[:end] + content[place:end] + content[end:]
    return content[:place]


def _change_words(content: bytes, rng: random.Random) -> bytes:
    """Replace a word, swap two, or repeat or leave out a line."""
    text = content.decode("utf-8", "surrogateescape")
    if rng.random() < 0.3:
        lines = text.split("\n")
        place = rng.randrange(len(lines))
        lines[place : place + 1] = rng.choice(([], [lines[place]] * 2, [rng.choice(lines)], [" " + lines[place]]))
        return "\n".join(lines).encode("utf-8", "surrogateescape")
    words = _split_words(text)
    inner = [k for k, word in enumerate(words) if word.strip()]
    if not inner:
        return content
    place = rng.choice(inner)
    is_number = words[place][0] in "0123456789.-"
    pool: tuple[str, ...]
    pool = (*NASTY_NUMBERS, *NASTY_NUMBERS, *NASTY_WORDS) if is_number else (*NASTY_WORDS, *NASTY_NUMBERS, *FUNCTIONS)
    if is_number and rng.random() < 0.4:
        pool = tuple(str(round(rng.uniform(-2, 5), rng.randrange(4))) for _ in range(2))
    words[place] = rng.choice(pool) if rng.random() < 0.7 else words[rng.choice(inner)]
    return "".join(words).encode("utf-8", "surrogatepass" if rng.random() < 0.1 else "replace")


def _split_words(text: str) -> list[str]:
    """Split text into words and what stands between them."""
    words: list[str] = []
    for character in text:
        is_word = character.isalnum() or character in "._-+"
        if words and (words[-1][-1].isalnum() or words[-1][-1] in "._-+") == is_word:
            words[-1] += character
        else:
            words.append(character)
    return words


def _change_structure(content: bytes, rng: random.Random) -> bytes:
    """Change one node of YAML or JSON; change other files, and broken ones, in their words."""
    try:
        data = json.loads(content) if content.lstrip()[:1] == b"{" else yaml.safe_load(content)
    except (ValueError, yaml.YAMLError, RecursionError):
        return _change_words(content, rng)
    if not isinstance(data, dict):
        return _change_words(content, rng)
    nodes = [*_list_nodes(data)]
    if not nodes:
        return _change_words(content, rng)
    holder, key = rng.choice(nodes)
    match rng.randrange(6):
        case 0:
            del holder[key]
        case 1:
            other, its = rng.choice(nodes)
            holder[key] = copy.deepcopy(other[its]) if its in other or isinstance(other, list) else None
        case 2:
            holder[key] = rng.choice(NASTY_WORDS)
        case 3:
            holder[key] = _read(rng.choice(NASTY_NUMBERS))
        case 4:
            inner = copy.deepcopy(holder[key])
            holder[key] = rng.choice(([], {}, [[]], None, True, [inner], {"a": inner}, [0] * 400))
        case _ if isinstance(holder, dict):
            holder[rng.choice((*KEYS, *FUNCTIONS, *NASTY_WORDS))] = copy.deepcopy(holder[key])
        case _:
            holder.append(copy.deepcopy(holder[key]))
    try:
        if content.lstrip()[:1] == b"{":
            return json.dumps(data).encode("utf-8", "replace")
        return yaml.safe_dump(data, sort_keys=False, allow_unicode=True).encode("utf-8", "replace")
    except (ValueError, yaml.YAMLError, RecursionError):
        return content


def _read(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _list_nodes(data: Any) -> Iterator[tuple[Any, Any]]:
    for key in [*data] if isinstance(data, dict) else range(len(data)):
        yield data, key
        if isinstance(data[key], dict | list):
            yield from _list_nodes(data[key])


# --- a trial ---------------------------------------------------------------------------------------------------------

_FORBIDDEN = ("os.system", "os.exec", "os.fork", "os.posix_spawn", "subprocess.Popen", "socket.connect", "pty.spawn")
_watched: list[tuple[Path, list[str]]] = []  # the folder where files may be written, and what else happened


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    """Note what no input may bring about. Hooks cannot be removed: outside of a trial, this one is idle."""
    if not _watched:
        return
    folder, seen = _watched[-1]
    if event in _FORBIDDEN:
        seen.append(event)
    named = not isinstance(arguments[0], int)  # a number is a descriptor that is open already
    if event == "open" and named and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
        path = Path(str(arguments[0]))
        if folder not in path.absolute().parents and "__pycache__" not in path.parts:
            seen.append(f"wrote {path}")


@cache
def _install() -> None:
    sys.addaudithook(_watch)


@contextmanager
def watched(folder: Path) -> Iterator[list[str]]:
    """Collect what happens that should not; raise HangError where it takes too long."""

    def stop(_: int, frame: FrameType | None) -> None:
        raise HangError(f"more than {LIMIT} s, in {traceback.format_stack(frame)[-1].strip() if frame else '?'}")

    _install()
    seen: list[str] = []
    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    _watched.append((folder, seen))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield seen
    finally:
        _watched.pop()
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def attempt(kind: Kind, name: str, content: bytes, folder: Path) -> tuple[bool, str]:
    """Use a file; return whether it was accepted, and what was not well, if anything."""
    for other, its in kind.beside.items():
        (folder / other).write_bytes(its)
    file = folder / name
    file.write_bytes(content)
    before = {path.name for path in folder.iterdir()}
    with watched(folder) as seen:
        try:
            kind.use(file)
            accepted, trouble = True, ""
        except MbsError as error:
            accepted, trouble = False, "" if str(error).strip() else "an error without words"
        except (Exception, HangError) as error:  # whatever it is, it is looked for
            last = traceback.extract_tb(error.__traceback__)[-1]
            accepted, trouble = (
                False,
                f"{type(error).__name__}: {str(error)[:150]} ({Path(last.filename).name}:{last.lineno})",
            )
    written = {path.name for path in folder.iterdir()} - before
    if not accepted and written:
        seen.append(f"left {', '.join(sorted(written))}")
    return accepted, trouble or "; ".join(seen)


def search(kind: Kind, count: int, seed: int, keep: Path | None = None) -> Tally:
    """Try a number of mutations of a kind's files."""
    accepted, findings = 0, list[Finding]()
    sources = kind.sources()
    for number in range(seed, seed + count):
        rng = random.Random(number)
        name, source = rng.choice(sources)
        content = mutate(source, rng)
        with tempfile.TemporaryDirectory() as path:
            is_accepted, trouble = attempt(kind, name, content, Path(path))
        accepted += is_accepted and not trouble
        if trouble:
            findings.append(Finding(number, trouble))
            if keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{number}-{name}").write_bytes(content)
    return Tally(accepted, count - accepted - len(findings), tuple(findings))


# --- kinds -----------------------------------------------------------------------------------------------------------

SCENES = (
    "functions: [impl, sensors]\nderivatives: 1\nlocked: {second: 0.3}\nsensors: [tip]\ngravity: false\n",
    "functions: [exp2, energy]\nderivatives: 2\nresults: {energy: [kinetic]}\nmotion: true\n",
    "functions: []\nderivatives: 2\ntogether: {step: [impl, sensors]}\nparameters: {l: differentiated, m: runtime}\n",
    "functions: [impl, semi]\nderivatives: 0\nlocked: {first: pi/4}\nmotion: false\ntolerance: 0.001\n",
)
MODEL = """\
name: pair
gravity: [0, 0, -9.81]
parameters: {l: {value: 0.5, kind: runtime}, m: 1.5}
bodies:
  - {name: first, joint: {type: revolute, axis: y, limits: [-2, 2]}, mass: m, com: [0, 0, -l], inertia: [0.1, 0.1, 0]}
  - {name: second, parent: first, joint: {type: prismatic, axis: x, stiffness: 3}, mass: 2}
frames: [{name: tip, body: second, position: [l, 0, 0]}]
wrenches: [{name: push, body: second, force: input}]
"""
LINKAGES = (
    """\
name: linkage
gravity: [0, 0, -9.81]
parameters: {l: {value: 0.5, kind: runtime}, a: 0.3}
bodies:
  - {name: crank, joint: {name: q1, type: revolute, axis: y}, mass: 1, com: [0.1, 0, 0]}
  - name: bar
    parent: crank
    joint: {name: q2, type: revolute, axis: y, position: [a, 0, 0], actuated: false}
    mass: 1
    com: [0.1, 0, 0]
  - name: rocker
    joint: {name: q3, type: revolute, axis: y, position: [l, 0, 0], actuated: false}
    mass: 1
    com: [0.1, 0, 0]
  - {name: slide, joint: {name: q4, type: prismatic, axis: x, actuated: false}, mass: 2}
loops:
  - name: knee
    type: hinge
    from: {body: bar, position: [l, 0, 0]}
    to: {body: rocker, position: [0.4, 0, 0]}
    axis: y
constraints: [{name: cam, equation: q4 - a*sin(q1)}]
independent: [q1]
assembly: {q1: -1, q3: -1.5}
""",
    """\
name: swing
gravity: [0, 0, -9.81]
bodies:
  - {name: plate, joint: {type: free}, mass: 1, inertia: [1, 1, 1]}
  - {name: motor, joint: {name: m, type: revolute, axis: x, actuated: false}, mass: 1, com: [0, 0, 0.1]}
  - {name: gear, joint: {name: g, type: revolute, axis: x, actuated: false}, mass: 1, com: [0, 0, 0.1]}
loops:
  - {name: rope, type: rod, from: {body: base}, to: {body: plate, position: [0.1, 0, 0]}, length: 1.05}
  - {name: hook, type: universal, from: {body: motor, position: [0, 0, 1]}, to: {body: plate}, axis2: [0, 3, 4]}
constraints: [{name: mesh, equation: g + 2*m - 0.1}]
driven: [m]
assembly: {plate.z: 1, plate.rx: pi/4}
""",
)
SETTINGS = (
    "duration: 1\nstart: {pose: {first: 0.2}, velocity: {first: 1}}\ninputs: {first: sin(2*pi*t), second: 0}\n",
    "duration: 2\nmethod: rk4\nstep: 0.01\nwrenches: {push: {force: [0, 0, 1]}}\nparameters: {l: 0.4}\n",
    "duration: 1\nconstants: {k: 2}\nmethod: gauss\nstages: 2\nstep: 0.01\noutput_step: 0.1\ninputs: {first: k*t}\n",
    "duration: 1\nmethod: dop853\nrtol: 1e-8\natol: 1e-8\nmax_steps: 1000\nformulation: exp2\n",
)
PROBLEMS = (
    """\
constants: {g: 9.81, k: 0.5}
references: {walk: {file: walk.csv, columns: {knee: "q[knee]"}, start: 0.1, degree: 3, gap: 0.3, noise: 0.01}}
unknowns: {p: {guess: 1, range: [0, 2]}}
horizon: 0.3
intervals: 6
scheme: radau
degree: 3
states:
  x: {rate: v*sin(theta), start: 0, end: pi}
  v: {rate: g*cos(theta) - p*lag, start: 0, end: [0, null], range: [-9, 9], guess: [0, 6]}
controls:
  theta: {range: [0, pi], guess: 1, rate: {range: [-5, 5], weight: 0.1}}
  lag: {range: [-1, 1], delay: 0.1, history: 0.2}
integrals: [{expression: v**2, range: [null, 5]}]
cost:
  terminal: [{expression: T + p, weight: 2}]
  running: [{expression: known_walk_knee*(x - ref_walk_knee)**2}]
  largest: [{expression: v, weight: 2, absolute: true, name: peak}]
constraints:
  - {expression: v - peak, range: [null, 3], soft: {linear: 10, quadratic: 50, name: miss}}
  - {expression: x, range: [1, 1], at: end, soft: 5}
refine: {accuracy: 1e-5, rounds: 2}
""",
    """\
model: block.yaml
horizon: {guess: 1, range: [0.1, 3]}
intervals: 5
scheme: radau
degree: 1
states: {act: {rate: (a - act)/0.1, start: 0, range: [0, 1]}}
controls: {a: {range: [0, 1]}}
forces: {x: 20*act - 0.1*qd_x}
contacts: [{sensor: block, axes: xz, friction: 0.4, mode: complementarity, height: 0}]
relaxation: {first: 0.1, last: 1e-6, factor: 0.1}
start: {pose: {x: null}, velocity: {}}
end: {pose: {x: 1}, velocity: zero, sensor_velocities: {block: {x: 0.1}}}
guess: {motion: line, start: {x: 0.1}, inputs: zero}
cost: {terminal: [{expression: T}]}
""",
    """\
model: block.yaml
horizon: 1
intervals: 10
scheme: radau
degree: 3
inputs: {course: polynomial, delay: 0.2, history: {x: 0.5}}
references: {walk: {file: walk.csv, time: normalised, columns: {knee: "q[knee]"}}}
wrenches: {block: {force: [0, 0, {range: [0, 60], guess: 20}], moment: null}}
contacts: [{sensor: block, axes: z, normal: z}]
bounds: {velocities: {x: [-3, 3]}, inputs: [-20, 20], input_rates: {x: [-100, 100]}}
start: {pose: {}}
end: {sensors: {block: {x: 0.4, y: 0, z: 0}}}
cost:
  inputs: 1
  input_rates: 0.1
  track: [{reference: walk, coordinates: {x: knee}, weight: 3}]
  largest: [{expression: u_x}]
""",
)
PHASES = (
    """\
constants: {g: 1.5}
unknowns: {h: {guess: 2, range: [0, 9]}}
scheme: radau
degree: 2
intervals: 4
horizon: {guess: 1, range: [0.1, 3]}
cost: {terminal: [{expression: T, weight: 0.1}]}
phases:
  - name: fall
    states: {x: {rate: v, start: null}, v: {rate: -g, start: 0}}
    constraints: [{expression: x - h, range: [0, 0], at: start}]
  - name: brake
    states: {x: {rate: v, start: null, end: 0}, v: {rate: b - g, start: null, end: 0}}
    controls: {b: {range: [0, 3], rate: {range: [-9, 9]}}}
    constraints: [{expression: v, range: [-2, null], soft: {linear: 3, name: haste}}]
links:
  - from: fall
    to: brake
    conditions: [{expression: end_T + start_T, range: [null, 4]}]
    cost: [{expression: (end_v - start_v)**2, weight: 2}]
""",
    """\
model: block.yaml
scheme: radau
degree: 2
intervals: 4
horizon: 0.5
cost: {inputs: 1}
bounds: {inputs: [-20, 20]}
phases:
  - name: flight
    start: {pose: {z: 0.3}}
    wrenches: {block: {force: [0, 0, 0]}}
  - name: stance
    horizon: {guess: 0.5, range: [0.1, 2]}
    contacts: [{sensor: block, axes: xz, friction: 0.8}]
    end: {pose: {x: 1}}
links:
  - from: flight
    to: stance
    map: {x: x - 0.1}
    velocities: {x: null}
    impact: {contacts: [block], restitution: 0}
    conditions: [{expression: jz_block - end_qd_x, range: [0, null]}]
""",
)
TRIALS = (
    """\
constants: {c: 0.1}
duration: 2
rate: 20
delay: 1
predict: true
fallback: hold
start: {pose: {second: c}, velocity: {first: 0.2}}
plant: {scale: {l: 1.1}, method: rk4, step: 0.001}
noise: {coordinates: 1e-3, velocities: {first: 0.01}, inputs: 0.1, seed: 3}
kicks: [{time: 0.5, velocity: {second: 0.8}}, {time: 0.5, velocity: {first: -c}}]
wrenches: [{wrench: push, from: 0.2, until: 0.4, force: [sin(t), 0, 1]}]
updates: {aim: 0.1*t}
references: {q_first: sin(t)}
measures: [{name: lean, expression: abs(q_first) + t, from: 0.5, until: 1, most: 0.6}]
horizon: {end: 2, least: 0.5}
""",
)
TRACKED = b"""\
model: pair.yaml
constants: {aim: 0}
horizon: 1
intervals: 4
scheme: radau
degree: 2
start: {pose: {}}
wrenches: {push: {force: [0, 0, 0]}}
cost: {inputs: 1, running: [{expression: (q_first - aim)**2}]}
"""
WALK = b"t,q[knee]\n0,1\n0.1,1.5\n0.2,1.8\n0.3,2\n0.4,2.1\n0.5,2\n"
URDF = """<robot name="pair"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 0.5" rpy="0 0.1 0"/>
<mass value="2"/><inertia ixx="0.1" ixy="0.01" ixz="0" iyy="0.1" iyz="0" izz="0.02"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1" rpy="0 0 0.3"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="3"/><dynamics damping="0.1" friction="0.2"/></joint>
<link name="hand"><inertial><mass value="1e-2"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/>
</inertial></link><joint name="slide" type="prismatic"><parent link="arm"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.1" effort="1" velocity="1"/></joint></robot>
"""
MJCF = """<mujoco model="pair"><compiler angle="degree"/><option gravity="0 0 -9.81"/>
<default><joint damping="0.1"/><default class="small"><geom density="500"/></default></default>
<worldbody><body name="arm" pos="0 0 1" euler="0 30 0"><joint name="turn" type="hinge" axis="0 1 0" range="-90 90"/>
<geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.05" mass="2"/><site name="tip" pos="0 0 0.5"/>
<body name="hand" pos="0 0 0.5"><joint type="slide" axis="0 0 1" stiffness="3"/>
<geom class="small" type="box" size="0.1 0.1 0.2"/></body></body></worldbody>
<actuator><motor joint="turn" gear="10" ctrlrange="-1 1"/></actuator></mujoco>
"""


_BAR = """<link name="{}"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link>"""
_PIN = """<joint name="{}" type="continuous" independent="{}"><parent link="{}"/><child link="{}"/>
<origin xyz="{} 0 {}"/><axis xyz="0 1 0"/></joint>"""
URDF_LOOP = f"""<robot name="bars"><link name="base"/>{"".join(map(_BAR.format, ("left", "right", "top", "gear")))}
{_PIN.format("a", "true", "base", "left", 0, 0)}{_PIN.format("b", "false", "base", "right", 0.4, 0)}
{_PIN.format("c", "false", "left", "top", 0, 0.5)}{_PIN.format("d", "false", "base", "gear", 0, 0)}
<loop name="pin" type="revolute"><predecessor link="top"><origin xyz="0.4 0 0"/></predecessor>
<successor link="right"><origin xyz="0 0 0.5" rpy="0 0 0"/></successor><axis xyz="0 1 0"/></loop>
<coupling name="belt"><predecessor link="left"/><successor link="gear"/><ratio value="3"/></coupling></robot>
"""
MJCF_LOOP = """<mujoco model="bars"><default><geom type="sphere" size="0.1"/><joint axis="0 1 0"/></default><worldbody>
<body name="left"><joint name="a" ref="20"/><geom/>
<body name="top" pos="0.1 0 0.5"><joint name="b"/><geom/></body></body>
<body name="right" pos="0.4 0 0"><joint name="c"/><geom/><site name="end" pos="0.1 0 0.5"/></body>
<body name="cam" pos="1 0 0"><joint name="d"/><geom pos="0.1 0 0"/></body></worldbody><equality>
<connect name="pin" body1="top" body2="right" anchor="0.4 0 0" solref="0.01 1"/>
<joint joint1="d" joint2="a" polycoef="0 1 0.3"/><weld active="false" body1="top" body2="cam" relpose="0 0 1 1 0 0 0"/>
</equality></mujoco>
"""
_SDF_LINK = """<link name="{}"><pose>{} 0 0.5 0 0.3 0</pose><inertial><pose>0 0 0.2 0 0 0.1</pose><mass>1.5</mass>
<inertia><ixx>0.03</ixx><iyy>0.03</iyy><izz>0.01</izz><ixy>0.001</ixy></inertia></inertial></link>
"""
_SDF_JOINT = """<joint name="{}" type="{}"><pose{}</pose><parent>{}</parent><child>{}</child><axis><xyz
expressed_in="__model__">0 1 0</xyz><limit><lower>-2</lower><upper>inf</upper></limit><dynamics><damping>0.3</damping>
</dynamics>{}</axis></joint>
"""
_SDF_MIMIC = '<mimic joint="a"><multiplier>2</multiplier></mimic>'
SDF = f"""<sdf version="1.11"><world name="lab"><gravity>0 0 -9.81</gravity><model name="wall"><static>1</static>
<link name="stone"/></model><model name="bars"><pose degrees="true">0.1 0.2 0.3 0 0 30</pose>
{"".join(_SDF_LINK.format(name, x) for name, x in (("crank", 0), ("top", 0.2), ("rocker", 0.9), ("gear", -0.5)))}
<link name="loose"/><frame name="tip" attached_to="crank"><pose>0 0 0.6 0 0 0</pose></frame>
{_SDF_JOINT.format("a", "revolute", ">", "world", "crank", "")}
{_SDF_JOINT.format("b", "revolute", ' relative_to="tip">', "tip", "top", "")}
{_SDF_JOINT.format("c", "continuous", ">", "world", "rocker", "")}
{_SDF_JOINT.format("e", "prismatic", ">0.1 0 0 0 0 0", "world", "gear", _SDF_MIMIC)}
{_SDF_JOINT.format("d", "revolute", ">0 0 0.6 0 0 0", "top", "rocker", "")}</model></world></sdf>
"""


def _use_model(file: Path) -> None:
    tree = read_tree(file)
    assert all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", parameter.name) for parameter in tree.parameters)
    if len(tree.bodies) <= SMALL:
        functions = ("loops",) if tree.loops else ("impl", "exp2")
        generate(file, file.parent / OUT, Options(functions=functions, derivatives=0))


def _use_scene(file: Path) -> None:
    generate(file.parent / "model.yaml", file.parent / OUT, Options(scene=file))


def _use_foreign(file: Path) -> None:
    tree = read_tree(import_model(file).model)
    if len(tree.bodies) <= SMALL:
        functions = ("loops",) if tree.loops else ("impl", "exp2")
        make(import_model(file).model, Options(functions=functions, derivatives=0))


def _use_manifest(file: Path) -> None:
    found = manifest.read(file)
    manifest.write(found)


@dataclass(frozen=True)
class _Described:
    """A mechanism without loops: nothing is computed of it when a problem is read."""

    manifest: manifest.Manifest

    @property
    def parameters(self) -> dict[str, float]:
        """Return the values of its parameters."""
        return {p.name: p.value for p in (*self.manifest.parameters, *self.manifest.design)}

    def with_parameters(self, **_: float) -> _Described:
        """Return the same: nothing is computed."""
        return self


@cache
def _describe(text: bytes) -> manifest.Manifest:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.yaml"
        file.write_bytes(text)
        return make(file, Options(derivatives=0, functions=("impl", "sensors"), reductions=ONE_TRIAL)).manifest


def _use_problem(file: Path) -> None:
    read_problem(file, lambda path: _MECHANISMS.get(path.name, _MECHANISMS["pair.yaml"]))


def _use_whole(file: Path) -> None:
    read_problem(file, lambda _: _MECHANISMS["block.yaml"], NO_MECHANISM)


def _use_phases(file: Path) -> None:
    read_phased_problem(file, lambda _: _MECHANISMS["block.yaml"])


def _use_trial(file: Path) -> None:
    plant = _MECHANISMS["pair.yaml"]
    problem, _ = read_problem(file.parent / "problem.ocp.yaml", lambda _: plant)
    TrialStatement(file, {}).trial(problem, plant.manifest, plant.parameters)


def _use_settings(file: Path) -> None:
    read_statement(file, {}, _describe(MODEL.encode()))


def _use_solution(file: Path) -> None:
    read_solution(file)


_MECHANISMS: dict[str, Any] = {}  # by the names of model files


def _list_models() -> Sources:
    return *_list("*.yaml"), *[("pair.yaml", MODEL.encode())] * 8


def _list_problems() -> Sources:
    _MECHANISMS["pair.yaml"] = _Described(_describe(MODEL.encode()))
    problems = _list("*.yaml", problems=True)
    for problem, content in problems:
        name = yaml.safe_load(content)["model"]
        if MODELS / name not in CLOSED:
            _MECHANISMS[name] = _Described(_describe((MODELS / name).read_bytes()))
        elif name not in _MECHANISMS:
            _MECHANISMS[name] = Mechanism(find_folder(MODELS / name, WITH_LOOPS))
            read_problem(MODELS / problem, lambda path: _MECHANISMS[path.name])  # compiles: a search sees no process
    return problems


def _list_with_contacts(name: str, texts: Sequence[str], use: Callable[[Path], None]) -> Sources:
    """List problems of a block that touches the ground; they are read once, which compiles."""
    _MECHANISMS["block.yaml"] = Mechanism(find_folder(MODELS / "contact" / "block.yaml", WITH_CONTACTS))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "walk.csv").write_bytes(WALK)
        for text in texts:
            (Path(folder) / name).write_text(text, encoding="utf-8")
            use(Path(folder) / name)
    return _texts(name, texts)


def _list_trials() -> Sources:
    _MECHANISMS["pair.yaml"] = _Described(_describe(MODEL.encode()))
    return _texts("trial.yaml", TRIALS)


def _list_settings() -> Sources:
    _describe(MODEL.encode())
    return _texts("settings.yaml", SETTINGS)


def _list_manifests() -> Sources:
    return (("manifest.json", manifest.write(_describe(MODEL.encode())).encode()),)


def _list_solutions() -> Sources:
    _list_problems()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "solution.json"
        problem, _ = read_problem(MODELS / "cart_pole_balance.ocp.yaml", lambda path: _MECHANISMS[path.name])
        mesh, states, points = np.arange(3.0), np.zeros((3, 2)), np.zeros((2, 1, 2))
        inputs, times = np.ones((2, 1)), np.array([[1.0], [2.0]])
        trajectory = Trajectory(mesh, states, states, inputs, times, points, points, points)
        solution = Solution(
            problem=problem,
            model="cart_pole",
            model_hash="0" * 64,
            coordinates=("cart", "pole"),
            inputs=("cart",),
            run=Run("Solve_Succeeded", 3, 0.1, 0.05),
            size=Size(10, 8, 20, 12),
            cost=CostTerms((("inputs", 1.0), ("input rates", 0.0))),
            violation=Violation(1e-9, 0.0),
            trajectory=trajectory,
        )
        write_solution(solution, file)
        return (("solution.json", file.read_bytes()),)


def _list(pattern: str, *, problems: bool = False) -> tuple[tuple[str, bytes], ...]:
    files = sorted(MODELS.glob(pattern))
    return tuple((file.name, file.read_bytes()) for file in files if file.name.endswith(".ocp.yaml") == problems)


def _texts(name: str, texts: Sequence[str]) -> tuple[tuple[str, bytes], ...]:
    return tuple((name, text.encode()) for text in texts)


RECORDINGS: Sources = (
    ("a.csv", b"t,q[knee] [deg],x[toe] [mm]\n0,1,2\n0.1,,3\n0.2,3e-1,nan\n0.3,2,1\n0.4,3,2\n0.5,1,1\n"),
    ("a.trc", b"PathFileType\t4\t(X/Y/Z)\ta.trc\nNumFrames\tNumMarkers\tUnits\n2\t1\tmm\nFrame#\tTime\thip\n"
     b"\t\tX1\tY1\tZ1\n\n1\t0\t1\t2\t3\n2\t0.01\t\t\t\n"),
    ("a.sto", b"walk\nversion=1\nnRows=2\nnColumns=2\ninDegrees=yes\nendheader\ntime\tknee\n0\t180\n0.5\tnan\n"),
)  # fmt: skip


def _use_recording(file: Path) -> None:
    """Read a recording, and fit splines to its columns."""
    recording = read_recording(file)
    for name, column in zip(recording.names, recording.columns, strict=True):
        fit(recording.times, read_column(recording, name, column.unit), Treatment())


KINDS: Mapping[str, Kind] = {
    "recordings": Kind(lambda: RECORDINGS, _use_recording),
    "models": Kind(_list_models, _use_model),
    "linkages": Kind(lambda: _texts("linkage.yaml", LINKAGES), _use_model),
    "scenes": Kind(lambda: _texts("scene.yaml", SCENES), _use_scene, {"model.yaml": MODEL.encode()}),
    "problems": Kind(_list_problems, _use_problem),
    "wholes": Kind(lambda: _list_with_contacts("whole.ocp.yaml", PROBLEMS, _use_whole), _use_whole, {"walk.csv": WALK}),
    "phases": Kind(lambda: _list_with_contacts("phases.ocp.yaml", PHASES, _use_phases), _use_phases),
    "trials": Kind(_list_trials, _use_trial, {"problem.ocp.yaml": TRACKED}),
    "settings": Kind(_list_settings, _use_settings),
    "solutions": Kind(_list_solutions, _use_solution),
    "manifests": Kind(_list_manifests, _use_manifest),
    "urdf": Kind(lambda: (("robot.urdf", URDF.encode()), ("bars.urdf", URDF_LOOP.encode())), _use_foreign),
    "mjcf": Kind(lambda: (("robot.xml", MJCF.encode()), ("bars.xml", MJCF_LOOP.encode())), _use_foreign),
    "sdf": Kind(lambda: (("bars.sdf", SDF.encode()),), _use_foreign),
}
