"""The texts of the verdicts, the findings at the top of a report, and the excitation of a record."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from replant.fitting.miso_fit import RowFit
from replant.model.preprocess import rejected_in_words
from replant.numerics.arguments import FloatArray, IntArray
from replant.online.runs.result import Result
from replant.plotting.numbers import complex_number, number

WINDOWS = 100  # windows of a record, unless they become too short for the parameters [count]
STRIDES = 4  # strides in a window: consecutive windows overlap [count]


@dataclass(frozen=True, eq=False)
class Excitation:
    """How well the samples in each window of a record determine the parameters."""

    samples: IntArray  # (W,): the sample after which each window ends
    window: int  # samples in a window
    # (W,): smallest eigenvalue of the window's scaled information matrix: 1 at best, 0 if a combination of parameters
    # is undetermined
    smallest: FloatArray
    condition: FloatArray  # (W,): of the window's scaled regressors, as in the verdict on the whole record


def excitation(phi: FloatArray) -> Excitation | None:
    r"""Return the excitation by regressors phi (K, P), each entry scaled by its root mean square over the record."""
    count, size = phi.shape
    finite = np.asarray(np.isfinite(phi).all(axis=1))
    if not finite.any():
        return None
    rows = np.where(finite[:, None], phi, 0.0)
    largest = np.abs(rows).max(axis=0)
    largest[largest == 0.0] = 1.0
    rows = rows / largest
    scale = np.sqrt((rows**2).sum(axis=0) / finite.sum())
    rows = rows / np.where(scale > 0.0, scale, 1.0)
    stride = max(1, -(-max(20 * size, count // WINDOWS) // STRIDES))
    blocks = max(1, count // stride)
    ends = count - stride * np.arange(blocks - 1, -1, -1)
    # sum phi phi' over each block of rows, (B, P, P), and how many of its rows are finite
    matrices = np.stack([part.T @ part for part in np.split(rows, ends[:-1])])
    totals = np.diff(np.cumsum(finite)[ends - 1], prepend=0)
    span = min(STRIDES, blocks)
    windows, weights = (sliding_window_view(sums, span, axis=0).sum(axis=-1) for sums in (matrices, totals))
    # eigenvalues of each window's information matrix, the mean of phi phi' over its finite rows
    values = np.linalg.eigvalsh(windows / np.maximum(weights, 1)[:, None, None])
    least, most = np.maximum(values[:, 0], 0.0), values[:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(most > 0.0, np.sqrt(most / least), np.inf)
    return Excitation(ends[span - 1 :], min(span * stride, count), least, condition)


GOOD, WARN, BAD = "good", "warn", "bad"
#: The colour of each gravity at a terminal.
COLOURS = {GOOD: "green", WARN: "yellow", BAD: "red"}


@dataclass(frozen=True)
class Finding:
    """One finding about a result."""

    gravity: str  # {"good", "warn", "bad"}
    headline: str  # one or two words
    text: str  # whole sentences
    shape: str = "?"  # a character for a verdict at a terminal, in addition to its colour
    usable: bool = True  # False if the model must not be used for anything
    more: tuple[str, ...] = ()  # further sentences, for details


#: The texts by status; the reasons of a verdict state how large the error of a model is.
VERDICTS = {
    "trusted": Finding(GOOD, "Trusted", "No test speaks against the model.", "●"),
    "converging": Finding(WARN, "Still converging", "The samples do not determine the model well enough yet.", "◐"),
    "not excited": Finding(
        BAD, "Not excited", "The input does not determine every parameter: do not use this model.", "○", usable=False
    ),
    # also for a model with nearly the fit of a trusted one: the reasons state the size of the error
    "inconsistent": Finding(BAD, "Inconsistent", "The samples contradict the model: the reasons say by how much.", "▲"),
    "diverged": Finding(BAD, "Diverged", "This is the last finite estimate: do not use it.", "✕", usable=False),
    "unknown": Finding(WARN, "Unknown", "The model cannot be judged at present."),
}


def words_of(status: str) -> Finding:
    """Return the texts of a verdict; an unknown status is a warning with the status as headline."""
    return VERDICTS.get(status, Finding(WARN, status.capitalize(), ""))


def colour_of(status: str) -> str:
    """Return the colour of a verdict at a terminal."""
    return COLOURS[words_of(status).gravity]


FEW_SAMPLES = 10  # samples per parameter below which a record is called too short [samples]
MANY_REJECTED = 0.01  # share of rejected samples that is reported as a finding [share of samples]


def without_reasons(status: str, *, excited: bool) -> str:
    """Return a verdict for a place without reasons: "trusted" then also states a lack of excitation."""
    return f"{status}, not excited" if status == "trusted" and not excited else status


def findings(result: Result | RowFit, total: int) -> list[Finding]:
    """Return the findings on a result of one or several inputs, from ``total`` samples, the gravest first."""
    found, few = _of_verdict(result), FEW_SAMPLES * result.parameters.size
    if 0 < result.samples < few:
        count = f"{result.samples} sample{'s' if result.samples > 1 else ''}"
        text = f"{count} cannot determine {result.parameters.size} parameters: record at least {few}."
        found.append(Finding(BAD, "Too short", text, usable=False))
    if text := much_rejected(sum(result.rejected.values()), total, rejected_in_words(result.rejected)):
        found.append(Finding(WARN, "Rejected samples", f"{text}."))
    plants = result.transfer_functions if isinstance(result, RowFit) else (result.transfer_function,)
    unstable = [pole for g in plants for pole in g.poles.tolist() if pole.real > 0 and pole.imag >= 0]
    if unstable and result.samples:
        poles = ", ".join(complex_number(pole) for pole in unstable)
        text = f"The model has {'a pole' if len(unstable) == 1 else 'poles'} in the right half-plane: {poles} rad/s."
        found.append(Finding(WARN, "Unstable", text))
    return sorted(found, key=lambda finding: (BAD, WARN, GOOD).index(finding.gravity))


def much_rejected(rejected: int, total: int, why: str) -> str:
    """Return which part of ``total`` samples is rejected, and ``why``; empty if it is small.

    >>> much_rejected(20, 2000, "20 stuck"), much_rejected(1500, 2000, "1,500 stuck")
    ('', '75 % of the record could not be used: 1,500 stuck')
    """
    if rejected <= MANY_REJECTED * max(total, 1):
        return ""
    return f"{number(100.0 * rejected / total, 3)} % of the record could not be used: {why}"


def _of_verdict(result: Result | RowFit) -> list[Finding]:
    status, reasons = result.verdict.status, result.verdict.reasons
    words = words_of(status)
    if result.samples == 0:
        why = "Every sample was rejected" if any(result.rejected.values()) else "The record is empty"
        return [Finding(BAD, "No sample used", f"{why}: there is nothing to identify a model from.", usable=False)]
    if status != "diverged" and result.samples < FEW_SAMPLES * result.parameters.size:
        return []  # the verdict on so few samples is meaningless: `findings` reports that they are too few
    said = [*map(_sentence, reasons)]
    return [replace(words, text=" ".join([words.text, *said[:1]]).strip(), more=tuple(said[1:]))]


def _sentence(reason: str) -> str:
    """Return a verdict's reason as a sentence, with long numbers in the format of the report."""
    reason = re.sub(r"-?\d{7,}(\.\d+)?|-?\d(\.\d+)?e[+-]\d+|-?\binf\b", lambda found: number(float(found[0])), reason)
    return reason[:1].upper() + reason[1:].rstrip(".") + "."
