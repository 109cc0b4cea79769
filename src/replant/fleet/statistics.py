"""The statistics of a fleet: the compared quantities, their location and spread, and the distance of each rig.

The gain is b0/a0, the time constant of one pole 1/a0, the natural frequency of two poles sqrt(a0) and their damping
a1 / (2 sqrt(a0)): the logarithm of each is linear in the logarithms of the coefficients, for real and complex poles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replant.fleet.job import Shape
from replant.fleet.store import column, verdicts_of
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.linear_algebra import chi2_quantile

# for the whole fleet: each rig gets its share
CHANCE = 0.01  # probability that a rig is named odd in a fleet without odd rigs [probability]
EFFICIENCY = 1.5
"""Efficiency of the quantile scale: number of rigs over degrees of freedom of the scale [number].
Origin: with it, a rig is named in 7 of 600 fleets of 20 usual rigs, in 3 of 400 of 50, and in 1 of 200 of 300; with 1
instead, in 13 of 300, 3 of 100 and 2 of 100.
Sensitivity: halved or doubled, nothing changes on these records.
"""
# an odd rig is far outside; one in forty usual rigs is left out, and the spread is corrected for this truncation
KEPT = 0.975  # probability of the region whose rigs determine location and spread [probability]
STEPS = 60  # steps of the iteration: later ones change the spread by less than 1 % [count]
MOST_USED = 20_000  # most rigs used for location and spread, which are then known to 1 % [count]
SCALED_AT = (0.5, 0.75)
"""Quantiles of the squared distances from which the scale is computed [probability].
Origin: with the 0.9 quantile, three odd rigs of 20 at 8 deviations mask each other (1 of 600 named); with the 0.75
quantile, 434 of 600 are named, and of 30 odd rigs in 300, 99 % instead of 45 %.
Sensitivity: halved or doubled, nothing changes on these records.
"""
MAD = 1.4826  # standard deviation of a normal variable over its median absolute deviation [number]
LEAST = 1e-6  # smallest variance of the rigs themselves [part of the estimates' variance]


@dataclass(frozen=True, eq=False)
class Location:
    """Location and spread of a fleet."""

    centre: FloatArray  # (p,)
    spread: FloatArray  # (p, p): covariance of the rigs themselves, without the uncertainty of their estimates
    scale: float  # squared distances over those expected from the covariances, at least 1

    def squared_distances(self, x: FloatArray, covariances: FloatArray) -> FloatArray:
        """Return (x_i - m)' (S + P_i)^-1 (x_i - m) over the scale, (N,), for x (N, p) and P (N, p, p)."""
        return np.asarray(_squared(x - self.centre, self.spread + covariances) / self.scale)


def limit_of(size: int, base: int, rigs: int) -> float:
    """Return the squared distance that a rig exceeds by chance in one of 1/`CHANCE` fleets."""
    from scipy.special import betaincinv

    degrees = max((base - size) / EFFICIENCY, 1.0)
    # F's quantile: its distribution is that of degrees / size (1 / x - 1), x of the beta distribution
    return float(degrees * (1.0 / betaincinv(degrees / 2.0, size / 2.0, CHANCE / rigs) - 1.0))


