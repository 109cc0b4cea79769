r"""The distance from an estimate to that of given samples, by one Gauss-Newton step, and the uncertainty of abs G.

The step :math:`(\sum \zeta\zeta^T)^{-1} \sum \zeta e`, slopes and residual filtered by the noise model, is that of
refined instrumental variables at the estimate: it is zero for an estimate made from the same record.  The filtered
residual is independent of the slopes, also under feedback.  The step's covariance allows for the remaining colour.  A
significant step means that noise has biased the estimate, that the estimate is frozen while the plant changes, or that
it lags.  An estimate that does not learn from the record, as in a validation, has an error of its own: its covariance
is added to the step's.

A coefficient may be known well and abs G badly, or the other way round; the users of a model use G.  After a change of
the plant a new model is made from few samples.  It is trusted if three standard deviations of abs G fit into the error
that a trusted model may have.  The relative standard deviation of abs G at a frequency follows from the covariance of
the coefficients by the delta method.  If an alarm ended and no other model was found, the samples since then must
suffice to detect such an error: two standard deviations of an estimate from them alone must fit into it.  The excited
frequencies are those at which :math:`|G|^2` times the input's power density, the power density of the model's output,
is at least a hundredth of its largest: a tenth of the amplitude.

The second test finds a change of the plant that the residual of a long record hides.  It takes the step from the newest
samples alone, for several numbers of them, and its effect on abs G.

Sources: Soderstrom and Stoica (1983), "Instrumental Variable Methods for System Identification", chapter 4; Ljung
(1999), "System Identification: Theory for the User", sections 9.4 and 6.4 (Welch's spectrum).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from replant.estimation.simulation.model_run import ModelRun
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import Autoregression, in_a_row
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import chi2_quantile, larger, products, pseudo_inverse, sum_of_squares
from replant.numerics.projections import lengths_of, orthogonal, without
from replant.verdict.evidence import Evidence, Runs
from replant.verdict.verdict import Finding, duration, percent

RANK_TOLERANCE = 1e-14  # eigenvalue below which a direction is not there: fifty times float64's [part of the largest]
FEWEST_STRETCHES, MOST_STRETCHES = 4, 8  # earlier stretches whose median gives the scatter of steps [count]
LARGEST_ERROR = math.sqrt(MATTERS)  # error of abs G up to which a model is trusted after a change [part of abs G]
SIGMAS = 3.0  # deviations of abs G that must fit into `LARGEST_ERROR`, for 99.7 % [standard deviations]
EXCITED = MATTERS  # density of the output's power below which a frequency is not excited [part of the largest]
SEGMENT = 1024  # length of a segment of Welch's spectrum [samples]
SLOWEST = 0.1  # lowest frequency added below the spectrum; abs G is then the static gain [part of the slowest pole]
SLOW_FREQUENCIES = 8  # frequencies added below the spectrum [count]
LENGTHS = (1, 2, 4, 8, 16)  # numbers of newest samples, as a change may be of any age [samples that a test needs]
CONTRADICTS = 0.5 * LARGEST_ERROR  # difference of abs G by the newest samples that is a contradiction [part of abs G]
CONTRADICTS_SIGMAS = 2.0  # its margin, for 95 %, where all coefficients together are significant [standard deviations]


@dataclass(frozen=True)
class Distance:
    """The distance from an estimate to the estimate of a record, to first order."""

    step: FloatArray  # (n + m + 1,)
    statistic: float  # over its limit: above 1 the step is significant
    covariance: FloatArray  # of an estimate from this record alone, with allowance for the residual's colour


@dataclass(frozen=True, eq=False)
class Step:
    """The step (Z' zeta)^-1 Z' e; Z, slopes zeta and error e whitened, without nuisances, columns of length one."""

    instruments: FloatArray  # (K, n)
    inverse: FloatArray  # (n, n): (Z' zeta)^-1
    step: FloatArray  # (n,)
    left: FloatArray  # (K,): error after the step
    lengths: FloatArray  # (n,): lengths of the slopes before scaling

    @classmethod
    def of(cls, zeta: FloatArray, error: FloatArray, by_reference: FloatArray | None, nuisances: FloatArray) -> Step:
        """Return the step of slopes (K, n) and an error (K,); the instruments are ``by_reference`` or the slopes."""
        lengths = lengths_of(zeta)
        zeta = instruments = zeta / lengths
        if by_reference is None:
            basis = orthogonal(products(zeta, zeta))
            inverse = np.asarray(basis @ basis.T)
        else:
            moved = without(by_reference, nuisances)
            instruments = moved / lengths_of(moved)
            inverse = pseudo_inverse(products(instruments, zeta), RANK_TOLERANCE)
        step = inverse @ products(instruments, error[:, None])[:, 0]
        return cls(instruments, inverse, step, error - np.einsum("ij,j->i", zeta, step), lengths)

    def spread(self, columns: FloatArray) -> FloatArray:
        """Return the step's covariance (n, n) over the noise's variance; columns: instruments coloured as the noise."""
        return np.asarray(self.inverse @ products(columns, columns) @ self.inverse.T)

    def apart(self, covariance: FloatArray, own: FloatArray | None) -> FloatArray:
        """Return the covariance (n, n) of the step: that by the record's noise, and the estimate's ``own``."""
        return covariance if own is None else covariance + own * np.outer(self.lengths, self.lengths)

    def surprise(self, covariance: FloatArray) -> float:
        """Return step' C^-1 step."""
        return float(self.step @ pseudo_inverse(covariance, RANK_TOLERANCE) @ self.step)

    def distance(self, square: float, limit: float, covariance: FloatArray) -> Distance:
        """Return the distance in the coefficients' units; it is significant if ``square`` is NaN."""
        statistic = math.inf if math.isnan(square) else square / limit
        return Distance(self.step / self.lengths, statistic, covariance / np.outer(self.lengths, self.lengths))


def distance(
    run: ModelRun, rows: slice, past: IntArray, used: BoolArray, false_alarm: float, *, closed: bool = False,
    own: FloatArray | None = None,
) -> Distance:  # fmt: skip
    """Return the Gauss-Newton step from an estimate towards that of some rows (K,), with its significance.

    ``own`` (n, n) is the covariance of an estimate that was made from other samples; else its error is not counted.
    """
    # past: number of used samples in a row before each, up to LAGS
    nuisances = np.hstack([run.nuisances[rows], np.ones((used.size, 1))])
    # with the initial state's part: of a slow plant it depends on the coefficients as well
    zeta, error = run.slopes[rows], run.error[rows]
    # In a closed loop the noise model is that of the residual itself: the slopes would explain much of a load's effect,
    # and the rest has another colour.  Instruments from a reference are right with any filter.
    taken = nuisances if closed or run.instruments is not None else np.hstack([zeta, nuisances])
    left = np.zeros(used.size)
    left[used] = without(error[used, None], taken[used])[:, 0]
    noise = Autoregression.of_residual(left, past, int(used.sum()))
    nuisances, whole = noise.whiten_whole(nuisances, past, used)
    zeta = without(noise.whiten_whole(zeta, past, used)[0], nuisances)
    error = without(noise.whiten_whole(error, past, used)[0][:, None], nuisances)[:, 0]
    by_reference = None if run.instruments is None else noise.whiten_whole(run.instruments[rows], past, used)[0]
    newton = Step.of(zeta, error, by_reference, nuisances)
    past = in_a_row(whole) if noise.order else past
    rest = Autoregression.of_residual(newton.left, past, int(whole.sum()))
    innovation, counted = rest.whiten_whole(newton.left, past, whole)
    coloured, variance = rest.colour(newton.instruments), sum_of_squares(innovation)
    covariance = variance / max(int(counted.sum()) - len(newton.step), 1) * newton.spread(coloured)
    usual = sum_of_squares(newton.left) / max(int(whole.sum()), 1)
    covariance = larger(covariance, usual * newton.spread(newton.instruments))
    limit = float(chi2_quantile(1.0 - false_alarm, len(newton.step)))
    return newton.distance(newton.surprise(newton.apart(covariance, own)), limit, covariance)


def newest_distances(
    run: ModelRun, past: IntArray, used: BoolArray, counts: Iterable[int], false_alarm: float,
    own: FloatArray | None = None,
) -> Iterator[tuple[int, Distance]]:  # fmt: skip
    """Yield the Gauss-Newton step from an estimate by the newest samples alone, for each of ``counts``.

    A few samples do not determine the colour of their own residual: coloured noise would be taken for a change.  So
    colour and power are those of the residual over the whole run (generalised least squares).  Slow noise makes steps
    scatter more than this predicts; the factor is measured on earlier stretches of the same length.  (The scatter of
    the estimate's path does not measure it: the path moves after a change, which would then hide itself.)  To the
    covariance of each step the estimate's ``own`` is added, as in `distance`.
    """
    error = np.where(used, run.error - run.error[used].mean(), 0.0)
    noise = Autoregression.of_residual(error, past, int(used.sum()))
    white, whole = noise.whiten_whole(error, past, used)
    nuisances = noise.whiten_whole(np.hstack([run.nuisances, np.ones((used.size, 1))]), past, used)[0]
    slopes = noise.whiten_whole(run.slopes, past, used)[0]
    by_reference = None if run.instruments is None else noise.whiten_whole(run.instruments, past, used)[0]
    usual, longest = sum_of_squares(white) / max(int(whole.sum()), 1), 0

    def newton(rows: slice) -> tuple[Step, FloatArray, float]:
        moving = without(np.column_stack([slopes[rows], white[rows]]), nuisances[rows])
        found = Step.of(
            moving[:, :-1], moving[:, -1], None if by_reference is None else by_reference[rows], nuisances[rows]
        )
        free = max(int(whole[rows].sum()) - len(found.step) - nuisances.shape[1], 1)
        covariance = max(usual, sum_of_squares(found.left) / free) * found.spread(found.instruments)
        covariance = found.apart(covariance, own)
        return found, covariance, found.surprise(covariance)

    def scatter(count: int) -> float:
        begins = np.arange((len(white) - count) % count, len(white) - count, count)
        chosen = np.linspace(0, begins.size - 1, min(begins.size, MOST_STRETCHES)).astype(int)
        squares = [newton(slice(begin, begin + count))[2] for begin in begins[chosen].tolist()]
        return float(np.median(squares)) / chi2_quantile(0.5, slopes.shape[1])  # some of them may lie after a change

    for count in counts:
        if count > len(white):
            return
        newest = len(white) - count
        longest = count if newest // count >= FEWEST_STRETCHES else longest
        found, covariance, square = newton(slice(newest, None))
        limit = chi2_quantile(1.0 - false_alarm, len(found.step))
        # what would be no surprise without scatter is none with it
        wider = max(scatter(longest), 1.0) if longest and not square <= limit else 1.0
        yield count, found.distance(square, wider * limit, wider * covariance)


def gain_findings(evidence: Evidence, runs: Runs, covariance: FloatArray, alone: FloatArray) -> list[Finding]:
    """Return findings if abs G is not known well enough, or the newest samples contradict it."""
    omega = excited_frequencies(evidence)
    worst = _worst_gain(evidence, covariance, omega)
    findings = [] if evidence.in_sample else _contradiction(evidence, runs, omega)
    if evidence.after_change and not SIGMAS * worst <= LARGEST_ERROR:
        reason = f"since the plant has changed abs G is known to {percent(worst)} only (standard deviation)"
        findings.append(Finding("converging", f"{reason}, at a frequency that the input excites"))
    if evidence.after_alarm:  # its cause may have been a change that the offset and initial state hide
        worst = _worst_gain(evidence, alone, excited_frequencies(evidence, slowest=True))
        if not CONTRADICTS_SIGMAS * worst <= LARGEST_ERROR:
            reason = "the residual is as usual again, but the samples since tell abs G"
            findings.append(Finding("converging", f"{reason} to {percent(worst)} only (standard deviation)"))
    return findings


def _worst_gain(evidence: Evidence, covariance: FloatArray, omega: FloatArray) -> float:
    """Return the largest relative standard deviation of abs G at some frequencies (F,)."""
    std = evidence.uncertainty(covariance).response(omega)[0]
    return float(std.max()) if np.isfinite(std).all() else np.inf


def excited_frequencies(evidence: Evidence, *, slowest: bool = False) -> FloatArray:
    """Return the frequencies (F,), in rad/s, that the input excites."""
    omega, density = _input_spectrum(evidence)
    lowest = SLOWEST * max(float(np.abs(evidence.poles).min()), 0.0 if slowest else 1.0 / evidence.record.span)
    # a record shorter than the slowest mode does not resolve these: their density is taken from the lowest resolved
    if 0.0 < lowest < omega[0]:
        below = np.geomspace(lowest, omega[0], SLOW_FREQUENCIES, endpoint=False)
        omega, density = np.concatenate([below, omega]), np.concatenate([np.full(below.size, density[0]), density])
    power = _magnitude(evidence, evidence.estimate, omega) ** 2 * density
    return np.asarray(omega[power >= EXCITED * power.max()])


def output_frequency(evidence: Evidence) -> float:
    """Return the mean frequency, in rad/s, of the power of the model's output, over the resolved frequencies."""
    omega, density = _input_spectrum(evidence)
    power = _magnitude(evidence, evidence.estimate, omega) ** 2 * density
    return float(omega @ (power / power.sum()))


def _input_spectrum(evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """Return the frequencies (F,), in rad/s, that the record resolves, and Welch's density (F,) of the input."""
    u, size = evidence.record.u, min(evidence.record.u.size, SEGMENT)
    segments = np.lib.stride_tricks.sliding_window_view(u, size)[:: max(size // 2, 1)]
    segments = (segments - segments.mean(axis=1, keepdims=True)) * np.hanning(size + 1)[:size]
    density = np.asarray((np.abs(np.fft.rfft(segments)) ** 2).mean(axis=0))
    return np.asarray(2.0 * np.pi * np.fft.rfftfreq(size, evidence.record.dt)[1:], float), density[1:]


def _contradiction(evidence: Evidence, runs: Runs, omega: FloatArray) -> list[Finding]:
    """Return a finding if the newest samples alone contradict abs G, for the number of them that does most."""
    present, surest, size, length = _magnitude(evidence, evidence.estimate, omega), 0.0, 0.0, 0
    counts = sorted({evidence.held_out, *(evidence.enough * times for times in LENGTHS)} - {0})
    whole = slice(0, evidence.samples)
    past, used = evidence.past_of(whole), evidence.used
    for count, away in newest_distances(runs.now, past, used, counts, ALPHA, evidence.own):
        if not away.statistic > 1.0:
            continue
        there = _magnitude(evidence, evidence.estimate[: evidence.coefficients] + away.step, omega)
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.abs(there / present - 1.0)
        margin = off - CONTRADICTS_SIGMAS * evidence.uncertainty(away.covariance).response(omega)[0]
        margin[~(off > CONTRADICTS)] = 0.0
        k = int(np.argmax(np.nan_to_num(margin)))
        if margin[k] > surest:
            surest, size, length = float(margin[k]), float(off[k]), count
    if not surest > 0.0:
        return []
    span = duration(evidence.seconds(length))
    reason = f"the samples of the last {span} alone would put abs G {percent(size)} elsewhere"
    return [Finding("inconsistent", f"{reason}: the plant may have changed")]


def _magnitude(evidence: Evidence, coefficients: FloatArray, omega: FloatArray) -> FloatArray:
    n, s = evidence.structure.poles, 1j * omega
    den = np.concatenate([[1.0], coefficients[:n]])
    return np.asarray(np.abs(np.polyval(coefficients[n : evidence.coefficients], s) / np.polyval(den, s)))
