"""The verdict: one word, its reasons in plain words, and the figures behind them."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: From the gravest: of several findings the first one's word is the verdict.
STATUSES = ("diverged", "not excited", "inconsistent", "converging", "trusted")

LEAST_PERCENT = 0.01
"""Part below which a figure in a reason tells nothing more [%]."""
MOST_FIGURE = 1e4
"""Figure beyond which it tells nothing more [number]."""


@dataclass(frozen=True)
class Verdict:
    """Whether to trust a model, and why.

    Attributes
    ----------
    status : {"trusted", "converging", "not excited", "inconsistent", "diverged"}
    reasons : tuple of str
        In plain words, with figures; the gravest first.
    """

    status: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Assessment(Verdict):
    """A verdict with the figures that it was made from; NaN where one is not known.

    Attributes
    ----------
    samples : int
        Samples looked at.
    held_out : int
        How many of them, the newest, were not used for the estimate that was run over them; 0: all were.
    fit : float
        Simulated fit in percent over the samples held out (or all): the model from the input alone, offset and initial
        state estimated.
    condition : float
        Condition number of the scaled instruments over the samples looked at, offset and initial state eliminated.
    excitation : float
        Smallest eigenvalue of the scaled information matrix of the samples held out, as a part of what it is over all
        of them: 1 where they tell as much as the others.
    whiteness : float
        Portmanteau statistic of the residual's autocorrelation over its 99 % limit: up to about 1 for white noise.
    explained : float
        Part of the output's power that the input could still explain, but the model does not.
    explained_limit : float
        The statistic of the test for that, over its limit: above 1 it is no chance.
    growth : float
        Power of the residual over the samples held out, over what it was before.
    movement : float
        Largest movement of a coefficient since the estimate that was run, in its standard deviations.
    distance : float
        How far the coefficients lie from where the samples looked at would put them, as a part of their size.
    uncertainty : float
        Largest standard deviation of a coefficient of the denominator, as a part of its size.
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
    """One thing found, and what the verdict would be if it were the only one."""

    status: str
    reason: str


def percent(part: float) -> str:
    """Return a part in percent, with two digits; beyond what anybody reads as a figure, only where it lies.

    Examples
    --------
    >>> percent(0.12345), percent(0.00123), percent(6.789)
    ('12 %', '0.12 %', '680 %')
    >>> percent(6.6e-32), percent(2e7)
    ('less than 0.01 %', 'more than 10000 %')
    """
    if 0.0 < part < LEAST_PERCENT / 100.0:
        return f"less than {LEAST_PERCENT:g} %"
    return f"{figure(100.0 * part)} %"


def figure(value: float) -> str:
    """Return a positive figure with two digits and no power of ten.

    Examples
    --------
    >>> figure(2.234), figure(123.0), figure(float("inf"))
    ('2.2', '120', 'more than 10000')
    """
    return f"more than {MOST_FIGURE:g}" if value > MOST_FIGURE else f"{float(f'{value:.2g}'):g}"


def duration(seconds: float) -> str:
    """Return a length of time in s with three digits, or to the second.

    Examples
    --------
    >>> duration(28.44), duration(2451.3), duration(50_000.0), duration(1e300)
    ('28.4 s', '2451 s', '50,000 s', '1e+300 s')
    """
    if seconds < 1000.0 or seconds >= 1e12:
        return f"{seconds:.3g} s"
    return f"{seconds:,.0f} s" if seconds >= 1e4 else f"{seconds:.0f} s"


def conclude(findings: list[Finding], otherwise: str) -> tuple[str, tuple[str, ...]]:
    """Return the status of the gravest finding and every reason, the gravest first.

    ``otherwise`` is the reason for trust where nothing speaks against it.

    Examples
    --------
    >>> conclude([Finding("converging", "young"), Finding("inconsistent", "poor fit")], "good")
    ('inconsistent', ('poor fit', 'young'))
    >>> conclude([Finding("trusted", "but for the offset")], "good")
    ('trusted', ('good', 'but for the offset'))
    """
    ranked = sorted(findings, key=lambda finding: STATUSES.index(finding.status))
    if not ranked or ranked[0].status == "trusted":
        ranked.insert(0, Finding("trusted", otherwise))
    return ranked[0].status, tuple(finding.reason for finding in ranked)
