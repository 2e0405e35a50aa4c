"""Equations to read: a tree's equations of motion as SymPy expressions, and as LaTeX, Markdown, HTML and Python.

`sums` holds trigonometric sums, a form in which equal functions are equal; `motion` finds the equations in it;
`named` takes out the numbers of forces that have names; `lines` keeps the recursion's own lines, for mechanisms whose
sums would fill pages, and `stepwise` takes the equations of motion apart in them; `printing` writes them.
"""

from mbsgen.equations.lines import Lines, write_lines
from mbsgen.equations.motion import EvaluationError, Line, Motion, Naming, build_numeric, build_symbolic, derive
from mbsgen.equations.printing import FORMATS, Page, show_lines, show_motion
from mbsgen.equations.stepwise import derive_stepwise
from mbsgen.equations.sums import SizeError

__all__ = [
    "FORMATS",
    "EvaluationError",
    "Line",
    "Lines",
    "Motion",
    "Naming",
    "Page",
    "SizeError",
    "build_numeric",
    "build_symbolic",
    "derive",
    "derive_stepwise",
    "show_lines",
    "show_motion",
    "write_lines",
]
