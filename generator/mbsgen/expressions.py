"""Expressions in untrusted files, such as `2*l1 + sin(pi/4)`: text -> `Expression` -> a number of any type.

`90 deg` is 90*(pi/180): the word multiplies the term before it, back to the last + or -. Powers whose exponent is no
whole number are written by sqrt, exp and log: x**1.5 is sqrt(x)**3, and x**(2/3) is exp(2/3*log(x)).

Python's parser gives the grammar, a white list decides which nodes are accepted, and the text is never run. The result
is a small tree of our own types. Length, nesting, size and powers are bounded.

Beside the usual functions there are

    max(x, y), min(x, y)    the larger or smaller one is differentiated; where they are equal, half of each
    step(x, w)              1/(1 + exp(-x/w)), a smooth step from 0 to 1 of width w
    softplus(x, w)          w log(1 + exp(x/w)), a smooth max(x, 0), of which step(x, w) is the derivative

    smoothmax(x, y, w)      x + (y - x) step(y - x, w), a smooth max(x, y), equal to it where they are far apart
    bezier(x, x0, y0, xc, yc, x1, y1, c)
                            y over x along the quintic Bezier curve from (x0, y0) to (x1, y1) whose tangents meet at
                            (xc, yc), of curviness c; y0 before x0, y1 after x1

step, softplus and smoothmax have all derivatives, and no argument makes them overflow. max, min and abs have a kink;
their second derivatives are taken as 0 there as elsewhere. The curve of bezier has the control points P0,
P0 + c (Pc - P0) twice, P1 + c (Pc - P1) twice, and P1 (Millard, Uchida, Seth, Delp, 2013), so that it has no curvature
at its ends.
"""

from __future__ import annotations

import ast
import json
import keyword
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any, Generic, Literal, TypeVar

from mbsgen.errors import MbsError

# Files are untrusted: limits keep what an expression costs, to parse and to differentiate, in proportion to its text.
MAX_NODES = 4000  # so 4000 characters always pass
MAX_LENGTH = 12_000  # characters: room for the spaces and brackets with which expressions are written
MAX_DEPTH = 40  # walks over an expression recurse; sums and products that are longer are halved, again and again
MAX_POWER = 16  # of one **
MAX_DEGREE = 128  # of the whole: powers of powers, and products, in the same name or number
MAX_DIGITS = 64  # characters of one number

_UNARY = ("sin", "cos", "tan", "asin", "acos", "atan", "sqrt", "exp", "log", "tanh", "abs")
PRIMITIVES: Mapping[str, int] = MappingProxyType({**dict.fromkeys(_UNARY, 1), "atan2": 2, "max": 2})  # of an Algebra
BEZIER = "bezier"
LONG = (BEZIER, "smoothmax")  # their definitions repeat arguments
DEFINED: Mapping[str, tuple[str, ...]] = MappingProxyType(  # by others: their arguments; see _DEFINITIONS
    {
        **dict.fromkeys(("min", "step", "softplus"), ("x", "w")),
        "smoothmax": ("x", "y", "w"),
        BEZIER: ("x", "x0", "y0", "xc", "yc", "x1", "y1", "c"),
    }
)
FUNCTIONS: Mapping[str, int] = MappingProxyType({**PRIMITIVES, **{name: len(x) for name, x in DEFINED.items()}})
CONSTANTS = ("pi",)


class ExpressionError(MbsError):
    """An expression that cannot be read, or has no value: the finding and the remedy."""

    def __init__(self, finding: str, remedy: str) -> None:
        self.finding = finding
        self.remedy = remedy
        super().__init__(f"{finding}; {remedy}")


@dataclass(frozen=True)
class Number:
    """A literal; it means the nearest double."""

    value: float


@dataclass(frozen=True)
class Constant:
    """A number with a name in mathematics: pi."""

    name: str


@dataclass(frozen=True)
class Name:
    """A name whose value is given at evaluation."""

    name: str


@dataclass(frozen=True)
class Negation:
    """Minus its operand."""

    operand: Expression


@dataclass(frozen=True)
class Operation:
    """Two operands joined by + - * /."""

    operator: Literal["+", "-", "*", "/"]
    left: Expression
    right: Expression


