"""C programs on a bare Cortex-M7: cross-compile them, run them in QEMU, count instructions and bytes.

C sources go in; the linked image, its sizes and symbols, its output and status come out, with the number of
instructions that it ran and the deepest use of its stack. `csrc/bare` holds the start-up code and the linker script.

QEMU's virtual time goes on by 64 ns an instruction (`-icount shift=6,sleep=off`), and the machine counts ticks of 40 ns
of that time: the count is exact to one instruction and the same in every run. QEMU knows no caches and no pipeline, so
it says nothing of cycles.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mbsgen.errors import MbsError
from mbsgen.resources import folder
from mbsrun.stack import GRAPHS, Function, read_graphs

SINGLE = "fpv5-sp-d16"  # the floating-point unit of most Cortex-M7
DOUBLE = "fpv5-d16"
FLAGS = (
    *("-std=c99", "-O2", "-ffp-contract=fast", "-fno-math-errno", "-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard"),
    *("-ffunction-sections", "-fdata-sections"),
)
LINK = ("-nostartfiles", "-nodefaultlibs", "-Wl,--gc-sections", "-lm", "-lc", "-lgcc")
EMULATOR = "qemu-system-arm"
COMPILER = "arm-none-eabi-gcc"
MACHINE = (
    *("-M", "mps2-an500", "-display", "none", "-monitor", "none", "-serial", "none", "-icount", "shift=6,sleep=off"),
    *("-chardev", "stdio,id=host", "-semihosting-config", "enable=on,target=native,chardev=host"),
)
PACKAGES = {
    COMPILER: "install gcc-arm-none-eabi and libnewlib-arm-none-eabi",
    "arm-none-eabi-size": "install binutils-arm-none-eabi",
    "arm-none-eabi-nm": "install binutils-arm-none-eabi",
    EMULATOR: "install qemu-system-arm",
}
# Bytes of newlib's functions, from runs: sine reduces a large argument by a long division.
LIBRARY = {"sinf": 512, "cosf": 512, "tanf": 512}
OTHER = 96  # of all other functions
START = 32  # of the code that calls main
_COUNTS = re.compile(r"^mbs_bare_instructions (\d+)\nmbs_bare_stack (\d+)\n\Z", re.MULTILINE)


class BareError(MbsError):
    """A program that cannot be compiled for the bare machine, or that does not end there."""


@dataclass(frozen=True)
class Image:
    """A linked program."""

    path: Path
    code: int  # bytes that stay in flash memory: instructions and constants
    data: int  # bytes of variables with a first value
    zeros: int  # bytes of variables without one, and of the stack
    symbols: frozenset[str]  # that it defines


@dataclass(frozen=True)
class Outcome:
    """The output, status and counts of a run."""

    status: int
    output: str
    instructions: int  # of main
    stack: int  # bytes of its deepest use

    def numbers(self, name: str) -> list[float]:
        """Return the numbers of the lines `name number`."""
        found = re.findall(rf"^{re.escape(name)} (\S+)$", self.output, re.MULTILINE)
        return [float.fromhex(text) if "x" in text else float(text) for text in found]


def build(sources: Sequence[Path], image: Path, flags: Sequence[str] = (), unit: str = SINGLE) -> Image:
    """Compile sources and link them, or objects, with the start-up code.

    `flags` are more flags of the compiler, such as -I and -D; `unit` is the floating-point unit. No heap is linked: a
    program that allocates memory does not link. Raises BareError with the compiler's message.
    """
    place = folder("csrc") / "bare"
    files = [*map(str, sources), str(place / "mbs_bare.c")]
    script = ("-T", str(place / "mps2_an500.ld"))
    _call(COMPILER, *FLAGS, f"-mfpu={unit}", f"-I{place}", *flags, *files, *script, *LINK, "-o", str(image))
    sizes = _call("arm-none-eabi-size", str(image)).splitlines()[1].split()
    symbols = _call("arm-none-eabi-nm", "--defined-only", "--format=just-symbols", str(image)).split()
    return Image(image, int(sizes[0]), int(sizes[1]), int(sizes[2]), frozenset(symbols))


def compile_object(sources: Sequence[Path], made: Path, flags: Sequence[str] = (), unit: str = SINGLE) -> Path:
    """Compile sources to one object file, which `build` takes as a source, with call graphs beside it."""
    command = (*FLAGS, f"-mfpu={unit}", *flags, GRAPHS, "-r", "-nostdlib", *map(str, sources))
    _call(COMPILER, *command, "-o", str(made))
    return made


def find_needs(made: Path) -> frozenset[str]:
    """Return the symbols that an object file needs of others."""
    return frozenset(_call("arm-none-eabi-nm", "--undefined-only", "--format=just-symbols", str(made)).split())


def read_functions(made: Path) -> dict[str, Function]:
    """Read the call graphs beside an object file of `compile_object`."""
    return read_graphs([path.read_text("utf-8") for path in sorted(made.parent.glob(f"{made.name}-*.ci"))])


def run(image: Path, seconds: float = 30.0) -> Outcome:
    """Run an image in QEMU. Raises BareError if it faults, or does not end in `seconds` of the host's clock."""
    try:
        done = subprocess.run(
            [_find(EMULATOR), *MACHINE, "-kernel", str(image)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise BareError(
            f"{image}: does not end within {seconds:g} s in {EMULATOR}; allow more, or shorten it"
        ) from None
    found = _COUNTS.search(done.stdout)
    if not found:
        said = (done.stdout + done.stderr).strip()
        raise BareError(
            f"{image}: stopped by a fault, such as an overflow of its stack, with status {done.returncode}; it "
            f"printed:\n{said}"
        )
    return Outcome(done.returncode, done.stdout[: found.start()], int(found[1]), int(found[2]))


def find_tools() -> None:
    """Raise BareError if a tool is missing, before there is any work to lose."""
    for tool in PACKAGES:
        _find(tool)


def _find(tool: str) -> str:
    path = shutil.which(tool)
    if path is None:
        raise BareError(f"{tool} is not on the PATH; {PACKAGES[tool]}")
    return path


def _call(tool: str, *arguments: str) -> str:
    done = subprocess.run([_find(tool), *arguments], capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        raise BareError(f"{tool} failed with status {done.returncode}:\n{done.stderr.strip()}")
    return done.stdout
