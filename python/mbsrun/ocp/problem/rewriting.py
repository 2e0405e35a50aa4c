"""Keys of a problem file as other parts of the problem: soft constraints, largest values, inputs with rates.

A soft constraint has a slack s >= 0, a control, or a number where it holds at one end:

    lower - s <= g <= upper + s,    cost += integral of (linear s + quadratic s^2)

The largest value of g along the path is an unknown p, with a price:

    g <= p,  -p <= g where |g| is meant,    cost += weight p

A number may be a state that holds still, s' = 0, where a solver or a controller has no place for numbers.

An input that is continuous is a state whose rate is a control: u' = r. Constant r make it linear over each interval;
r that are polynomials of degree d - 1 through the collocation points make it one of degree d.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mbsrun.ocp.problem.problem import Constraint, Control, Delay, Force, Problem, Range, State, Term, Unknown

FREE: Range = (-math.inf, math.inf)
RATE = "rate_"  # before the name of an input: the name of its rate
RATE_OF = "rate_of_"  # where that name is taken
INPUT = "input_"  # before the name of a coordinate: the state that is its continuous input


@dataclass(frozen=True)
class Price:
    """The price of a slack s: linear s + quadratic s^2."""

    linear: float
    quadratic: float


def soften(problem: Problem, constraint: Constraint, price: Price, name: str) -> Problem:
    """Add a constraint that a slack of this name lets be violated at a price."""
    (lower, upper), text = constraint.range, f"({constraint.expression})"
    sides = []
    if upper < math.inf:
        side = replace(constraint, expression=f"{text} - {name}", name=f"{constraint.label} less its slack")
        sides.append(replace(side, range=(-math.inf, upper)))
    if lower > -math.inf:
        side = replace(constraint, expression=f"{text} + {name}", name=f"{constraint.label} plus its slack")
        sides.append(replace(side, range=(lower, math.inf)))
    terms = [
        Term(expression, weight, f"slack of {constraint.expression}{squared}")
        for expression, weight, squared in ((name, price.linear, ""), (f"{name}**2", price.quadratic, ", squared"))
        if weight
    ]
    problem = replace(problem, constraints=(*problem.constraints, *sides))
    least: Range = (0.0, math.inf)
    if constraint.at == "path":
        control = Control(name, least, softens=constraint.expression)
        cost = replace(problem.cost, running=(*problem.cost.running, *terms))
        return replace(problem, controls=(*problem.controls, control), cost=cost)
    unknown = Unknown(name, least, softens=constraint.expression)
    cost = replace(problem.cost, terminal=(*problem.cost.terminal, *terms))
    return replace(problem, unknowns=(*problem.unknowns, unknown), cost=cost)


def price_largest(problem: Problem, expression: str, weight: float, name: str, *, is_absolute: bool) -> Problem:
    """Add the largest value of an expression along the path, or of its absolute value, as a term of the cost."""
    text = f"({expression})"
    sides = [Constraint(f"{text} - {name}", (-math.inf, 0.0))]
    if is_absolute:
        sides.append(Constraint(f"{text} + {name}", (0.0, math.inf)))
    largest = (expression, f"-{text}") if is_absolute else (expression,)
    title = f"largest |{expression}|" if is_absolute else f"largest {expression}"
    cost = replace(problem.cost, terminal=(*problem.cost.terminal, Term(name, weight, title)))
    return replace(
        problem,
        unknowns=(*problem.unknowns, Unknown(name, largest=largest)),
        constraints=(*problem.constraints, *sides),
        cost=cost,
    )


def hold_unknowns(problem: Problem) -> Problem:
    """Return a problem whose unknown numbers are its last states, which hold still and begin anywhere."""
    held = tuple(State(x.name, "0", x.bounds, guess=x.guess) for x in problem.unknowns)
    return replace(problem, states=(*problem.states, *held), unknowns=())


@dataclass(frozen=True)
class Lifted:
    """An input or a control that becomes a continuous state."""

    name: str  # of the state
    rate: str  # the name of its rate
    rates: Range = FREE
    weight: float = 0.0  # times the integral of the squared rate


def lift_controls(problem: Problem, chosen: Sequence[Lifted]) -> Problem:
    """Make controls continuous; the state has the name of the control."""
    known = {lifted.name: lifted for lifted in chosen}
    states = tuple(
        State(control.name, known[control.name].rate, control.bounds, guess=control.guess)
        for control in problem.controls
        if control.name in known
    )
    names = [control.name for control in problem.controls]
    places = {name: len(problem.states) + i for i, name in enumerate(name for name in names if name in known)}
    changed = tuple(_make_rate(known[x.name]) if x.name in known else x for x in problem.controls)
    delays = [(names[delay.index] if delay.kind == "control" else "", delay) for delay in problem.delays]
    problem = replace(problem, states=(*problem.states, *states), controls=changed, delays=())
    for name, delay in delays:
        problem = _delay(problem, delay, places.get(name), delay.index)
    return _price(problem, [lifted for lifted in chosen if lifted.weight])


def lift_inputs(problem: Problem, chosen: Sequence[tuple[int, Lifted, str]]) -> Problem:
    """Make inputs of the mechanism continuous: index, state, and the name in expressions.

    They are no unknowns then, so the price of inputs becomes a term for them.
    """
    known = {i: lifted for i, lifted, _ in chosen}
    bounds = problem.bounds
    states = tuple(State(lifted.name, lifted.rate, bounds.u[i]) for i, lifted, _ in chosen)
    places = {i: len(problem.states) + k for k, i in enumerate(known)}
    controls = {i: len(problem.controls) + k for k, i in enumerate(known)}
    delays = problem.delays
    problem = replace(
        problem,
        states=(*problem.states, *states),
        controls=(*problem.controls, *(_make_rate(lifted) for _, lifted, _ in chosen)),
        forces=(*problem.forces, *(Force(i, lifted.name) for i, lifted, _ in chosen)),
        bounds=replace(bounds, u=tuple(FREE if i in known else limits for i, limits in enumerate(bounds.u)), rates=()),
        delays=(),
    )
    for delay in delays:
        is_lifted = delay.kind == "input" and delay.index in known
        problem = _delay(
            problem,
            delay,
            places[delay.index] if is_lifted else None,
            controls[delay.index] if is_lifted else delay.index,
        )
    price, rates = problem.cost.inputs, problem.cost.input_rates
    problem = replace(problem, cost=replace(problem.cost, input_rates=0.0))
    problem = _price(problem, [replace(lifted, weight=rates) for _, lifted, _ in chosen if rates])
    if price:
        left = price if len(problem.forces) < len(bounds.u) else 0.0
        squares = Term(" + ".join(f"{text}**2" for _, _, text in chosen), price, "continuous inputs")
        cost = replace(problem.cost, inputs=left, running=(*problem.cost.running, squares))
        problem = replace(problem, cost=cost)
    return problem


def _make_rate(lifted: Lifted) -> Control:
    return Control(lifted.rate, lifted.rates)


def _delay(problem: Problem, delay: Delay, state: int | None, control: int) -> Problem:
    """Delay an input; where it is a state, the state starts as it was before, and its rate is 0 until then."""
    if state is None:
        return replace(problem, delays=(*problem.delays, delay))
    states, history = list(problem.states), None
    if delay.history is not None:
        states[state] = replace(states[state], start=(delay.history, delay.history))
        history = 0.0
    rate = replace(delay, kind="control", index=control, history=history, state=state)
    return replace(problem, states=tuple(states), delays=(*problem.delays, rate))


def _price(problem: Problem, lifted: Sequence[Lifted]) -> Problem:
    """Price squared rates."""
    terms = tuple(Term(f"{x.rate}**2", x.weight, f"rates of {x.name}") for x in lifted)
    return replace(problem, cost=replace(problem.cost, running=(*problem.cost.running, *terms)))