@dataclass(frozen=True)
class Power:
    """A base raised to a whole number."""

    base: Expression
    exponent: int


@dataclass(frozen=True)
class Call:
    """A function of the table applied to its arguments."""

    function: str
    arguments: tuple[Expression, ...]


Expression = Number | Constant | Name | Negation | Operation | Power | Call

T = TypeVar("T")


@dataclass(frozen=True)
class Algebra(Generic[T]):
    """The operations of a number type that evaluation needs.

    Its functions raise ArithmeticError or ValueError where they are not defined, or overflow.
    """

    number: Callable[[float], T]
    constants: Mapping[str, T]
    negate: Callable[[T], T]
    operations: Mapping[str, Callable[[T, T], T]]  # + - * /
    power: Callable[[T, int], T]
    functions: Mapping[str, Callable[..., T]]  # PRIMITIVES; functions of DEFINED here are not written out


@lru_cache(maxsize=1024)  # problems of a batch have the same expressions
def parse(text: str) -> Expression:
    """Read an expression. Raises ExpressionError for anything but numbers, names, + - * / **, and known functions."""
    if not text.strip():
        raise ExpressionError("an empty expression", "give a number or an expression such as l1/2")
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"an expression of {len(text)} characters", f"give at most {MAX_LENGTH}")
    _check_tokens(text)
    try:
        tree = ast.parse(_DEGREES.sub("*(pi/180)", text.strip()), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ExpressionError(f"{_quote(text)} is not an expression", "mend it, e.g. l1/2 or -2*(a + b)") from None
    nodes = sum(isinstance(node, ast.expr) for node in ast.walk(tree))
    if nodes > MAX_NODES:
        raise ExpressionError(f"an expression of {nodes} terms", f"give at most {MAX_NODES}; name its parts")
    expression = _convert_plainly(tree)
    if (degree := measure(expression).degree) > MAX_DEGREE:
        raise ExpressionError(f"an expression of degree {degree}", f"give powers and products up to {MAX_DEGREE}")
    return expression


def is_free_name(text: str) -> bool:
    """Return whether expressions can use a text as the name of a number, because it has no other meaning."""
    is_word = re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", text) is not None
    return is_word and text not in (*FUNCTIONS, *CONSTANTS) and not keyword.iskeyword(text)


def spell(words: Sequence[str]) -> list[str | None]:
    """Write words as parts of names, with _ for all but letters a to z and digits; None where two would be alike."""
    spelled = [re.sub(r"\W", "_", word, flags=re.ASCII) for word in words]
    return [new if new == old or spelled.count(new) == 1 else None for old, new in zip(words, spelled, strict=True)]


def names(expression: Expression) -> frozenset[str]:
    """Collect the names in an expression."""
    if isinstance(expression, Name):
        return frozenset((expression.name,))
    return frozenset().union(*map(names, list_operands(expression)))


def _has_names(expression: Expression) -> bool:
    return isinstance(expression, Name) or any(map(_has_names, list_operands(expression)))


def substitute(expression: Expression, values: Mapping[str, Expression]) -> Expression:
    """Put expressions in place of names."""
    match expression:
        case Name(name):
            return values.get(name, expression)
        case Negation(operand):
            return Negation(substitute(operand, values))
        case Operation(_, left, right):
            return replace(expression, left=substitute(left, values), right=substitute(right, values))
        case Power(base):
            return replace(expression, base=substitute(base, values))
        case Call(_, arguments):
            return replace(expression, arguments=tuple(substitute(x, values) for x in arguments))
    return expression


def fold(expression: Expression) -> Expression:
    """Compute the parts of an expression that have no names, in doubles. Raises ExpressionError without a value."""
    if not _has_names(expression):
        value = evaluate(expression, {}, FLOATS)
        return Negation(Number(-value)) if value < 0 else Number(value)
    match expression:
        case Negation(operand):
            return Negation(fold(operand))
        case Operation(_, left, right):
            return replace(expression, left=fold(left), right=fold(right))
        case Power(base):
            return replace(expression, base=fold(base))
        case Call(_, arguments):
            return replace(expression, arguments=tuple(map(fold, arguments)))
    return expression


def evaluate(expression: Expression, values: Mapping[str, T], algebra: Algebra[T]) -> T:
    """Compute an expression in a number type. Raises ExpressionError for unknown names and where it has no value."""
    if isinstance(expression, Number):
        return algebra.number(expression.value)
    return Program((expression,), algebra).evaluate(values)[0]


@dataclass(frozen=True)
class _Step(Generic[T]):
    """A part of a program that is computed from others; `expression` is named where it has no value."""

    part: int
    compute: Callable[..., T]
    operands: tuple[int, ...]
    expression: Expression


class Program(Generic[T]):
    """Expressions as steps, each part that occurs several times once: quicker than `evaluate` from the second time."""

    def __init__(self, expressions: Sequence[Expression], algebra: Algebra[T]) -> None:
        """Write the steps in the order of evaluation."""
        self._algebra = algebra
        self._parts: dict[tuple[str, tuple[int, ...]], int] = {}  # their numbers, by operation and operands
        self._values: list[Any] = []  # of parts that are numbers and constants
        self._names: dict[str, int] = {}
        self._steps: list[_Step[T]] = []
        self._results = [self._add(expression) for expression in expressions]

    def evaluate(self, values: Mapping[str, T]) -> list[T]:
        """Compute all expressions. Raises ExpressionError for unknown names and where one has no value."""
        found = self._values.copy()
        for name, part in self._names.items():
            if name not in values:
                raise ExpressionError(f"unknown name {_quote(name)}", _list_known(sorted(values)))
            found[part] = values[name]
        for step in self._steps:
            try:
                found[step.part] = step.compute(*[found[operand] for operand in step.operands])
            except (ArithmeticError, ValueError):
                finding = f"{write(step.expression)} has no value"
                raise ExpressionError(finding, "keep to what the function is defined for") from None
        return [found[part] for part in self._results]

    def _add(
        self,
        expression: Expression,
        given: Mapping[str, int] = MappingProxyType({}),
        whole: Expression | None = None,
    ) -> int:
        """Add a part and return its number; `given` are parts that names stand for in the definition of `whole`."""
        if isinstance(expression, Name) and expression.name in given:
            return given[expression.name]
        operands = tuple(self._add(operand, given, whole) for operand in list_operands(expression))
        if isinstance(expression, Call) and expression.function not in self._algebra.functions:
            return self._add_definition(expression.function, operands, whole or expression)
        key = (_label(expression), operands)
        if key not in self._parts:
            self._parts[key] = len(self._values)
            self._append(expression, operands, whole or expression)
        return self._parts[key]

    def _add_definition(self, function: str, operands: Sequence[int], whole: Expression) -> int:
        """Add the steps of a definition, each of which reads the arguments and the steps before it."""
        known = dict(zip(DEFINED[function], operands, strict=True))
        part = -1
        for name, step in _DEFINITIONS[function].items():
            known[name] = part = self._add(step, known, whole)
        return part

    def _append(self, expression: Expression, operands: tuple[int, ...], whole: Expression) -> None:
        part, algebra = len(self._values), self._algebra
        self._values.append(None)
        match expression:
            case Number(value):
                self._values[part] = algebra.number(value)
            case Constant(name):
                self._values[part] = algebra.constants[name]
            case Name(name):
                self._names[name] = part
            case Negation():
                self._steps.append(_Step(part, algebra.negate, operands, whole))
            case Operation(symbol):
                self._steps.append(_Step(part, algebra.operations[symbol], operands, whole))
            case Power(_, exponent):
                self._steps.append(_Step(part, lambda base: algebra.power(base, exponent), operands, whole))
            case Call(function):
                self._steps.append(_Step(part, algebra.functions[function], operands, whole))


def _label(expression: Expression) -> str:
    """Write what an expression does with its operands."""
    match expression:
        case Number(value):
            return repr(value)
        case Constant(name) | Name(name):
            return name
        case Negation():
            return "-"
        case Operation(symbol):
            return symbol
        case Power(_, exponent):
            return f"**{exponent}"
        case Call(function):
            return function


@dataclass(frozen=True)
class Measure:
    """The size of an expression: its terms, and its degree."""

    terms: int = 1
    degree: int = 1


def measure(expression: Expression, named: Mapping[str, Measure] = MappingProxyType({})) -> Measure:
    """Measure an expression in which some names stand for expressions of the given sizes."""
    if isinstance(expression, Name):
        return named.get(expression.name, Measure())
    inner = [measure(operand, named) for operand in list_operands(expression)] or [Measure(0)]
    terms, degrees = 1 + sum(x.terms for x in inner), [x.degree for x in inner]
    match expression:
        case Operation("*" | "/"):
            return Measure(terms, sum(degrees))
        case Power(_, exponent):
            return Measure(terms, degrees[0] * abs(exponent))
    return Measure(terms, max(degrees))


def write(expression: Expression) -> str:
    """Write an expression as text that `parse` reads as the same expression."""
    return _write(expression, 0)


def list_operands(expression: Expression) -> tuple[Expression, ...]:
    """List the expressions that an expression is directly made of."""
    match expression:
        case Negation(operand) | Power(operand):
            return (operand,)
        case Operation(_, left, right):
            return (left, right)
        case Call(_, arguments):
            return arguments
    return ()


def find_first_name(expression: Expression) -> str:
    """Return the name that an expression begins with; "" where it begins with a number."""
    while not isinstance(expression, Name):
        operands = list_operands(expression)
        if not operands:
            return ""
        expression = operands[0]
    return expression.name


# --- doubles -------------------------------------------------------------------------------------------------------


def _finite(function: Callable[..., float]) -> Callable[..., float]:
    """Make a function raise where it overflows, as it does where it is undefined."""

    def compute(*operands: float) -> float:
        result = function(*operands)
        if not math.isfinite(result):
            raise OverflowError
        return result

    return compute


_BUILT_IN: Mapping[str, Callable[..., float]] = {"abs": abs, "max": max}
_MATH: Mapping[str, Callable[..., float]] = {name: getattr(math, name) for name in PRIMITIVES if name not in _BUILT_IN}

FLOATS: Algebra[float] = Algebra(
    number=float,
    constants={"pi": math.pi},
    negate=operator.neg,
    operations={
        symbol: _finite(function)
        for symbol, function in zip("+-*/", (operator.add, operator.sub, operator.mul, operator.truediv), strict=True)
    },
    power=_finite(operator.pow),
    functions={**_BUILT_IN, **{name: _finite(function) for name, function in _MATH.items()}},
)


# --- reading -------------------------------------------------------------------------------------------------------

_NUMBER = re.compile(r"(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_TOKEN = re.compile(rf"(?P<number>{_NUMBER.pattern})|(?P<name>[^\W\d]\w*)|\*\*|[-+*/(),]|[ \t\n]+", re.ASCII)
_DEGREES = re.compile(r"(?<=[\w.)])[ \t\n]+deg(?!\w)(?![ \t\n]*\()", re.ASCII)  # the term before it is in degrees
_OPERATORS: Mapping[type[ast.operator], Literal["+", "-", "*", "/"]] = MappingProxyType(
    {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
)
_FACTORS = (ast.Mult, ast.Div)
_SHORT = 4  # terms of a sum, factors of a product, that are not halved


def _mend_character(character: str) -> str:
    """Return the remedy for a character that expressions do not have."""
    if character == "^":
        return "write a power as **"
    if character.isalpha():
        return "names in expressions have the letters a to z, digits and _; rename what is meant in its file"
    return "use numbers, names, + - * / ** ( ) and functions"


def _check_tokens(text: str) -> None:
    """Check that a text contains only words of the language, before Python's parser sees it."""
    position, previous = 0, ""
    while position < len(text):
        token = _TOKEN.match(text, position)
        if token is None:
            raise ExpressionError(
                f"{_quote(text[position])} has no meaning in an expression", _mend_character(text[position])
            )
        if previous == "number" and token.lastgroup in ("number", "name"):
            raise ExpressionError(f"{_quote(text[:60])} joins a number to a word", "put * or a space between")
        if token["number"]:
            read_double(token["number"])
        previous = token.lastgroup or ""
        position = token.end()


def read_double(digits: str) -> float:
    """Read a number in decimal digits. Raises ExpressionError where no double other than 0 or infinity is near."""
    if len(digits) > MAX_DIGITS:
        raise ExpressionError(f"a number of {len(digits)} characters", f"give at most {MAX_DIGITS}")
    value = float(digits)
    if math.isinf(value):
        raise ExpressionError(f"{digits} is beyond the largest double", "give a smaller number")
    if value == 0 and re.search("[1-9]", re.split("[eE]", digits)[0]):
        raise ExpressionError(f"{digits} is below the smallest double", "give 0 or a larger number")
    return value


class _DeepError(ExpressionError):
    """An expression that is nested too deep."""


def _convert_plainly(tree: ast.expr) -> Expression:
    """Convert an expression in the order in which it is written, unless it is nested too deep for that."""
    try:
        return _convert(tree)
    except (_DeepError, RecursionError):  # recursion: of a finding that shows a part without a meaning
        pass
    try:
        return _convert(tree, halved=True)
    except RecursionError:
        raise _DeepError(f"an expression nested deeper than {MAX_DEPTH}", "name its parts") from None


def _convert(node: ast.expr, depth: int = 1, *, halved: bool = False) -> Expression:
    if depth > MAX_DEPTH:
        raise _DeepError(f"an expression nested deeper than {MAX_DEPTH}", "name its parts")
    convert = partial(_convert, halved=halved)
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return Number(float(value))
        case ast.Name(id=name):
            return Constant(name) if name in CONSTANTS else Name(name)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return Negation(convert(operand, depth + 1))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return convert(operand, depth + 1)
        case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
            return _raise(convert(base, depth + 1), convert(exponent, depth + 1))
        case ast.BinOp(op=op) if halved and type(op) in _OPERATORS and len(chain := _unroll(node)) > _SHORT:
            inverse: Literal["-", "/"] = "-" if isinstance(op, (ast.Add, ast.Sub)) else "/"
            below = depth + len(chain).bit_length()
            return _halve([(symbol == inverse, convert(term, below)) for symbol, term in chain], inverse)[1]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return Operation(_OPERATORS[type(op)], convert(left, depth + 1), convert(right, depth + 1))
        case ast.Call(func=ast.Name(id=function), args=arguments, keywords=[]):
            _check_call(function, len(arguments))
            return Call(function, tuple(convert(argument, depth + 1) for argument in arguments))
    raise ExpressionError(
        f"{_quote(ast.unparse(node))} has no meaning here", "use numbers, names, + - * / ** ( ) and functions"
    )


def _unroll(node: ast.expr) -> list[tuple[str, ast.expr]]:
    """List the terms of a sum, or the factors of a product, each with the sign that stands before it."""
    kinds = (ast.Add, ast.Sub) if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Sub)) else _FACTORS
    terms = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, kinds):
        terms.append((_OPERATORS[type(node.op)], node.right))
        node = node.left
    return [("", node), *reversed(terms)]


