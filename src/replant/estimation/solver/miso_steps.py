"""The joint steps of a row: y = sum_i B_i/A_i u_i + offset + free responses + noise, each input with poles of its own.

theta <- theta + (sum phi phi')^-1 sum phi D e, with whitened slopes phi, damped until the error falls.  The fixed
point is the maximum of likelihood.

Where references move inputs, the instruments zeta of what comes from outside take the place of phi in front:
theta <- theta + (sum zeta phi')^-1 sum zeta D e.  The fixed point, where they explain nothing of the error, is
consistent whatever the noise and the controller.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from replant.estimation.simulation.miso import Point, Row, evaluate, is_exact
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import least_norm, products, quiet
from replant.numerics.projections import orthogonal

STEPS = 30  # at the most [count]

# of 10,000 samples it is a ten-thousandth of a unit of chi-square
DONE = 1e-8  # decrease of the cost below which the steps end [part of the cost]

# the estimate is then a thousandth of a standard deviation from the fixed point
STILL = 1e-6  # what slopes or instruments explain of the error, below which steps end [variances of the error]

HALVINGS = 12  # of a step with instruments, at the most [count]
DAMPING = (1e-3, 6.0, 8)  # first damping [part of the diagonal], its growth after a step that fails, tries [ratios]


def solved(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the least-squares solution, rows and columns scaled: a direction that nothing tells is not moved."""
    left, right = (np.where(size > 0.0, size, 1.0) for size in (np.abs(matrix).max(axis=k) for k in (1, 0)))
    return least_norm(matrix / left[:, None] / right, vector / left, 1e-13)[0] / right


def refine(
    row: Row, theta: FloatArray, noise: Autoregression, before: Point | None = None, steps: int = STEPS,
    done: float = DONE,
) -> Point:  # fmt: skip
    """Return the point that damped joint steps (Levenberg-Marquardt) lead to."""
    *_, point = path(row, theta, noise, before, steps, done)
    return point


def path(
    row: Row, theta: FloatArray, noise: Autoregression, before: Point | None = None, steps: int = STEPS,
    done: float = DONE,
) -> Iterator[Point]:  # fmt: skip
    """Yield points of damped joint steps (Levenberg-Marquardt), until one gains no more than ``done`` of the cost."""
    point, damping = evaluate(row, theta, noise, before), DAMPING[0]
    yield point
    for _ in range(steps):
        new, damping = _improved(row, noise, point, damping)
        if new is None:
            return
        gain, point = point.cost - new.cost, new
        yield point
        if gain <= done * (point.cost + gain):
            return


@quiet
def _improved(row: Row, noise: Autoregression, point: Point, damping: float) -> tuple[Point | None, float]:
    """Return the point after a step that does not raise the cost, and the next damping; None where there is none."""
    _, growth, tries = DAMPING
    matrix, vector = point.information, _along(point.phi, point.error)
    if not (np.isfinite(matrix).all() and np.isfinite(vector).all()):
        return None, damping
    if vector @ solved(matrix, vector) <= STILL * point.cost / max(row.count, 1):
        return None, damping
    for _ in range(1 if is_exact(row, point) else tries):  # of rounding no smaller step makes less
        theta = point.theta + solved(matrix + damping * np.diag(np.diag(matrix)), vector)
        if row.is_stable(theta):
            tried = evaluate(row, theta, noise, point)
            if tried.cost <= point.cost:
                return tried, damping / 10.0
        damping *= growth
    return None, damping


def is_near(row: Row, point: Point, other: Point) -> bool:
    """Say whether two points lie within a standard deviation of each other: steps lead to the same from both."""
    move = point.theta - other.theta
    # a point of which the samples say nothing has everything near it
    return all(bool(move @ each.information @ move <= each.cost / max(row.count, 1)) for each in (point, other))


def ends_of(row: Row, paths: Iterable[Iterator[Point]], most: float = math.inf) -> list[Point]:
    """Return the last points of paths, at most so many, but for paths that come near the end of one before."""
    ends: list[Point] = []
    for each in paths:
        if len(ends) == most:
            break
        for point in each:
            if any(is_near(row, point, end) for end in ends):
                break
        else:
            ends.append(point)
    return ends


@quiet
def instrumental(
    row: Row, theta: FloatArray, noise: Autoregression, before: Point | None = None, steps: int = STEPS
) -> Point:
    """Return the point that steps with instruments lead to, each halved until these explain less of the error."""
    point = evaluate(row, theta, noise, before)
    for _ in range(steps):
        matrix = np.asarray(sum(products(zeta, phi) for zeta, phi in zip(point.zeta, point.phi, strict=True)))
        turned = orthogonal(np.asarray(sum(products(zeta, zeta) for zeta in point.zeta)))
        vector = _along(point.zeta, point.error)
        if not (np.isfinite(matrix).all() and np.isfinite(vector).all()):
            break
        direction, explained = solved(matrix, vector), float(np.sum((turned.T @ vector) ** 2))
        if explained <= STILL * point.cost / max(row.count, 1):
            break
        for halvings in range(HALVINGS):
            new = point.theta + direction * 0.5**halvings
            if row.is_stable(new):
                tried = evaluate(row, new, noise, point)
                if float(np.sum((turned.T @ _along(point.zeta, tried.error)) ** 2)) < explained:
                    break
        else:
            break
        point = tried
    return point


def explained_by(row: Row, point: Point) -> float:
    """Return what instruments explain of the error, in variances of it: how far a point is from the fixed point."""
    turned = orthogonal(np.asarray(sum(products(zeta, zeta) for zeta in point.zeta)))
    power = float(np.sum((turned.T @ _along(point.zeta, point.error)) ** 2))
    return power * max(row.count, 1) / max(point.cost, 1e-300)


def _along(columns: list[FloatArray], signals: list[FloatArray]) -> FloatArray:
    return np.asarray(sum(products(each, signal) for each, signal in zip(columns, signals, strict=True)))
