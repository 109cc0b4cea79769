"""Notation: a model in one line, as LaTeX, and as HTML for notebooks."""

from __future__ import annotations

import html as escaped
import math
import textwrap
from typing import Any

from replant.errors import MissingDependencyError
from replant.fitting.model_fields import ModelFields
from replant.model.polynomial import terms_of
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from replant.plotting.numbers import with_std
from replant.plotting.style import picture

WIDTH, COEFFICIENT_LINES, REASONS = 110, 3, 5  # characters of a line, lines of coefficients, reasons [count]


def one_line(model: ModelFields) -> str:
    """Return a model's G(s), signals, fit and verdict."""
    fit = "" if math.isnan(model.simulated_fit) else f", fit {model.simulated_fit:.1f} %"
    signals = f"{model.input_name} -> {model.output_name}"
    return f"<Model {model.transfer_function}: {signals}{fit}, {model.verdict.status}>"


def in_lines(kind: str, model: ModelFields, samples: int, reasons: tuple[str, ...]) -> str:
    """Return a result in at most twelve lines: G(s), coefficients, fit, and the reasons of the verdict."""
    count = model.parameters.size
    stds = [None] * count if model.uncertainty is None else model.uncertainty.std.tolist()
    values = zip(model.names, model.parameters.tolist(), stds, strict=True)
    known = [f"{name} {with_std(value, std)}" for name, value, std in values]
    fits = [(model.simulated_fit, "simulated"), (model.one_step_fit, "one step ahead")]
    fit = ", ".join(f"{value:.1f} % {how}" for value, how in fits if not math.isnan(value))
    shown = [*reasons[:REASONS], *([f"... {len(reasons) - REASONS} more"] if len(reasons) > REASONS else [])]
    lines = [
        f"<{kind} {model.transfer_function}: {model.input_name} -> {model.output_name}",
        *textwrap.wrap(", ".join(known), WIDTH, max_lines=COEFFICIENT_LINES),
        f"fit {fit}; {samples:,} samples",
        f"{model.verdict.status}: {shown[0] if shown else ''}",
        *shown[1:],
    ]
    return "\n  ".join(lines) + ">"


def latex(model: TransferFunction) -> str:
    r"""Return G(s) as mathematical text of LaTeX."""
    dead_time = rf"\, e^{{-{_number(model.delay)}\, s}}" if model.delay else ""
    return rf"G(s) = \frac{{{_polynomial(model.num)}}}{{{_polynomial(model.den)}}}{dead_time}"


CELL = 'style="padding: 0 1em 0 0; text-align: left"'  # without it a page may leave no room between two cells


def html(model: ModelFields) -> str:
    """Return G(s), the coefficients with their standard deviations, the poles and the verdict as HTML."""
    std = None if model.uncertainty is None else model.uncertainty.std
    rows = []
    for i, name in enumerate(model.names):
        known = "" if std is None else f"± {std[i]:.2g}" if math.isfinite(std[i]) else "± unknown"
        cells = (name, f"{model.parameters[i]:.5g}", known)
        rows.append("<tr>" + "".join(f"<td {CELL}>{cell}</td>" for cell in cells) + "</tr>")
    poles = ", ".join(f"{pole:.4g}" for pole in model.transfer_function.poles.tolist())
    fit = "not known" if math.isnan(model.simulated_fit) else f"{model.simulated_fit:.1f} %"
    reasons = "".join(f"<li>{escaped.escape(reason)}</li>" for reason in model.verdict.reasons)
    signals = escaped.escape(f"{model.input_name} → {model.output_name}")
    return (
        f"<div><p><b>G(s)</b> = {escaped.escape(str(model.transfer_function))}<br>{signals}, dt {model.dt:g} s</p>"
        f"<table>{''.join(rows)}</table>"
        f"<p>poles {poles} rad/s<br>fit {fit}<br>verdict <b>{model.verdict.status}</b></p><ul>{reasons}</ul></div>"
    )


def with_picture(model: Any) -> str:
    """Return a model as HTML with the picture of its responses; without matplotlib in words alone."""
    try:
        return html(model) + picture(model.plot())
    except MissingDependencyError:
        return html(model)


def _polynomial(coefficients: FloatArray) -> str:
    return "".join(terms_of(coefficients, _number, r"\, ", "s^{{{}}}"))


def _number(value: float) -> str:
    mantissa, _, exponent = f"{value:.5g}".partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa
