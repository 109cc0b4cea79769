"""Contest: the supposition of what has changed in a record that explains its newest samples best.

A residual may grow for many reasons.  Each is a supposition, fitted to the samples from some sample b on:

    NOTHING   the model goes on, with its offset, its state and its noise
    NOISE     the noise has another variance or colour
    LOAD      offset and initial state are new
    PART      also some directions of the coefficients: the gain, or single ones
    PLANT     also all coefficients
    CUT       the output no longer responds to the input: an open cable
    WHOLE     one other model holds for these samples and those before: the model was wrong

The knowledge from before is a prior, of which a supposition forgets some directions
(`estimation.solver.change_evidence`).  PART, PLANT and CUT are supposed only if the input moves.

All are compared over the same samples by the log-likelihood of their residuals.  These are whitened by the noise model
from before the change, or by their own at the price of its numbers, as an autoregression fitted to a step nearly
explains it.  Each fitted number costs ln(K) / 2 (Bayes' criterion), and another G(s) in addition -ln `ALPHA`, the prior
odds against it.  A linear model of a nonlinear plant fits each stretch differently: the gain by another G(s) is
weighed against this dispersion, see `weighed`.

Source: Schwarz (1978), "Estimating the dimension of a model", Annals of Statistics 6; Willsky and Jones (1976), "A
generalized likelihood ratio approach to the detection and estimation of jumps", IEEE Transactions on Automatic Control
21.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import Pass
from replant.estimation.solver import change_evidence
from replant.estimation.solver.change_evidence import WEAKEST, Known, Stretch, with_nuisances
from replant.estimation.solver.refined_estimate import Prior, Refined, Root, conclude, without_nuisances
from replant.estimation.solver.solve import Solution
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem, is_long_enough
from replant.kernels.schema import Supposition
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import combined, least_norm, quiet, sum_of_squares

# half of the amplitude that matters, as a change must be noticed before it is as large
NOTICED = 0.5 * math.sqrt(MATTERS)  # change of the simulated output up to which it is harmless [part of its amplitude]
# a fifth of `NOTICED`, so that no change that matters is missed
HARMLESS = 0.2 * NOTICED  # residual below which no change is looked for [part of the output's standard deviation]
# the growth that raises an alarm
UNEXPLAINED = 5.0  # residual power of LOAD or PART above which it is rejected [usual power]


@dataclass(frozen=True, eq=False)
class Claim:
    """A fitted supposition."""

    supposition: Supposition
    contest: Contest  # whose samples it is fitted to
    likelihood: float  # logarithm of the likelihood ratio to NOTHING, including a prior's
    odds: float = 0.0  # logarithm of the prior odds: the price of another G(s)
    price: float = 0.0  # of the fitted numbers
    unserved: float = 0.0  # log-likelihood gain of the likeliest model of this supposition over the one served
    left: float = 1.0  # residual variance of a fit with a prior, over the usual one
    model: FloatArray | None = None  # (T,)
    root: Root | None = None  # where its fit has ended
    prior: Prior | None = None  # of that fit
    refined: Refined | None = None  # the estimate, if made from the samples alone
    solution: Solution | None = None  # that of all samples

    @property
    def theta(self) -> FloatArray:
        """The model (T,) to continue with; after CUT, without a numerator."""
        return self.contest.known.mean if self.model is None else self.model

    @property
    def fair(self) -> float:
        """The evidence without the price of another G(s)."""
        return self.likelihood - self.price

    @property
    def evidence(self) -> float:
        """The logarithm of the evidence over that of NOTHING."""
        return self.fair + self.odds


def odds_of(supposition: Supposition) -> float:
    """Return the logarithm of the prior odds of a supposition."""
    return math.log(ALPHA) if supposition.is_of_plant else 0.0


def decided(claims: Sequence[Claim]) -> Claim | None:
    """Return the claim of most evidence; None if it does not win against all others, or without claims."""
    told = dict(zip(claims, weighed(claims), strict=True))
    found = max(claims, key=lambda claim: told[claim].evidence, default=None)
    if found is None or found.supposition is Supposition.CUT:
        return found
    if found.left > UNEXPLAINED:  # it would raise an alarm again, and explains nothing
        likeliest = max(claims, key=lambda claim: told[claim].fair)
        return likeliest if likeliest.supposition is Supposition.CUT else None
    wins = all(_wins(found, claim, told) for claim in claims)
    return found if wins else None


def _wins(found: Claim, rival: Claim, told: Mapping[Claim, Claim]) -> bool:
    """Return whether the claim of most evidence is likelier than another one, the price of G(s) aside."""
    more, of_plant = told[found].fair - told[rival].fair, found.supposition.is_of_plant
    if rival.supposition is Supposition.CUT and of_plant:
        # weighed against a third claim, both grow as the logarithm of the samples, and their difference does not grow
        more = found.contest.weighed(found.fair - rival.fair)
    # accepting a load discards most of the earlier information on G(s): it must be sure against no change at all
    same = Supposition.NOTHING, Supposition.NOISE
    if rival.supposition is Supposition.CUT or (found.supposition is Supposition.LOAD and rival.supposition in same):
        return more >= -math.log(ALPHA)
    # a claim of the same G(s) must also win without the price of another one
    return more >= (-math.inf if of_plant else 0.0)


def is_sure(claims: Sequence[Claim], best: Claim) -> bool:
    """Return whether no claim of a G(s) other than that of the best one could hold as well."""

    def less_likely(claim: Claim) -> float:
        # a load is sure once the samples since determine G(s): no other one is as likely, even with its numbers free
        is_free = best.supposition is Supposition.LOAD and claim.supposition.is_of_plant
        left = best.fair - (claim.likelihood if is_free else claim.fair + claim.unserved)
        of_plant = next((each for each in (claim, best) if each.supposition.is_of_plant), None)
        return left if of_plant is None else of_plant.contest.weighed(left)

    close = [claim for claim in claims if less_likely(claim) < -math.log(ALPHA)]
    return not any(best.contest.differ(claim.theta, best.theta) for claim in close)


def would_change(claims: Sequence[Claim], other: Claim) -> bool:
    """Return whether another claim would change what is decided on among some, or whether that is sure."""
    found, both = decided(claims), [*claims, other]
    if decided(both) is not found:
        return True
    return found is not None and is_sure(claims, found) and not is_sure(both, found)


def weighed(claims: Sequence[Claim]) -> list[Claim]:
    """Return the claims, the gain of a change of G(s) over the claims of one G(s) weighed by `Contest.weighed`."""
    same = [claim for claim in claims if not (claim.supposition.is_of_plant or claim.supposition is Supposition.CUT)]
    base = max((claim.fair for claim in same), default=0.0)
    most = max((claim.fair + claim.unserved for claim in same), default=0.0)
    return [
        replace(claim, likelihood=base + claim.contest.weighed(claim.fair - most) + claim.price)
        if claim.supposition.is_of_plant
        else claim
        for claim in claims
    ]


def outputs_differ(problem: Problem, model: FloatArray, other: FloatArray, part: float = NOTICED) -> bool:
    """Return whether the outputs of two models' G(s) for a problem's input differ by a ``part`` of the second."""
    bare = (without_nuisances(problem.structure, each[: problem.structure.coefficients]) for each in (model, other))
    own, others = (problem.run_whole(each).output for each in bare)
    return not float(np.std(own - others)) < part * float(np.std(others))


class Contest:
    """The suppositions of what has changed at a sample of a record."""

    def __init__(
        self, structure: Structure, record: Record, begin: int, known: Known, parted: int | None = None
    ) -> None:
        self.structure, self.record, self.begin, self.known = structure, record, begin, known
        self.since = record.last(record.u.size - begin)
        self.problem = Problem(structure, self.since)
        self.problem.noise = known.noise
        self._whole = Problem(structure, record)
        self.rows = self.problem.record.u.size  # samples since that depend on known inputs
        self.count = self.problem.record.count
        middle = max((parted or begin) - (record.u.size - self.rows), 0)
        self.stretch = Stretch.of(self.problem.record, slice(None), middle)
        self.error = known.error[known.error.size - self.rows :]  # of the model from before
        self.usual = self.stretch.of_usual(self.error, known.noise, known.variance)

    @quiet
    def claims(self, *, again: bool = False) -> list[Claim]:
        """Return the claims about the samples since; ``again``: only those of a change, which was accepted before."""
        if not is_long_enough(self.structure, self.since):
            return []
        found: list[Claim] = []
        if not again:
            noise = self.stretch.of_other(self.error, self.known.noise) - self.usual
            found = [self._claim(Supposition.NOTHING, 0.0), self._claim(Supposition.NOISE, noise)]
        if float(np.std(self.error)) < HARMLESS * self.problem.record.spread:
            return found
        models = [self.known.mean]
        for claim in self._of_models():
            models.append(claim.model if claim.model is not None else self.known.mean)
            # a load must leave G(s) as it is, and another G(s) must change the output
            if self.differ(models[-1], self.known.mean) == claim.supposition.is_of_plant:
                found.append(claim)
        return found if again else [*found, *self._cuts(models)]

    @property
    def power(self) -> float:
        """Mean square of the residual of the model from before in the newer half of the samples since."""
        newer = slice(self.rows // 2, None)  # a burst of noise may be over
        return sum_of_squares(self.error[newer]) / max(int(self.stretch.measured[newer].sum()), 1)

    def weighed(self, more: float) -> float:
        """Return the evidence in a log-likelihood gain by another G(s), see `change_evidence.weighed`."""
        return change_evidence.weighed(more, *self.dispersion)

    @cached_property
    def dispersion(self) -> tuple[float, float]:
        """`Known.dispersion` in stretches as long as the samples since."""
        return self.known.dispersion(self.record, self.rows)

    def _of_models(self) -> Iterator[Claim]:
        """Yield the claims of models fitted to the samples since: a load, a part of the plant, another plant."""
        moved = with_nuisances(self.problem, self.known.mean, slice(-self.rows, None))
        begins = [(Supposition.LOAD, (moved, np.zeros((moved.size, 0))))]
        if self._is_driven(*self._driven(self.known.mean)):  # else the gain is not determined
            begins.append((Supposition.PART, self._scaled()))
        starts = []
        for supposition, start in begins:
            claim = self._with_prior(supposition, start)
            if claim is not None and claim.model is not None:
                starts.append(claim.model)
                yield claim
        plant = self._plant(starts)
        if plant is None:
            return
        yield plant
        if plant.refined is not None:
            part = self.known.asked_for(plant.refined, self.structure.coefficients, self.stretch.price)
            claim = self._with_prior(Supposition.PART, part) if part is not None else None
            if claim is not None:
                yield claim

    @quiet
    def whole(self, model: FloatArray, solution: Solution | None = None) -> Claim:
        """Return the claim that one other model (T,), from a solution, holds for the samples before as well."""
        likelihood = self._likelihood_of_all(model)
        self._whole.noise = self.known.noise  # a solution is not always the likeliest model, see `srivc`
        likeliest = self._likelihood_of_all(self._whole.polish(model, whitened=True)[0])
        more = max(likeliest - likelihood, 0.0) if math.isfinite(likelihood) else 0.0
        return self._claim(Supposition.WHOLE, likelihood, model=model, solution=solution, unserved=more)

    @quiet
    def hopeful(self, models: Sequence[FloatArray]) -> Claim:
        """Return the claim that `whole` may lead to at best, from the likeliest of the models (T,) at hand."""
        self._whole.noise = self.known.noise
        start = max((with_nuisances(self._whole, model) for model in models), key=self._likelihood_of_all)
        ends = start, self._whole.polish(start, whitened=True)[0]
        # a solution ends elsewhere: it is supposed to be surely likelier
        return self._claim(Supposition.WHOLE, max(map(self._likelihood_of_all, ends)) - math.log(ALPHA), model=ends[1])

    def _likelihood_of_all(self, model: FloatArray) -> float:
        """Return the log-likelihood ratio to NOTHING of one model for the samples before and since."""
        error = self._whole.run_whole(model).ahead
        rows, noise = slice(0, error.size - self.rows), self.known.noise
        before = Stretch.of(self.record, rows)
        likelihood = self.stretch.of_other(error[-self.rows :], noise) - self.usual
        likelihood += before.of_other(error[rows], noise)
        offset = before.measured[:, None].astype(float)
        return likelihood - before.of_other(self.known.error[rows], noise, offset)

    def _claim(self, supposition: Supposition, likelihood: float, numbers: int = 0, **parts: object) -> Claim:
        """Return a claim with ``numbers`` fitted numbers."""
        price = numbers * self.stretch.price
        return Claim(supposition, self, likelihood, odds_of(supposition), price, **parts)  # type: ignore[arg-type]

    def _likelihood(self, done: Pass, error: FloatArray | None = None) -> float:
        """Return the log-likelihood ratio to NOTHING of a model's pass, or of another error (K,) with its nuisances."""
        nuisances = done.phi[:, self.structure.coefficients :]
        return self.stretch.of_other(done.ahead if error is None else error, self.known.noise, nuisances) - self.usual

    def _scaled(self) -> tuple[FloatArray, FloatArray]:
        """Return the known model with the gain that fits the samples since best, and the numerator's direction."""
        model, size, numerator = self.known.mean.copy(), self.structure.coefficients, self.structure.numerator
        without, forced = self._driven(model)
        columns = np.column_stack([forced, without.phi[:, size:]])
        weights = least_norm(columns, without.error, WEAKEST)[0]
        direction = np.zeros((model.size, 1))
        direction[numerator, 0] = model[numerator]
        model[numerator] *= weights[0]
        model[size:] = weights[1:]
        return model, direction

    def _driven(self, model: FloatArray) -> tuple[Pass, FloatArray]:
        """Return the pass of a model without its numerator, from rest, and the output (K,) due to the numerator."""
        still, moving = model.copy(), model.copy()
        still[self.structure.coefficients :] = moving[self.structure.coefficients :] = 0.0
        still[self.structure.numerator] = 0.0
        without = self.problem.run(still)
        return without, without.error - self.problem.run(moving).error

    def _is_driven(self, without: Pass, driven: FloatArray) -> bool:
        """Return whether the driven part (K,) of an output is more than an offset and an initial state."""
        columns = without.phi[:, self.structure.coefficients :]
        beside = driven - combined(columns, least_norm(columns, driven, WEAKEST)[0])
        return float(np.std(beside)) > HARMLESS * float(np.std(driven))

    def _with_prior(self, supposition: Supposition, start: tuple[FloatArray, FloatArray]) -> Claim | None:
        """Return the claim of a model known except in some directions, fitted from ``start``, model and directions."""
        # with a drifting load, a fit without a line may be wrong; without a drift, one with a line may be
        drifting, best = self._drifting(self.problem.run(start[0])), None
        for problem in {id(each): each for each in (self.problem, drifting)}.values():
            prior = self.known.without(start[1])
            model, done, converged = problem.polish(start[0], prior=prior, whitened=True)
            variance = self._variance(done.ahead)
            if variance > prior.variance:  # the samples since are weighed by their own variance
                prior = replace(prior, variance=variance)
                model, done, converged = problem.polish(start[0], prior=prior, whitened=True)
            if not (np.isfinite(model).all() and math.isfinite(done.cost)):
                continue
            likelihood = self._likelihood(self.problem.run(model)) - 0.5 * prior.cost(model) / prior.variance
            root = self._root(model, done, converged=converged)
            numbers = start[0].size - self.structure.coefficients + start[1].shape[1]
            left = self._variance(done.ahead) / (self.known.variance + self.stretch.least)
            claim = self._claim(supposition, likelihood, numbers, model=model, root=root, prior=prior, left=left)
            best = claim if best is None or claim.fair > best.fair else best
        return best

    def _variance(self, error: FloatArray) -> float:
        """Return the variance of an error (K,) filtered by the noise model from before."""
        white = self.known.noise.whiten_known(error, self.stretch.predecessors)
        return sum_of_squares(white) / max(self.count, 1)

    def _drifting(self, done: Pass) -> Problem:
        """Return the problem of the samples since with a drifting load as a pass shows; the same without one."""
        line = self.stretch.line(done.ahead, self.known.noise, done.phi[:, self.structure.coefficients :])
        if line.shape[1] == 0:
            return self.problem
        problem = Problem(self.structure, self.since, line)
        problem.noise = self.known.noise
        return problem

    def _root(self, model: FloatArray, done: Pass, *, converged: bool) -> Root:
        """Return a model as the end of a fit, filtered by the noise model from before if estimates are."""
        white = self.known.noise.whiten_known(done.ahead, self.stretch.predecessors)
        power = sum_of_squares(white)
        innovation = power / max(self.count, 1)
        return Root(model, done, self.known.noise, innovation, power, converged, converged, filters=self.known.filters)

    def _plant(self, given: Sequence[FloatArray]) -> Claim | None:
        """Return the claim of a model of the samples since alone; one that has not settled cannot win."""
        found = refine(self.structure, self.since, given, afresh=True, filtered=self.known.filters)
        # with a constant input any gain fits with some offset: the numerator is not determined
        if found is None or not self._is_driven(*self._driven(found.theta)):
            return None
        run = self.problem.run(found.theta)
        if not found.settled:
            likelihood, numbers = self._likelihood(run), found.theta.size
            return self._claim(Supposition.PLANT, likelihood, numbers, model=found.theta, left=math.inf)
        problem = self._drifting(run)
        if problem is not self.problem:
            root = problem.polished(found.theta)
            again = conclude(self.structure, problem.record, root)
            if again is not None and again.settled:
                found, run = again, self.problem.run(again.theta)
        return self._claim(Supposition.PLANT, self._likelihood(run), found.theta.size, model=found.theta, refined=found)

    def _cuts(self, models: Sequence[FloatArray]) -> Iterator[Claim]:
        """Yield the claims that the output decays as a model does, and does not respond to the input."""
        for model in models:
            done, driven = self._driven(model)
            columns, error = done.phi[:, self.structure.coefficients :], done.ahead
            if not self._is_driven(done, driven):
                continue
            left = error - combined(columns, least_norm(columns, error, WEAKEST)[0])
            # the initial state of a wandering output is determined only with the noise model
            noise = self.stretch.colour(left)
            white, target = (noise.whiten_known(each, self.stretch.predecessors) for each in (columns, error))
            other = error - combined(columns, least_norm(white, target, WEAKEST)[0])
            likelihood, still = max(self._likelihood(done, left), self._likelihood(done, other)), model.copy()
            still[self.structure.numerator] = 0.0
            yield self._claim(Supposition.CUT, likelihood, columns.shape[1], model=still)

    def differ(self, model: FloatArray, other: FloatArray, part: float = NOTICED) -> bool:
        """Return `outputs_differ` for the whole input."""
        return outputs_differ(self._whole, model, other, part)

    def estimate(self, claim: Claim) -> Refined | None:
        """Return the estimate of a claim about the samples since, including the prior."""
        if claim.refined is not None or claim.root is None:
            return claim.refined
        return self.problem.conclude(claim.root, claim.prior)
