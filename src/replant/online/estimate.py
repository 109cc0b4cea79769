"""Estimate: the base class of `Identifier` with all that is read from it; nothing here changes its state."""

from __future__ import annotations

from functools import partial

import numpy as np

from replant.estimation.engine.estimate_covariance import covariance
from replant.estimation.engine.recent_samples import RecentSamples
from replant.estimation.engine.state import REASONS, State
from replant.estimation.settings import STORED, Request, Settings
from replant.estimation.solver.refined_estimate import Refined
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.numerics.arguments import BoolArray, FloatArray
from replant.online.identification import Identification
from replant.online.locking import reads
from replant.online.startup import Solved, collected, provisional, provisional_parameters
from replant.online.trace import Estimated
from replant.verdict import Assessment, assess_running, assess_starting
from replant.verdict.assess import judged

#: Reasons for rejection of samples that also count as accepted.
COUNTED = {"outlier", "stuck", "no output", "no reference"}


class Estimate(Identification):
    """The estimate of an `Identifier`, its uncertainty, its settings and its samples."""

    _request: Request
    _settings: Settings | None
    _reference: bool
    _hold: int  # measured outputs that the start-up waits for
    _dropped: int  # samples that the start-up has discarded
    _solved: Solved
    _state: State

    @property
    def request(self) -> Request:
        """The settings as the user gave them, "auto" for those chosen from the data."""
        return self._request

    @property
    def structure(self) -> Structure:
        """The structure that is identified."""
        return self._request.structure

    @property
    def dt(self) -> float:
        """Sampling time in s."""
        return float(self._request.dt)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order."""
        return self.structure.names

    @property
    @reads
    def settings(self) -> Settings | None:
        """The settings in use; None while samples are collected for the start-up."""
        return self._settings

    @property
    def _provisional(self) -> tuple[int, Refined] | None:
        """The number of outputs that the provisional model is made from, and this model; None if there is none."""
        return provisional(self._request, collected(self._state), self._solved)

    @property
    @reads
    def has_model(self) -> bool:
        """Whether there is an estimate: during start-up a provisional one, later that of the recursion."""
        return self._settings is not None or self._provisional is not None

    @property
    @reads
    def parameters(self) -> FloatArray:
        """The estimate (P,) in physical units, in the order of `names`.

        During start-up it is a provisional one, made from the first samples collected; zero while there is none.
        """
        return self._estimate()()

    def _estimate(self) -> Estimated:
        """Return a function that gives the present estimate, also later: collected samples stay unchanged."""
        size = self.structure.size
        if self._settings is None:
            return partial(provisional_parameters, self._request, collected(self._state), self._solved)
        return partial(np.asarray, self._state.theta[:size] * self._state.unit[:size])

    @property
    @reads
    def transfer_function(self) -> TransferFunction:
        """The estimate as G(s)."""
        return self.structure.transfer_function(self.parameters)

    @property
    @reads
    def covariance(self) -> FloatArray:
        """Covariance (P, P) of the estimate in physical units, with allowance for the residual's colour.

        NaN while there is no estimate, and without instruments, where noise biases the estimate by an unknown amount.
        """
        if self._settings is None:
            found, size = self._provisional, self.structure.size
            return np.full((size, size), np.nan) if found is None else found[1].covariance[:size, :size].copy()
        return covariance(self._state, self._settings)

    @property
    @reads
    def noise(self) -> NoiseModel | None:
        """The model of the residual's noise; None during start-up, and if the settings have none.

        The default has one; tracking and gradient optimizers and fixed filters have none.
        """
        if self._settings is None or not self._state.has_noise_model:
            return None
        return NoiseModel.of_slots(self._state.noise, self.dt, self._settings.scaling.output)

    @property
    @reads
    def uncertainty(self) -> Uncertainty:
        """Standard deviations of the parameters, poles, gain and frequency response."""
        return Uncertainty(self.structure, self.parameters, self.covariance)

    @property
    @reads
    def input_hold(self) -> str:
        """The input between two samples: "zoh" (held) or "foh" (linear)."""
        return self._request.input_hold if self._settings is None else self._settings.filter.input_hold

    @property
    def reference(self) -> bool:
        """Whether the samples come with a reference; see `Identifier.update`."""
        return self._reference

    @property
    @reads
    def samples(self) -> int:
        """Number of accepted samples; during start-up of those collected."""
        return self._state.samples

    @property
    @reads
    def taken(self) -> int:
        """Number of samples given so far, with rejected ones: where to continue after an interrupt.

        All samples up to this one were taken, with all work due after them, and none of the following ones was used,
        except one that confirms a sample held back.
        """
        counts = {reason: count for reason, count in self.rejected.items() if reason not in COUNTED}
        return self.samples + sum(counts.values()) + self._dropped

    @property
    @reads
    def rejected(self) -> dict[str, int]:
        """Number of rejected samples by reason."""
        return {reason: getattr(self._state, slot.name) for reason, slot in REASONS.items()}

    @property
    @reads
    def adapting(self) -> bool:
        """Whether the estimate follows the samples, or is frozen."""
        return self._settings is None or self._state.adapt

    @property
    @reads
    def recent(self) -> FloatArray:
        """The newest accepted samples (K, 3): mapped input, output, and seconds since the sample before."""
        kept = RecentSamples.of(self._state).values[:, :3]
        if self._settings is None:
            return kept.copy()
        rest = self._settings.preprocess
        return np.asarray(kept + np.array([float(rest.input_offset), float(rest.output_offset), 0.0]))

    @property
    @reads
    def recent_reference(self) -> FloatArray | None:
        """The reference (K,) of the samples of `recent`; None without one."""
        if not self._reference:
            return None
        return RecentSamples.of(self._state).reference.copy()

    @property
    @reads
    def judged(self) -> BoolArray:
        """Which samples of `recent` (K,) the verdict uses: since the last interruption, neither bridged nor stuck."""
        return judged(self._state, self.dt)

    @property
    @reads
    def bridged(self) -> BoolArray:
        """Which samples of `recent` (K,) were bridged: outliers, missing outputs, outputs of a stuck sensor."""
        return RecentSamples.of(self._state).is_bridged

    @property
    @reads
    def left_out(self) -> BoolArray:
        """Which samples (K,) of the record the solution of `Identifier.finish` left out; (0,) without one."""
        state = self._state
        solved = self._settings is not None and state.finished_at == state.samples
        return RecentSamples.of(state, STORED).is_bridged if solved else np.zeros(0, bool)

    @property
    @reads
    def loads(self) -> tuple[int, ...]:
        """Accepted samples before each load that `Identifier.finish` has found; empty once samples follow."""
        state = self._state
        solved = self._settings is not None and state.finished_at == state.samples and not state.undecided
        return RecentSamples.of(state, STORED).loads if solved else ()

    @property
    @reads
    def status(self) -> str:
        """One of "starting", "running", or "diverged": an update was undone as it would have exceeded float64."""
        if self._settings is None:
            return "starting"
        return "diverged" if self._state.refused else "running"

    @reads
    def __repr__(self) -> str:
        structure, known = self.structure, self.has_model
        dead_time = f"dead time {structure.delay:g} s, " if structure.delay else ""
        wanted = f"poles {structure.poles}, zeros {structure.zeros}, {dead_time}dt {self.dt:g} s"
        model = self.transfer_function if known else "no model yet"
        return f"<{type(self).__name__}: {wanted}; {self.samples:,} samples, {self.status}, {model}>"

    def assess(self) -> Assessment:
        """Return the verdict: whether to trust the estimate, why in plain words, and the figures behind it.

        ``status`` says whether the model is right, ``excited`` whether the newest samples are informative: a model that
        was trusted stays so while the input rests.

        The state does not change.  Takes some tens of milliseconds, and some tenths of a second after `finish` on a
        long record, which is then examined as a whole.  See `replant.verdict.Assessment`.
        """
        return self._snapshot()._assess()

    def _snapshot(self) -> Estimate:
        """Return a read-only copy in the present state, so that no other call waits; it takes no sample."""
        raise NotImplementedError

    def _assess(self) -> Assessment:
        if self._settings is None:
            found = self._provisional
            solved, uncertainty = (0, np.nan) if found is None else (found[0], found[1].uncertainty)
            state = self._state
            finished, kept = state.finished_at == state.samples, collected(state)
            return assess_starting(self._request, kept, self._hold, solved, uncertainty, finished=finished)
        return assess_running(self._state, self._settings, self._request.history)