def _halve(terms: Sequence[tuple[bool, Expression]], inverse: Literal["-", "/"]) -> tuple[bool, Expression]:
    """Add up terms, or multiply factors, by halves; each comes with whether it is subtracted, or divided by.

    Returns the same of the whole; a first term that is added makes it added.
    """
    if len(terms) == 1:
        return terms[0]
    plain: Literal["+", "*"] = "+" if inverse == "-" else "*"
    middle = len(terms) // 2
    (is_minus, left), (is_also, right) = _halve(terms[:middle], inverse), _halve(terms[middle:], inverse)
    if is_minus == is_also:
        return is_minus, Operation(plain, left, right)
    return False, Operation(inverse, right, left) if is_minus else Operation(inverse, left, right)


def _raise(base: Expression, exponent: Expression) -> Expression:
    """Return x**n; for half a number sqrt(x)**(2 n), and for any other exp(n log(x)), so that x must be positive."""
    n = math.nan if names(exponent) else evaluate(exponent, {}, FLOATS)
    if not abs(n) <= MAX_POWER:
        remedy = f"give a number up to {MAX_POWER}; for others, exp(n*log(x)) is x to the n where x is positive"
        raise ExpressionError(f"exponent {_quote(write(exponent))}", remedy)
    if n.is_integer():
        return Power(base, int(n))
    if (2 * n).is_integer() and abs(2 * n) <= MAX_POWER:
        root = Call("sqrt", (base,))
        return root if n == 0.5 else Power(root, int(2 * n))
    return Call("exp", (Operation("*", exponent, Call("log", (base,))),))


