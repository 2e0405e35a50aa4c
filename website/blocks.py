"""The blocks of a page that are run: Markdown -> commands and Python, the lines that they print, and files to show.

A block fenced as `sh` or `python` is run, in order, in a folder that the blocks of a page share. A block fenced as
`text` that follows it quotes lines of its output. A comment `<!-- shows build/motion/plots.png: a motion -->` names a
file that the blocks write, and the site shows it there.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

NOT_RUN = "# not run"  # how a block opens that is left out
_BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```$(?:\n*^```text\n(.*?)^```$)?", re.MULTILINE | re.DOTALL)
_SHOWN = re.compile(r"^<!-- shows (\S+): (.+?) -->$", re.MULTILINE)
_PYTHON = "python - <<'END_OF_PYTHON'\n{}END_OF_PYTHON\n"


@dataclass(frozen=True)
class Block:
    """Text that is run, and the lines of its output that the page quotes."""

    language: str  # sh or python
    text: str
    quoted: tuple[str, ...]


def read_blocks(page: str) -> list[Block]:
    """List the blocks of a page that can be run."""
    return [
        Block(match.group(1), match.group(2), tuple(line for line in (match.group(3) or "").splitlines() if line))
        for match in _BLOCK.finditer(page)
    ]


def list_shown(page: str) -> list[str]:
    """List the files that a page shows."""
    return [match.group(1) for match in _SHOWN.finditer(page)]


def replace_shown(page: str, write: Callable[[str, str], str]) -> str:
    """Replace each comment by the result of `write`, of the file and its description."""
    return _SHOWN.sub(lambda match: write(match.group(1), match.group(2)), page)


def write_script(page: str) -> str:
    """Write the blocks of a page as one script for bash."""
    blocks = [block for block in read_blocks(page) if not block.text.startswith(NOT_RUN)]
    return "".join(block.text if block.language == "sh" else _PYTHON.format(block.text) for block in blocks)
