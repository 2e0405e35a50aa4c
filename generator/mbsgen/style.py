"""The style of all pictures: a palette for colour-blind readers too, sizes, and files with equal bytes.

The palette is Okabe and Ito's (Color Universal Design, 2008), in an order whose neighbours differ in lightness too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

P = ParamSpec("P")
T = TypeVar("T")

PALETTE = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#8c6d31", "#7f7f7f")
GOOD, BAD, NEUTRAL = "#009e73", "#d55e00", "#7f7f7f"  # within a bound, beyond it, neither
DOTS = 150  # an inch

STYLE: Mapping[str, Any] = MappingProxyType(
    {
        "font.size": 10,
        "axes.titlesize": 10.5,
        "axes.labelsize": 10,
        "axes.edgecolor": "#5d6b7a",
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "grid.color": "#b9c3cf",
        "grid.linewidth": 0.7,
        "xtick.color": "#3b4754",
        "ytick.color": "#3b4754",
        "xtick.labelsize": 9,
        "ytick.labelsize": 9,
        "legend.frameon": False,
        "legend.fontsize": 9,
        "lines.linewidth": 1.6,
        "lines.solid_capstyle": "round",
        "figure.titlesize": 12,
        "pdf.fonttype": 42,  # fonts that editors and journals read
        "svg.hashsalt": "mbsgen",
    }
)


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Return a function that draws in this style."""

    @wraps(draw)
    def within(*args: P.args, **kwargs: P.kwargs) -> T:
        import matplotlib
        from cycler import cycler

        with matplotlib.rc_context({**STYLE, "axes.prop_cycle": cycler(color=PALETTE)}):
            return draw(*args, **kwargs)

    return within


METADATA: Mapping[str, Mapping[str, None]] = MappingProxyType(  # versions and dates, which would change the bytes
    {
        "png": {"Software": None},
        "svg": {"Date": None, "Creator": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    }
)


FORMATS = ("png", "svg", "pdf")
_FORMAT = ContextVar("format", default=FORMATS[0])


@contextmanager
def picture_format(name: str) -> Iterator[None]:
    """Draw plots in one of FORMATS within the context."""
    assert name in FORMATS, name
    token = _FORMAT.set(name)
    try:
        yield
    finally:
        _FORMAT.reset(token)


def in_format(path: Path) -> Path:
    """Return the path of a plot, given as PNG, in the format of the context; other paths stay as they are."""
    return path.with_suffix(f".{_FORMAT.get()}") if path.suffix == f".{FORMATS[0]}" else path


def save_plot(figure: Figure, path: Path) -> Path:
    """Write a plot of a command in the format of the context, and return its path."""
    save_figure(figure, in_format(path))
    return in_format(path)


@styled
def save_figure(figure: Figure, path: Path, dots: int = DOTS) -> None:
    """Write a picture in the format of the path's suffix; equal pictures have equal bytes."""
    metadata = dict(METADATA.get(path.suffix.lower().lstrip("."), {}))
    if path.suffix == ".png":
        _save_pixels(figure, path, dots, metadata)
    else:
        figure.savefig(path, dpi=dots, metadata=metadata)


def _save_pixels(figure: Figure, path: Path, dots: int, metadata: dict[str, None]) -> None:
    """Lay a figure out and draw it, once: `Figure.savefig` draws all of it once more for any layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas, before = figure.canvas, figure.dpi
    drawn = FigureCanvasAgg(figure)
    figure.dpi = dots
    try:
        drawn.print_png(path, metadata=metadata)
    finally:
        figure.dpi = before
        figure.set_canvas(canvas)


def spare_docstrings() -> None:
    """Import Matplotlib without the docstrings of its `set` methods, where this process imports it later.

    Matplotlib writes them while it is imported, from all setters of all artists, which takes a third of that time; a
    command shows none of them. Pictures are the same.
    """
    if "matplotlib.artist" not in sys.modules and not any(isinstance(finder, _Sparing) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Sparing())


class _Sparing:
    """A finder of modules that finds none; it replaces two functions before the first class of artists is made."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:  # noqa: ARG002
        """Act once, before Matplotlib's axes or figures are imported."""
        if name in ("matplotlib.axes", "matplotlib.figure") and self in sys.meta_path:
            sys.meta_path.remove(self)
            artist = import_module("matplotlib.artist")
            for owner, function, other in ((artist.Artist, SIGNING, classmethod(_sign)), (artist, LISTING, _list_none)):
                if hasattr(owner, function):  # another version may have others, and then takes its time
                    setattr(owner, function, other)


SIGNING, LISTING = "_update_set_signature_and_docstring", "kwdoc"  # of Matplotlib


def _sign(artist: Any) -> None:
    artist.set._autogenerated_signature = True  # so that classes derived from this one have their own `set`, too


def _list_none(_: object) -> str:
    return ""


def mix(color: str, other: str, share: float) -> str:
    """Mix a colour "#rrggbb" with a share of another one."""
    pairs = zip(_read(color), _read(other), strict=True)
    return "#" + "".join(f"{round((1 - share) * a + share * b):02x}" for a, b in pairs)


def _read(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
