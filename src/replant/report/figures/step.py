"""The step response, with a band of +-2 sigma."""

from __future__ import annotations

from typing import Any

import numpy as np

from replant.identified.responses import StepResponse
from replant.model.transfer_function import TransferFunction
from replant.plotting.diagrams import TRUE, given_axes
from replant.report.figures import style
from replant.runs.result import Result


def draw_step(
    result: Result,
    *,
    truth: TransferFunction | None = None,
    ax: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw the output by a unit step of the input of G(s), until it has settled, with its band of +-2 sigma.

    Parameters
    ----------
    result : Result
    truth : TransferFunction, optional
        The true plant of a simulated record.
    ax : matplotlib axes, optional
        Drawn into; without it a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.

    Returns
    -------
    axes
    """
    axis = style.new_axes(1, 1, (6.2, 3.4))[0, 0] if ax is None else given_axes("ax", ax, 1)[0]
    unit = style.gain_unit(style.plant_input(result, input_label), output_label)
    axis.set_ylabel(f"step response [{unit}]" if unit else "step response")
    axis.set_xlabel("time [s]")
    style.tidy(axis)
    with np.errstate(all="ignore"):
        step = result.model.step()
    if not (np.isfinite(step.output).all() and np.abs(step.output).max() < style.FARTHEST):
        style.say(axis, "the response of G(s) is not finite")
        return axis
    shown = [step.output, np.zeros(1)]
    if step.std is not None and np.isfinite(step.std).all():
        low, high = step.output - style.SIGMAS * step.std, step.output + style.SIGMAS * step.std
        axis.fill_between(step.time, low, high, color=style.MODEL, alpha=0.22, lw=0, label="± 2σ")
        shown += [low, high]
    axis.axhline(0.0, color=style.MUTED, lw=0.8)
    axis.plot(step.time, step.output, color=style.MODEL, lw=1.8, label="model")
    if truth is not None:
        axis.plot(step.time, StepResponse.of(truth, None, step.time).output, label="true", **TRUE)
    axis.set_xlim(0.0, float(step.time[-1]))
    axis.set_ylim(*style.output_limits(np.concatenate(shown[:2]), *shown[2:]))
    style.legend(axis, 3)
    return axis
