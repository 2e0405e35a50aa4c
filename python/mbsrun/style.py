"""The style of all pictures: a palette for colour-blind readers too, sizes, and files with equal bytes.

The palette is Okabe and Ito's (Color Universal Design, 2008), in an order whose neighbours differ in lightness too.
"""

from __future__ import annotations

PALETTE = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#f0e442", "#7f7f7f")


def mix(color: str, other: str, share: float) -> str:
    """Mix a colour "#rrggbb" with a share of another one."""
    pairs = zip(_read(color), _read(other), strict=True)
    return "#" + "".join(f"{round((1 - share) * a + share * b):02x}" for a, b in pairs)


def _read(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