def located(x: FloatArray, covariances: FloatArray) -> Location:
    r"""Return location and spread of :math:`x_i \sim N(m, S + P_i)` in the presence of outliers.

    Expectation maximization over the rigs within the quantile `KEPT`.  The scale reduces two quantiles of the squared
    distances to at most their expected values: if covariances are too small or not normal, fewer rigs are odd.
    """
    from scipy.special import chdtr

    used = np.linspace(0, len(x) - 1, min(len(x), MOST_USED)).astype(np.int64)
    x, covariances = x[used], covariances[used]
    size = x.shape[1]
    unit = _spread_of(x)
    y, P = x / unit, covariances / np.outer(unit, unit)
    limit = chi2_quantile(KEPT, size)
    shrunk = chdtr(size + 2, limit) / KEPT
    m = np.median(y, axis=0)
    own = np.median(np.diagonal(P, axis1=1, axis2=2), axis=0)
    S = np.diag(np.maximum(1.0 - own, LEAST))
    for _ in range(STEPS):
        total = np.linalg.inv(S + P)
        off = y - m
        distance = np.einsum("ni,nij,nj->n", off, total, off)
        kept = distance <= max(limit, float(np.median(distance)))
        weights, off = total[kept], off[kept]
        m = m + np.linalg.solve(weights.sum(0), np.einsum("nij,nj->i", weights, off))
        share = S @ weights
        seen = np.einsum("nij,nj->ni", share, off)
        S = np.einsum("ni,nj->ij", seen, seen) / (shrunk * len(seen)) + S - share.mean(0) @ S
        S = 0.5 * (S + S.T) + LEAST * np.eye(size) * 1e-3
    squared = _squared(y - m, S + P)
    scale = max(1.0, *(float(np.quantile(squared, level)) / chi2_quantile(level, size) for level in SCALED_AT))
    return Location(m * unit, S * np.outer(unit, unit), scale)


def _squared(off: FloatArray, covariances: FloatArray) -> FloatArray:
    solved = np.linalg.solve(covariances, off[..., None])[..., 0]
    return np.asarray(np.einsum("ni,ni->n", off, solved))


def _spread_of(x: FloatArray) -> FloatArray:
    """Return the robust standard deviation of each column; of a nearly constant column its magnitude."""
    found = MAD * np.median(np.abs(x - np.median(x, axis=0)), axis=0)
    small = 1e-12 * np.maximum(np.abs(np.median(x, axis=0)), 1e-300)
    return np.asarray(np.where(found > small, found, np.maximum(np.abs(np.median(x, axis=0)), 1.0)))


AGREEING = 0.8  # part of the rigs that must have the same sign of a coefficient for its logarithm to be used [share]


@dataclass(frozen=True)
class Quantity:
    """A physical quantity."""

    name: str
    weights: tuple[tuple[str, float], ...]  # exponents of the coefficients in it
    factor: float = 1.0  # factor of the product of powers
    unit: str = ""
    input: str = ""  # the input of its transfer function, if there are several

    @property
    def label(self) -> str:
        """Its name, with that of the input if there are several."""
        return f"{self.name} of {self.input}" if self.input else self.name


@dataclass(frozen=True, eq=False)
class Figures:
    """The coefficients of a fleet, transformed for comparison."""

    names: tuple[str, ...]  # of the p coefficients
    x: FloatArray  # (N, p): their logarithms; scaled coefficients if the fleet has no common sign
    covariances: FloatArray  # (N, p, p): of x, to first order
    signs: FloatArray  # (p,): the fleet's sign of each coefficient; 0 if it has no common sign
    reversed: BoolArray  # (N, p): whether a coefficient has the opposite sign
    certainty: FloatArray  # (N, p): absolute values of coefficients over their standard deviations
    known: BoolArray  # (N,): whether a rig has finite coefficients and covariances

    def weighed(self, shape: Shape) -> list[tuple[Quantity, FloatArray]]:
        """Return the quantities, with weights (p,), whose coefficients all have a common sign in the fleet."""
        found = []
        for quantity in quantities_of(shape):
            w = np.array([dict(quantity.weights).get(name, 0.0) for name in self.names])
            if (self.signs[w != 0.0] != 0.0).all():
                found.append((quantity, w))
        return found


