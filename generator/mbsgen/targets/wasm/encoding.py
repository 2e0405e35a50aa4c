"""The binary format of WebAssembly, as far as straight-line code in doubles needs it: instructions, functions, modules.

Format: WebAssembly Core Specification 2.0, chapter 5. A function may return several values.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

HEADER = b"\0asm\x01\0\0\0"
I32, I64, F64 = 0x7F, 0x7E, 0x7C  # types of values
MOST_LOCALS = 50_000  # of a function, in engines
_FUNCTION, _MEMORY, _GLOBAL = 0x00, 0x02, 0x03  # kinds of exports


class Code(IntEnum):
    """Instructions without operands in the code."""

    ELSE = 0x05
    END = 0x0B
    RETURN = 0x0F
    DROP = 0x1A
    SELECT = 0x1B
    I32_EQZ = 0x45
    F64_LT = 0x63
    F64_GT = 0x64
    F64_LE = 0x65
    I64_ADD = 0x7C
    I64_SUB = 0x7D
    I64_AND = 0x83
    I64_XOR = 0x85
    I64_SHL = 0x86
    F64_ABS = 0x99
    F64_NEG = 0x9A
    F64_SQRT = 0x9F
    F64_ADD = 0xA0
    F64_SUB = 0xA1
    F64_MUL = 0xA2
    F64_DIV = 0xA3
    TO_BITS = 0xBD  # i64.reinterpret_f64
    FROM_BITS = 0xBF  # f64.reinterpret_i64


@dataclass(frozen=True)
class Signature:
    """The types of the arguments and results of a function."""

    arguments: tuple[int, ...]
    results: tuple[int, ...]


@dataclass(frozen=True)
class Import:
    """A function that the host provides."""

    module: str
    name: str
    signature: Signature


@dataclass(frozen=True)
class Function:
    """A function: its locals follow its arguments, and its code leaves its results on the stack."""

    signature: Signature
    locals: tuple[tuple[int, int], ...]  # counts and types
    code: bytes
    name: str | None = None  # under which it is exported


@dataclass(frozen=True)
class Module:
    """Imported functions, then own ones, which are numbered in this order; a memory, and where its free part begins."""

    imports: tuple[Import, ...]
    functions: tuple[Function, ...]
    heap: int  # bytes before it are zero, and stay so


def encode(module: Module) -> bytes:
    """Encode a module; it exports `memory`, the global `__heap_base`, and the functions that have names."""
    own: tuple[Import | Function, ...] = (*module.imports, *module.functions)
    signatures = list(dict.fromkeys(x.signature for x in own))
    pages = module.heap // 65536 + 1
    first = len(module.imports)

    def kind(function: Import | Function) -> bytes:
        return unsigned(signatures.index(function.signature))

    exports = [_name("memory") + bytes([_MEMORY, 0]), _name("__heap_base") + bytes([_GLOBAL, 0])]
    exports += [
        _name(function.name) + bytes([_FUNCTION]) + unsigned(first + k)
        for k, function in enumerate(module.functions)
        if function.name is not None
    ]
    sections = (
        (1, [b"\x60" + _types(x.arguments) + _types(x.results) for x in signatures]),
        (
            2,
            [_name(x.module) + _name(x.name) + b"\0" + kind(x) for x in module.imports],
        ),
        (3, [kind(x) for x in module.functions]),
        (5, [b"\0" + unsigned(pages)]),
        (6, [bytes([I32, 0]) + integer(module.heap) + bytes([Code.END])]),
        (7, exports),
        (10, [_sized(_body(x)) for x in module.functions]),
    )
    return HEADER + b"".join(bytes([number]) + _sized(_vector(items)) for number, items in sections if items)


def _body(function: Function) -> bytes:
    declared = [unsigned(count) + bytes([kind]) for count, kind in function.locals if count]
    return _vector(declared) + function.code + bytes([Code.END])


def _types(kinds: Sequence[int]) -> bytes:
    return _vector([bytes([kind]) for kind in kinds])


def _vector(items: Sequence[bytes]) -> bytes:
    return unsigned(len(items)) + b"".join(items)


def _sized(content: bytes) -> bytes:
    return unsigned(len(content)) + content


def _name(text: str) -> bytes:
    return _sized(text.encode())


def unsigned(number: int) -> bytes:
    """Encode a number that is not negative, in 7 bits a byte (LEB128)."""
    found = bytearray()
    while number > 0x7F:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)


def signed(number: int) -> bytes:
    """Encode a number of either sign, in 7 bits a byte."""
    found = bytearray()
    while not -0x40 <= number < 0x40:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number & 0x7F)
    return bytes(found)


# --- instructions ----------------------------------------------------------------------------------------------------


def code(*parts: bytes | Code) -> bytes:
    """Join instructions."""
    return b"".join(bytes([part]) if isinstance(part, Code) else part for part in parts)


def get(local: int) -> bytes:
    """Push a local."""
    return b"\x20" + unsigned(local)


def put(local: int) -> bytes:
    """Pop into a local."""
    return b"\x21" + unsigned(local)


def tee(local: int) -> bytes:
    """Copy the top of the stack to a local."""
    return b"\x22" + unsigned(local)


def call(function: int) -> bytes:
    """Call a function by its number."""
    return b"\x10" + unsigned(function)


def integer(number: int) -> bytes:
    """Push an i32."""
    return b"\x41" + signed(number)


def long(number: int) -> bytes:
    """Push an i64."""
    return b"\x42" + signed(number)


def double(number: float) -> bytes:
    """Push an f64."""
    return b"\x44" + struct.pack("<d", number)


def load_address(offset: int) -> bytes:
    """Replace an address by the i32 at a distance from it."""
    return b"\x28\x02" + unsigned(offset)


def load(offset: int) -> bytes:
    """Replace an address by the f64 at a distance from it."""
    return b"\x2b\x03" + unsigned(offset)


def store(offset: int) -> bytes:
    """Pop an f64 and an address, and write at a distance from it."""
    return b"\x39\x03" + unsigned(offset)


def when(*parts: bytes | Code) -> bytes:
    """Pop an i32, and run instructions where it is not 0."""
    return b"\x04\x40" + code(*parts, Code.END)


def join(parts: Iterable[bytes]) -> bytes:
    """Join instructions that are made one by one."""
    return b"".join(parts)
