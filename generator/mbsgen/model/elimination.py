"""Linear constraints of joints -> joints that follow others: their equations hold exactly, with a coordinate less.

A constraint a q1 + b q2 + c = 0 with constants a, b, c is a follower's rule q2 = -(a/b) q1 - c/b (see `following`).
The follower has no input, is not driven, not independent by the author's choice, and no part of a quaternion. Of two
such joints it is the later one, unless the file gives its rough coordinate.

In a constraint of more joints, one follows the sum of the others. Besides, it has no bounds, nor have its followers,
since bounds on a sum bind no single joint. The file gives no rough coordinate of it, or of all joints of the equation.
Of several such joints it is the one with the largest coefficient, so that ratios are at most 1 where possible; of equal
ones, the later one.

All other constraints remain equations: equations of one joint, nonlinear equations, and equations that depend on
run-time parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

from mpmath import mpf

from mbsgen.documents import Finding
from mbsgen.expressions import (
    PRIMITIVES,
    Algebra,
    Expression,
    ExpressionError,
    Name,
    Number,
    Operation,
    evaluate,
    names,
)
from mbsgen.model.expansion import list_steps
from mbsgen.model.following import check_followers, find_rules, list_joints
from mbsgen.model.model import Body, Constraint, Follow, Joint, Model
from mbsgen.model.symbols import DIGITS
from mbsgen.model.valuation import Valuation

NOISE = 1e-40  # of the largest coefficient: smaller sums are the rounding of coefficients that cancel in 60 digits
OPEN = 1e-12  # of the largest number in an equation: the rounding of doubles where the equation holds
LARGEST = 1e100  # of a ratio or its inverse: beyond, the equation remains


@dataclass(frozen=True)
class Linear:
    """A linear form: the sum of coefficients times coordinates of joints, and a constant, in 60 digits."""

    coefficients: Mapping[str, mpf] = field(default_factory=dict)
    constant: mpf = DIGITS.zero

    def scaled(self, factor: mpf) -> Linear:
        """Multiply by a number."""
        return Linear({name: factor * x for name, x in self.coefficients.items()}, factor * self.constant)

    def plus(self, other: Linear) -> Linear:
        """Add a form; coefficients that cancel are left out."""
        found = dict(self.coefficients)
        for name, x in other.coefficients.items():
            total = found.get(name, DIGITS.zero) + x
            found[name] = total if abs(total) > NOISE * abs(x) else DIGITS.zero
        return Linear({name: x for name, x in found.items() if x}, self.constant + other.constant)

    def substitute(self, joint: str, form: Linear) -> Linear:
        """Put a form in place of the coordinate of a joint."""
        if joint not in self.coefficients:
            return self
        rest = {name: x for name, x in self.coefficients.items() if name != joint}
        return Linear(rest, self.constant).plus(form.scaled(self.coefficients[joint]))

    def solve(self, joint: str) -> Linear:
        """Return the coordinate of a joint for which this form vanishes."""
        rest = {name: x for name, x in self.coefficients.items() if name != joint}
        return Linear(rest, self.constant).scaled(-1 / self.coefficients[joint])


def eliminate(model: Model) -> Model:
    """Replace constraints of a checked model by rules of followers where possible; the other constraints remain."""
    if not model.constraints:
        return model
    forms, candidates = _express(model), _list_candidates(model)
    rules: dict[str, Linear] = {}
    remaining: list[Constraint] = []
    for constraint in model.constraints:
        form = read_linear(constraint.equation, forms)
        follower = None if form is None else _choose_follower(form, candidates)
        if form is None or follower is None:
            remaining.append(constraint)
            continue
        _put(follower, form.solve(follower), rules, forms)
    follows = {name: _make_follow(rule) for name, rule in rules.items()}
    return replace(
        model,
        bodies=tuple(_let_follow(i, body, follows) for i, body in enumerate(model.bodies)),
        constraints=tuple(remaining),
        assembly=_move_rough(model.assembly, follows),
    )


@dataclass(frozen=True)
class Sums:
    """The joints of a model that follow sums of others, by constraints."""

    rules: Mapping[str, Linear]  # of each follower, over joints that follow no other
    solved: Mapping[str, Constraint]  # by their names: a follower's coordinate less a sum, with numbers alone
    remaining: tuple[Constraint, ...]


def find_sums(model: Model) -> Sums:
    """Find the constraints of a model after `eliminate` that make joints follow sums of others."""
    rules: dict[str, Linear] = {}
    solved: dict[str, Constraint] = {}
    if not model.constraints:
        return Sums(rules, solved, ())
    forms, candidates, rough = _express(model), _list_unbounded(model), {name for name, _ in model.assembly}
    for constraint in model.constraints:
        form = read_linear(constraint.equation, forms)
        follower = None if form is None else _choose_sum(form, candidates, rough)
        if form is None or follower is None:
            continue
        rule = form.solve(follower)
        if all(x.substitute(follower, rule).coefficients for x in rules.values()):  # none is left without a leader
            solved[constraint.name] = replace(constraint, equation=_write_rule(follower, rule))
            _put(follower, rule, rules, forms)
    return Sums(rules, solved, tuple(x for x in model.constraints if x.name not in solved))


def _write_rule(follower: str, rule: Linear) -> Expression:
    equation: Expression = Name(follower)
    for leader, ratio in rule.coefficients.items():
        equation = Operation("-", equation, Operation("*", Number(float(ratio)), Name(leader)))
    return Operation("-", equation, Number(float(rule.constant))) if rule.constant else equation


def _put(follower: str, rule: Linear, rules: dict[str, Linear], forms: dict[str, Linear]) -> None:
    """Add a rule, and put it in place of the follower in all others."""
    for known in (rules, forms):
        known.update({name: x.substitute(follower, rule) for name, x in known.items() if follower in x.coefficients})
    rules[follower] = rule


def _express(model: Model) -> dict[str, Linear]:
    """Express constant parameters, and joints by their leaders, as linear forms."""
    valuation, steps = Valuation(model.parameters, ()), list_joints(model)
    constants = (p.name for p in model.parameters if not valuation.changes(Name(p.name)))
    forms = {name: Linear({}, valuation.digits((), Name(name))) for name in constants}
    forms |= {step.name: Linear({step.name: DIGITS.one}) for step in steps if step.joint.follows is None}
    for name, rule in find_rules(steps).items():
        if not (valuation.changes(rule.ratio) or valuation.changes(rule.offset)):
            ratio, offset = valuation.digits((), rule.ratio), valuation.digits((), rule.offset)
            forms[name] = forms[rule.joint].scaled(ratio).plus(Linear({}, offset))
    return forms


def _list_candidates(model: Model) -> list[str]:
    """List the joints that may follow others, those first that should."""
    kept, rough = {*model.driven, *model.independent}, {name for name, _ in model.assembly}
    joints = [
        step.name
        for step in reversed(list_joints(model))
        if not (step.joint.actuated or step.joint.floats or step.joint.follows or step.joint.dry or step.joint.stops)
        and step.name not in kept
    ]
    return sorted(joints, key=lambda name: name in rough)


def _choose_follower(form: Linear, candidates: Sequence[str]) -> str | None:
    if len(form.coefficients) != 2:
        return None
    one, other = map(abs, form.coefficients.values())
    if not 1 / LARGEST < one / other < LARGEST:
        return None
    return next((name for name in candidates if name in form.coefficients), None)


def _list_unbounded(model: Model) -> list[str]:
    """List the joints that may follow sums of others, the later ones first."""
    steps = list_joints(model)
    bounded = {
        step.name for step in steps if (step.joint.lower, step.joint.upper, step.joint.max_speed) != (None, None, None)
    }
    bounded |= {rule.joint for name, rule in find_rules(steps).items() if name in bounded}
    return [name for name in _list_candidates(model) if name not in bounded]


def _choose_sum(form: Linear, candidates: Sequence[str], rough: Set[str]) -> str | None:
    """Choose the joint of a form that follows the others."""
    own = [name for name in candidates if name in form.coefficients.keys() - rough]
    if form.coefficients.keys() <= rough:  # the follower's is not needed
        own = [name for name in candidates if name in form.coefficients]
    sizes = {name: abs(x) for name, x in form.coefficients.items()}
    if len(sizes) < 2 or not own or not max(sizes.values()) < LARGEST * min(sizes.values()):
        return None
    return max(own, key=lambda name: sizes[name])


def _make_follow(rule: Linear) -> Follow:
    ((leader, ratio),) = rule.coefficients.items()
    return Follow(leader, Number(float(ratio)), Number(float(rule.constant)))


def _let_follow(i: int, body: Body, follows: Mapping[str, Follow]) -> Body:
    if isinstance(body.joint, Joint):
        (step,) = list_steps(i, body)
        return replace(body, joint=replace(body.joint, follows=follows.get(step.name, body.joint.follows)))
    if isinstance(body.joint, tuple):
        steps = list_steps(i, body)
        joints = (replace(step.joint, follows=follows.get(step.name, step.joint.follows)) for step in steps)
        return replace(body, joint=tuple(joints))
    return body


def _move_rough(
    assembly: Sequence[tuple[str, Expression]], follows: Mapping[str, Follow]
) -> tuple[tuple[str, Expression], ...]:
    """Move rough coordinates of followers to their leaders, unless these have their own."""
    found = {name: value for name, value in assembly if name not in follows}
    for name, value in assembly:
        if name in follows:
            rule = follows[name]
            found.setdefault(rule.joint, Operation("/", Operation("-", value, rule.offset), rule.ratio))
    return tuple(found.items())


# --- checks ----------------------------------------------------------------------------------------------------------


def check_constraints(model: Model) -> Iterator[Finding]:
    """Find constraints of a model without other faults that cannot hold together, or with drives."""
    if not model.constraints:
        return
    yield from _check_drives(model)
    yield from _check_linear(model)
    yield from check_followers(eliminate(model), Valuation(model.parameters, ()))


def _check_drives(model: Model) -> Iterator[Finding]:
    rules = find_rules(list_joints(model))
    for i, constraint in enumerate(model.constraints):
        joints = names(constraint.equation) - {p.name for p in model.parameters}
        if {rules[name].joint if name in rules else name for name in joints} <= {*model.driven}:
            finding = "all joints in this equation are driven: their given motions may not obey it"
            yield Finding(("constraints", i, "equation"), finding, "take one of them from driven")


def _check_linear(model: Model) -> Iterator[Finding]:
    """Find linear constraints that contradict each other, and constraints that let no joint move.

    Gauss and Jordan's elimination in doubles, row by row: each row that is kept has 1 in the column of its pivot, and
    the other rows have 0 there.
    """
    import numpy as np  # here alone: few models have constraints

    joints = [step.name for step in list_joints(model) if step.joint.follows is None]
    columns, forms = {name: k for k, name in enumerate(joints)}, _express(model)
    rows = np.zeros((len(joints), len(joints) + 1))
    pivots: list[int] = []
    for i, constraint in enumerate(model.constraints):
        form = read_linear(constraint.equation, forms)
        if form is None:
            continue
        row = np.zeros(len(joints) + 1)
        for name, x in form.coefficients.items():
            row[columns[name]] = float(x)
        row[-1] = float(form.constant)
        rounding = OPEN * np.abs(row).max()
        count = len(pivots)
        (used,) = np.nonzero(row[pivots])
        row = row - row[pivots][used] @ rows[used]
        pivot = int(np.abs(row[:-1]).argmax())
        if abs(row[pivot]) > rounding:
            row = row / row[pivot]
            (others,) = np.nonzero(rows[:count, pivot])
            rows[others] -= np.outer(rows[others, pivot], row)
            rows[count] = row
            pivots.append(pivot)
        elif abs(row[-1]) > rounding:
            finding = f"no coordinates obey this equation and those before it: {row[-1]:g} is left"
            yield Finding(("constraints", i, "equation"), finding, "mend one of them, or leave it out")
    if len(pivots) == len(joints):
        yield Finding(("constraints",), "no joint is left that moves", "leave an equation out")


# --- linear forms ----------------------------------------------------------------------------------------------------


def read_linear(expression: Expression, forms: Mapping[str, Linear]) -> Linear | None:
    """Read an expression as a linear form, given the forms of its names; None if it is none, or not with constants."""
    if not names(expression) <= forms.keys():
        return None
    try:
        return evaluate(expression, forms, _FORMS)
    except ExpressionError:
        return None


def _multiply(a: Linear, b: Linear) -> Linear:
    if a.coefficients and b.coefficients:
        raise ValueError("a product of coordinates")
    return a.scaled(b.constant) if a.coefficients else b.scaled(a.constant)


def _divide(a: Linear, b: Linear) -> Linear:
    if b.coefficients:
        raise ValueError("a coordinate in a denominator")
    return a.scaled(1 / b.constant)


def _raise(base: Linear, exponent: int) -> Linear:
    if base.coefficients and exponent != 1:
        raise ValueError("a power of a coordinate")
    return base if exponent == 1 else Linear({}, base.constant**exponent)


def _apply(function: Callable[..., object]) -> Callable[..., Linear]:
    """Make a function of constants alone."""

    def compute(*arguments: Linear) -> Linear:
        if any(argument.coefficients for argument in arguments):
            raise ValueError("a function of a coordinate")
        value = function(*(argument.constant for argument in arguments))
        if not isinstance(value, DIGITS.mpf) or not DIGITS.isfinite(value):
            raise ValueError("no real value")
        return Linear({}, value)

    return compute


_BUILT_IN: Mapping[str, Callable[..., object]] = {"abs": abs, "max": max}
_FORMS: Algebra[Linear] = Algebra(
    number=lambda value: Linear({}, DIGITS.mpf(value)),
    constants={"pi": Linear({}, +DIGITS.pi)},
    negate=lambda a: a.scaled(DIGITS.mpf(-1)),
    operations={
        "+": lambda a, b: a.plus(b),
        "-": lambda a, b: a.plus(b.scaled(DIGITS.mpf(-1))),
        "*": _multiply,
        "/": _divide,
    },
    power=_raise,
    functions={name: _apply(_BUILT_IN.get(name) or getattr(DIGITS, name)) for name in PRIMITIVES},
)
