"""A number of a document, where an expression may stand as well: plain data -> `Expression`."""

from __future__ import annotations

import math
from typing import Any

from mbsgen.documents.places import abbreviate
from mbsgen.documents.validation import WrongValueError
from mbsgen.expressions import Expression, ExpressionError, Number, parse


def read_number(value: Any, *, example: str = "pi/2") -> Expression:
    """Read a finite number, or an expression such as `example`. Raises WrongValueError for anything else."""
    if isinstance(value, str):
        try:
            return parse(value)
        except ExpressionError as error:
            raise WrongValueError(error.finding, error.remedy) from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WrongValueError(f"found {abbreviate(value)}", f"give a number, or an expression such as {example}")
    if not math.isfinite(value):
        raise WrongValueError(f"found {value}", "give a finite number")
    return Number(float(value) or 0.0)  # no -0
