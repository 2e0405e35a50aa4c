"""Pictures of linear equations: poles in the complex plane, and transfer functions over frequency."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from mbsgen.style import PALETTE, save_plot, styled
from mbsrun.linearisation.equations import Array, Linearisation

COLORS = PALETTE
DASHES = ("-", "--", "-.", ":")
DECADES = 1.5  # shown below the lowest and above the highest frequency
POINTS = 800
MOST = 6  # lines in one picture


@styled
def plot_poles(found: Linearisation, path: Path) -> None:
    """Plot the poles."""
    figure = Figure(figsize=(6, 5), layout="constrained")
    axes = figure.subplots()
    poles = np.array([mode.pole for mode in found.modes])
    whole = np.concatenate((poles, poles.conj()))
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.plot(whole.real, whole.imag, "x", color=COLORS[0], markersize=9, markeredgewidth=2)
    axes.set_xlabel("real part [1/s]: right of 0 grows")
    axes.set_ylabel("imaginary part [rad/s]")
    axes.set_title("Poles", loc="left")
    axes.margins(0.15)
    half = max(1.15 * float(np.abs(poles.imag).max()), 0.5 * float(np.abs(poles).max()), 0.1)
    axes.set_ylim(-half, half)
    axes.grid(alpha=0.3)
    save_plot(figure, path)


@styled
def plot_responses(found: Linearisation, path: Path) -> None:
    """Plot the transfer functions from each input and each driven joint to each freedom: magnitude and phase."""
    frequencies = _choose_frequencies(found)
    responses = np.concatenate((found.respond(frequencies), found.transmit(frequencies)), axis=2)
    titles = [*(f"input {name}" for name in found.inputs), *(f"motion of {name}" for name in found.driven)]
    columns = max(1, len(titles))
    figure = Figure(figsize=(4 + 3 * columns, 6), layout="constrained")
    plots = np.atleast_2d(figure.subplots(2, columns, sharex=True, squeeze=False))
    for k, title in enumerate(titles):
        magnitude, phase = plots[:, k]
        for i, output in enumerate(found.outputs[: min(MOST, len(found.freedoms))]):
            values = responses[:, i, k]
            if not np.abs(values).any():
                continue
            color, dashes = COLORS[i % len(COLORS)], DASHES[i % len(DASHES)]  # equal phases are both seen
            magnitude.loglog(frequencies, np.abs(values), color=color, linestyle=dashes, label=output)
            phase.semilogx(frequencies, np.degrees(np.unwrap(np.angle(values))), color=color, linestyle=dashes)
        magnitude.set_title(title, loc="left", fontsize="medium")
        if magnitude.lines:  # none where the input moves nothing
            magnitude.legend(frameon=False, fontsize="small")
        phase.set_xlabel("frequency [Hz]")
        low, high = phase.get_ylim()
        phase.set_ylim(min(low, (low + high) / 2 - 100), max(high, (low + high) / 2 + 100))
        phase.yaxis.set_major_locator(MultipleLocator(45 if high - low < 400 else 90))
    plots[0, 0].set_ylabel(f"magnitude [rad or m, for {_name_causes(found)}]")
    plots[1, 0].set_ylabel("phase [degrees]")
    for axes in plots.flat:
        axes.grid(alpha=0.3)
    save_plot(figure, path)


def _name_causes(found: Linearisation) -> str:
    return " or ".join(("N m, N",) * bool(found.inputs) + ("rad, m",) * bool(found.driven))


def _choose_frequencies(found: Linearisation) -> Array:
    known = [mode.frequency for mode in found.modes if mode.frequency > 0] or [1.0]
    low, high = np.log10(min(known)) - DECADES, np.log10(max(known)) + DECADES
    return np.asarray(np.logspace(low, high, POINTS))
