r"""The steps of refined instrumental variables: evaluation of models on a record, and steps to better ones.

`replant.estimation.solver.srivc` has the equations, and the sequence from the starts to the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel, Pass, stability_margin
from replant.estimation.solver.refined_estimate import Prior, Projection, Refined, Root, conclude
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ROUNDING
from replant.numerics.linear_algebra import combined, products, real_coefficients, roots, solve, sum_of_squares
from replant.numerics.projections import amounts_of, orthogonal

# with 10,000 samples .01 of chi-square, .1 standard deviations
STALLED = 1e-6  # decrease of the cost below which an iteration stalls [part of the cost]
STILL = 1e-3  # movement of an entry below which an iteration has converged [standard deviations; `descend`: variances]
DONE = 1e-6  # gain of a Gauss-Newton step below which the fit is done: .001 standard deviations [residual's variances]
# a third of a standard deviation: with poles as fast as the sampling, the instruments' root is not the least cost
NEARLY_DONE = 0.1  # the same if shorter steps gain nothing either [variances of the residual]
DIFFERENCE = 1e-5  # step of numerical derivatives: the cube root of float64's precision [part of a coefficient]
HALVINGS = 10  # lengths tried of a damped step, each half of the last: down to 1/512 [count]
POLISH = 30  # most Gauss-Newton steps [count]
STALLS = 6  # steps without a notable gain after which an iteration ends: a limit of effort [count]
SLOW = 0.01  # gain of the last `STALLS` whitened steps below which they end: .1 deviations [innovation's variances]
# growth of the cost that is allowed in a whitened step [part of the cost]: the root of the instruments' equations is
# not the least cost.  With a reference, J is chi-squared at the root, and may grow in a step of any length
SLACK = {False: 1e-3, True: 0.02}
FASTEST = 3.0  # largest magnitude of a pole: just below half the sampling rate, pi / dt [1 / sampling time]


# the variance of so many residuals is known to a fifth
SOONEST = 50  # fewest samples before and after a change in a search, and between two searches [samples]


class Problem:
    """The fit of one structure to one record: evaluates models on it, and makes steps from model to model."""

    def __init__(self, structure: Structure, record: Record, beside: FloatArray | None = None) -> None:
        self.whole, self._unknown = record, record.unknown(structure.delay)
        self._beside = beside
        # without the first samples, which depend on inputs before the record because of the dead time
        self.structure, self.record = structure, record.last(record.u.size - self._unknown) if self._unknown else record
        # a filter's poles lie left of -slowest, their magnitudes are at most fastest, in rad/s
        self.slowest, self.fastest = stability_margin(record), FASTEST / record.dt
        self.projection = None if record.r is None else Projection.of(record)
        referenced = self.projection is not None
        hold = record.input_hold
        self._model = AuxiliaryModel(structure, record.dt, hold, margin=self.slowest, reference=referenced)
        self.noise = Autoregression.white(1.0, self.record.u.size)  # D(q) of the residual
        self._basis: tuple[Autoregression, FloatArray, FloatArray] | None = None

    def run(self, model: FloatArray, *, filled: bool = True, alone: bool = False) -> Pass:
        """Return the pass of a model (T,) over the record; zero rows where no output was measured."""
        done = self.run_whole(model, filled=filled, alone=alone).since(self._unknown)
        return done if self._beside is None else done.without(self._beside)

    def run_whole(self, model: FloatArray, *, filled: bool = True, alone: bool = False) -> Pass:
        """Return the pass over the whole record, also over samples that depend on inputs before it."""
        parts = None if self.projection is None else self.projection.parts
        if filled or self.whole.measured is None:
            return self._model.run(model, self.whole, parts, alone=alone)
        return self._model.run(model, replace(self.whole, measured=None), parts).of(self.whole.measured)

    def scores(self, model: FloatArray, signals: FloatArray) -> float:
        """Write slopes and residual (K, T + 1) of the whole record; return rms prediction error over rms residual."""
        record, alone = self.whole, self.projection is None and len(self.whole.parts) == 1 and self.is_stable(model)
        if alone:
            _, output = self._model.branch(model, record, constant=True, rows=signals)
            np.subtract(record.y, output, out=signals[:, -1])
            signals[: self._unknown] = 0.0
            if record.measured is not None:
                signals[~record.measured] = 0.0
            return 1.0
        # the prediction error of a stable model is the residual itself
        done = self.run_whole(model)
        power = sum_of_squares(done.error)
        signals[:, :-1], signals[:, -1] = done.zeta, done.error
        return math.sqrt(done.power / power) if power > 0.0 else math.nan

    def is_stable(self, model: FloatArray) -> bool:
        """Return whether no pole of ``model`` (T,) has to be reflected: all lie left of -slowest."""
        poles = roots(np.append(1.0, model[self.structure.denominator]))
        return bool(poles.real.max() < -self.slowest)

    def is_usable(self, model: FloatArray) -> bool:
        """Return whether the denominator of ``model`` (T,) can be a filter: finite, and not too fast."""
        return self._speed(model) < self.fastest

    def _speed(self, model: FloatArray) -> float:
        """Return a lower bound in rad/s of the largest pole magnitude; infinite if the denominator is not finite."""
        a = model[self.structure.denominator]
        if not np.isfinite(a).all():
            return math.inf
        return float((np.abs(a) ** (1.0 / np.arange(1, a.size + 1))).max()) / a.size

    def bounded(self, model: FloatArray, fastest: float = 0.0) -> FloatArray:
        """Return ``model`` (T,) with pole magnitudes up to `FASTEST`; unchanged if `_speed` is at most ``fastest``."""
        if self.is_usable(model) or self._speed(model) <= fastest:
            return model
        n = self.structure.poles
        poles = roots(np.concatenate([[1.0], model[:n]]))
        if np.isfinite(poles).all():
            poles = poles * np.minimum(1.0, self.fastest / np.maximum(np.abs(poles), 1e-300))
            a = np.poly(poles).real[1:]
        else:
            a = np.poly(np.full(n, -math.sqrt(self.slowest * self.fastest)))[1:]
        return np.concatenate([np.asarray(a, np.float64), model[n:]])

    def from_cutoff(self, cutoff: float, *, by_reference: bool = True) -> FloatArray | None:
        """Return the estimate with filter (s + cutoff)^-n, by least squares or reference; None if singular."""
        n = self.structure.poles
        a = np.asarray(np.poly(np.full(n, -cutoff))[1:], np.float64)
        # a model without a numerator does not predict missing outputs: the record's interpolated ones are used
        done = self.run(np.concatenate([a, np.zeros(self._model.entries - n)]), filled=False)
        phi = self.whiten(done.phi)
        zeta = phi if self.projection is None or not by_reference else self.whiten(done.zeta)
        found = solve(products(zeta, phi), products(zeta, self.whiten(done.target)))
        return None if found is None else self.bounded(found)

    def with_nuisances(self, model: FloatArray) -> FloatArray:
        """Return ``model`` (T,) with the offset and the initial state that fit best."""
        done, count = self.run(model), self.structure.poles + 1
        more = amounts_of(done.phi[:, -count:], done.error)
        return np.concatenate([model[:-count], model[-count:] + more])

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` (K, ...), weighted where the past is unknown."""
        return self.record.whitened(self.noise, signals)

    def is_rounding(self, done: Pass) -> bool:
        """Return whether the residual is only rounding."""
        return done.cost <= ROUNDING * float(np.mean(self.record.y**2))

    def renew_noise(self, done: Pass) -> None:
        """Fit the noise model to the residual of a pass; rounding counts as white."""
        if self.is_rounding(done):
            self.noise = Autoregression.white(sum_of_squares(done.error), self.record.count)
        else:
            self.noise = Autoregression.of_residual(done.error, self.record.predecessors, self.record.count)

    def misfit(self, done: Pass) -> float:
        """Return J, the power of the white residual that the reference explains; without one, that of white `ahead`."""
        white = self.whiten(done.ahead if self.projection is None else done.error)
        if not np.isfinite(white).all():
            return math.inf
        if self.projection is None:
            return sum_of_squares(white)
        # the whitened functions of the reference (K, L) and their orthonormaliser are kept for a noise model
        if self._basis is None or self._basis[0] is not self.noise:
            functions = self.whiten(self.projection.functions[self._unknown :])
            self._basis = self.noise, functions, orthogonal(products(functions, functions))
        _, functions, basis = self._basis
        return float(np.sum((basis.T @ products(functions, white[:, None])) ** 2))

    def improve(
        self, theta: FloatArray, iterations: int, patience: int, *, stable: bool
    ) -> tuple[float, FloatArray, FloatArray | None]:
        """Iterate the instrumental-variable step; return least cost, its model, and the last model (or None)."""
        best, best_model, stalls = math.inf, theta, 0
        current = theta
        for _ in range(iterations):
            model = current
            done = self.run(model)
            stalls += not done.cost < best * (1.0 - STALLED)
            if done.cost < best:
                best, best_model = done.cost, model
            found = solve(products(done.zeta, done.phi), products(done.zeta, done.target))
            if found is None:
                return best, best_model, None
            change = np.abs(found - model) * np.linalg.norm(done.zeta, axis=0)
            current = self.stabilized(self.bounded(found)) if stable else self.bounded(found)
            if change.max() <= STILL * math.sqrt(done.cost) or stalls >= patience:
                break
        return best, best_model, current

    def polish(
        self, model: FloatArray, *, stable: bool = False, prior: Prior | None = None, whitened: bool = False
    ) -> tuple[FloatArray, Pass, bool]:
        """Take damped Gauss-Newton steps on the output error; return the model, its pass, whether it converged."""
        known = Prior.none(model.size) if prior is None else prior
        white = self.whiten if whitened else np.asarray

        def cost(tried: FloatArray, done: Pass) -> float:
            if stable and not self.is_stable(tried):
                return math.inf
            power = float(np.sum(white(done.ahead) ** 2)) if whitened and math.isfinite(done.cost) else done.power
            return power + known.cost(tried)

        done, exact, halved, converged = self.run(model, alone=True), False, 0, False
        for _ in range(POLISH):
            slopes = white(self._slopes(model, done) if exact else done.zeta)
            gradient = products(slopes, white(done.error)) + known.pull(model)
            direction = solve(products(slopes, slopes) + known.weight, gradient)
            if direction is None:
                break
            variance = done.cost if prior is None else prior.variance
            gain = float(direction @ gradient)
            # converged: the step is a thousandth of a standard deviation, or the error is rounding
            converged = gain <= DONE * variance or self.is_rounding(done)
            if converged:
                break
            better = self._damped(model, direction, cost, cost(model, done), halved, alone=True)
            if better is not None:
                model, done, halved = better
            elif exact:
                converged = gain <= NEARLY_DONE * variance
                break
            else:
                exact, halved = True, 0
        return model, self.run(model), converged

    def polished(self, start: FloatArray, *, stable: bool = False) -> Root:
        """Return the root that steps on the output error lead to, with the noise model of its residual."""
        model, done, converged = self.polish(start, stable=stable)
        self.renew_noise(done)
        return Root(model, done, self.noise, done.cost, done.power, converged, converged, filters=False)

    def conclude(self, root: Root, prior: Prior | None = None) -> Refined | None:
        """Return the estimate of a root, see `refined_estimate.conclude`."""
        return conclude(self.structure, self.record, root, self.projection, prior)

    def _damped(
        self, model: FloatArray, direction: FloatArray, cost: Callable[[FloatArray, Pass], float], own: float,
        halved: int = 0, *, slack: float = 0.0, rise: float = 0.0, alone: bool = False,
    ) -> tuple[FloatArray, Pass, int] | None:  # fmt: skip
        """Return the model after the longest step that lowers the cost, its pass, and the next step's first halvings.

        The first length has ``halved`` halvings; the next step begins four times as long as this one.  The cost may
        exceed ``own`` by a ``rise`` at any length, and by ``slack`` times the part of the full step.  None if no length
        suffices, or, without a rise, if the parabola through ``own`` and the last two costs rises from the model on.
        """
        longer, fastest = math.inf, max(self.fastest, self._speed(model))
        for halvings in range(halved, HALVINGS):
            part = 0.5**halvings
            tried = model + direction * part
            if self._speed(tried) <= fastest:
                done = self.run(tried, alone=alone)
                above = cost(tried, done) - own - rise - part * slack
                if above < 0.0:
                    return tried, done, max(halvings - 2, 0)
                if not rise and halvings > halved + 1 and longer <= 4.0 * above < math.inf:
                    return None
                longer = above
        return None

    def _slopes(self, model: FloatArray, done: Pass) -> FloatArray:
        """Return the derivatives (K, T) of the output, those along the denominator by differences."""
        # the instruments interpolate the model's output linearly: with fast poles they are not its derivatives
        slopes = done.phi.copy()
        sizes = real_coefficients(model[self.structure.denominator], 1.0 / self.record.span)
        for i, size in enumerate(sizes):
            step = np.zeros(model.size)
            step[i] = DIFFERENCE * size
            less, more = (self.run(model + part, alone=True).ahead for part in (-step, step))
            slopes[:, i] = (less - more) / (2.0 * step[i])
        return slopes

    def stabilized(self, model: FloatArray) -> FloatArray:
        """Return ``model`` (T,) with unstable poles reflected into the left half-plane."""
        poles = roots(np.append(1.0, model[self.structure.denominator]))
        if not np.isfinite(poles).all() or poles.real.max() < -self.slowest:
            return model
        inside = -np.maximum(np.abs(poles.real), 2.0 * self.slowest) + 1j * poles.imag
        return np.concatenate([np.poly(inside).real[1:], model[self.structure.poles :]])

    def descend(
        self, model: FloatArray, steps: int, renewals: Sequence[int] = (), *, stable: bool = False
    ) -> Root | None:
        """Take damped steps on the whitened residual; None if the first pass fails."""
        done = self.run(model)
        if not math.isfinite(done.cost):
            return None
        settled, moved = max(renewals, default=0), math.inf
        costs: list[float] = []  # of the steps since the noise model was last renewed
        stuck, halved = False, 0  # stuck: no step lowers the cost
        is_own = False  # whether the noise model is that of this very model

        def cost(tried: FloatArray, done: Pass) -> float:
            is_allowed = math.isfinite(done.cost) and (not stable or self.is_stable(tried))
            return self.misfit(done) if is_allowed else math.inf

        for step in range(steps):
            if self.is_rounding(done):
                moved = 0.0
                break
            if step in renewals or stuck:  # with another noise model a step may lower the cost
                self.renew_noise(done)
                stuck, is_own = False, True
            zeta, white = self.whiten(done.zeta), self.whiten(done.error)
            variance = max(sum_of_squares(white) / self.record.count, 1e-300)
            own, better = self.misfit(done), None
            more = SLACK[self.projection is not None] * own
            # the instrumental-variable step converges from afar; the Gauss-Newton step is sure to lower the power of
            # the innovation, but not J, which contains the noise of the instruments
            companions = [self.whiten(done.phi), zeta]
            if self.projection is None:
                companions.reverse()
            for companion in companions:
                direction = solve(products(zeta, companion), products(zeta, white))
                if direction is None:
                    continue
                moved = sum_of_squares(combined(zeta, direction)) / variance
                if self.projection is None:
                    better = self._damped(model, direction, cost, own, halved, slack=more)
                else:
                    better = self._damped(model, direction, cost, own, rise=more)
                if better is not None:
                    break
            if better is None:
                stuck, halved = True, 0
                if is_own or step > settled:
                    break
                continue
            is_own = False
            model, done, halved = better
            if moved < STILL and step >= settled:
                break
            if step > settled:
                costs.append(self.misfit(done))
            if self.projection is None and _stalls(costs, SLOW * variance):
                break
        white = self.whiten(done.error if self.projection is not None else done.ahead)
        variance = sum_of_squares(white) / self.record.count
        converged = moved <= NEARLY_DONE
        # without a reference the cost has a kink where a pole crosses the axis, about which steps oscillate
        stalls = self.projection is None and _stalls(costs, NEARLY_DONE * variance)
        at_kink = self.projection is None and stuck
        ends = converged or stalls or (at_kink and step > settled)
        return Root(model, done, self.noise, variance, self.misfit(done), converged, ends, at_kink=at_kink)


def is_long_enough(structure: Structure, record: Record) -> bool:
    """Return whether a record has more usable samples than a model has parameters and nuisances."""
    return record.count - record.unknown(structure.delay) > 2 * structure.poles + structure.zeros + 3


def least_since(structure: Structure) -> int:
    """Return the fewest samples needed before and after a change."""
    return max(4 * (2 * structure.poles + structure.zeros + 2), SOONEST)


def _stalls(costs: Sequence[float], least: float) -> bool:
    """Return whether the last `STALLS` of some costs lie no more than ``least`` below the lowest before them."""
    earlier, last = costs[:-STALLS], costs[-STALLS:]
    return bool(earlier) and min(earlier) - min(last) <= least
