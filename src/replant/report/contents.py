"""The contents of a report: tables, facts and the captions of figures."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from importlib import metadata

import numpy as np

from replant.fitting.model import Model
from replant.logs.log import Log, logs_in
from replant.logs.recording import digest
from replant.model.interop import unit_of
from replant.model.preprocess import rejected_in_words
from replant.numerics.residuals import Correlations
from replant.online.runs.result import Result
from replant.plotting import style
from replant.plotting.diagrams import reach_of
from replant.plotting.numbers import (
    MINUS,
    complex_number,
    duration,
    number,
    off_by,
    percent,
    symbols,
    uncertain,
)
from replant.report.outputs import Output
from replant.report.page_frame import facts, note, table
from replant.report.panels import first_estimate, regions, unit_of_gain
from replant.report.results_as_text import POLE, gain_and_times, modes_of, stds_of

UNCERTAIN = "Estimate ± standard deviation."
NO_STD = "This estimator gives no standard deviations."
PACKAGES = ("replant", "numpy", "scipy", "matplotlib")


def way(model: Model) -> str:
    """Return from which input to which output a model leads."""
    return f"{model.input_name} → {model.output_name}"


def coefficients(models: Sequence[Model], truth: Sequence[float] | None = None) -> str:
    """Return the table of coefficients with units, standard deviations and, if known, true values."""
    headings, rows, known = ["coefficient", "estimate"], [], any(model.uncertainty is not None for model in models)
    for model in models:
        before = f"{way(model)}: " if len(models) > 1 else ""
        names = symbols(model.structure, model.input_name, model.output_name)
        for name, value, std in zip(names, model.parameters.tolist(), stds_of(model), strict=True):
            rows.append([before + name, uncertain(value, std)])
    if truth is not None:
        headings += ["true", "off by"]
        for row, value, true in zip(rows, models[0].parameters.tolist(), truth, strict=True):
            row += [number(float(true)), off_by(value, float(true)).replace("-", MINUS)]
    headings[1] += " ± std" if known else ""
    return table(headings, rows, "Coefficients") + note(UNCERTAIN if known else NO_STD)


def gains(models: Sequence[Model]) -> str:
    """Return the table of gains, dead times and time constants."""
    rows = []
    for model in models:
        gain, times = gain_and_times(model, uncertain)
        delay = f"{model.transfer_function.delay:.4g}"
        rows.append((way(model), f"{gain} {unit_of_gain(model)}".strip(), delay, "; ".join(times)))
    return table(("from, to", "DC gain", "dead time [s]", "time constants [s]"), rows, "Gains")


def poles_and_zeros(models: Sequence[Model]) -> str:
    """Return the tables of poles, with frequency, damping and time constant, and of zeros."""
    poles, zeros, several = list[list[str]](), list[tuple[list[str], complex, float | None]](), len(models) > 1
    for model in models:
        where, g = [way(model)] if several else [], model.transfer_function
        figures = zip(g.modes, modes_of(model, uncertain), strict=True)
        poles += [[*where, complex_number(mode.pole), *rest] for mode, rest in figures]
        spread = {
            root: math.sqrt(max(float(np.trace(each)), 0.0)) for root, each in regions(model) if np.isfinite(each).all()
        }
        zeros += [(where, zero, spread.get(zero)) for zero in sorted(g.zeros.tolist(), key=abs) if zero.imag >= 0]
    head = ["from, to"] if several else []
    listed = table([*head, *POLE], poles, "Poles")
    if not zeros:
        return listed + (note("No zeros.") if all(model.structure.zeros == 0 for model in models) else "")
    known = any(std is not None for *_, std in zeros)
    size = "distance from 0 ± std [rad/s]" if known else "frequency [Hz]"
    rows = [
        [*where, complex_number(zero), uncertain(abs(zero), std) if known else number(abs(zero) / math.tau)]
        for where, zero, std in zeros
    ]
    return listed + table([*head, "zero [rad/s]", size], rows, "Zeros")


def origin(outputs: Sequence[Output]) -> str:
    """Return facts about the record, the use of its samples, and the versions of the software."""
    first, log = outputs[0].result, outputs[0].log
    found = of_record(*(each.log for each in outputs))
    for each in outputs:
        of = f"{each.name}, " if len(outputs) > 1 else ""
        rejected = rejected_in_words(each.result.rejected) or "none"
        found += [(f"{of}used", f"{each.result.used:,} samples"), (f"{of}rejected", rejected)]
    if log.earlier:
        found.append(("residual tests, excitation", f"of the newest {log.input.size:,} samples"))
    if not math.isnan(first.elapsed):
        found.append(("computed in", f"{number(first.elapsed, 3)} s"))
    return facts([*found, ("versions", versions())])


def of_record(log: Log, *others: Log) -> list[tuple[str, str]]:
    """Return facts about a record, as terms and descriptions; ``others`` have its further outputs."""
    return [
        ("file", log.path.name or "none: the record is simulated"),
        ("SHA-256", ", ".join(filter(None, (digest(each.path) for each in logs_in(log)))) or "none: there is no file"),
        ("input, output", ", ".join([*log.input_names, *(each.output_name for each in (log, *others))])),
        *([("reference", ", ".join(log.reference_names))] if log.reference_name else []),
        ("record", f"{len(log):,} samples, {lasts(log)}"),
    ]


def lasts(log: Log) -> str:
    """Return the duration of a record and its sampling time as text."""
    logs = logs_in(log)
    clock = "on an irregular clock, usually at" if any(each.stamps is not None for each in logs) else "at"
    return f"{duration(log.duration)}{f' of {len(logs)} logs' if len(logs) > 1 else ''} {clock} {number(log.dt, 6)} s"


def versions() -> str:
    """Return the versions of the software that computed the result."""
    found = []
    for package in PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join([*found, f"Python {platform.python_version()}"])


PARTS = (
    " Offset and initial states are estimated. Below the output the contribution of each input, from rest at its first "
    "value, as a deviation from the working point."
)
SEEN = 0.01  # shortest stretch that is visible in a picture [part of the record]


def captions(outputs: Sequence[Output]) -> dict[str, str]:
    """Return the captions of the figures of a page, by name."""
    first, models = outputs[0], [model for output in outputs for model in output.models]
    alone = len(models) == 1
    of = "G(s)" if alone else "each G(s)"
    known = any(model.uncertainty is not None for model in models)
    dashed = "" if first.truth is None else " Dashed: the true plant."
    gain = f"{number(models[0].transfer_function.dc_gain)} {unit_of_gain(models[0])}".strip()
    gain = f"; the DC gain is {gain}" if alone else ""
    return {
        "fit": " ".join(_of_fit(each, several=len(outputs) > 1) for each in outputs)
        + ("" if isinstance(first.fitted, Result) else PARTS),
        "parameters": _of_parameters(first),
        "excitation": _of_excitation(first),
        "poles": _of_poles(models, known=known, is_true=first.truth is not None),
        "bode": (
            f"Bode diagram of {of}: magnitude and phase{' with bands of two standard deviations' if known else ''}"
            f"{gain}.{dashed}"
        ),
        "step": (
            f"Step response of {of}{' with a band of two standard deviations' if known else ''}: the output for a unit "
            f"step of the input, from rest.{dashed}"
        ),
    }


def _of_fit(output: Output, *, several: bool) -> str:
    result, residual = output.result, output.residual[np.isfinite(output.residual)]
    of = f" of {output.name}" if several else ""
    if residual.size == 0:
        return f"Input and measured output over time; the model's output{of} is not finite."
    size = number(float(np.sqrt(np.mean(np.square(residual, dtype=np.longdouble)))), 3)
    size = f"{size} {unit_of(output.name)}".strip()
    newest = f" over the newest {output.log.output.size:,} samples" if output.log.earlier else ""
    hidden = " Where the model's output is not visible, it lies outside the axes."
    return (
        f"The model{of}, {output.how}, has a fit of {percent(result.simulation.fit)}; the root mean square of "
        f"the residual is {size}{newest}.{hidden if result.simulation.fit < 0 else ''}"
    )


def _of_parameters(output: Output) -> str:
    history = output.result.history
    if history is None:
        return ""
    if (np.abs(output.result.parameters) > style.FARTHEST).any():
        return "Each parameter's estimate over time; estimates that diverged are not drawn."
    banded = history.std is not None and bool(np.isfinite(history.std).any())
    band = ", with bands of two standard deviations" if banded else ""
    true = ", with the true values" if output.truth is not None else ""
    said = f"Each parameter's estimate over time{band}{true}. The axes are scaled to the last 90 % of the record."
    begin, rows = first_estimate(history), history.samples.size
    if begin == rows or begin < SEEN * rows:
        return said
    held = number(float(output.clock.after(history.samples[begin])), 3)
    return f"{said} The first estimate is made from the first {held} s."


def _of_excitation(output: Output) -> str:
    found = output.excitation
    if found is None:
        return "Excitation over time: there are no regressors."
    window = number(found.window * output.log.dt, 3)
    poorest = int(np.argmin(found.smallest))
    when = number(float(output.clock.after(found.samples[poorest])), 3)
    is_regular = not output.clock.irregular
    windows = f"{window} s" if is_regular else f"{found.window:,} samples"
    # the clock of several logs counts the time between them
    place = f"{when} s" if len(logs_in(output.log)) == 1 else f"sample {found.samples[poorest] + 1:,}"
    return (
        f"Excitation in windows of {windows}: the smallest eigenvalue of the scaled information matrix is at most "
        f"{number(float(found.smallest.max()), 2)} and at least {number(float(found.smallest[poorest]), 2)}, in the "
        f"window up to {place}. Where it is small, the input does not excite every parameter."
    )


def _of_poles(models: Sequence[Model], *, known: bool, is_true: bool) -> str:
    heads = "Poles (crosses) and zeros (circles) of each G(s)"
    if len(models) == 1:
        g = models[0].transfer_function
        poles = ", ".join(complex_number(mode.pole) for mode in g.modes)
        zeros = ", ".join(complex_number(zero) for zero in g.zeros.tolist() if zero.imag >= 0)
        tail = f"; zero{'s' if g.zeros.size > 1 else ''} at {zeros} rad/s" if zeros else ""
        heads = f"Pole{'s' if g.poles.size > 1 else ''} at {poles} rad/s{tail}"
    region = " Coloured: 95 % confidence regions." if known else ""
    diamonds = " Diamonds: the true poles." if is_true else ""
    return f"{heads}. Grey: the right half-plane, in which poles are unstable.{region}{diamonds}"


def on_clock(output: Output) -> str:
    """Return a remark on figures that need a regular clock."""
    if len(logs_in(output.log)) > 1:
        apart = f"{number(output.log.dt, 4)} s apart"
        return f" Samples are taken as {apart}, and lost ones and those between logs as unknown."
    if not output.clock.irregular:
        return ""
    apart = f"samples are taken as {number(output.log.dt, 4)} s apart, and lost ones as unknown"
    return f" The clock is irregular: {apart}."


def correlation_in_words(found: Correlations | None, name: str = "") -> str:
    """Return a text on the residual's correlation with itself, or with the named input."""
    of = "Input" if name == "input" else name
    what = f"{of} with the later residual" if name else "Residual with itself"
    if found is None:
        return f"{what}: too few samples, or a constant signal."
    lags = f"{number(100 * found.outside[bool(name)], 2)} % of the lags{' from 0 on' if name else ''}"
    more = "a part of the response is missing" if name else "the noise is coloured, or dynamics are missing"
    beyond = not name and reach_of(found.auto, found.auto_std)
    hidden = " The value 1 at lag 0 lies outside the axes." if beyond else ""
    return f"{what}: {lags} lie outside the limits, 5 % by chance. More: {more}.{hidden}"


def of_spectrum(output: Output) -> str:
    """Return a text on the spectrum of the residual and the model of the noise."""
    noise, said = output.result.noise, "Power spectral density of the residual"
    if noise is None:
        said = f"{said}; this method has no model of the noise."
    elif noise.is_white:
        said = f"{said}: the noise is modelled as white."
    else:
        share = percent(noise.variance / noise.residual_variance) if noise.residual_variance > 0.0 else "0 %"
        said = (
            f"{said} and of its model, an autoregression of order {noise.order}. The past does not predict {share} of "
            "the residual's power."
        )
    return said + on_clock(output)
