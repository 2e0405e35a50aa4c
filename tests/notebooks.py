"""Run a notebook without Jupyter: its cells in order, in one namespace; the last line of a cell is its output."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any


def run(path: Path) -> list[Any]:
    """Run the cells of a notebook, and return the value of each that has one."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    namespace: dict[str, Any] = {"__name__": "__main__"}
    values = []
    for number, cell in enumerate(cells):
        if cell["cell_type"] != "code":
            continue
        name = f"{path.name}, cell {number}"
        body = ast.parse("".join(cell["source"]), name).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), name, "exec"), namespace)  # noqa: S102  # the project's own files
        if isinstance(last, ast.Expr):
            values.append(eval(compile(ast.Expression(last.value), name, "eval"), namespace))  # noqa: S307
    return values
