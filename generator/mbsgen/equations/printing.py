"""Equations as text, Python, LaTeX, Markdown and HTML.

A page holds named matrices or values, and the symbols that they read. HTML has MathML, which browsers draw without any
other file. Names of a model may have any characters: they are escaped, and made identifiers for Python.
"""

from __future__ import annotations

import html
import keyword
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import sympy as sp
from sympy.printing.mathml import mathml
from sympy.printing.str import StrPrinter

from mbsgen.equations.lines import Lines
from mbsgen.equations.motion import Motion, Naming
from mbsgen.model.smooth import SMOOTH, bezier, print_source
from mbsgen.targets.layout import lay_out

_WIDE = 90  # characters of a row beyond which a matrix is written entry by entry
_NUMBERED = re.compile(r"([A-Za-z]+)_?(\d+(?:_\d+)*)", re.ASCII)
_LETTERED = re.compile(r"([A-Za-z]|gap|depth|slip|drag|length|rate)_(.+)", re.ASCII)


@dataclass(frozen=True)
class Formula:
    """A named matrix or value."""

    name: str
    value: sp.Matrix | sp.Expr
    title: str = ""
    is_line: bool = False  # other formulas read it by its name


@dataclass(frozen=True)
class Page:
    """What is printed."""

    title: str
    statement: sp.Eq
    formulas: tuple[Formula, ...]
    naming: Naming
    notes: tuple[str, ...] = ()


def show_motion(motion: Motion, named_title: str = "contacts, springs and cables") -> Page:
    """Lay the equations of motion out, without the parts that are zero."""
    formulas = [
        Formula("M", motion.M, "mass matrix"),
        Formula("c", motion.c, "forces of motion: velocities cause them"),
        Formula("G", motion.g, "forces at rest: weight and springs"),
        Formula("Q", motion.applied, "applied forces"),
        Formula("h", motion.h, "loops: h = 0"),
        Formula("J", motion.J, "Jacobian of h"),
    ]
    formulas += [
        Formula(f"p_{name}", motion.position[:, k], f"place of {name} in the base frame")
        for k, name in enumerate(motion.sensors)
    ]
    kept = tuple(f for f in formulas if not f.value.is_zero_matrix)
    titles = (named_title, *[""] * len(motion.named))
    named = tuple(
        Formula(x.name.name, x.expression, title, is_line=True) for x, title in zip(motion.named, titles, strict=False)
    )
    terms = {f.name: sp.Symbol(f.name) for f in kept}
    left = [sp.Mul(sp.Symbol("M"), sp.Symbol("qdd"), evaluate=False), *(terms[x] for x in ("c", "G") if x in terms)]
    statement = sp.Eq(sp.Add(*left, evaluate=False), terms.get("Q", sp.Integer(0)), evaluate=False)
    return Page(f"Equations of motion of {motion.name}", statement, kept + named, motion.naming)


def show_lines(lines: Lines) -> Page:
    """Lay the lines of a recursion out, and then its results."""
    formulas = [Formula(x.name.name, x.expression, is_line=True) for x in lines.lines]
    formulas += [Formula(name, value, "residual") for name, value in lines.results.items()]
    statement = sp.Eq(sp.Symbol("Phi"), sp.Integer(0), evaluate=False)
    return Page(f"Equations of motion of {lines.name}, line by line", statement, tuple(formulas), lines.naming)


def separate(page: Page) -> Page:
    """Return a page in which no symbol of the model has the name of a matrix: a parameter M becomes M_p."""
    own = {*(formula.name for formula in page.formulas if not formula.is_line), "q", "qdd", "Phi"}
    taken = {*own, *(symbol.name for symbol in _list_symbols(page)), *page.naming.taken}
    renamed: dict[sp.Symbol, sp.Symbol] = {}
    notes = []
    moving = {symbol: k for k, symbol in enumerate(page.naming.q)}
    for symbol in sorted(_list_symbols(page) | set(moving), key=str):
        if symbol.name not in own:
            continue
        name, kind = f"{symbol.name}_p", "number"
        if symbol in moving:
            name, kind = f"{symbol.name}_q", "coordinate"
        while name in taken:
            name += "_"
        taken.add(name)
        renamed[symbol] = sp.Symbol(name, real=True)
        notes.append(f"{name} is the {kind} {symbol.name} of the model")
        if symbol in moving:
            for rates in (page.naming.qd, page.naming.qdd):
                rate = rates[moving[symbol]]
                renamed[rate] = sp.Symbol(name + rate.name.removeprefix(symbol.name), real=True)
    if not renamed:
        return page
    formulas = tuple(replace(f, value=f.value.xreplace(renamed)) for f in page.formulas)
    columns = {x.name: getattr(page.naming, x.name) for x in fields(page.naming)}
    naming = Naming(**{key: tuple(renamed.get(x, x) for x in column) for key, column in columns.items()})
    return replace(page, formulas=formulas, naming=naming, notes=(*page.notes, *notes))


# --- text and Python -------------------------------------------------------------------------------------------------


def write_text(page: Page) -> str:
    """Write plain text."""
    sides = (sp.sstr(side, order="none") for side in (page.statement.lhs, page.statement.rhs))
    lines = [page.title, "", " = ".join(sides), *page.notes]
    for formula in page.formulas:
        if formula.title:
            lines += ["", f"{formula.title}:"]
        lines += [f"  {name} = {_plain(value)}" for name, value in _list_entries(formula)]
    return "\n".join(lines) + "\n"


def write_python(page: Page) -> str:
    """Write a Python module that makes SymPy's objects."""
    names = _name_identifiers(page)
    lines = [f'"""{_escape_python(page.title)}."""', "", "import sympy as sp", ""]
    lines += [f"{name} = sp.Symbol({symbol.name!r}, real=True)" for symbol, name in _list_known(page, names)]
    lines += [part for function in _list_functions(page) for part in ("", "", print_source(function))]
    lines.append("")
    printer = _PythonPrinter({"full_prec": False})
    for formula in sorted(page.formulas, key=lambda x: not x.is_line):
        target = _make_identifier(formula.name)
        if formula.is_line:
            target = names.get(sp.Symbol(formula.name, real=True), target)
        value = formula.value.xreplace({symbol: sp.Symbol(name) for symbol, name in names.items()})
        lines.append(f"{target} = {printer.doprint(value)}")
    return "\n".join(lines) + "\n"


class _PythonPrinter(StrPrinter):  # type: ignore[misc]  # SymPy has no types
    """Writes expressions as calls of SymPy's functions."""

    def _print_Function(self, expr: sp.Function) -> str:
        text = super()._print_Function(expr)
        return text if isinstance(expr, SMOOTH) else f"sp.{text}"

    def _print_LatticeOp(self, expr: sp.Max | sp.Min) -> str:
        return f"sp.{super()._print_LatticeOp(expr)}"

    def _print_Abs(self, expr: sp.Abs) -> str:
        return f"sp.Abs({self._print(expr.args[0])})"

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
        text = super()._print_Pow(expr, rational=rational)
        return f"sp.{text}" if text.startswith("sqrt(") else text.replace("/sqrt(", "/sp.sqrt(")

    def _print_Rational(self, expr: sp.Rational) -> str:
        return f"sp.Rational({expr.p}, {expr.q})"

    def _print_MatrixBase(self, expr: sp.Matrix) -> str:
        rows = (", ".join(self._print(x) for x in expr.row(k)) for k in range(expr.rows))
        return "sp.Matrix([" + ", ".join(f"[{row}]" for row in rows) + "])"


def _list_known(page: Page, names: Mapping[sp.Symbol, str]) -> Iterator[tuple[sp.Symbol, str]]:
    lines = {formula.name for formula in page.formulas if formula.is_line}
    return ((symbol, name) for symbol, name in names.items() if symbol.name not in lines)


def _name_identifiers(page: Page) -> dict[sp.Symbol, str]:
    """Choose an identifier for every symbol."""
    taken = {"sp", *(_make_identifier(formula.name) for formula in page.formulas if not formula.is_line)}
    taken |= {function.__name__ for function in SMOOTH}
    names = {}
    for symbol in sorted(_list_symbols(page), key=lambda x: x.name):
        name = _make_identifier(symbol.name)
        while name in taken:
            name += "_"
        taken.add(name)
        names[symbol] = name
    return names


def _list_functions(page: Page) -> tuple[type[sp.Function], ...]:
    """List the smooth functions to define: `softplus` and `step` may have each other in their derivatives."""
    kinds = (tuple(x for x in SMOOTH if x is not bezier), (bezier,))
    return tuple(x for kind in kinds if any(formula.value.has(*kind) for formula in page.formulas) for x in kind)


def _make_identifier(name: str) -> str:
    found = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"{found}_" if keyword.iskeyword(found) or not found.isidentifier() else found


def _escape_python(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', "'")


def _plain(value: sp.Expr) -> str:
    return str(sp.sstr(value, full_prec=False))


# --- LaTeX and Markdown ----------------------------------------------------------------------------------------------


def write_latex(page: Page) -> str:
    """Write a fragment of LaTeX, for amsmath."""
    lines = [f"% {page.title}", _display(_latex_equation(page)), *(f"% {note}" for note in page.notes)]
    for formula in page.formulas:
        lines += [f"% {formula.title}"] * bool(formula.title)
        lines += [_display(text) for text in _write_latex(formula, page)]
    return "\n".join(lines) + "\n"


def write_markdown(page: Page) -> str:
    """Write Markdown with LaTeX between dollar signs."""
    lines = [f"# {page.title}", "", f"$${_latex_equation(page)}$$"]
    lines += [part for note in page.notes for part in ("", f"{note}.")]
    for formula in page.formulas:
        lines += ["", f"## {formula.title[0].upper()}{formula.title[1:]}"] if formula.title else []
        lines += [part for text in _write_latex(formula, page) for part in ("", f"$${text}$$")]
    return "\n".join(lines) + "\n"


def _display(text: str) -> str:
    return f"\\[\n{text}\n\\]"


def _latex_equation(page: Page) -> str:
    names = {sp.Symbol("qdd"): r"\ddot{q}", sp.Symbol("Phi"): r"\Phi"}
    sides = (page.statement.lhs, page.statement.rhs)
    return " = ".join(sp.latex(side, symbol_names=names, order="none") for side in sides)


def _write_latex(formula: Formula, page: Page) -> Iterator[str]:
    names = {symbol: _write_symbol(_classify(symbol, page.naming), _LATEX) for symbol in _list_symbols(page)}
    printed = partial(sp.latex, symbol_names=names, full_prec=False, mat_delim="(")
    target = _write_symbol((formula.name, 0), _LATEX)
    if _is_narrow(formula):
        yield f"{target} = {printed(formula.value)}"
        return
    for place, value in _list_places(formula):
        yield f"{target}_{{{place}}} = {printed(value)}"


# --- HTML ------------------------------------------------------------------------------------------------------------


def write_html(page: Page) -> str:
    """Write a page that needs no other file."""
    blocks = [(f.title, [_join(left, right) for left, right in _write_mathml(f, page)]) for f in page.formulas]
    left = "<mo>+</mo>".join(_to_mathml(x, page) for x in sp.Add.make_args(page.statement.lhs))
    statement = _join(left, _to_mathml(page.statement.rhs, page))
    notes = [html.escape(note) for note in page.notes]
    return lay_out(
        "html/equations.html", title=html.escape(page.title), statement=statement, notes=notes, blocks=_merge(blocks)
    )


def _merge(blocks: Sequence[tuple[str, list[str]]]) -> list[tuple[str, list[str]]]:
    """Put formulas without a title under the heading before them."""
    merged: list[tuple[str, list[str]]] = []
    for title, formulas in blocks:
        if merged and not title:
            merged[-1][1].extend(formulas)
        else:
            merged.append((html.escape(title), list(formulas)))
    return merged


def _join(left: str, right: str) -> str:
    return f'<math display="block"><mrow>{left}<mo>=</mo>{right}</mrow></math>'


def _write_mathml(formula: Formula, page: Page) -> Iterator[tuple[str, str]]:
    target = _write_symbol((formula.name, 0), _MATHML)
    if _is_narrow(formula):
        yield target, _to_mathml(formula.value, page)
        return
    for place, value in _list_places(formula):
        yield f"<msub>{target}<mn>{place}</mn></msub>", _to_mathml(value, page)


_SPACED = {  # products and minus signs as books set them
    "<mo>&InvisibleTimes;</mo>": '<mo lspace="0.12em" rspace="0.12em">&InvisibleTimes;</mo>',
    "<mo>-</mo>": "<mo>−</mo>",
}


def _to_mathml(value: sp.Matrix | sp.Expr, page: Page) -> str:
    """Write MathML; symbols go through it under names of letters, since it reads names by itself."""
    symbols = sorted(value.free_symbols, key=str)
    aliases = {symbol: sp.Symbol(f"zz{_count(k)}zz") for k, symbol in enumerate(symbols)}
    text = str(mathml(value.xreplace(aliases), printer="presentation"))
    for plain, spaced in _SPACED.items():
        text = text.replace(plain, spaced)
    for symbol, alias in aliases.items():
        text = text.replace(f"<mi>{alias.name}</mi>", _write_symbol(_classify(symbol, page.naming), _MATHML))
    return text


def _count(k: int) -> str:
    return "".join(chr(ord("a") + int(digit)) for digit in str(k))


# --- names -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Script:
    """How a language writes names: words, subscripts, and dots above."""

    word: Callable[[str], str]
    number: Callable[[str], str]
    below: Callable[[str, str], str]
    dotted: Callable[[str, int], str]


def _write_symbol(symbol: tuple[str, int], script: _Script) -> str:
    """Write a name with a number of dots; digits at its end go below."""
    name, dots = symbol
    numbered = _NUMBERED.fullmatch(name)
    found = numbered or _LETTERED.fullmatch(name)
    stem, index = found.groups() if found else (name, "")
    written = script.word(stem)
    written = script.dotted(written, dots) if dots else written
    if not index:
        return written
    return script.below(written, script.number(index.replace("_", ",")) if numbered else script.word(index))


def _classify(symbol: sp.Symbol, naming: Naming) -> tuple[str, int]:
    """Return the name of a coordinate or another symbol, and the number of its dots."""
    if symbol.name == "qdd":
        return "q", 2
    for dots, symbols in ((1, naming.qd), (2, naming.qdd)):
        if symbol in symbols:
            return symbol.name[: -1 - dots], dots
    return symbol.name, 0


_SPECIAL = {"\\": r"\backslash ", "^": r"\hat{}", "~": r"\sim "} | {x: f"\\{x}" for x in "&%$#_{}"}
_GREEK = frozenset(
    [
        *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu"),
        *("xi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega", "Phi"),
    ]
)


def _latex_word(name: str) -> str:
    if len(name) == 1 and name.isalpha():
        return name
    if name in _GREEK:
        return f"\\{name}"
    return r"\mathrm{" + "".join(_SPECIAL.get(x, x) for x in name) + "}"


def _mathml_word(name: str) -> str:
    if name in _GREEK:
        return f"<mi>&{name};</mi>"
    return f"<mi>{html.escape(name)}</mi>"


_LATEX = _Script(
    word=_latex_word,
    number=str,
    below=lambda word, index: f"{word}_{{{index}}}",
    dotted=lambda word, dots: rf"\{'d' * dots}ot{{{word}}}",
)
_MATHML = _Script(
    word=_mathml_word,
    number="<mn>{}</mn>".format,
    below=lambda word, index: f"<msub>{word}{index}</msub>",
    dotted=lambda word, dots: f"<mover>{word}<mo>{'˙¨'[dots - 1]}</mo></mover>",
)


# --- entries ---------------------------------------------------------------------------------------------------------


def _is_narrow(formula: Formula) -> bool:
    """Return whether a value can be written whole."""
    if not isinstance(formula.value, sp.MatrixBase):
        return True
    rows = (formula.value.row(k) for k in range(formula.value.rows))
    return all(sum(len(_plain(x)) for x in row) <= _WIDE for row in rows)


def _list_places(formula: Formula) -> Iterator[tuple[str, sp.Expr]]:
    """List the entries that are not 0 of a matrix with their places, from 1."""
    assert isinstance(formula.value, sp.MatrixBase), "expressions are written whole"
    matrix = formula.value
    for r in range(matrix.rows):
        for c in range(matrix.cols):
            if matrix[r, c] != 0:
                yield (f"{r + 1}" if matrix.cols == 1 else f"{r + 1},{c + 1}"), matrix[r, c]


def _list_entries(formula: Formula) -> Iterator[tuple[str, sp.Expr]]:
    """List the entries that are not 0 with their names."""
    if not isinstance(formula.value, sp.MatrixBase):
        yield formula.name, formula.value
        return
    for place, value in _list_places(formula):
        yield f"{formula.name}[{place}]", value


def _list_symbols(page: Page) -> set[sp.Symbol]:
    return {symbol for formula in page.formulas for symbol in formula.value.free_symbols}


FORMATS: Mapping[str, Callable[[Page], str]] = {
    "text": lambda page: write_text(separate(page)),
    "python": write_python,  # which takes further words, such as `sp`
    "latex": lambda page: write_latex(separate(page)),
    "markdown": lambda page: write_markdown(separate(page)),
    "html": lambda page: write_html(separate(page)),
}