def _check_call(function: str, arguments: int) -> None:
    if function not in FUNCTIONS:
        raise ExpressionError(f"unknown function {_quote(function)}", f"the functions are {', '.join(FUNCTIONS)}")
    if arguments != FUNCTIONS[function]:
        raise ExpressionError(f"{function} of {arguments} arguments", f"give {FUNCTIONS[function]}")


_ITERATIONS = 4  # of Halley's method: they lead to rounding for 0.1 <= c <= 0.9, and corners from 2 to 98 % of the way


def _define_bezier() -> Mapping[str, Expression]:
    """Write a Bezier curve in steps: the part u of the way at x, by Halley's method, and y there."""
    steps = {
        "place": "(x - x0)/(x1 - x0)",
        "at": "(abs(place) - abs(place - 1) + 1)/2",
        "a": "c*(xc - x0)/(x1 - x0)",
        "b": "1 - c*(x1 - xc)/(x1 - x0)",
        "third": "10*b",
        "fourth": "10*a - 15*b",
        "fifth": "1 + 5*b - 5*a",
        "t": "2*at - 1",
        "u0": "0.5 + t*(0.31 + 0.1265*t**2)",  # near the inverse of u**2 (3 - 2 u), which lies amid all these curves
    }
    for k in range(_ITERATIONS):
        u, f, d, e = (f"{key}{k}" for key in ("u", "miss", "slope", "bend"))
        steps |= {
            f: f"(5*a + {u}*({u}*(third + {u}*(fourth + {u}*fifth)) - 10*a))*{u} - at",
            d: f"5*a + {u}*({u}*(3*third + {u}*(4*fourth + 5*{u}*fifth)) - 20*a)",
            e: f"{u}*(6*third + {u}*(12*fourth + 20*{u}*fifth)) - 20*a",
            f"u{k + 1}": f"{u} - 2*{f}*{d}/(2*{d}**2 - {f}*{e})",
        }
    steps |= {"u": f"u{_ITERATIONS}", "v": "1 - u", "first": "y0 + c*(yc - y0)", "last": "y1 + c*(yc - y1)"}
    inner = "first*(5*u*v**4 + 10*u**2*v**3) + last*(10*u**3*v**2 + 5*u**4*v)"
    return {key: parse(text) for key, text in {**steps, "y": f"y0*v**5 + {inner} + y1*u**5"}.items()}


