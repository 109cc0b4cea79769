"""The report and the pictures of several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from replant.fitting.miso_fit import RowFit
from replant.plotting import style
from replant.plotting.over_time import draw_panels
from replant.report.outputs import Output as Output
from replant.report.result_page import write_outputs as write_rows

__all__ = ["Output", "save_figures", "write_rows"]


def save_figures(folder: Path, outputs: Sequence[Output]) -> list[Path]:
    """Draw each output over time, and the responses from each input, as PNG files; return their paths."""
    found: dict[str, Any] = {}
    for i, each in enumerate(outputs, 1):
        assert isinstance(each.fitted, RowFit)
        number_of = f"-{i}" if len(outputs) > 1 else ""
        inputs, of_output = each.over_time()
        panels = of_output + inputs
        axes = style.blank_figure(9.0, 1.0 + 1.8 * len(panels)).subplots(len(panels), 1, sharex=True)
        draw_panels(axes, panels)
        for axis in axes[:2]:
            style.legend(axis)
        style.title(axes[0], f"simulated fit {each.fitted.fit:.1f} %")
        found |= {f"fit{number_of}": axes[0], f"responses{number_of}": each.fitted.model.plot()[0, 0]}
    return style.saved(folder, found)
