"""The methods of integration, by the names that a user says. To add one, write how it steps, and an entry here."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial

from mbsgen.manifest import Manifest
from mbsrun.ocp.ground import schemes
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration import adaptive, explicit, implicit, multipliers, stepping, switching, variational
from mbsrun.simulation.integration.method import Family, Integrator, Method
from mbsrun.simulation.motion import Impacts, Keeping, Settings

__all__ = [
    "METHODS",
    "Family",
    "Formulation",
    "Method",
    "choose_formulation",
    "complete_settings",
    "find_idle",
    "find_refusals",
    "takes_too_many_steps",
]

_STEP, _TOLERANCES = ("step",), ("rtol", "atol")


def _explicit(order: int, title: str, pair: explicit.Pair, stability: float) -> Method:
    family, settings = (Family.ADAPTIVE, _TOLERANCES) if pair.E else (Family.EXPLICIT, _STEP)
    integrate = partial(switching.integrate, pair)
    return Method(family, order, title, integrate, settings, stability, closed=integrate, keeps=explicit.KEEPS)


def _implicit_adaptive(order: int | None, title: str, stepper: str) -> Method:
    return Method(Family.ADAPTIVE, order, title, partial(adaptive.integrate, stepper), _TOLERANCES)


def _implicit(make: implicit.Make) -> Integrator:
    return partial(implicit.integrate, make)


METHODS: Mapping[str, Method] = {
    "euler": _explicit(1, "explicit Euler", explicit.EULER, 2.0),
    "symplectic-euler": Method(
        Family.IMPLICIT,
        1,
        "symplectic Euler in coordinates and momenta",
        _implicit(implicit.make_symplectic),
        _STEP,
        takes_quaternions=False,
        needs_residual=True,
    ),
    "rk4": _explicit(4, "the classical Runge-Kutta method", explicit.RK4, 2.785),
    "dop853": _explicit(8, "explicit Runge-Kutta of Dormand and Prince", explicit.DOP853, 6.1),
    "rk45": _explicit(5, "explicit Runge-Kutta of Dormand and Prince", explicit.RK45, 3.3),
    "lsoda": _implicit_adaptive(None, "Adams or BDF, as the stiffness asks for", adaptive.LSODA),
    "radau": _implicit_adaptive(5, "implicit Runge-Kutta, three Radau IIA stages", adaptive.RADAU),
    "bdf": _implicit_adaptive(None, "backward differentiation formulas", adaptive.BDF),
    "generalized-alpha": Method(
        Family.IMPLICIT,
        2,
        "generalised alpha of Chung and Hulbert",
        _implicit(implicit.make_alpha),
        (*_STEP, "rho"),
        closed=_implicit(multipliers.make_alpha),
        keeps=(Keeping.INDEX_3,),
    ),
    "variational": Method(
        Family.IMPLICIT,
        2,
        "variational steps in momenta, on the Lie group of the coordinates",
        variational.integrate,
        _STEP,
        needs_residual=True,
        closed=variational.integrate,
        keeps=(Keeping.RATTLE,),
    ),
    "moreau": Method(
        Family.IMPLICIT,
        2,
        "time stepping of Moreau and Jean: impulses of contacts, stops and friction; without these, implicit midpoint",
        stepping.integrate,
        _STEP,
        needs_residual=True,
        strikes=True,
    ),
    "radau-iia": Method(
        Family.IMPLICIT,
        None,
        "Radau collocation: order 2 stages - 1; 1 stage is implicit Euler",
        _implicit(partial(implicit.make_collocation, schemes.Family.RADAU)),
        (*_STEP, "stages"),
        closed=_implicit(multipliers.make_radau),
        keeps=(Keeping.GGL,),
    ),
    "gauss": Method(
        Family.IMPLICIT,
        None,
        "Gauss collocation: order 2 stages; 1 stage is the implicit midpoint rule",
        _implicit(partial(implicit.make_collocation, schemes.Family.LEGENDRE)),
        (*_STEP, "stages"),
    ),
}


def choose_formulation(method: str, formulation: Formulation) -> Formulation:
    """Return the formulation that a method evaluates: the residual, where it needs one and is given accelerations."""
    lacks_residual = METHODS[method].needs_residual and formulation.evaluated.is_direct
    return Formulation.IMPL if lacks_residual else formulation


def complete_settings(settings: Settings, *, is_closed: bool) -> Settings:
    """Return the settings with the method's own choices; `is_closed`: for a model with loops or driven joints."""
    method = METHODS[settings.method]
    formulation = choose_formulation(settings.method, settings.formulation)
    if not is_closed:
        return replace(settings, formulation=formulation)
    if method.family is Family.IMPLICIT and formulation.evaluated.is_direct:
        formulation = Formulation.IMPL
    return replace(settings, formulation=formulation, loops=settings.loops or next(iter(method.keeps), None))


def find_idle(settings: Settings, given: Collection[str]) -> Iterator[tuple[str, str, str]]:
    """Find settings that are given and have no effect: the setting, the finding and the remedy."""
    own = METHODS[settings.method].settings
    for name in sorted({name for method in METHODS.values() for name in method.settings} - {*own}):
        if name in given:
            known = ", ".join(other for other, method in METHODS.items() if name in method.settings)
            yield name, f"{settings.method} does not use it", f"leave it out, or give a method that does: {known}"
    for name in ("alpha", "beta"):
        if name in given and settings.loops is not Keeping.BAUMGARTE:
            yield name, "a gain of loops: baumgarte", "leave it out, or give that"


