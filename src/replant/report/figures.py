"""Figures of a result, drawn with matplotlib: input and output, parameter transients."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import MissingDependencyError
from replant.runs import Result
from replant.validation import FloatArray

# Okabe and Ito's colours: told apart by the colour-blind, and in grey by their different lightness.
MEASURED, MODEL, TRUTH, RESIDUAL = "#7f8c95", "#d55e00", "#000000", "#0072b2"
SHOWN = 20_000  # points a curve; beyond it min and max of each stretch stand for the stretch


def save_figures(
    folder: Path,
    result: Result,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    *,
    input_label: str = "input",
    output_label: str = "output",
    truth: Sequence[float] | None = None,
) -> list[Path]:
    """Draw every figure of ``result`` into ``folder`` as PNG and return their paths."""
    plt = _pyplot()
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    figures = {"fit": draw_fit(result, u, y, dt, input_label=input_label, output_label=output_label)}
    if result.history is not None and len(result.history.samples):
        figures["parameters"] = draw_transients(result, dt, truth=truth)
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        figure.savefig(path, dpi=130)
        plt.close(figure)
        paths.append(path)
    return paths


def draw_fit(
    result: Result,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    *,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Return a figure of input, measured and simulated output, and their difference, over time."""
    plt = _pyplot()
    figure, (top, middle, bottom) = plt.subplots(
        3, 1, sharex=True, figsize=(9, 6.6), layout="constrained", height_ratios=(1, 2, 1)
    )
    t = np.arange(u.size) * dt
    top.plot(*_envelope(t, u), color=MEASURED, lw=0.8)
    top.set_ylabel(input_label)
    middle.plot(*_envelope(t, y), color=MEASURED, lw=2.2, alpha=0.7, label="measured")
    middle.plot(*_envelope(t, result.simulation.output), color=MODEL, lw=0.8, label="model, from the input alone")
    middle.set_ylabel(output_label)
    middle.legend(loc="upper right", ncols=2, frameon=False, bbox_to_anchor=(1, 1.14), borderaxespad=0)
    middle.set_title(f"simulated fit {result.simulation.fit:.1f} %", loc="left", fontsize="medium")
    bottom.plot(*_envelope(t, y - result.simulation.output), color=RESIDUAL, lw=0.6)
    bottom.axhline(0, color="black", lw=0.6)
    bottom.set_ylabel("measured - model")
    bottom.set_xlabel("time [s]")
    for axis in (top, middle, bottom):
        axis.margins(x=0.01)
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def draw_transients(result: Result, dt: float, *, truth: Sequence[float] | None = None) -> Any:
    """Return a figure of each parameter's estimate over time, the true value dashed where it is known."""
    plt = _pyplot()
    assert result.history is not None
    names = result.structure.names
    columns = 2 if len(names) > 1 else 1
    rows = -(-len(names) // columns)
    figure, axes = plt.subplots(
        rows, columns, sharex=True, squeeze=False, figsize=(9, 1.3 + 1.9 * rows), layout="constrained"
    )
    t = result.history.samples * dt
    for i, (axis, name) in enumerate(zip(axes.flat, names, strict=False)):
        axis.plot(t, result.history.parameters[:, i], color=MODEL, lw=1.2, label="estimate")
        if truth is not None:
            axis.axhline(truth[i], color=TRUTH, lw=1.0, ls="--", label="true")
        _limit(axis, result.history.parameters[:, i], None if truth is None else truth[i])
        axis.set_title(f"${name[0]}_{{{name[1:]}}}$" if name != "bias" else "bias", loc="left")
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes.flat[len(names) :]:
        axis.set_axis_off()
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    if truth is not None:
        axes.flat[0].legend(loc="lower right", ncols=2, frameon=False)
    return figure


def _limit(axis: Any, values: FloatArray, true: float | None) -> None:
    """Show where the estimate goes, not how far it first shot: limits from the last nine tenths, and the truth."""
    settled = values[values.size // 10 :]
    if true is not None:
        settled = np.append(settled, true)
    low, high = float(settled.min()), float(settled.max())
    margin = max(0.25 * (high - low), 0.1 * abs(high)) or 1.0
    axis.set_ylim(low - margin, high + margin)


def _envelope(t: Any, signal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Thin a curve to its minimum and maximum per stretch: no peak is lost."""
    stretch = signal.size // (SHOWN // 2)
    if stretch < 2:
        return t, signal
    kept = signal.size // stretch * stretch
    blocks = signal[:kept].reshape(-1, stretch)
    values = np.stack([blocks.min(axis=1), blocks.max(axis=1)], axis=1).ravel()
    return np.repeat(t[:kept:stretch], 2), values


def _pyplot() -> Any:
    try:
        import matplotlib as mpl
    except ImportError as cause:
        raise MissingDependencyError("plots need matplotlib: pip install 'replant[report]'") from cause
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt
