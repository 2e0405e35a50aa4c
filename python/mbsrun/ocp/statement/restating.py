"""The keys of a problem file that are other parts of a problem: read, checked and rewritten by `rewriting`.

These are soft constraints, largest values, rates of controls, linear inputs, and delays.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from mbsgen.documents import Place, abbreviate
from mbsgen.expressions import Expression, is_free_name, spell
from mbsrun.ocp.problem.kinks import bound_kinks
from mbsrun.ocp.problem.problem import Constraint, Course, Delay, Form, Problem, Range
from mbsrun.ocp.problem.rewriting import (
    INPUT,
    RATE,
    RATE_OF,
    Lifted,
    Price,
    lift_controls,
    lift_inputs,
    price_largest,
    soften,
)
from mbsrun.ocp.statement.parts import FREE, PartReading
from mbsrun.ocp.statement.sections import ControlSection, InputsSection, ProblemSection, SoftSection
from mbsrun.ocp.transcription.quantities import Quantity

LINK = "link"  # the history of an input: commands of the phase before


class Rewriting:
    """Reads the keys, and rewrites a problem."""

    def __init__(
        self,
        reading: PartReading,
        section: ProblemSection,
        inputs: Sequence[str],
        prefix: str,
        determined: Collection[str] = (),
    ) -> None:
        """Add the names of slacks, largest values and rates; `prefix` keeps the numbers of phases apart.

        `determined` are controls that an equation gives at each point: they stay polynomials beside linear inputs.
        """
        self.determined = frozenset(determined)
        self.reading, self.section, self.inputs, self.prefix = reading, section, inputs, prefix
        given = section.inputs
        self.form = given if isinstance(given, InputsSection) else InputsSection(course=given)
        spelled = spell(inputs)
        self.texts = [f"u_{name or i}" for i, name in enumerate(spelled)]
        self.states = [f"{INPUT}{name or i}" for i, name in enumerate(spelled)]
        self.slacks = [self._name_slack(i) for i in range(len(section.constraints))]
        self.peaks = [
            self._name(("cost", "largest", i), part.name, f"{prefix}largest_{i}", "a largest value", "unknowns")
            for i, part in enumerate(section.cost.largest)
        ]
        self.lifted_inputs = [i for i in range(len(inputs)) if self._is_lifted_input(i)]
        self.lifted_controls = [name for name, part in section.controls.items() if self._is_lifted_control(name, part)]
        for i in self.lifted_inputs:
            reading.add_name(("inputs",), self.states[i], "the continuous input", Quantity("states", 0))
            reading.add_name(("inputs",), RATE + self.texts[i], "the rate of an input", Quantity("controls", 0))
        # the rate of a force element may have the first name, as where the activation of a muscle is a control
        self.rates = {
            name: (RATE if RATE + name not in reading.quantities else RATE_OF) + name for name in self.lifted_controls
        }
        for name, rate in self.rates.items():
            reading.add_name(("controls", name), rate, "the rate of a control", Quantity("controls", 0))

    @property
    def course(self) -> Course:
        """Return the course of the inputs that stay inputs: linear ones are states with constant rates."""
        is_mixed = self.form.course == "linear" and bool(self.determined)
        return "polynomial" if self.form.course == "polynomial" or is_mixed else "constant"

    def apply(self, problem: Problem) -> Problem:
        """Rewrite a problem that was read without these keys."""
        delays = tuple(self._list_delays(problem))
        problem = self._rate(replace(problem, delays=delays) if delays else problem)
        if problem.form is Form.STANDARD:
            problem = self._lift(problem)
        elif self.form.course == "linear":
            finding = f"the {problem.form.value} form takes no inputs that change within an interval"
            self.reading.fault(("inputs",), finding, "take constant ones, or form: standard")
        for i, part in enumerate(self.section.constraints):
            if part.soft is not None:
                problem = self._soften(problem, i, part.soft)
        for i, peak in enumerate(self.section.cost.largest):
            place: Place = ("cost", "largest", i)
            self.reading.check_formula((*place, "expression"), peak.expression)
            weight = self.reading.number((*place, "weight"), peak.weight, least=math.ulp(0))
            problem = price_largest(problem, peak.expression, weight, self.peaks[i], is_absolute=peak.absolute)
        if problem.form is Form.STANDARD and not self.reading.faults:
            problem = self._bound_kinks(problem)
        return self._hold_steady(problem) if self.form.course == "linear" and self.determined else problem

    def _hold_steady(self, problem: Problem) -> Problem:
        """Mark the controls that no equation gives as constant over each interval, as rates of linear inputs are."""
        controls = tuple(replace(x, is_steady=x.name not in self.determined) for x in problem.controls)
        return replace(problem, controls=controls)

    def _bound_kinks(self, problem: Problem) -> Problem:
        """Bound absolute values and maxima of the cost."""
        constant: list[str] = []
        if self.form.course == "constant":
            given = {force.input for force in problem.forces}
            constant = [text for i, text in enumerate(self.texts) if i not in given and not problem.delays]
            constant += [x.name for x in problem.controls if not problem.delays]
            constant += [x.name for x in problem.unknowns]
        return bound_kinks(
            problem,
            self.reading.constants,
            constant,
            lambda role, usual: self._name((), None, usual if role == "controls" else self.prefix + usual, "", role),
        )

    # --- names ---

    def _name_slack(self, i: int) -> str:
        part = self.section.constraints[i]
        if part.soft is None:
            return ""
        own = part.soft.name if isinstance(part.soft, SoftSection) else None
        is_path = part.at == "path"
        usual = f"slack_{i}" if is_path else f"{self.prefix}slack_{i}"
        return self._name(("constraints", i, "soft"), own, usual, "a slack", "controls" if is_path else "unknowns")

    def _name(self, place: Place, own: str | None, usual: str, kind: str, role: str) -> str:
        """Add a name that the file gives, or a usual one, which is made longer while it is taken."""
        name = usual if own is None else own
        while own is None and (name in self.reading.quantities or name in self.reading.constants):
            name += "_"
        self.reading.add_name((*place, "name"), name, kind, Quantity(role, 0))
        return name if is_free_name(name) else usual

    # --- inputs ---

    def _is_lifted_input(self, i: int) -> bool:
        """Return whether an input becomes a state: where it is linear, or a polynomial with a rate."""
        if self.inputs[i] in self.section.forces:
            return False
        rates, cost = self.section.bounds.input_rates, self.section.cost
        is_bounded = isinstance(rates, tuple) or self.inputs[i] in rates
        has_price = cost.input_rates != type(cost).model_fields["input_rates"].default
        return self.form.course == "linear" or (self.form.course == "polynomial" and (is_bounded or has_price))

    def _is_lifted_control(self, name: str, section: ControlSection) -> bool:
        has_rate = section.rate is not None
        is_linear = self.form.course == "linear" and name not in self.determined
        return is_linear or (self.form.course == "polynomial" and has_rate)

    def _rate(self, problem: Problem) -> Problem:
        """Read the rates of controls."""
        controls, prices, reading = [], [], self.reading
        for control in problem.controls:
            section = self.section.controls[control.name].rate
            if section is None:
                controls.append(control)
                continue
            place: Place = ("controls", control.name, "rate")
            limits = reading.range((*place, "range"), section.range)
            weight = reading.number((*place, "weight"), section.weight, least=0)
            if limits == FREE and weight == 0:
                reading.fault(place, "no bounds and no weight", "give a range, a weight, or leave the rate out")
            controls.append(replace(control, rates=limits))
            prices += [(control.name, weight)] if weight else []
        for i, limits in enumerate(problem.bounds.rates):
            if limits != FREE and self.inputs[i] in self.section.forces:
                given = self.section.bounds.input_rates
                inner: Place = ("bounds", "input_rates", *([self.inputs[i]] if isinstance(given, dict) else []))
                finding = f"forces gives the input {self.inputs[i]}, and no difference of constant inputs is its rate"
                reading.fault(inner, finding, "bound the rate of a state or a control in its expression")
        if all(self.section.controls[control.name].rate is None for control in problem.controls):
            return problem
        cost = replace(problem.cost, control_rates=tuple(prices))
        return replace(problem, controls=tuple(controls), cost=cost)

    def _lift(self, problem: Problem) -> Problem:
        """Make inputs and controls continuous."""
        if self.lifted_controls:
            weights, cost = dict(problem.cost.control_rates), problem.cost
            rates = {control.name: control.rates for control in problem.controls}
            left = tuple((name, weight) for name, weight in cost.control_rates if name not in self.lifted_controls)
            problem = lift_controls(
                replace(problem, cost=replace(cost, control_rates=left)),
                [Lifted(name, self.rates[name], rates[name], weights.get(name, 0.0)) for name in self.lifted_controls],
            )
        if self.lifted_inputs:
            ranges = problem.bounds.rates or (FREE,) * len(self.inputs)
            problem = lift_inputs(
                problem,
                [
                    (i, Lifted(self.states[i], RATE + self.texts[i], ranges[i]), self.texts[i])
                    for i in self.lifted_inputs
                ],
            )
        return problem

    # --- delays ---

    def _list_delays(self, problem: Problem) -> Iterator[Delay]:
        """Read the delays of inputs and controls."""
        given, reading = self.form.delay, self.reading
        place: Place = ("inputs", "delay")
        named: dict[str, Expression | None] = dict.fromkeys(self._list_open(), None)
        if isinstance(given, dict):
            named = dict(given)
        elif given is not None:
            named = dict.fromkeys(named, given)
        for name, expression in named.items():
            inner: Place = (*place, name) if isinstance(given, dict) else place
            i = reading.find(inner, name, self.inputs, "actuated coordinate")
            if i is None or expression is None:
                continue
            if name in self.section.forces:
                reading.fault(inner, f"forces gives the input {name}", "delay the controls that its expression reads")
                continue
            yield from self._make_delay(inner, "input", i, expression, self._find_history(name), problem.bounds.u[i])
        self._check_histories(named)
        for i, (name, section) in enumerate(self.section.controls.items()):
            inner = ("controls", name)
            if section.delay is not None:
                bounds = problem.controls[i].bounds
                yield from self._make_delay((*inner, "delay"), "control", i, section.delay, section.history, bounds)
            elif section.history is not None:
                reading.fault((*inner, "history"), "a history without a delay", "give delay, too, or leave it out")

    def _list_open(self) -> list[str]:
        return [name for name in self.inputs if name not in self.section.forces]

    def _find_history(self, name: str) -> Expression | str | None:
        given = self.form.history
        return given.get(name) if isinstance(given, dict) else given

    def _check_histories(self, delayed: dict[str, Expression | None]) -> None:
        """Report histories of inputs that have no delay."""
        given = self.form.history
        if self.form.delay is None and given is not None:
            self.reading.fault(("inputs", "history"), "a history without a delay", "give delay, too, or leave it out")
            return
        for name in given if isinstance(given, dict) else ():
            if name not in delayed:
                finding = f"{abbreviate(name)} has no delay"
                self.reading.fault(("inputs", "history", name), finding, "give it one under delay, or leave it out")

    def _make_delay(
        self, place: Place, kind: str, index: int, given: Expression, history: Expression | str | None, bounds: Range
    ) -> Iterator[Delay]:
        reading = self.reading
        seconds = reading.number(place, given, least=math.ulp(0))
        if history is None and reading.is_linked:
            finding = "the phase before gave the inputs that act first, and the file does not say which"
            reading.fault(place, finding, "give history: link, for commands of the phase before; a number; or free")
            return
        before = None
        inner: Place = (*place[:-1], "history") if kind == "control" else ("inputs", "history")
        if history == LINK and not reading.is_linked:
            reading.fault(inner, "no link leads here, whose phase would have given commands", "give a number, or free")
        if not isinstance(history, str):
            before = 0.0 if history is None else reading.number(inner, history)
            if before < bounds[0] or before > bounds[1]:
                finding = f"the history {before:g} is out of [{bounds[0]:g}, {bounds[1]:g}]"
                reading.fault(place if history is None else inner, finding, "give history within the bounds, or free")
        if math.isfinite(seconds):
            yield Delay("control" if kind == "control" else "input", index, seconds, before, history == LINK)

    # --- soft constraints ---

    def _soften(self, problem: Problem, i: int, section: Expression | SoftSection) -> Problem:
        place: Place = ("constraints", i)
        part, reading = self.section.constraints[i], self.reading
        reading.check_formula((*place, "expression"), part.expression)
        limits = reading.range((*place, "range"), part.range)
        soft: Place = (*place, "soft")
        if isinstance(section, SoftSection):
            linear = reading.number((*soft, "linear"), section.linear, least=0)
            quadratic = reading.number((*soft, "quadratic"), section.quadratic, least=0)
        else:
            linear, quadratic = reading.number(soft, section, least=0), 0.0
        if linear == 0 and quadratic == 0:
            reading.fault(soft, "the violation has no price", "give linear, quadratic or both a positive weight")
        if limits == FREE:
            reading.fault((*place, "range"), "no bounds, so nothing is soft", "give a bound, or leave soft out")
        if part.at == "path" and problem.form is not Form.STANDARD:
            finding = f"the {problem.form.value} form takes no slacks along the path, which are controls"
            reading.fault(soft, finding, "take form: standard")
            return problem
        constraint = Constraint(part.expression, limits, part.at)
        return soften(problem, constraint, Price(linear, quadratic), self.slacks[i])
