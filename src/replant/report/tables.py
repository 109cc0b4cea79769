"""The tables of a report, and the facts about its record."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from replant.data.logs.recording import digest
from replant.log import Log
from replant.plotting.numbers import MINUS, complex_number, duration, number, off_by, symbols, uncertain
from replant.report.figures import regions
from replant.report.material import Material
from replant.report.page import facts, table
from replant.runs.result import Result

UNCERTAIN = "Estimate ± standard deviation."
NO_STD = "This estimator gives no standard deviations."
PACKAGES = ("replant", "numpy", "scipy", "matplotlib")


def coefficients(material: Material) -> str:
    """Return the table of coefficients with units, standard deviations and, if known, true values."""
    result, known = material.result, material.uncertainty
    stds: Sequence[float | None] = [None] * result.structure.size if known is None else known.std.tolist()
    labels = symbols(result.structure, material.plant_label, material.log.output_name)
    headings = ["coefficient", "estimate" if known is None else "estimate ± std"]
    rows = [
        [label, uncertain(value, std)]
        for label, value, std in zip(labels, result.parameters.tolist(), stds, strict=True)
    ]
    if material.truth is not None:
        headings += ["true", "off by"]
        for row, value, true in zip(rows, result.parameters.tolist(), material.truth, strict=True):
            row += [number(float(true)), off_by(value, float(true)).replace("-", MINUS)]
    note = NO_STD if known is None else UNCERTAIN
    return table(headings, rows, "Coefficients") + f'<p class="note">{note}</p>'


def poles(material: Material) -> str:
    """Return the tables of poles, with frequency, damping and time constant, and of zeros."""
    result, known = material.result, material.uncertainty
    modes = result.transfer_function.modes
    spreads: Sequence[tuple[float | None, ...]] = [(None, None, None)] * len(modes)
    if known is not None:
        spreads = [(each.frequency_std, each.damping_std, each.time_constant_std) for each in known.modes]
    rows = [
        [complex_number(mode.pole), *map(uncertain, (mode.frequency, mode.damping, mode.time_constant), spread)]
        for mode, spread in zip(modes, spreads, strict=True)
    ]
    headings = ("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]")
    return table(headings, rows, "Poles") + _zeros(result)


def _zeros(result: Result) -> str:
    zeros = [zero for zero in result.transfer_function.zeros.tolist() if zero.imag >= 0]
    if not zeros:
        return '<p class="note">No zeros.</p>' if result.structure.zeros == 0 else ""
    spread = {root: covariance for root, covariance in regions(result) if np.isfinite(covariance).all()}
    rows = []
    for zero in sorted(zeros, key=abs):
        known = spread.get(zero)
        std = None if known is None else math.sqrt(max(float(np.trace(known)), 0.0))
        frequency = abs(zero) / math.tau
        rows.append([complex_number(zero), number(frequency) if std is None else uncertain(abs(zero), std)])
    return table(("zero [rad/s]", "frequency [Hz]" if not spread else "distance from 0 ± std [rad/s]"), rows, "Zeros")


def origin(material: Material) -> str:
    """Return facts about the record, the use of its samples, and the versions of the software."""
    log, result = material.log, material.result
    rejected = ", ".join(f"{count:,} {reason}" for reason, count in result.rejected.items() if count) or "none"
    return facts(
        [
            *of_record(log),
            ("used", f"{result.samples:,} samples"),
            ("rejected", rejected),
            *([("residual tests, excitation", f"of the newest {log.input.size:,} samples")] if log.earlier else []),
            ("computed in", f"{number(result.elapsed, 3)} s"),
            ("versions", versions()),
        ]
    )


def of_record(log: Log) -> list[tuple[str, str]]:
    """Return what is to be said of a record, as names and words."""
    return [
        ("file", log.path.name or "none: the record is simulated"),
        ("SHA-256", fingerprint(log.path)),
        ("input, output", f"{log.input_name}, {log.output_name}"),
        *([("reference", log.reference_name)] if log.reference_name else []),
        ("record", f"{len(log):,} samples, {lasts(log)}"),
    ]


def lasts(log: Log) -> str:
    """Return in words how long a record lasts, and its sampling time.

    Examples
    --------
    >>> signal = np.zeros(3)
    >>> lasts(Log(signal, signal, 0.5, np.array([0.0, 0.5, 9.5]), "u", "y", Path("log.csv")))
    '10 s on an irregular clock, usually at 0.5 s'
    """
    clock = "at" if log.stamps is None else "on an irregular clock, usually at"
    return f"{duration(log.duration)} {clock} {number(log.dt, 6)} s"


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal; a remark if there is no file."""
    return digest(path) or "none: there is no file"


def versions() -> str:
    """Return the versions of the software that computed the result."""
    found = []
    for package in PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join([*found, f"Python {platform.python_version()}"])