def figures_of(table: Any, shape: Shape, usual: BoolArray | None = None) -> Figures:
    """Return the coefficients of a fleet's table, transformed for comparison."""
    size, names = shape.coefficients, shape.names[: shape.coefficients]
    theta = np.column_stack([column(table, name) for name in names])
    P = _covariances(table, len(shape.names))[:, :size, :size]
    std = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    known = np.isfinite(theta).all(axis=1) & np.isfinite(P).all(axis=(1, 2)) & (std > 0.0).all(axis=1)
    known &= (theta != 0.0).all(axis=1)
    # if a zero may cancel a pole, the covariance is not the uncertainty of the coefficients
    known &= np.isfinite(np.column_stack([column(table, f"{name}_std") for name in names])).all(axis=1)
    if usual is None:
        usual = verdicts_of(table) == "trusted"
    signs = _signs(theta[usual & known], std[usual & known])
    safe, scale = np.where(known[:, None], theta, 1.0), np.ones(size)
    for k in np.flatnonzero(signs == 0.0):
        scale[k] = float(np.median(np.abs(safe[usual & known, k]))) if (usual & known).any() else 1.0
    scale = np.where(scale > 0.0, scale, 1.0)
    x = np.where(signs == 0.0, safe / scale, np.log(np.abs(safe)))
    slope = np.where(signs == 0.0, 1.0 / scale, 1.0 / safe)
    covariances = np.where(known[:, None, None], P * slope[:, :, None] * slope[:, None, :], np.eye(size))
    certainty = np.abs(safe) / np.where(known[:, None], std, 1.0)
    turned = known[:, None] & (signs != 0.0) & (np.sign(safe) != signs)
    return Figures(names, x, covariances, signs, turned, certainty, known)


def quantities_of(shape: Shape) -> list[Quantity]:
    """Return the physical quantities of a shape, for each input."""
    return [
        replace(each, weights=tuple((f"{name}{end}", weight) for name, weight in each.weights), input=entered)
        for entered, end, structure in shape.branches
        for each in _of_structure(structure)
    ]


def _of_structure(structure: Structure) -> list[Quantity]:
    n, m = structure.poles, structure.zeros
    found = [Quantity("gain", (("b0", 1.0), ("a0", -1.0)))]
    if n == 1:
        found.append(Quantity("time constant", (("a0", -1.0),), unit="s"))
    elif n == 2:
        found.append(Quantity("natural frequency", (("a0", 0.5),), unit="rad/s"))
        found.append(Quantity("damping", (("a1", 1.0), ("a0", -0.5)), 0.5))
    else:
        found.append(Quantity("mean frequency of the poles", (("a0", 1.0 / n),), unit="rad/s"))
        found += [Quantity(f"coefficient a{k}", ((f"a{k}", 1.0),)) for k in range(n - 1, 0, -1)]
    if m == 1:
        found.append(Quantity("zero", (("b0", 1.0), ("b1", -1.0)), unit="rad/s"))
    elif m > 1:
        found += [Quantity(f"coefficient b{k}", ((f"b{k}", 1.0),)) for k in range(m, 0, -1)]
    return found


def _signs(theta: FloatArray, std: FloatArray) -> FloatArray:
    """Return the significant sign (p,) of each coefficient in most rigs; 0 if the rigs differ."""
    if not len(theta):
        return np.zeros(theta.shape[1])
    sure = np.abs(theta) > std
    positive, negative = (np.mean(sure & (sign * theta > 0.0), axis=0) for sign in (1.0, -1.0))
    return np.asarray(np.where(positive >= AGREEING, 1.0, np.where(negative >= AGREEING, -1.0, 0.0)))


def _covariances(table: Any, size: int) -> FloatArray:
    """Return the covariances (N, size, size) of all rigs; NaN if a rig has none."""
    lists = table.column("covariance").combine_chunks()
    found = np.full((table.num_rows, size, size), np.nan)
    there = np.asarray(lists.is_valid())
    found[there] = np.asarray(lists.drop_null().flatten(), np.float64).reshape(-1, size, size)
    return found


def distances(figures: Figures, place: Location) -> FloatArray:
    """Return squared distances (N,); a coefficient of the opposite sign adds to it by the certainty of its sign."""
    squared = place.squared_distances(figures.x, figures.covariances)
    spread = np.diag(place.spread)
    turned = 4.0 / (spread + 1.0 / np.square(figures.certainty)) / place.scale
    return np.asarray(squared + np.where(figures.reversed, turned, 0.0).sum(axis=1))


