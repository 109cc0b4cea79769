"""Public records of several inputs, beside an output-error fit that shares no code with the program.

They are read from clones of public repositories; none is part of the project.  The anchor has a denominator for each
input: SciPy's least squares finds the poles, from what `fit` finds and from scattered time constants; numerators,
offset and initial states follow linearly.
"""

from __future__ import annotations

import gzip
import io
import math
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.linalg import lstsq
from scipy.optimize import least_squares

import replant as rp
from campaign.anchor import poles_of, written
from campaign.exact import Clock, forced, free, poles_apart
from public_logs.records import git_folder
from replant.numerics.arguments import FloatArray

STARTS = 12  # of scattered time constants
EVALUATIONS = 60  # of each, beside those for derivatives
WINDING = ("GrammarViz2/grammarviz2_src", "55657542f6e6d131c3c4733c9398c5da256e0fef", "data/winding.dat.gz")
FARNN = "robotsorcerer/FARNN", "9cfb82f2b42a53a604dba66d0eab23243a9a21ae"


@dataclass(frozen=True)
class Public:
    """A record: repository, commit and path; columns of inputs and of the output; sampling time in s; structure."""

    name: str
    where: tuple[str, str, str]
    inputs: tuple[int, ...]
    output: int
    dt: float
    poles: tuple[int, ...]
    zeros: tuple[int, ...]
    delay: tuple[float, ...]


def _of(name: str, where: tuple[str, str, str], inputs: int, output: int, dt: float, first: int = 0) -> Public:
    columns = tuple(range(first, first + inputs))
    return Public(name, where, columns, output, dt, (1,) * inputs, (0,) * inputs, (0.0,) * inputs)


RECORDS = (
    _of("winding, T1", WINDING, 5, 5, 0.1),
    _of("winding, T3", WINDING, 5, 6, 0.1),
    _of("glass furnace, T1", (*FARNN, "data/glassfurnace.dat"), 3, 4, 1.0, 1),
    _of("glass furnace, T4", (*FARNN, "data/glassfurnace.dat"), 3, 7, 1.0, 1),
    _of("dryer, dry bulb", (*FARNN, "data/dryer2.dat"), 3, 3, 10.0),
    _of("evaporator, flow", (*FARNN, "data/evaporator.dat"), 3, 4, 1.0),
    _of("evaporator, temperature", (*FARNN, "data/evaporator.dat"), 3, 5, 1.0),
)


def read(mirror: Path, record: Public) -> tuple[FloatArray, FloatArray] | None:
    """Return inputs (K, q) and output (K,); None where the repository is not there."""
    repository, commit, path = record.where
    folder = git_folder(mirror, repository)
    if folder is None:
        return None
    command = ["git", f"--git-dir={folder}", "show", f"{commit}:{path}"]
    content = subprocess.run(command, check=True, capture_output=True).stdout
    table = np.loadtxt(io.BytesIO(gzip.decompress(content) if path.endswith(".gz") else content))
    return np.ascontiguousarray(table[:, record.inputs]), np.ascontiguousarray(table[:, record.output])


class OutputError:
    """The output error of rows with given poles over a record, all else fitted."""

    def __init__(self, record: Public, u: FloatArray, y: FloatArray) -> None:
        self.t, self.y, self.record = record.dt * np.arange(y.size), y, record
        pairs = zip((u - u[0]).T, record.delay, strict=True)
        self.clocks = [Clock.of(self.t, each, delay, self.t) for each, delay in pairs]
        self.known = self.t >= max(record.delay)

    def left(self, logarithms: FloatArray) -> FloatArray:
        """Return the residual (K,) of poles as logarithms, those of one input after the other."""
        ends, columns = np.cumsum(self.record.poles)[:-1], [np.ones((self.t.size, 1))]
        with np.errstate(all="ignore"):
            for part, zeros, clock in zip(np.split(logarithms, ends), self.record.zeros, self.clocks, strict=True):
                poles: npt.NDArray[np.complex128] = poles_apart(poles_of(part))
                columns += [forced(poles, zeros, clock), free(poles, self.t)]
        whole = np.column_stack(columns)[self.known]
        lengths = np.linalg.norm(whole, axis=0)
        if not np.isfinite(lengths).all():
            return np.full(int(self.known.sum()), 1e3 * float(np.abs(self.y).max()))
        scaled = whole / np.where(lengths > 0.0, lengths, 1.0)
        return self.y[self.known] - scaled @ lstsq(scaled, self.y[self.known], cond=1e-11, check_finite=False)[0]

    def fit(self, logarithms: FloatArray) -> float:
        """Return the simulated fit in percent."""
        y = self.y[self.known]
        return 100.0 * (1.0 - float(np.linalg.norm(self.left(logarithms)) / np.linalg.norm(y - y.mean())))


def compared(mirror: Path, record: Public) -> tuple[str, float, float, float, str]:
    """Return name, fits of the anchor, of `fit` and of the identifier in percent, and the verdict."""
    read_in = read(mirror, record)
    if read_in is None:
        return record.name, math.nan, math.nan, math.nan, "the repository is not there"
    u, y = read_in
    asked = {"poles": record.poles, "zeros": record.zeros, "delay": record.delay}
    found = rp.fit(u, y, record.dt, **asked)
    ident = rp.Identifier(**asked, dt=record.dt, startup=y.size // 10)
    ident.update_many(u, y)
    ident.finish()
    error, rng = OutputError(record, u, y), np.random.default_rng(0)
    starts = [np.concatenate([written(g.den, record.dt) for g in found.transfer_functions])]
    slowest, fastest = 1.0 / (y.size * record.dt), 1.0 / record.dt
    for _ in range(STARTS):
        speeds = np.sort(np.exp(rng.uniform(math.log(slowest), math.log(fastest), sum(record.poles))))
        parts = np.split(rng.permutation(speeds), np.cumsum(record.poles)[:-1])
        starts.append(np.concatenate([written(np.poly(-part), record.dt) for part in parts]))
    best = max(
        error.fit(least_squares(error.left, start, max_nfev=EVALUATIONS, xtol=1e-6, ftol=1e-7).x) for start in starts
    )
    return record.name, best, found.fit, ident.model.validate(u, y).fit, found.verdict.status
