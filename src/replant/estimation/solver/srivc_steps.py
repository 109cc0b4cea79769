r"""The steps of refined instrumental variables: a structure, a record, passes of models over it, better models.

`replant.estimation.solver.srivc` has the equations and the way from the starts to the estimate.
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

# of 10,000 samples that is a hundredth of a unit of chi-square, a tenth of a standard deviation
STALLED = 1e-6  # decrease of the cost below which an iteration stalls [part of the cost]
STILL = 1e-3  # movement of the estimate below which it has converged [standard deviations of what an entry tells]
DONE = 1e-6  # gain of a Gauss-Newton step below which the fit is done: .001 standard deviations [residual's variances]
# a third of a standard deviation: where poles are as fast as the sampling the instruments' root is not the least cost
NEARLY_DONE = 0.1  # the same where no shorter step gains anything either [variances of the residual]
DIFFERENCE = 1e-5  # step of differences that make derivatives: float64's cube root [part of a coefficient]
HALVINGS = 10  # halvings of a Gauss-Newton step at the most: a thousandth is left of it [count]
POLISH = 30  # Gauss-Newton steps at the most [count]
STALLS = 6  # steps that may gain nothing to speak of before an iteration counts as ended: a limit of effort [count]
SLOW = 0.01  # gain of the last `STALLS` whitened steps below which they end: .1 deviations [innovation's variances]
# growth of the cost that a whitened step may bring [part of the cost]: the root of the instruments' equations lies
# beside the least cost.  With a reference J is chi-squared at it, and may grow however short a step towards it is
SLACK = {False: 1e-3, True: 0.02}
FASTEST = 3.0  # bound of a pole's magnitude: beyond pi / dt it lies above half the sampling rate [1 / sampling time]


# that many residuals tell their variance to a fifth
SOONEST = 50  # fewest samples before or since a change that are looked into, and between two looks [samples]


class Problem:
    """The fit of one structure to one record: passes of models over it, and the steps from model to model."""

    def __init__(self, structure: Structure, record: Record, beside: FloatArray | None = None) -> None:
        self.whole, self._unknown = record, record.unknown(structure.delay)
        self._beside = beside
        # without the samples at its beginning that answer to unknown inputs, because of a dead time
        self.structure, self.record = structure, record.last(record.u.size - self._unknown) if self._unknown else record
        # a filter's poles lie left of -slowest, their magnitudes are at most fastest, in rad/s
        self.slowest, self.fastest = stability_margin(record), FASTEST / record.dt
        self.projection = None if record.r is None else Projection.of(record)
        referenced = self.projection is not None
        hold = record.input_hold
        self._model = AuxiliaryModel(structure, record.dt, hold, margin=self.slowest, reference=referenced)
        self.noise = Autoregression.white(1.0, self.record.u.size)  # D(q) of the residual
        self._basis: tuple[Autoregression, FloatArray, FloatArray] | None = None

    def run(self, model: FloatArray, *, filled: bool = True) -> Pass:
        """Return the pass of a model (T,) over the record; zero rows where no output was measured."""
        done = self.run_whole(model, filled=filled).since(self._unknown)
        return done if self._beside is None else done.without(self._beside)

    def run_whole(self, model: FloatArray, *, filled: bool = True) -> Pass:
        """Return the same with the samples that answer to unknown inputs."""
        parts = None if self.projection is None else self.projection.parts
        if filled or self.whole.measured is None:
            return self._model.run(model, self.whole, parts)
        return self._model.run(model, replace(self.whole, measured=None), parts).of(self.whole.measured)

    def scores(self, model: FloatArray, signals: FloatArray) -> float:
        """Write slopes and residual (K, T + 1) without nuisances, record whole; return how much larger its error is."""
        record, alone = self.whole, self.projection is None and len(self.whole.parts) == 1 and self.is_stable(model)
        if alone:
            _, output = self._model.branch(model, record, constant=True, rows=signals)
            np.subtract(record.y, output, out=signals[:, -1])
            signals[: self._unknown] = 0.0
            if record.measured is not None:
                signals[~record.measured] = 0.0
            return 1.0
        # the error is the measured less the predicted output; where the model is stable it is the residual itself
        done = self.run_whole(model)
        power = sum_of_squares(done.error)
        signals[:, :-1], signals[:, -1] = done.zeta, done.error
        return math.sqrt(done.power / power) if power > 0.0 else math.nan

    def is_stable(self, model: FloatArray) -> bool:
        """Return whether no pole of ``model`` (T,) is reflected."""
        poles = roots(np.append(1.0, model[self.structure.denominator]))
        return bool(poles.real.max() < -self.slowest)

    def is_usable(self, model: FloatArray) -> bool:
        """Return whether the denominator of ``model`` (T,) can be a filter: finite, and not too fast."""
        return self._speed(model) < self.fastest

    def _speed(self, model: FloatArray) -> float:
        """Return a magnitude in rad/s that some pole has at least; infinite where the denominator is not finite."""
        a = model[self.structure.denominator]
        if not np.isfinite(a).all():
            return math.inf
        return float((np.abs(a) ** (1.0 / np.arange(1, a.size + 1))).max()) / a.size

    def bounded(self, model: FloatArray, fastest: float = 0.0) -> FloatArray:
        """Return ``model`` (T,) with no pole faster than the bound, unless all are slower than ``fastest`` [rad/s]."""
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
        """Return the estimate behind (s + cutoff)^n by least squares or a reference's instruments; None if singular."""
        n = self.structure.poles
        a = np.asarray(np.poly(np.full(n, -cutoff))[1:], np.float64)
        # without a numerator the model's output is no guess of outputs that were not measured: those that were, are
        done = self.run(np.concatenate([a, np.zeros(self._model.entries - n)]), filled=False)
        phi = self.whiten(done.phi)
        zeta = phi if self.projection is None or not by_reference else self.whiten(done.zeta)
        found = solve(products(zeta, phi), products(zeta, self.whiten(done.target)))
        return None if found is None else self.bounded(found)

    def with_nuisances(self, model: FloatArray) -> FloatArray:
        """Return ``model`` (T,) with the offset and the initial state that explain most."""
        done, count = self.run(model), self.structure.poles + 1
        more = amounts_of(done.phi[:, -count:], done.error)
        return np.concatenate([model[:-count], model[-count:] + more])

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` (K, ...), weighted where the past is not known."""
        return self.record.whitened(self.noise, signals)

    def is_rounding(self, done: Pass) -> bool:
        """Return whether only rounding is left of the residual."""
        return done.cost <= ROUNDING * float(np.mean(self.record.y**2))

    def renew_noise(self, done: Pass) -> None:
        """Model the residual of a pass; what only rounding is left of counts as white."""
        if self.is_rounding(done):
            self.noise = Autoregression.white(sum_of_squares(done.error), self.record.count)
        else:
            self.noise = Autoregression.of_residual(done.error, self.record.predecessors, self.record.count)

    def misfit(self, done: Pass) -> float:
        """Return J, what the reference explains of the whitened residual; without one, the power of that of `ahead`."""
        white = self.whiten(done.ahead if self.projection is None else done.error)
        if not np.isfinite(white).all():
            return math.inf
        if self.projection is None:
            return sum_of_squares(white)
        functions, basis = self._functions(self.projection)
        return float(np.sum((basis.T @ products(functions, white[:, None])) ** 2))

    def _functions(self, projection: Projection) -> tuple[FloatArray, FloatArray]:
        """Return the reference's whitened functions (K, L) and what makes them orthonormal, kept per noise model."""
        if self._basis is None or self._basis[0] is not self.noise:
            functions = self.whiten(projection.functions[self._unknown :])
            self._basis = self.noise, functions, orthogonal(products(functions, functions))
        return self._basis[1:]

    def improve(
        self, theta: FloatArray, iterations: int, patience: int, *, stable: bool
    ) -> tuple[float, FloatArray, FloatArray | None]:
        """Iterate the instrumental-variable step."""
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

        done, exact, halved = self.run(model), False, 0
        for _ in range(POLISH):
            slopes = white(self._slopes(model, done) if exact else done.zeta)
            gradient = products(slopes, white(done.error)) + known.pull(model)
            direction = solve(products(slopes, slopes) + known.weight, gradient)
            if direction is None:
                return model, done, False
            variance = done.cost if prior is None else prior.variance
            # converged: the step is a thousandth of a standard deviation, or the error is rounding
            if float(direction @ gradient) <= DONE * variance or self.is_rounding(done):
                return model, done, True
            better = self._damped(model, direction, cost, cost(model, done), halved)
            if better is not None:
                model, done, halved = better
            elif exact:
                return model, done, float(direction @ gradient) <= NEARLY_DONE * variance
            else:
                exact, halved = True, 0
        return model, done, False

    def polished(self, start: FloatArray, *, stable: bool = False) -> Root:
        """Return where steps on the output error end, and the noise model of its residual."""
        model, done, converged = self.polish(start, stable=stable)
        self.renew_noise(done)
        return Root(model, done, self.noise, done.cost, done.power, converged, converged, filters=False)

    def conclude(self, root: Root, prior: Prior | None = None) -> Refined | None:
        """Return the estimate that an iteration has come to."""
        return conclude(self.structure, self.record, root, self.projection, prior)

    def _damped(
        self, model: FloatArray, direction: FloatArray, cost: Callable[[FloatArray, Pass], float], own: float,
        halved: int = 0, *, slack: float = 0.0, rise: float = 0.0,
    ) -> tuple[FloatArray, Pass, int] | None:  # fmt: skip
        """Return the model after the longest step that costs less, its pass, and the halvings the next begins with.

        It begins with ``halved``, up to four times as long as the last one taken.  The ``own`` cost may be exceeded by
        a part of the slack as large as that of the step, or by a ``rise`` however short it is.  None where no step is
        short enough, or, without a rise, where the parabola through own cost and the last two goes up from there.
        """
        longer, fastest = math.inf, max(self.fastest, self._speed(model))
        for halvings in range(halved, HALVINGS):
            part = 0.5**halvings
            tried = model + direction * part
            if self._speed(tried) <= fastest:
                done = self.run(tried)
                above = cost(tried, done) - own - rise - part * slack
                if above < 0.0:
                    return tried, done, max(halvings - 2, 0)
                if not rise and halvings > halved + 1 and longer <= 4.0 * above < math.inf:
                    return None
                longer = above
        return None

    def _slopes(self, model: FloatArray, done: Pass) -> FloatArray:
        """Return the derivatives (K, T) of the output, those along the denominator by differences."""
        # the instruments join the model's output by straight lines: where poles are fast, they are no derivatives
        slopes = done.phi.copy()
        sizes = real_coefficients(model[self.structure.denominator], 1.0 / self.record.span)
        for i, size in enumerate(sizes):
            step = np.zeros(model.size)
            step[i] = DIFFERENCE * size
            slopes[:, i] = (self.run(model - step).ahead - self.run(model + step).ahead) / (2.0 * step[i])
        return slopes

    def stabilized(self, model: FloatArray) -> FloatArray:
        """Return ``model`` (T,) with the poles reflected that are not stable."""
        poles = roots(np.append(1.0, model[self.structure.denominator]))
        if not np.isfinite(poles).all() or poles.real.max() < -self.slowest:
            return model
        inside = -np.maximum(np.abs(poles.real), 2.0 * self.slowest) + 1j * poles.imag
        return np.concatenate([np.poly(inside).real[1:], model[self.structure.poles :]])

    def descend(
        self, model: FloatArray, steps: int, renewals: Sequence[int] = (), *, stable: bool = False
    ) -> Root | None:
        """Take damped steps on the whitened residual; None where the first pass fails."""
        done = self.run(model)
        if not math.isfinite(done.cost):
            return None
        settled, moved = max(renewals, default=0), math.inf
        costs: list[float] = []  # of the steps since the noise model was last renewed
        stuck, halved = False, 0  # whether no step lowers the cost
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
            # the instrumental-variable step finds its way from far; that of Gauss and Newton lowers the cost for sure
            # where that is the innovation's power, but J has the noise of the instruments in it
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
        # without a reference the cost has a bend where a pole crosses the axis, and steps go to and fro about it
        stalls = self.projection is None and _stalls(costs, NEARLY_DONE * variance)
        at_bend = self.projection is None and stuck
        ends = converged or stalls or (at_bend and step > settled)
        return Root(model, done, self.noise, variance, self.misfit(done), converged, ends, at_bend=at_bend)


def is_long_enough(structure: Structure, record: Record) -> bool:
    """Return whether a record has more samples that say something than a model has parameters and nuisances."""
    return record.count - record.unknown(structure.delay) > 2 * structure.poles + structure.zeros + 3


def least_since(structure: Structure) -> int:
    """Return the fewest samples before or since a change that are looked into."""
    return max(4 * (2 * structure.poles + structure.zeros + 2), SOONEST)


def _stalls(costs: Sequence[float], least: float) -> bool:
    """Return whether the last `STALLS` of some costs lie no more than ``least`` below the lowest before them."""
    earlier, last = costs[:-STALLS], costs[-STALLS:]
    return bool(earlier) and min(earlier) - min(last) <= least