FACTORS = {
    "a power of ten": (10.0, 100.0, 1e3, 1e4, 1e6, 1e9),
    "degrees beside radians": (180.0 / math.pi,),
    "revolutions a minute beside rad/s": (30.0 / math.pi,),
    "revolutions a second beside rad/s": (math.tau,),
    "a minute beside a second": (60.0,),
    "inches beside mm": (25.4,),
    "km/h beside m/s": (3.6,),
    "pounds beside kg": (2.2046,),
    "bar beside psi": (14.504,),
}
# a normal variable exceeds it in one of 370 cases
NEAR = 3.0  # largest distance of a ratio from a factor that may explain it [standard deviations]
# a third of the distance between 2.2 and 3.6; a halved gain must not be taken for 1/2.2
FARTHEST = 0.15  # bound of that distance for an uncertain ratio [natural logarithm]
# half of the distance between neighbours in the list
WIDEST = 0.15  # largest uncertainty of a ratio; beyond it several factors could explain it [natural logarithm]


@dataclass(frozen=True)
class Deviation:
    """Deviation of a rig or a fleet in a quantity."""

    quantity: Quantity
    log_ratio: float
    std: float  # standard deviation of the logarithm
    turned: int  # number of its coefficients with the opposite sign
    certainty: float  # certainty of the opposite sign in standard deviations; 0 if the quantity keeps its sign

    @property
    def size(self) -> float:
        """Significance in standard deviations."""
        return max(abs(self.log_ratio) / self.std, self.certainty)

    def words(self, beside: str = "the fleet's median") -> str:
        """Return a text that compares the quantity with another value of it."""
        times = _ratio(math.exp(min(max(self.log_ratio, -700.0), 700.0)))
        sign, sure = "", abs(self.log_ratio) / self.std
        if self.turned % 2:
            sign, sure = " of the opposite sign,", self.certainty
        return f"{self.quantity.label}{sign} {times} times {beside}, {sure:,.0f} standard deviations"


def deviations(
    weighed: Sequence[tuple[Quantity, FloatArray]],
    off: FloatArray,
    P: FloatArray,
    turned: BoolArray,
    certainty: FloatArray,
    bound: float = math.inf,
) -> list[Deviation]:
    """Return the deviations of quantities, given those of the coefficients, ``off`` (p,) with covariance P (p, p)."""
    found = []
    for quantity, w in weighed:
        std, signs = math.sqrt(float(w @ P @ w)), int(turned[w != 0.0].sum())
        # the certainty of a sign is at most the bound over the standard deviation of the logarithm
        sure = min(float(certainty[w != 0.0].min()), bound / std) if signs % 2 else 0.0
        found.append(Deviation(quantity, float(w @ off), std, signs, sure))
    return found


def _ratio(value: float) -> str:
    """Return a ratio with two digits; with three if it is near 1."""
    if 0.9 < value < 1.1:
        return f"{value:.3g}"
    return f"{value:.2g}" if value < 100.0 else f"{value:,.0f}" if value < 1e6 else f"{value:.1e}"


def unit_factor(found: Sequence[Deviation]) -> str:
    """Return a text on the unit factor that explains the deviation of a gain; empty if none does."""
    words = ""
    for each in found:
        said = ""
        if each.quantity.name == "gain":
            said = _nearest(each.log_ratio, each.std, each.turned > 0, each.quantity.label)
        if not said and abs(each.log_ratio) > NEAR * each.std * 1.5:  # a wrong unit changes gains alone
            return ""
        words = words or said
    return words


def _nearest(log_ratio: float, std: float, is_reversed: bool, label: str = "gain") -> str:
    """Return a text on the unit factor nearest to a ratio; empty if none is near."""
    if std > WIDEST or is_reversed:
        return ""
    tried = [(abs(abs(log_ratio) - math.log(each)), each, what) for what, of in FACTORS.items() for each in of]
    off, factor, what = min(tried)
    if off > min(NEAR * std, FARTHEST):
        return ""
    times = f"{factor:.4g}" if factor == round(factor) else f"{factor:.3g}"
    times = f"{times} times" if log_ratio > 0.0 else f"1/{times} of"
    return f"the {label} is {times} the fleet's, nearly: {what}"
