r"""A refined instrumental-variable estimate of a record, its covariance and its relative uncertainty.

The instruments of a record with a reference are made from it: input and output are projected on the Laguerre functions
of the reference and a constant.  The weights are found by generalised least squares, with an autoregression of the
remainder, as disturbances in a loop are seldom white:

.. math:: u_r = L w_u, \qquad y_r = L w_y.

Source: Van den Hof and Schrama (1993), "An indirect method for transfer function estimation from closed loop data",
Automatica 29.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.dimensions import entries_of
from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import Pass
from replant.kernels.schema import FIXED, LAGS, LAGUERRE, ColourSlots, NoiseSlots, PathSlots, ReferenceSlots
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.batch_means import no_less_than_scattered, path_of_record, scatter_of
from replant.numerics.linear_algebra import (
    combined,
    compose,
    eigenvalues,
    factor_information,
    inner,
    inverse_of,
    larger,
    products,
    quiet,
    real_coefficients,
    roots,
    sum_of_squares,
    without_rounding,
)
from replant.numerics.projections import best_pole, laguerre, weights_of

ACCEPTABLE = 0.25
"""Relative uncertainty up to which a start-up is long enough [part of a coefficient's size].
Origin: a recursion from a bad first model may diverge; with a quarter, sign and size of each coefficient are known.
Sensitivity: halved or doubled, nothing changes on these records.
"""

# no sampled controller is robust with a plant that grows e-fold per sample: its sensitivity peaks at e or more
FASTEST_UNSTABLE = 1.0  # real part of a pole beyond which no estimate starts a recursion [1 / sampling time]


@dataclass(frozen=True, eq=False)
class Prior:
    """The knowledge of a model before a record, as a normal density."""

    mean: FloatArray  # (T,)
    information: FloatArray  # (T, T), inverse of the covariance; zero for the nuisances
    variance: float  # of the residual that it is weighed against, in the output's unit squared

    @classmethod
    def none(cls, size: int) -> Prior:
        """Return the prior without information on ``size`` entries."""
        return cls(np.zeros(size), np.zeros((size, size)), 1.0)

    @property
    def weight(self) -> FloatArray:
        """What the prior adds to sum zeta zeta', (T, T)."""
        return self.variance * self.information

    def pull(self, model: FloatArray) -> FloatArray:
        """Return what the prior adds to sum zeta e at a model, (T,)."""
        return np.asarray(self.weight @ (self.mean - model))

    def cost(self, model: FloatArray) -> float:
        """Return what the prior adds to the sum of squares at a model, not less than 0 in spite of rounding."""
        return max(float((self.mean - model) @ self.pull(model)), 0.0)


@dataclass(frozen=True, eq=False)
class Projection:
    """The parts of input and output that the reference of a record of K samples explains."""

    functions: FloatArray  # (K, L), Laguerre functions of the reference, and ones
    parts: FloatArray  # (K, 2), u_r and y_r
    share: float  # part of the input's power that u_r explains
    slots: ReferenceSlots  # for a recursion that continues from the record's end

    @classmethod
    def of(cls, record: Record) -> Projection:
        """Project input and output of a record that has a reference."""
        assert record.r is not None
        pole = best_pole(record.r, record.u, record.y)
        states = laguerre(record.r, pole)
        functions = np.column_stack([states, np.ones(record.u.size)])
        weights = np.array([weights_of(functions, signal) for signal in (record.u, record.y)])
        slots = ReferenceSlots.zeros(FIXED | {"L": LAGUERRE + 1})
        slots.pole, slots.origin = pole, float(record.r.mean())
        slots.states[:], slots.weights[:] = functions[-1], weights
        slots.factors[:], slots.diagonal[:] = factor_information(products(functions, functions))
        parts = combined(functions, weights.T)
        power = float(np.var(record.u))
        left = float(np.var(record.u - parts[:, 0]))
        return cls(functions, parts, max(1.0 - left / power, 0.0) if power > 0.0 else 0.0, slots)


@dataclass(frozen=True, eq=False)
class Root:
    """The end of an iteration: a model, its pass and its noise model."""

    model: FloatArray  # (T,)
    done: Pass  # of the model
    noise: Autoregression  # of its residual
    innovation: float  # variance of the residual, whitened if ``filters``; without a reference, of the prediction error
    misfit: float  # see `Problem.misfit`
    converged: bool  # the last step was at most a third of a standard deviation
    ends: bool  # it has converged, or the last steps no longer lowered the cost
    filters: bool = True  # the model was found with the noise model as a filter
    at_kink: bool = False  # no step lowers the cost, as where a pole lies on the axis

    @property
    def relative_misfit(self) -> float:
        """The misfit in variances of the innovation."""
        return self.misfit / max(self.innovation, 1e-300)


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined instrumental-variable estimate of a record."""

    theta: FloatArray  # (T,), parameters, then nuisances
    upper: FloatArray  # (T, T), U of (sum zeta zeta')^-1 = U D U', instruments filtered by the noise model
    diagonal: FloatArray  # (T,), D
    covariance: FloatArray  # (T, T), the residual's colour and the scatter along the record taken into account
    variance: float  # of the residual, in the output's unit squared
    innovation: float  # variance of the residual filtered by the noise model
    converged: bool
    ends: bool  # the iteration converged, or no longer lowered the cost
    uncertainty: float  # see `relative_uncertainty`
    rightmost: float  # largest real part of a pole times the sampling time
    colour: ColourSlots  # of the filtered residual at the record's end, for a recursion that continues from it
    path: PathSlots  # the estimates that a recursion would have passed through
    noise: NoiseSlots
    reference: ReferenceSlots | None  # what the reference explains of input and output
    explained: float  # part of the input's power that it explains; NaN without one
    misfit: float  # J in variances of the innovation: for a right model chi-squared, 12 less the coefficients
    # largest standard deviation of a parameter over that which the residual's power and colour predict, as in drift
    slowness: float = 1.0
    disagreement: float = 0.0  # see `specification_test.disagreement`; 0 unless the filtered estimate was given up

    @property
    def noise_model(self) -> Autoregression:
        """The noise model as an autoregression."""
        slots, order = self.noise, int(self.noise.order)
        powers = slots.variances * max(float(slots.count), 1.0)
        return Autoregression(
            slots.models[order, : order + 1], float(powers[order]), slots.models, powers, slots.sums, float(slots.count)
        )  # fmt: skip

    def condition(self, size: int) -> float:
        """Return the ratio of the largest to the smallest singular value of a scaled regressor of this information."""
        covariance = compose(self.upper, self.diagonal)[:size, :size]
        scale = np.sqrt(np.diag(covariance))
        if not (np.isfinite(scale).all() and (scale > 0).all()):
            return math.inf
        values = eigenvalues(covariance / np.outer(scale, scale))
        return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else math.inf

    @property
    def is_finite(self) -> bool:
        """Whether the estimate and its factors are finite; a covariance that is not counts as unknown."""
        parts = self.theta, self.upper, self.diagonal, self.variance
        return all(bool(np.isfinite(part).all()) for part in parts)

    @property
    def settled(self) -> bool:
        """Whether the iteration ended at a model without extremely unstable poles, however uncertain."""
        return self.ends and self.rightmost < FASTEST_UNSTABLE

    @property
    def acceptable(self) -> bool:
        """Whether the estimate can start a recursion."""
        return self.settled and self.uncertainty < ACCEPTABLE


def without_nuisances(structure: Structure, parameters: FloatArray) -> FloatArray:
    """Return the model (T,) with parameters (P,) and zero nuisances."""
    model = np.zeros(entries_of(structure, refined=True))
    model[: parameters.size] = parameters
    return model


@quiet
def conclude(
    structure: Structure, record: Record, root: Root, projection: Projection | None = None,
    prior: Prior | None = None,
) -> Refined | None:  # fmt: skip
    """Return the estimate of a root with its covariance; None if not finite."""
    model, done, noise = root.model, root.done, root.noise
    samples, size = record.count, model.size
    free = max(samples - size - record.nuisances_beside(structure.poles, bias=structure.bias), 1)
    applied = noise if root.filters else Autoregression.white(1.0, samples)
    zeta, white = record.whitened(applied, done.zeta), record.whitened(applied, done.error)
    prior = Prior.none(size) if prior is None else prior
    variance = sum_of_squares(done.error) / free
    innovation = sum_of_squares(white) / free
    before = prior.weight
    upper, diagonal = factor_information(products(zeta, zeta) + before)
    inverse = compose(upper, diagonal)
    if projection is not None:  # the instruments are not the noise-free regressor: M^-1 (sum zeta zeta') M^-T
        inverse = inverse_of(products(zeta, record.whitened(applied, done.phi)))
        plain = innovation * inverse @ products(zeta, zeta) @ inverse.T
    else:
        plain = innovation * inverse
    colour, power = _colour(zeta, white, samples)
    covariance = larger(power / free * inverse @ colour.squares @ inverse.T, plain)
    # without the scatter along the path: the few blocks of a start-up scatter by chance, which must not set its length
    uncertainty = relative_uncertainty(structure, model, covariance, done.phi, record)
    entries = size - structure.poles
    path = path_of_record(zeta, white, model, before, prior.pull(model), entries)
    coloured = np.diag(covariance)[: structure.size]
    covariance = no_less_than_scattered(covariance, scatter_of(path, model, compose(upper, diagonal), entries))
    slowness = float(np.sqrt(np.diag(covariance)[: structure.size] / coloured).max()) if (coloured > 0.0).all() else 1.0
    covariance = without_rounding(covariance)  # with an infinitely fast surplus pole few of its digits are valid
    slots = _noise(noise, size, filters=root.filters)
    misfit = root.misfit / innovation if innovation > 0.0 else 0.0
    share, reference = (math.nan, None) if projection is None else (projection.share, projection.slots)
    rightmost = record.dt * float(roots(np.concatenate([[1.0], model[structure.denominator]])).real.max())
    refined = Refined(
        model, upper, diagonal, covariance, variance, innovation, root.converged, root.ends, uncertainty,
        rightmost, colour, path, slots, reference, share, misfit, slowness,
    )  # fmt: skip
    return refined if refined.is_finite else None


def no_surer(estimate: Refined, efficient: Refined) -> Refined:
    """Return an estimate with at least the variances of the efficient one: by Gauss and Markov none is surer."""
    covariance = larger(estimate.covariance, efficient.covariance)
    stretch = np.sqrt(np.diag(covariance) / np.diag(estimate.covariance))
    inverse, colour = compose(estimate.upper, estimate.diagonal), estimate.colour
    turned = inverse_of(inverse) * stretch @ inverse
    if np.isfinite(turned).all():  # a recursion that continues from it is as sure
        colour.squares[:] = turned @ colour.squares @ turned.T
    return replace(estimate, covariance=covariance)


def _noise(model: Autoregression, size: int, *, filters: bool) -> NoiseSlots:
    """Return the noise model of a record for a recursion of ``size`` entries that continues from its end."""
    noise = NoiseSlots.zeros(FIXED | {"T": size})
    noise.order, noise.count = model.order, model.count if model.sums.any() else 0.0
    noise.models[:], noise.variances[:], noise.sums[:] = model.models, model.variances, model.sums
    noise.filters, noise.gain = float(filters), 1.0
    if filters and model.powers[0] > 0.0:
        noise.gain = float(model.powers[model.order] / model.powers[0])
    return noise


def relative_uncertainty(
    structure: Structure, model: FloatArray, covariance: FloatArray, phi: FloatArray, record: Record
) -> float:
    """Return the largest relative standard deviation of a coefficient: below `ACCEPTABLE` a start-up is long enough.

    For b_j: half the output by one std(b_j), over the measured output.  For a_i: the same or, if less, std(a_i) over
    the coefficient of prod(s + max(abs(pole), 1/duration)), as the a_0 of an integrator has no size of its own.
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    sizes = real_coefficients(model[structure.denominator], 1.0 / record.span)
    relative = std[structure.denominator] / np.maximum(sizes, 1e-300)
    outputs = 0.5 * std * np.linalg.norm(phi, axis=0) / max(math.sqrt(sum_of_squares(record.y)), 1e-300)
    of_a = np.minimum(relative, outputs[structure.denominator])
    return float(max(of_a.max(), outputs[structure.numerator].max()))


def _colour(zeta: FloatArray, error: FloatArray, count: int) -> tuple[ColourSlots, float]:
    """Return power and autoregression of the residual at the record's end, and the innovation's sum of squares."""
    samples, size = zeta.shape
    colour = ColourSlots.zeros(FIXED | {"T": size})
    colour.covariances[:] = [inner(error[lag:], error[: samples - lag]) for lag in range(LAGS + 1)]
    noise = Autoregression.of_covariances(colour.covariances)
    filtered = noise.colour(zeta)
    colour.model[:] = noise.coefficients
    colour.count, colour.power = count, sum_of_squares(error)
    colour.errors[:] = error[-LAGS:][::-1]
    for age in range(min(LAGS, samples)):
        colour.filtered[-age % LAGS] = filtered[-1 - age]
    colour.squares[:] = products(filtered, filtered)
    return colour, noise.power
