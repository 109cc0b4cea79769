"""The picture of `docs/performance.md`: measured cost over size, and beside it how it should grow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from replant.plotting.style import BLUE, FONT, GREEN, ORANGE, VERMILION, blank_figure, tidy

COLOURS, MARKERS = (BLUE, VERMILION, GREEN, ORANGE), "osD^"


def panels(rows: list[dict[str, Any]]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Return the label of each panel's axis and the kernels in it."""
    parameters = [row for row in rows if row["size"] == "parameters"]
    return [
        ("parameters P", [row for row in parameters if row["expected"] == 1]),
        ("parameters P", [row for row in parameters if row["expected"] > 1]),
        ("rows of a batch, or of the buffer", [row for row in rows if row not in parameters]),
    ]


def draw_scaling(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw cost over size: points are measured, dashed lines have the expected slope, through the points' middle."""
    with mpl.rc_context({**FONT, "svg.fonttype": "none"}):
        axes = blank_figure(9.0, 3.2).subplots(1, 3)
        for axis, (label, kernels) in zip(axes, panels(rows), strict=True):
            for kernel, colour, marker in zip(kernels, COLOURS, MARKERS, strict=False):
                size, cost = np.array(kernel["sizes"], float), np.array(kernel["nanoseconds"])
                middle = np.exp(np.log(cost).mean() + kernel["expected"] * (np.log(size) - np.log(size).mean()))
                name = kernel["what"] if kernel["size"] == "parameters" else f"{kernel['what']}, {kernel['size']}"
                axis.loglog(size, middle, color=colour, ls=(0, (4, 3)), lw=1.0)
                axis.loglog(size, cost, marker, color=colour, ms=4.5, label=f"{name}: {kernel['exponent']:.2f}")
            every = sorted({number for kernel in kernels for number in kernel["sizes"]})
            ticks = every if len(every) <= 4 else [every[0], every[len(every) // 2], every[-1]]
            axis.set_xticks(ticks, [f"{number:,}" for number in ticks])
            axis.minorticks_off()
            axis.set_xlabel(label)
            low, high = axis.get_ylim()
            axis.set_ylim(low, high * (high / low) ** 0.5)  # room for the legend
            axis.legend(loc="upper left", frameon=False, handletextpad=0.3)
            tidy(axis)
        axes[0].set_ylabel("ns")
        axes[0].figure.savefig(path, metadata={"Date": None})
