"""The muscles of a model in a problem: `muscles:` -> states, controls, constraints and costs of the problem.

Each muscle whose activation is a signal gets an excitation e, a control. Its activation a is e itself, or follows it,

    da/dt = ((1/2 + f)/(rise z) + (1/2 - f) z/fall)(e - a),    f = tanh((e - a)/10)/2,    z = 1/2 + 3/2 a,

as in De Groote, Kinney, Rao, Fregly (2016) and OpenSim's DeGrooteFregly2016Muscle. A `sharp` law has f = 1/2 where
e > a, else -1/2, as OpenSim's muscles of Millard and Thelen have it. The force s of an elastic tendon, over the
strength, is a state. Its rate is a control that the equation of equilibrium determines at each collocation point. At a
start that is no such point, and of no phase, the rate is an unknown number: else the tendon could begin with a
force that no fibres balance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mbsgen.documents import Place, abbreviate, nearest
from mbsgen.expressions import Expression, Name, Number, fold, is_free_name, parse, spell, substitute, write
from mbsgen.manifest import Fibres
from mbsrun.metabolics import EXCITATION, PRICED, RATE, name_numbers, write_rate
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Constraint
from mbsrun.ocp.statement.sections import (
    ControlSection,
    LagSection,
    MusclesSection,
    ProblemSection,
    StateSection,
    TermSection,
    UnknownSection,
)

_ACTIVATION = parse(
    "((0.5 + tanh((e - a)/10)/2)/(rise*(0.5 + 1.5*a)) + (0.5 - tanh((e - a)/10)/2)*(0.5 + 1.5*a)/fall)*(e - a)"
)
_SHARP = parse("max(e - a, 0)/(rise*(0.5 + 1.5*a)) + min(e - a, 0)*(0.5 + 1.5*a)/fall")
_STRONGEST = 5.0  # force of a tendon over the strength
_QUICKEST = 1000.0  # its rate [1/s]
_START = "{}_start_rate"  # at the start

Blame = Callable[[Place, str, str], None]  # of a place, a finding and a remedy


@dataclass(frozen=True)
class _Muscle:
    """A muscle, and the names of its numbers in the problem."""

    name: str  # in expressions
    label: str  # in the model
    activation: str
    tendon: str | None  # the signal of its tendon's force
    fibres: Fibres

    def find_lag(self, wanted: MusclesSection) -> LagSection | MusclesSection:
        """Return what has its activation dynamics."""
        return wanted.own.get(self.label, wanted)

    def drive(self, wanted: MusclesSection) -> str:
        """Return the name of its excitation."""
        lag = self.find_lag(wanted)
        return self.activation if lag.rise is None or lag.fall is None else EXCITATION.format(self.activation)


def add_muscles(section: ProblemSection, plant: Plant, blame: Blame, *, is_phase: bool = False) -> ProblemSection:
    """Return a problem with states, controls and costs of muscles; `blame` takes faults.

    A link may give the start of a phase.
    """
    wanted = section.muscles
    if wanted is None:
        return section
    muscles = [*_list_muscles(plant, blame)]
    places: list[tuple[Place, LagSection | MusclesSection]] = [(("muscles",), wanted)]
    places += [(("muscles", "own", key), x) for key, x in wanted.own.items()]
    for place, lag in places:
        if (lag.rise is None) != (lag.fall is None):
            blame(place, "one time of activation dynamics", "give rise and fall, or neither")
    labels = [x.label for x in muscles]
    for key in [x for x in wanted.own if x not in labels]:
        meant = nearest(key, labels)
        remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a muscle of the model"
        blame(("muscles", "own", key), f"there is no muscle {abbreviate(key)}", remedy)
    elastic = [x for x in muscles if x.tendon is not None]
    course = section.inputs if isinstance(section.inputs, str) else section.inputs.course
    if elastic and course == "constant":
        finding = "rates of elastic tendons have a value at each collocation point"
        blame(("muscles",), finding, "take inputs: polynomial, or linear")
    states, controls, unknowns = dict(section.states), dict(section.controls), dict(section.unknowns)
    running = [*section.cost.running, *(_price(muscle, wanted) for muscle in muscles)]
    for muscle in muscles:
        drive = muscle.drive(wanted)
        controls[drive] = _control(wanted.excitation, wanted.guess)
        if drive != muscle.activation:
            states[muscle.activation] = _follow(muscle, wanted)
        if muscle.tendon is not None:
            rate = RATE.format(muscle.tendon)
            states[muscle.tendon] = _state(rate, None, (Number(0.0), Number(_STRONGEST)), wanted.guess)
            quickest = Number(-_QUICKEST), Number(_QUICKEST)
            controls[rate] = _control(quickest, Number(0.0))
            if section.scheme is not Family.LOBATTO and not is_phase:
                start = UnknownSection.model_construct(guess=Number(0.0), range=quickest)
                unknowns[_START.format(muscle.tendon)] = start
    cost = section.cost.model_copy(update={"running": tuple(running)})
    added = {"states": states, "controls": controls, "unknowns": unknowns, "cost": cost}
    return section.model_copy(update=added)


def list_equilibria(section: ProblemSection, plant: Plant) -> tuple[Constraint, ...]:
    """Return the equations of elastic tendons of a problem with `muscles`."""
    if section.muscles is None:
        return ()
    elastic = [x for x in _list_muscles(plant, lambda *_: None) if x.tendon is not None]
    starting = [x for x in elastic if _START.format(x.tendon) in section.unknowns]
    return (*(_balance(x, plant) for x in elastic), *(_begin(x, plant) for x in starting))


def list_metabolic_rates(section: ProblemSection, plant: Plant) -> Mapping[str, str]:
    """Return the metabolic rates that a problem with `muscles` prices, by their names."""
    wanted = section.muscles
    if wanted is None or wanted.metabolics is None:
        return {}
    found = {}
    for muscle in _list_muscles(plant, lambda *_: None):
        assert muscle.fibres.contraction is not None, "every muscle has one"
        rate = write_rate(muscle.fibres.contraction, Name(muscle.drive(wanted)), wanted.metabolics.metabolism)
        tendon = None if muscle.tendon is None else Name(RATE.format(muscle.tendon))
        found[PRICED.format(muscle.name)] = _write(name_numbers(muscle.fibres, muscle.name, tendon, rate), plant)
    return found


def _price(muscle: _Muscle, wanted: MusclesSection) -> TermSection:
    return TermSection.model_construct(expression=f"{muscle.drive(wanted)}**2", weight=wanted.effort)


def _follow(muscle: _Muscle, wanted: MusclesSection) -> StateSection:
    """Make the state of an activation."""
    lag = muscle.find_lag(wanted)
    assert lag.rise is not None, "the activation follows"
    assert lag.fall is not None, "the activation follows"
    own = {"a": Name(muscle.activation), "e": Name(muscle.drive(wanted)), "rise": lag.rise, "fall": lag.fall}
    return _state(
        write(substitute(_SHARP if lag.sharp else _ACTIVATION, own)), wanted.start, wanted.excitation, wanted.guess
    )


def _state(rate: str, start: Any, bounds: Any, guess: Any) -> StateSection:
    return StateSection.model_construct(rate=rate, start=start, end=None, range=bounds, guess=guess)


def _control(bounds: Any, guess: Any) -> ControlSection:
    return ControlSection.model_construct(range=bounds, guess=guess, rate=None, delay=None, history=None)


def _balance(muscle: _Muscle, plant: Plant) -> Constraint:
    """Make the constraint of the equilibrium of an elastic tendon."""
    assert muscle.tendon is not None, "the tendon is elastic"
    rate = RATE.format(muscle.tendon)
    text = _write(write_equilibrium(muscle.fibres, muscle.name, rate), plant)
    return Constraint(text, (0.0, 0.0), name=f"the equilibrium of {muscle.name}", gives=rate)


def _begin(muscle: _Muscle, plant: Plant) -> Constraint:
    """Make the constraint of the equilibrium of an elastic tendon at a start that is no collocation point."""
    assert muscle.tendon is not None, "the tendon is elastic"
    rate = RATE.format(muscle.tendon)
    own = {rate: Name(_START.format(muscle.tendon))}
    text = _write(substitute(write_equilibrium(muscle.fibres, muscle.name, rate), own), plant)
    return Constraint(text, (0.0, 0.0), "start", name=f"the equilibrium of {muscle.name} at the start")


def _write(expression: Expression, plant: Plant) -> str:
    """Write an expression with the numbers of the model's parameters."""
    numbers = {name: Number(float(x)) for name, x in plant.parameters.items() if is_free_name(name)}
    return write(fold(substitute(expression, numbers)))


def write_equilibrium(fibres: Fibres, name: str, rate: str) -> Expression:
    """Write the equation of a muscle with an elastic tendon, of a name, over quantities of a motion."""
    return name_numbers(fibres, name, Name(rate), parse(fibres.equilibrium))


def _list_muscles(plant: Plant, blame: Blame) -> Iterator[_Muscle]:
    appearance = plant.manifest.appearance
    elements = () if appearance is None else [x for x in appearance.elements if x.muscle is not None]
    if not elements:
        blame(("muscles",), "the model has no muscles", "give it some, with type: muscle under forces")
    for element, name in zip(elements, spell([x.name for x in elements]), strict=True):
        fibres = element.muscle
        assert fibres is not None, "it is a muscle"
        activation, tendon = parse(fibres.activation), parse(fibres.tendon_state) if fibres.tendon_state else None
        if name is None or not isinstance(activation, Name) or not isinstance(tendon, Name | None):
            finding = f"the activation of {element.name} is no signal" if name else f"{element.name} has no name here"
            blame(("muscles",), finding, "give states and controls of all muscles yourself")
            continue
        yield _Muscle(name, element.name, activation.name, None if tendon is None else tendon.name, fibres)
