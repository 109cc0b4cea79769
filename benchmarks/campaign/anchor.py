"""The anchor: an output-error fit of one's own that begins at the truth, among other starts.

The poles are found by SciPy's least squares; numerator, offset and initial state follow linearly from them (variable
projection).  The input is held on the record's own time stamps, missing outputs are left out, and behind a gap, where
the input is not known, the state is another one.  Of all starts the least residual is kept.

Source: Golub and Pereyra (1973), "The differentiation of pseudo-inverses and nonlinear least squares problems whose
variables separate", SIAM Journal on Numerical Analysis 10.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.linalg import lstsq
from scipy.optimize import least_squares

from campaign.exact import Clock, forced, free, poles_apart
from campaign.field import FieldRecord
from replant.numerics.arguments import FloatArray

GAP = 3.5  # sampling times without a row behind which the state is another one
STEPS = 60  # evaluations, beside those for derivatives, of a start
FARTHEST = 1e8  # of poles beside the sampling, each way
SCATTER = 0.25  # of the logarithms of a start beside the truth
OTHERS = 4  # starts beside the truth
SAME = 0.02  # distance of two starts, in logarithms, up to which they are one


class OutputError:
    """The output error of models with given poles over a record, all else fitted."""

    def __init__(self, record: FieldRecord) -> None:
        t = record.stamps
        self._t0, self._dt = float(t[0]), record.dt
        self._zeros, self._clock = record.structure.zeros, Clock.of(t, record.u, record.plant.delay, t)
        self._parts = [part for part in parts_of(t, record.dt) if part.stop - part.start > 1]
        self._t = t
        answers = np.zeros(t.size, bool)  # to inputs of the same part of the record
        for part in self._parts:
            answers[part] = t[part] - t[part.start] >= record.plant.delay * (1.0 - 1e-9)
        self._used = answers & np.isfinite(record.y)
        self._y = record.y[self._used]

    @property
    def samples(self) -> int:
        """How many outputs it fits."""
        return int(self._used.sum())

    def columns(self, poles: npt.NDArray[np.complex128]) -> FloatArray:
        """Return what is fitted linearly: the numerator's responses, a constant, a state for each part."""
        poles = poles_apart(poles)
        given = forced(poles, self._zeros, self._clock)
        states = np.zeros((given.shape[0], poles.size * len(self._parts)))
        for k, part in enumerate(self._parts):
            states[part, k * poles.size : (k + 1) * poles.size] = free(poles, self._t[part] - self._t[part.start])
        return np.column_stack([given, np.ones(given.shape[0]), states])[self._used]

    def fitted(self, poles: npt.NDArray[np.complex128]) -> tuple[FloatArray, FloatArray]:
        """Return the numerator (m + 1,) and the residual (K,)."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            columns = self.columns(poles)
            lengths = np.linalg.norm(columns, axis=0)
        if not (np.isfinite(columns).all() and np.isfinite(lengths).all()):
            return np.zeros(self._zeros + 1), np.full(self._y.size, 1e3 * float(np.abs(self._y).max()))
        lengths[lengths == 0.0] = 1.0
        weights = lstsq(columns / lengths, self._y, cond=1e-11, lapack_driver="gelsy", check_finite=False)[0] / lengths
        return weights[: self._zeros + 1], self._y - columns @ weights


def parts_of(t: FloatArray, dt: float) -> list[slice]:
    """Return the stretches of a clock between gaps."""
    begins = [0, *(np.flatnonzero(np.diff(t) > GAP * dt) + 1).tolist(), t.size]
    return [slice(begin, end) for begin, end in itertools.pairwise(begins)]


def written(den: FloatArray, dt: float) -> FloatArray:
    """Return the logarithms (n,) that stand for a denominator: of w^2 and 2 d w of each pair, of w of a lone pole.

    Unstable poles are reflected, poles at the origin moved away from it.
    """
    poles = np.roots(den)
    poles = np.where(np.abs(poles) * dt < 1.0 / FARTHEST, -1.0 / (FARTHEST * dt), poles)
    poles = np.where(poles.real > 0.0, -poles.conj(), poles)
    upper = sorted(poles[poles.imag > 0.0], key=abs)
    real = sorted(poles[poles.imag == 0.0].real, key=abs)
    pairs = [(-2.0 * one.real, abs(one) ** 2) for one in upper]
    pairs += [(-one - other, one * other) for one, other in zip(real[0::2], real[1::2], strict=False)]
    pairs.sort(key=lambda pair: pair[1])
    lone = [-real[-1]] if len(real) % 2 else []
    least = 1.0 / (FARTHEST * dt)
    return np.log([max(value, least ** (k % 2 + 1)) for pair in pairs for k, value in enumerate(pair)] + lone)


def poles_of(logarithms: FloatArray) -> npt.NDArray[np.complex128]:
    """Return the poles (n,) that logarithms stand for."""
    values = np.exp(np.clip(logarithms, -300.0, 300.0))
    lone = [complex(-values[-1])] if values.size % 2 else []
    pairs = [np.roots([1.0, a, b]) for a, b in zip(values[0 : values.size - 1 : 2], values[1::2], strict=False)]
    return np.concatenate([*pairs, np.array(lone, np.complex128)])


@dataclass(frozen=True, eq=False)
class Anchor:
    """The best output-error fit.

    Attributes
    ----------
    num, den : (m + 1,) and (n + 1,) arrays
    cost : float
        Mean square of its residual.
    start : str
        Which start has led to it.
    """

    num: FloatArray
    den: FloatArray
    cost: float
    start: str


def improved(record: FieldRecord, starts: Sequence[tuple[str, FloatArray]], best: Anchor | None = None) -> Anchor:
    """Return the best of a fit so far and of those that some denominators lead to."""
    error, seen = OutputError(record), [] if best is None else [written(best.den, record.dt)]
    for name, den in starts:
        start = written(den, record.dt)
        if any(np.abs(start - one).max() < SAME for one in seen):
            continue
        seen.append(start)
        found = least_squares(
            lambda logs: error.fitted(poles_of(logs))[1], start, method="trf", max_nfev=STEPS, xtol=1e-6, ftol=1e-7,
            gtol=1e-12,
        )  # fmt: skip
        poles = poles_of(found.x)
        num, residual = error.fitted(poles)
        cost = float(np.mean(residual**2))
        seen.append(found.x)
        if best is None or cost < best.cost:
            best = Anchor(num, np.poly(poles).real, cost, name)
    assert best is not None, "the truth is a start"
    return best


def anchor(record: FieldRecord, others: Sequence[tuple[str, FloatArray]], kept_at: Path) -> Anchor:
    """Return the anchor of a record, with other starts by name; kept in a file for the next run.

    Where an anchor is kept, another start is gone from only if it explains the record better as it is.
    """
    digest = digest_of(record)
    kept = _read(kept_at, digest)
    if kept is None:
        rng = np.random.default_rng([record.number, 6])
        truth = written(record.plant.den, record.dt)
        beside = [np.poly(poles_of(truth + rng.normal(0.0, SCATTER, truth.size))).real for _ in range(OTHERS)]
        starts = [("truth", record.plant.den), *others, *(("beside the truth", den) for den in beside)]
        found = improved(record, starts)
    else:
        error = OutputError(record)
        costs = [(name, den, np.mean(error.fitted(np.roots(den))[1] ** 2)) for name, den in others]
        found = improved(record, [(name, den) for name, den, cost in costs if cost < kept.cost], kept)
    if found is not kept:
        kept_at.parent.mkdir(parents=True, exist_ok=True)
        as_json = {"digest": digest, "num": found.num.tolist(), "den": found.den.tolist(), "cost": found.cost}
        kept_at.write_text(json.dumps(as_json | {"start": found.start}))
    return found


def digest_of(record: FieldRecord) -> str:
    """Return what tells a record from every other."""
    digest = hashlib.sha256()
    for signal in (record.u, record.y, record.stamps, record.plant.den, np.array([record.plant.delay, record.dt])):
        digest.update(np.ascontiguousarray(signal).tobytes())
    return digest.hexdigest()


def _read(path: Path, digest: str) -> Anchor | None:
    if not path.exists():
        return None
    kept = json.loads(path.read_text())
    if kept["digest"] != digest or not math.isfinite(kept["cost"]):
        return None
    return Anchor(np.array(kept["num"]), np.array(kept["den"]), kept["cost"], kept["start"])
