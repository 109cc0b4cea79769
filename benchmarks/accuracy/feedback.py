"""What is measured of a method in feedback, and what is promised of it: all coefficients of a loop at once.

The error of a coefficient is in percent of a size that is not zero where the coefficient is: `sizes`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import replant as rp
from accuracy.methods import QUANTILE, Figures
from replant.numerics.arguments import FloatArray

TRUSTED = "trusted"  # the figure that is 1 where the verdict is this
FAR_OFF = 10.0  # %: an estimate with a coefficient farther off is wrong
DIVERGED = 100.0  # %: one with a coefficient farther off, or none at all, has diverged
CLEAR = 4.0  # %: where the anchor's RMS error is below, right models are to be trusted
LEAST_TRUSTED = 90.0  # % of the right runs of such a loop
MOST_WRONG = 1.0  # % of all runs of a family: wrong and trusted
FEWEST_INTERVALS = 100  # of all runs and coefficients, from which a coverage is judged
INSIDE = (88.0, 99.0)  # % of the nominal 95 % intervals that hold the truth, over runs and coefficients


@dataclass(frozen=True)
class Promised:
    """What is promised of a method in a loop; NaN or False: nothing.

    Attributes
    ----------
    bias : float
        At most so many percent,
    standard_errors : float
        or so many standard errors.
    rms : float
        At most so many times the anchor's.
    online : str
        The method whose RMS error is not exceeded either, but for 5 % of chance.
    is_covered, is_trusted : bool
    never_wrong : bool
        Whether not a single run is wrong and trusted.
    stays : bool
        Whether no run diverges.
    """

    bias: float = math.nan
    standard_errors: float = 2.0
    rms: float = math.nan
    online: str = ""
    is_covered: bool = False
    is_trusted: bool = False
    never_wrong: bool = False
    stays: bool = False


@dataclass(frozen=True)
class Feedback:
    """What an experiment with a controller has besides.

    Attributes
    ----------
    sizes : mapping
        By coefficient.
    promised : mapping
        By method.
    families : mapping
        By method, the name of the family over all of whose runs at most `MOST_WRONG` percent are wrong and trusted.
    anchor : str
        The method that knows the controller.
    """

    sizes: Mapping[str, float]
    promised: Mapping[str, Promised]
    families: Mapping[str, str]
    anchor: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """One method in one loop, over the runs.

    Attributes
    ----------
    runs, failed, diverged : int
        Runs made; those without an estimate; those without one or with one that is far off.
    bias, standard_error, rms : mapping
        By coefficient, in percent, over the runs with an estimate.
    coverage : float
        Percentage of intervals that hold the truth, over runs and coefficients; a run without an estimate misses it.
    judges : bool
        Whether the method gives a verdict.
    right, right_and_trusted, wrong_and_trusted : int
        Runs in which no coefficient is `FAR_OFF`, those of them that are trusted, and the others that are.
    """

    runs: int
    failed: int
    diverged: int
    bias: Mapping[str, float]
    standard_error: Mapping[str, float]
    rms: Mapping[str, float]
    coverage: float
    judges: bool
    right: int
    right_and_trusted: int
    wrong_and_trusted: int

    @property
    def worst(self) -> str:
        """The coefficient with the largest bias."""
        return max(self.bias, key=lambda name: abs(self.bias[name]))

    @property
    def largest_rms(self) -> float:
        """Of all coefficients, in percent."""
        return max(self.rms.values())


def outcome(sizes: Mapping[str, float], truth: Mapping[str, float], found: Sequence[Figures]) -> Outcome:
    """Return what a method's figures of every run say.

    Examples
    --------
    >>> runs = [{"b0": (2.1, 0.2), "trusted": (1.0, math.nan)}, {"b0": (1.5, 0.1), "trusted": (0.0, math.nan)}]
    >>> seen = outcome({"b0": 2.0}, {"b0": 2.0}, runs)
    >>> round(seen.bias["b0"], 6), seen.coverage, seen.right, seen.right_and_trusted
    (-10.0, 50.0, 1, 1)
    """
    names = list(sizes)
    values = np.array([[figures[name][0] for name in names] for figures in found])
    stds = np.array([[figures[name][1] for name in names] for figures in found])
    true, scale = np.array([truth[name] for name in names]), np.array([sizes[name] for name in names])
    errors = 100.0 * (values - true) / scale
    known = np.isfinite(errors).all(axis=1)
    far = np.where(known, np.abs(errors).max(axis=1), np.inf)
    right = far <= FAR_OFF
    trusted = np.array([figures.get(TRUSTED, (0.0, 0.0))[0] == 1.0 for figures in found])
    inside = known[:, None] & (np.abs(values - true) < QUANTILE * stds)

    def by_name(numbers: FloatArray) -> dict[str, float]:
        return dict(zip(names, numbers.tolist(), strict=True))

    good, none = errors[known], np.full(len(names), math.nan)
    return Outcome(
        runs=len(found),
        failed=int((~known).sum()),
        diverged=int((far > DIVERGED).sum()),
        bias=by_name(good.mean(axis=0) if len(good) else none),
        standard_error=by_name(good.std(axis=0, ddof=1) / math.sqrt(len(good)) if len(good) > 1 else none),
        rms=by_name(np.sqrt((good**2).mean(axis=0)) if len(good) else none),
        coverage=float(100.0 * inside.mean()) if np.isfinite(stds[known]).all() else math.nan,
        judges=any(TRUSTED in figures for figures in found),
        right=int(right.sum()),
        right_and_trusted=int((right & trusted).sum()),
        wrong_and_trusted=int((~right & trusted).sum()),
    )


Line = tuple[str, str, bool | None]  # what is promised, what was measured, whether it is kept; None: not compared


def compared(feedback: Feedback, outcomes: Mapping[str, Outcome], method: str) -> Iterator[Line]:
    """Yield every promise of a method in a loop."""
    promised, seen = feedback.promised[method], outcomes[method]
    anchor = outcomes.get(feedback.anchor)
    whole = seen.failed == 0
    if not math.isnan(promised.bias):
        yield _bias(promised, seen)
    if not math.isnan(promised.rms) and anchor:
        ratio = seen.largest_rms / anchor.largest_rms
        measured = f"{ratio:.2f} ({seen.largest_rms:.1f} % beside {anchor.largest_rms:.1f} %)"
        yield f"RMS error at most {promised.rms:g} times the anchor's", measured, whole and ratio <= promised.rms
    if promised.online in outcomes:
        ratio = seen.largest_rms / outcomes[promised.online].largest_rms
        yield f"RMS error that of {promised.online} at most", f"{ratio:.2f} times", whole and ratio <= 1.05
    if promised.is_covered:
        enough = seen.runs * len(seen.bias) >= FEWEST_INTERVALS
        kept = INSIDE[0] <= seen.coverage <= INSIDE[1] if enough else None
        few = "" if enough else f" (of fewer than {FEWEST_INTERVALS} intervals)"
        yield f"coverage {INSIDE[0]:g} to {INSIDE[1]:g} %", f"{seen.coverage:.0f} %{few}", kept
    if promised.is_trusted and anchor:
        words = f"trusted in {LEAST_TRUSTED:g} % of right runs"
        measured = f"{seen.right_and_trusted} of {seen.right}"
        if anchor.largest_rms < CLEAR:
            yield words, measured, seen.right_and_trusted >= LEAST_TRUSTED / 100.0 * seen.right > 0
        else:
            yield words, f"{measured} (the anchor's RMS error is {CLEAR:g} % or more)", None
    if promised.never_wrong:
        yield "never wrong and trusted", f"{seen.wrong_and_trusted} of {seen.runs}", seen.wrong_and_trusted == 0
    if promised.stays:
        yield "no run diverges", f"{seen.diverged} of {seen.runs}", seen.diverged == 0


def _bias(promised: Promised, seen: Outcome) -> Line:
    def is_kept(name: str) -> bool:
        allowed = max(promised.bias, promised.standard_errors * seen.standard_error[name])
        return seen.failed == 0 and abs(seen.bias[name]) <= allowed

    parts = [f"{name} {bias:.2f} (se {seen.standard_error[name]:.2f})" for name, bias in seen.bias.items()]
    words = f"bias within {promised.bias:g} %"
    if promised.standard_errors:
        words += f" or {promised.standard_errors:g} standard errors"
    return words, ", ".join(parts), all(is_kept(name) for name in seen.bias)


def sizes(plant: rp.TransferFunction) -> FloatArray:
    """Return by what the error of each coefficient is judged: its own size, or that with all poles as fast as they are.

    For a pole at zero that is 1/s, or the fastest pole's magnitude where that is larger.

    Examples
    --------
    >>> sizes(rp.TransferFunction([1.0], [1.0, 1.0, 0.0])).tolist()
    [2.0, 1.0, 1.0]
    """
    speeds = np.abs(np.roots(plant.den))
    speeds[speeds < 1e-9] = max(speeds.max(), 1.0)
    together = np.poly(-speeds)[1:]
    return np.concatenate([np.maximum(np.abs(plant.den[1:]), together), np.abs(plant.num)])
