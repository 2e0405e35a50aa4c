"""The largest stack of C functions, from call graphs that the compiler writes.

C sources go in; the bytes of the deepest chain of calls come out. GCC writes for each file which function calls which,
and the bytes of each frame (`-fcallgraph-info=su`); a chain needs the sum of its frames. Calls through pointers go to
functions that the caller names by file. A function that calls itself again, by whatever way, is taken as often as the
caller allows.

The bytes belong to the compiler, the flags and the processor that the graphs were written for.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath

from mbsgen.errors import MbsError

GRAPHS = "-fcallgraph-info=su"  # GCC's flag
TASKS = {  # functions of csrc/stages, by file, that recursion.c calls for all stages
    "recursion.c": ("condense_stages", "collect_stages", "expand_stages", "add_transposed"),
    "newton.c": ("find_residuals",),
    "evaluate.c": ("values_of_stages", "jacobians_of_stages", "hessians_of_stages"),
}
_INDIRECT = "__indirect_call"
_NODE = re.compile(r'^node: \{ title: "([^"]*)" label: "[^"]*?\\n([^"]*?):\d+:\d+\\n(\d+) bytes \(([a-z,]+)\)', re.M)
_EDGE = re.compile(r'^edge: \{ sourcename: "([^"]*)" targetname: "([^"]*)"', re.M)


class StackError(MbsError):
    """A stack that cannot be bounded."""


@dataclass(frozen=True)
class Function:
    """A compiled function."""

    file: str
    frame: int  # bytes
    bounded: bool  # otherwise its frame grows at run time
    callees: tuple[str, ...]


@dataclass(frozen=True)
class Rules:
    """Facts that the graphs do not hold."""

    pointers: Mapping[str, Sequence[str]] = field(default_factory=dict)  # file: whom it calls through pointers
    library: Mapping[str, int] = field(default_factory=dict)  # bytes of functions without a graph
    other: int = 0  # bytes of all others without a graph
    depth: int = 1  # how often a function may be in one chain


@dataclass(frozen=True)
class Chain:
    """The deepest chain of calls, from the outermost function."""

    bytes: int
    functions: tuple[str, ...]


def read_graphs(graphs: Sequence[str]) -> dict[str, Function]:
    """Read call graphs of files as GCC writes them."""
    callees: dict[str, set[str]] = {}
    for graph in graphs:
        for caller, callee in _EDGE.findall(graph):
            callees.setdefault(_shorten(caller), set()).add(_shorten(callee))
    functions = {}
    for graph in graphs:
        for title, file, frame, kind in _NODE.findall(graph):
            name = _shorten(title)
            called = tuple(sorted(callees.get(name, ())))
            functions[name] = Function(PurePath(file).name, int(frame), kind != "dynamic", called)
    return functions


def list_tasks(prefix: str = "") -> tuple[str, ...]:
    """List what recursion.c of csrc/stages calls through pointers where there is no team; files may have a prefix."""
    return tuple(f"{prefix}{file}:{name}" for file, names in TASKS.items() for name in names)


def find_deepest(functions: Mapping[str, Function], roots: Sequence[str], rules: Rules) -> Chain:
    """Find the deepest chain of calls that begins with one of `roots`.

    Raises StackError for a root or a target of pointers without a graph, for calls through pointers of a file that
    `rules` do not name, and for a frame without bound.
    """
    named = [*roots, *(target for targets in rules.pointers.values() for target in targets)]
    missing = sorted({name for name in named if name not in functions})
    if missing:
        raise StackError(f"the call graphs have no {', '.join(missing)}")
    search = _Search(functions, rules, _find_cyclic(functions, rules))
    return max((search.descend(root, ()) for root in roots), key=lambda chain: chain.bytes)


@dataclass(frozen=True)
class _Search:
    """A search of deepest chains; it keeps the answers for the functions that a chain may repeat."""

    functions: Mapping[str, Function]
    rules: Rules
    cyclic: frozenset[str]
    found: dict[tuple[str, tuple[str, ...]], Chain] = field(default_factory=dict)

    def descend(self, name: str, above: tuple[str, ...]) -> Chain:
        """Return the deepest chain from a function; `above` holds the functions of cycles that led to it, sorted."""
        if name not in self.functions:
            return Chain(self.rules.library.get(name, self.rules.other), (name,))
        key = (name, above)
        if key not in self.found:
            self.found[key] = self._extend(name, above)
        return self.found[key]

    def _extend(self, name: str, above: tuple[str, ...]) -> Chain:
        function = self.functions[name]
        if not function.bounded:
            raise StackError(f"the frame of {name} in {function.file} grows at run time")
        chain = tuple(sorted((*above, name))) if name in self.cyclic else above
        best = Chain(0, ())
        for callee in _list_callees(name, function, self.rules):
            if chain.count(callee) < self.rules.depth:
                found = self.descend(callee, chain)
                best = found if found.bytes > best.bytes else best
        return Chain(function.frame + best.bytes, (name, *best.functions))


def _list_callees(name: str, function: Function, rules: Rules) -> tuple[str, ...]:
    if _INDIRECT not in function.callees:
        return function.callees
    if function.file not in rules.pointers:
        raise StackError(f"{name} in {function.file} calls through a pointer; name the functions that it may call")
    direct = set(function.callees) - {_INDIRECT}
    return tuple(sorted(direct | set(rules.pointers[function.file])))


def _find_cyclic(functions: Mapping[str, Function], rules: Rules) -> frozenset[str]:
    """Find the functions that may call themselves, directly or through others."""
    callees = {name: _list_callees(name, function, rules) for name, function in functions.items()}

    def reaches_itself(start: str) -> bool:
        seen: set[str] = set()
        left = list(callees[start])
        while left:
            name = left.pop()
            if name not in seen:
                seen.add(name)
                left += callees.get(name, ())
        return start in seen

    return frozenset(name for name in functions if reaches_itself(name))


def _shorten(title: str) -> str:
    """Drop the folder of `folder/file.c:function`."""
    return title.rpartition("/")[2]
