"""Outputs, step responses, magnitudes and poles of several models, in common axes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from replant.identified.model import Model
from replant.log import Log
from replant.plotting.diagrams import RADIUS_95, REACH_95, given_axes
from replant.report.figures import style
from replant.report.figures.side_by_side import draw_outputs, draw_responses
from replant.runs.result import Result


def draw_models(
    models: Mapping[str, Model], results: Mapping[str, Result], log: Log, best: str, axes: Any = None
) -> Any:
    """Draw outputs, step responses, magnitudes and poles of all models; return four axes."""
    drawn = style.new_axes(2, 2, (11.0, 7.0)) if axes is None else axes
    output, step, magnitude, poles = given_axes("axes", drawn, 4)
    tail, phase = given_axes("axes", style.new_axes(2, 1, (4.0, 3.0)), 2)  # not shown
    draw_outputs(results, log.output, log.dt, axes=(output, tail), output_label=log.output_name)
    draw_steps(models, step)
    draw_responses(results, log.dt, reference=best, axes=(magnitude, phase))
    draw_poles_of(models, poles)
    output.legend(frameon=False, ncols=2)
    return np.array([output, step, magnitude, poles], dtype=object)


def draw_steps(models: Mapping[str, Model], axis: Any) -> None:
    """Draw the step response of each model with its band of two standard deviations."""
    longest = max(float(model.step().time[-1]) for model in models.values())
    for (name, model), (colour, dashes) in zip(models.items(), style.LINES, strict=False):
        step = model.step(longest)
        axis.plot(step.time, step.output, color=colour, ls=dashes, lw=1.4, label=name)
        if step.std is not None:
            reach = style.SIGMAS * np.minimum(step.std, np.ptp(step.output) or 1.0)
            axis.fill_between(step.time, step.output - reach, step.output + reach, color=colour, alpha=0.15, lw=0)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("step response")
    style.tidy(axis)


def draw_poles_of(models: Mapping[str, Model], axis: Any) -> None:
    """Draw the poles of each model with their 95 % regions."""
    reach = 0.0
    for (name, model), (colour, _) in zip(models.items(), style.LINES, strict=False):
        found = model.poles()
        axis.plot(found.values.real, found.values.imag, "x", color=colour, ms=8, mew=2, label=name)
        reach = max(reach, float(np.abs(found.values).max()))
        for mode in found.uncertain:
            outline, is_real = _region(mode.mode.pole, mode.covariance), not mode.mode.pole.imag
            for side in (1.0,) if is_real else (1.0, -1.0):
                axis.plot(outline.real, side * outline.imag, color=colour, alpha=0.5, lw=5.0 if is_real else 1.2)
    axis.axvline(0.0, color=style.MUTED, lw=0.8)
    axis.set_xlim(-1.3 * reach, 0.5 * reach)
    axis.set_ylim(-1.1 * reach, 1.1 * reach)
    axis.set_xlabel("real part [rad/s]")
    axis.set_ylabel("imaginary part [rad/s]")
    style.tidy(axis)


def _region(pole: complex, covariance: Any) -> Any:
    """Return the outline (N,) of a pole's 95 % region; of a real pole its interval."""
    if not np.isfinite(covariance).all():
        return np.zeros(0, complex)
    if not pole.imag:
        return pole + REACH_95 * math.sqrt(max(float(covariance[0, 0]), 0.0)) * np.array([-1.0, 1.0])
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, math.tau, 91)
    unit = np.stack([np.cos(angle), np.sin(angle)]) * RADIUS_95 * np.sqrt(np.maximum(values, 0.0))[:, None]
    outline = vectors @ unit
    return pole + outline[0] + 1j * outline[1]