_DEFINITIONS: Mapping[str, Mapping[str, Expression]] = MappingProxyType(  # in steps; the last one is the value
    {
        "min": {"": parse("-max(-x, -w)")},
        "step": {"": parse("(1 + tanh(x/(2*w)))/2")},
        "softplus": {"": parse("w*(max(x/w, 0) + log(exp(-max(x/w, 0)) + exp(x/w - max(x/w, 0))))")},
        "smoothmax": {"more": parse("y - x"), "": parse("x + more*step(more, w)")},
        BEZIER: _define_bezier(),
    }
)


def _list_known(known: list[str]) -> str:
    if not known:
        return "no names are known here; give a number"
    return f"known here are {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}"


def _quote(text: str) -> str:
    return json.dumps(text if len(text) <= 40 else text[:37] + "...", ensure_ascii=False)


# --- writing -------------------------------------------------------------------------------------------------------


def _write(expression: Expression, binding: int) -> str:
    """Write with brackets where the context binds more strongly: + - 1, * / 2, minus sign 3, ** 4, else 5."""
    match expression:
        case Number(value):
            text = str(int(value)) if value.is_integer() and abs(value) < 1e16 else repr(value)
            strength = 3 if value < 0 else 5
        case Constant(name) | Name(name):
            text, strength = name, 5
        case Negation(operand):
            text, strength = f"-{_write(operand, 3)}", 3
        case Operation(symbol, left, right):
            strength = 1 if symbol in "+-" else 2
            joint = f" {symbol} " if strength == 1 else symbol
            text = f"{_write(left, strength)}{joint}{_write(right, strength + 1)}"
        case Power(base, exponent):
            text, strength = f"{_write(base, 5)}**{exponent}", 4
        case Call(function, arguments):
            text, strength = f"{function}({', '.join(_write(argument, 0) for argument in arguments)})", 5
    return text if strength >= binding else f"({text})"
