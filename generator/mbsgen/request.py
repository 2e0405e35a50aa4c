"""The request: what is to be generated of a model, merged once from options and a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from mbsgen.errors import MbsError
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.changes.scene import EVERYTHING, LARGEST_TOLERANCE, Scene


@dataclass(frozen=True)
class CodeSize:
    """The sizes from which on code takes another form; all are measured."""

    # Operations from which on columns are looped over. A Panda's Jacobian of EXP1 (4700 operations) takes 0.47 us
    # straight and 0.62 with a loop, a quadruped's (20,000) 3.4 and 3.2, a humanoid's (110,000) 24 and 20.
    straight: int = 16_000
    # Operations of the loop from which on the straight code, which leaves zeros out, is certainly longer than
    # `straight`: a quadruped's loop has 30,000 for 20,000, a humanoid's 190,000 for 110,000.
    certain: int = 48_000
    # Pairs of a body with one that carries it, or itself, from which on first derivatives are loops over tables.
    # By tables a chain of 24 (300) takes 1.2 times as long as straight, of 32 (528) 0.9 times, of 48 (1176) a
    # third; Talos (38 joints in limbs) takes twice as long.
    looped: int = 800
    # Such pairs from which on M is: straight, a chain of 64 (2080) takes 0.75 times as long as by tables, of 128 (8256)
    # 1.5 times.
    matrix: int = 5_000
    compared: int = 12  # bodies: in larger trees, derivatives are written once for all forms
    # Operations of a function from which on Jacobians of its tape surely lose: of those tried, they won last in a star
    # of eight joints (144); the arm of the paper (230 to 453) has 1.1 to 2.9 times as many by its tape. Beside `few`
    # bodies, laws of force may have most of the operations.
    tried: int = 200
    few: int = 4


MEASURED = CodeSize()


@dataclass(frozen=True)
class Options:
    """The outputs to generate, besides the C of every function."""

    runtime: bool = False  # every number of the model a run-time parameter, see `model.changes.releasing`
    zeros: bool = False  # with `runtime`: also numbers that are 0
    targets: tuple[str, ...] = ()  # beside C, see `targets.languages`
    count: bool = True  # the formulations, for the report; they are written once more for this
    compare: bool = False  # also count the formulations without each reduction, and all ways of writing derivatives
    functions: tuple[str, ...] | None = None  # of the catalogue; None: the scene's
    optional: tuple[str, ...] = ()  # beside these, the ones of the catalogue that the model has
    values: tuple[str, ...] = ()  # the ones among these that are written without derivatives
    derivatives: int = 2  # the highest order; the scene may lower it
    scene: Path | Scene = EVERYTHING  # the part of the model to generate
    tolerance: float | None = None  # allowed relative error; None: the scene's
    reductions: Reductions = ALL  # what is done to lower the operation count
    size: CodeSize = MEASURED
    prefix: str | None = None  # that names in C begin with; None: made of the model's name
    opened: bool = False  # the forces of rigid stops, dry friction and rigid points are inputs


DEFAULT = Options()


class OptionError(MbsError):
    """Options that a model cannot be generated with."""


@dataclass(frozen=True)
class Request:
    """The merged options and scene. Of the scene, its functions and its order of derivatives are merged here."""

    functions: tuple[str, ...] | None = None  # of the catalogue; None: all that the model has
    optional: tuple[str, ...] = ()  # beside these, the ones that the model has
    values: tuple[str, ...] = ()  # the ones that are written without derivatives
    derivatives: int = 2  # up to which order
    targets: tuple[str, ...] = ()  # beside C
    runtime: bool = False  # every number of the model a run-time parameter
    zeros: bool = False  # with `runtime`: numbers that are 0 too
    count: bool = True  # the formulations, for the report
    compare: bool = False  # also count the formulations without each reduction, and all ways of writing derivatives
    scene: Scene = EVERYTHING  # the part of the model that is kept, and the tolerance
    reductions: Reductions = ALL
    size: CodeSize = MEASURED
    prefix: str | None = None  # that names in C begin with; None: made of the model's name

    @property
    def tolerance(self) -> float | None:
        """Return the relative error that may be made; None: no error."""
        return self.scene.tolerance

    @property
    def needed(self) -> tuple[str, ...] | None:
        """List the chosen functions, optional ones, and the parts of combined functions; None: all."""
        parts = [part for _, group in self.scene.together for part in group]
        return None if self.functions is None else tuple(dict.fromkeys((*self.functions, *self.optional, *parts)))

    @property
    def values_alone(self) -> Request:
        """Return the same request without derivatives, in C alone."""
        return replace(self, derivatives=0, targets=())


EVERY_FUNCTION = Request()


def merge(options: Options, scene: Scene) -> Request:
    """Merge options with the scene. Raises OptionError for options that contradict each other."""
    if options.zeros and not options.runtime:
        raise OptionError("zeros: they are parameters only with the other numbers; give runtime too")
    tolerance = scene.tolerance if options.tolerance is None else options.tolerance
    if not 0 <= (tolerance or 0) <= LARGEST_TOLERANCE:
        raise OptionError(f"tolerance: {tolerance} is no relative error; give a number from 0 to {LARGEST_TOLERANCE}")
    if tolerance and options.runtime:
        finding = "with every number a run-time parameter, no value decides what can be left out"
        raise OptionError(f"tolerance: {finding}; leave one of the options out")
    named = (*(options.functions or options.values), *options.optional)
    if strange := [name for name in options.values if name not in named]:
        raise OptionError(f"values: {', '.join(strange)} is not among the functions; name it there too")
    return Request(
        functions=scene.functions if options.functions is None else options.functions,
        optional=options.optional,
        values=options.values,
        derivatives=min(options.derivatives, scene.derivatives),
        targets=options.targets,
        runtime=options.runtime,
        zeros=options.zeros,
        count=options.count,
        compare=options.compare,
        scene=replace(scene, tolerance=tolerance or None),
        reductions=options.reductions,
        size=options.size,
        prefix=options.prefix,
    )
