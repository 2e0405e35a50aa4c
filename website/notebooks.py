"""Notebooks of examples: cells of Python -> a file of Jupyter, with the outputs of its cells.

`python -m website.notebooks FILE` runs a notebook without Jupyter, in its folder, and writes the outputs into it: the
last line of a cell is its output. The cells alone are the same at every build.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from website.examples import Example


def write(example: Example) -> str:
    """Return the notebook of an example, without outputs."""
    names = ", ".join(f"`{Path(file).name}`" for file in example.files if file.startswith("models/"))
    note = f"The notebook reads {names} in its folder."
    cells = [_make_cell(0, "markdown", f"# {example.title}\n\n{example.text}\n\n{note}")]
    cells += [_make_cell(number, "code", text) for number, text in enumerate(example.notebook, 1)]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return _print({"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5})


def execute(path: Path) -> list[Any]:
    """Run the cells of a notebook, write their outputs into it, and return the value of each cell that has one."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    values = []
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for count, (cell, (printed, value)) in enumerate(zip(code, run(path), strict=True), 1):
        cell["execution_count"] = count
        cell["outputs"] = [{"output_type": "stream", "name": "stdout", "text": _split(printed)}] if printed else []
        if value is not None:
            values.append(value)
            result = {"output_type": "execute_result", "execution_count": count, "metadata": {}, "data": show(value)}
            cell["outputs"].append(result)
    path.write_text(_print(notebook), encoding="utf-8")
    return values


def run(path: Path) -> Iterator[tuple[str, Any]]:
    """Run the cells of a notebook in one namespace; yield the text that each one prints, and its value or None."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        if cell["cell_type"] != "code":
            continue
        name = f"{path.name}, cell {number}"
        body = ast.parse("".join(cell["source"]), name).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        value = None
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(ast.Module(body, []), name, "exec"), namespace)  # noqa: S102  # the project's own files
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), name, "eval"), namespace)  # noqa: S307
        yield printed.getvalue(), value


def show(value: Any) -> dict[str, Any]:
    """Return a value as a notebook shows it, by type of media; a method that returns None has nothing to show."""

    def call(name: str) -> Any:
        return getattr(value, name, lambda: None)()

    data: dict[str, Any] = {"text/plain": _split(repr(value))}
    for media, name in (("text/latex", "_repr_latex_"), ("text/html", "_repr_html_")):
        if (text := call(name)) is not None:
            data[media] = _split(text)
    if (picture := call("_repr_png_")) is not None:
        data["image/png"] = base64.b64encode(picture).decode("ascii") + "\n"
    return data


def _make_cell(number: int, kind: str, text: str) -> dict[str, Any]:
    """Return a cell; its name is its number, since a random one would change with each build."""
    cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": _split(text)}
    return cell if kind == "markdown" else cell | {"execution_count": None, "outputs": []}


def _split(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def _print(notebook: dict[str, Any]) -> str:
    return json.dumps(notebook, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def run_file(path: str) -> None:
    """Run a notebook in its folder, and write the outputs into it."""
    file = Path(path).resolve()
    os.chdir(file.parent)
    execute(file)


if __name__ == "__main__":
    run_file(sys.argv[1])