def find_refusals(settings: Settings, manifest: Manifest) -> Iterator[tuple[str, str, str]]:
    """Find what a model's loops and driven joints forbid: the setting, the finding and the remedy."""
    method = METHODS[settings.method]
    if settings.impacts is Impacts.POISSON and (not manifest.rigid or method.stability is None):
        finding = "poisson concerns rigid contacts, from event to event"
        yield (
            "impacts",
            finding,
            "leave it out: stops of joints with one restitution have the same impacts by both laws",
        )
    yield from _check_latches(settings, manifest)
    if manifest.meetings and not method.strikes:
        finding = f"{settings.method} takes no contacts of two solids, which the model has: {manifest.meetings[0].name}"
        yield "method", finding, "give moreau"
    if manifest.rigid and method.stability is not None:
        yield from _refuse_contacts(settings, manifest)
    elif latches := [point.name for point in manifest.rigid if point.hold > 0]:
        finding = f"{settings.method} takes no stops that hold, which the model has: {latches[0]}"
        yield "method", finding, "give dop853, or leave hold out"
    elif manifest.rigid and not method.strikes:
        finding = f"{settings.method} takes no rigid contacts, which the model has: {manifest.rigid[0].name}"
        yield "method", finding, "give moreau or dop853; or give contacts a stiffness in place of a restitution"
    elif manifest.loaded and method.strikes:
        finding = f"{settings.method} takes no friction by the load of joints: {', '.join(manifest.loaded)}"
        yield "method", finding, "give dop853, or a torque in place of load"
    elif manifest.switching and not method.strikes:
        yield from _refuse_switching(settings, manifest)
    if not (manifest.loops or manifest.driven):
        if settings.loops is not None:
            yield "loops", "the model has no loops", "leave it out"
        return
    if method.closed is None:
        known = ", ".join(name for name, x in METHODS.items() if x.closed is not None)
        yield "method", f"{settings.method} takes no loops or driven joints", f"give one of {known}"
        return
    if settings.loops is not None and settings.loops not in method.keeps:
        known = ", ".join(x.value for x in method.keeps)
        yield "loops", f"{settings.method} does not keep them closed by {settings.loops.value}", f"give one of {known}"
        return
    if settings.loops is Keeping.PARTITIONING and manifest.quaternions:
        yield "loops", "partitioning takes no quaternions", "give projection"
    if settings.loops is Keeping.BAUMGARTE:
        gain = max(settings.alpha, settings.beta)
        if method.has_fixed_steps and gain * settings.step > 1:
            finding = f"the gain {gain:g} 1/s times the step {settings.step:g} s is {gain * settings.step:.3g}"
            yield "step", finding, "keep it below 1, else the loops' own motion diverges"


def _check_latches(settings: Settings, manifest: Manifest) -> Iterator[tuple[str, str, str]]:
    """Find latches that the model has not, and times that do not follow each other."""
    known = list_latches(manifest)
    for latch in settings.latches:
        if latch.name not in known:
            given = f"give one of {', '.join(known)}" if known else "give hold to a rigid stop of the model"
            yield "latches", f"the model has no latch or coupling {latch.name}", given
        edges = [time for pair in latch.times for time in pair]
        if not latch.times:
            yield "latches", f"{latch.name} has no times", "give pairs of times: [[0, 1], [2, null]]"
        elif not edges[0] >= 0 or any(not a < b for a, b in itertools.pairwise(edges)):
            finding = f"the times of {latch.name} do not increase from 0 on"
            yield "latches", finding, "give pairs of times that follow each other: [[0, 1], [2, null]]"
    names = [latch.name for latch in settings.latches]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        yield "latches", f"{twice[0]} stands there twice", "give all of its times at once"


def list_latches(manifest: Manifest) -> list[str]:
    """List the stops of a model that hold."""
    return sorted({point.stop for point in manifest.rigid if point.hold > 0})


def _refuse_contacts(settings: Settings, manifest: Manifest) -> Iterator[tuple[str, str, str]]:
    others = {"loops": manifest.loops, "driven joints": manifest.driven, "stops or friction": manifest.switching}
    for what, found in others.items():
        if found:
            finding = f"{settings.method} takes no rigid contacts beside {what}, which the model has"
            yield "method", finding, "give moreau; or give contacts a stiffness in place of a restitution"


def _refuse_switching(settings: Settings, manifest: Manifest) -> Iterator[tuple[str, str, str]]:
    joints = ", ".join(manifest.switching)
    if METHODS[settings.method].stability is None:
        known = ", ".join(name for name, x in METHODS.items() if x.stability is not None)
        known += ", moreau"
        finding = f"{settings.method} takes no rigid stops or dry friction, which joints have: {joints}"
        yield "method", finding, f"give one of {known}; or smooth friction by a speed, and give stops a stiffness"
    if manifest.loops and settings.loops is Keeping.BAUMGARTE:
        finding = f"baumgarte lets loops open, where rigid stops or dry friction of joints {joints} hold them"
        yield "loops", finding, "give projection, mass-projection or partitioning"


def takes_too_many_steps(settings: Settings) -> bool:
    """Return whether a method with a fixed step cannot reach the end within `max_steps`."""
    is_fixed = METHODS[settings.method].has_fixed_steps
    return is_fixed and settings.duration / settings.step > settings.max_steps * (1 + 1e-12)  # to rounding
