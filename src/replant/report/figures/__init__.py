"""Figures of a result, drawn with matplotlib into given axes or into a new figure; the axes are returned.

Examples
--------
>>> import numpy as np
>>> from replant import Structure, TransferFunction
>>> from replant.runs.run import run_online
>>> from replant.settings import Request
>>> u = np.where(np.arange(2000) // 50 % 2 == 0, 1.0, -1.0)
>>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
>>> result = run_online(Request(Structure(poles=1), 0.1), u, y)
>>> top, bottom = draw_bode(result, 0.1, input_label="voltage [V]", output_label="speed [rpm]")
>>> top.get_ylabel()
'magnitude [dB re rpm/V]'
>>> axis = draw_poles_and_zeros(result)
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from replant.arguments import FloatArray, instance
from replant.limits import file_path
from replant.report.figures.comparison import draw_outputs, draw_overlay, draw_responses
from replant.report.figures.over_time import draw_correlations, draw_excitation, draw_fit, draw_transients
from replant.report.figures.responses import draw_bode, draw_poles_and_zeros, draw_spectrum, draw_step
from replant.report.figures.style import (
    INK,
    MEASURED,
    MODEL,
    MUTED,
    RESIDUAL,
    TRUTH,
)
from replant.runs.result import Result

__all__ = [
    "INK",
    "MEASURED",
    "MODEL",
    "MUTED",
    "RESIDUAL",
    "TRUTH",
    "draw_bode",
    "draw_correlations",
    "draw_excitation",
    "draw_fit",
    "draw_outputs",
    "draw_overlay",
    "draw_poles_and_zeros",
    "draw_responses",
    "draw_spectrum",
    "draw_step",
    "draw_transients",
    "save_figures",
]


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
    """Draw the fit and the parameter estimates over time as PNG files, and return their paths.

    Parameters
    ----------
    folder : Path
        Created if missing.
    result : Result
    u, y : (K,) arrays
        Raw input and output.
    dt : float
        Sampling time in s.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.
    truth : (P,) sequence, optional
        True parameters, of a simulated plant.

    Raises
    ------
    InvalidArgumentError
        If ``u`` and ``y`` are not the record of the result.
    MissingDependencyError
        If matplotlib is not installed.
    """
    result = instance("result", result, Result)
    folder = Path(file_path("folder", folder))
    folder.mkdir(parents=True, exist_ok=True)
    labels = {"input_label": input_label, "output_label": output_label}
    drawn = {"fit": draw_fit(result, u, y, dt, **labels)}
    drawn["fit"][1].set_title(f"simulated fit {result.simulation.fit:.1f} %", loc="left", fontsize="medium")
    if result.history is not None and len(result.history.samples):
        drawn["parameters"] = draw_transients(result, dt, truth=truth, **labels)
    paths = []
    for name, axes in drawn.items():
        paths.append(folder / f"{name}.png")
        axes[0].figure.savefig(paths[-1], dpi=130)
    return paths
