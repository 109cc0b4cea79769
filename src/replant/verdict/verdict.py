"""Verdict: the result of a judgement, its reasons and figures, and how figures are written in reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: The statuses, the gravest first.  A verdict has the status of its gravest finding.
STATUSES = ("diverged", "not excited", "inconsistent", "converging", "trusted")

LEAST_PERCENT = 0.01  # part below which a reason gives this bound instead [%]
MOST_FIGURE = 1e4  # figure above which a reason gives this bound instead [number]


@dataclass(frozen=True)
class Verdict:
    """Whether to trust a model, and why.

    Attributes
    ----------
    status : {"trusted", "converging", "not excited", "inconsistent", "diverged"}
    reasons : tuple of str
        In plain words, with figures; the gravest first.
    excited : bool
        Whether the newest samples carry information on the model.  If not, as while the input rests, the verdict is
        that of all samples kept, or that from before the rest.
    """

    status: str
    reasons: tuple[str, ...]
    excited: bool = True


@dataclass(frozen=True)
class Assessment(Verdict):
    """A verdict with the figures that it was made from; NaN: not known.

    Attributes
    ----------
    samples : int
        Samples examined.
    held_out : int
        Number of newest samples that the tested estimate had not used; 0: it had used all.
    fit : float
        Simulated fit in percent over the samples held out (or all): the model run from the input alone, with offset and
        initial state estimated.  With a reference: the fit to the part of the output that the reference explains.  For
        an unstable model without a reference: the fit one step ahead.
    condition : float
        Condition number of the scaled instruments over the samples examined, offset and initial state eliminated.
    excitation : float
        Smallest eigenvalue of the scaled information matrix of the samples held out, over that of all samples: 1 if
        they determine the coefficients as well as the others do.
    whiteness : float
        Portmanteau statistic of the residual's autocorrelation over its 99 % limit: up to about 1 for white noise.
    explained : float
        Part of the output's power that the model does not explain, but the input could; with a reference the part of
        the output's power by the reference that the reference could explain.
    explained_limit : float
        The test statistic of that part over its limit: above 1 the part is statistically significant.
    growth : float
        Power of the residual over the samples held out (or the last quarter), relative to that before, or to the usual
        power since the noise has grown.
    movement : float
        Largest movement of a coefficient since the tested estimate, in its standard deviations.
    distance : float
        Relative distance of the coefficients from those by the samples examined.
    uncertainty : float
        Largest relative standard deviation of a coefficient of the denominator.
    """

    samples: int = 0
    held_out: int = 0
    fit: float = math.nan
    condition: float = math.nan
    excitation: float = math.nan
    whiteness: float = math.nan
    explained: float = math.nan
    explained_limit: float = math.nan
    growth: float = math.nan
    movement: float = math.nan
    distance: float = math.nan
    uncertainty: float = math.nan


@dataclass(frozen=True)
class Finding:
    """A finding: its reason, and the status of the verdict if it is the only one."""

    status: str
    reason: str


def percent(part: float) -> str:
    """Return a part in percent with two digits, or a bound if it is very small or large."""
    if 0.0 < part < LEAST_PERCENT / 100.0:
        return f"less than {LEAST_PERCENT:g} %"
    return f"{figure(100.0 * part)} %"


def figure(value: float) -> str:
    """Return a positive figure with two digits and without a power of ten, or a bound if it is very large.

    >>> figure(2.234), figure(123.0), figure(float("inf"))
    ('2.2', '120', 'more than 10000')
    """
    return f"more than {MOST_FIGURE:g}" if value > MOST_FIGURE else f"{float(f'{value:.2g}'):g}"


def duration(seconds: float) -> str:
    """Return a duration in s with three digits, from 1000 s on in whole seconds.

    >>> duration(28.44), duration(2451.3), duration(50_000.0), duration(1e300)
    ('28.4 s', '2451 s', '50,000 s', '1e+300 s')
    """
    if seconds < 1000.0 or seconds >= 1e12:
        return f"{seconds:.3g} s"
    return f"{seconds:,.0f} s" if seconds >= 1e4 else f"{seconds:.0f} s"


def conclude(findings: list[Finding], otherwise: str) -> tuple[str, tuple[str, ...]]:
    """Return the gravest finding's status and all reasons, the gravest first; if trusted, ``otherwise`` comes first."""
    ranked = sorted(findings, key=lambda finding: STATUSES.index(finding.status))
    if not ranked or ranked[0].status == "trusted":
        ranked.insert(0, Finding("trusted", otherwise))
    return ranked[0].status, tuple(finding.reason for finding in ranked)
