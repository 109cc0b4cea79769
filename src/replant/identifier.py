"""Identifier: wires filters, regressor, scaling, buffer and optimizer together and owns their state."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

from replant.assessment import Assessment, assess_running, assess_starting
from replant.covariance import covariance
from replant.defaults import settle
from replant.errors import InvalidArgumentError
from replant.filters import RefinedFilter, StateVariableFilter
from replant.kernels import layout as at
from replant.optimizers import Optimizer
from replant.preprocess import Preprocess, screen
from replant.renewal import RECENT, REGULAR, first_look, look, next_solution, solved_again
from replant.replay import Replay
from replant.scaling import Scaling
from replant.settings import AUTO, Request, Settings
from replant.startup import LARGEST, first_model, kernels_for, ready_record, seed, warm_up, without_spikes
from replant.state import State
from replant.structure import Structure
from replant.trace import Trace
from replant.transfer_function import TransferFunction
from replant.uncertainty import Uncertainty
from replant.validation import FloatArray, number, record, vector

#: Why a sample is not learned, and where it is counted.  Outliers, and what comes from a stuck sensor, are bridged.
REASONS = {
    "not finite": at.NOT_FINITE, "too large": at.TOO_LARGE, "not later": at.NOT_LATER, "too dense": at.TOO_DENSE,
    "outlier": at.OUTLIERS, "stuck": at.STUCK,
}  # fmt: skip


class Identifier:
    r"""Identify G(s) online: samples go in one by one, the estimate is there after each.

    What is left to "auto" is chosen from the first ``startup`` accepted samples, which are held back for that and
    then learned in their order, so none is lost; until then the estimate stays at zero and `settings` is None.

    Parameters
    ----------
    structure : Structure
    dt : float
        Sampling time in s.
    filter : RefinedFilter, StateVariableFilter or "auto"
        "auto" is the refined filter for optimizers that keep a covariance, and else (s + cutoff)^n with the cutoff
        chosen from the data.
    scaling : Scaling, "auto" or None
        None changes nothing.
    optimizer : Optimizer or "auto"
        Or the name of one (see `replant.optimizers.OPTIMIZERS`), its settings chosen from the data.
    replay : Replay, "auto" or None
        None learns each sample once.
    instruments : bool or "auto"
        Use the noise-free companion of the regressor, zeta, where the update has phi.  "auto" does so with the
        refined filter and with optimizers that keep a covariance.
    normalize : bool
        Divide the error by :math:`m^2 = 1 + \varphi^T \varphi`, (13).
    preprocess : Preprocess
        Input map and working point.
    startup : int
        Samples held back at the beginning, from which choices and the first model are made.  Doubled as often as
        needed where they do not suffice for instruments, up to 20000.

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        For an argument that cannot be used; the message names it.

    Notes
    -----
    A sample that is not finite, or whose magnitude exceeds 1e150, is rejected before it touches anything, and counted
    in `rejected`.  An update that would leave float64 is undone: the last finite estimate stays and `status` says
    "diverged".  Memory does not grow with the stream.

    An optimizer that keeps a covariance learns from no output that cannot be: an outlier, or a sensor that is stuck
    or at its limit.  The filters see the model's output instead; `rejected` counts such samples, `samples` as well.
    Where the residual grows and stays so, `assess` says that something has changed; a model of what came since then
    takes over as soon as it can be used and predicts what it has not seen much better than the present one.

    As the record grows to twice, four times, ... the start-up, it is solved again as a whole, from the present
    estimate, until 10000 samples are reached: a first model from too short a start-up does not leave its traces.
    Such a solution takes some tens of milliseconds; every other update about a microsecond.

    Examples
    --------
    >>> true = TransferFunction([2.0], [1.0, 0.5])
    >>> u = np.where(np.arange(4000) // 125 % 2 == 0, 1.0, -1.0)
    >>> y = true.simulate(u, dt=0.01)
    >>> ident = Identifier(Structure(poles=1), dt=0.01)
    >>> trace = ident.update_many(u, y)
    >>> print(ident.transfer_function)
    2 / (s + 0.5)

    References
    ----------
    Bernat and Kolota (2023), (8)-(14); Young (2011), "Recursive Estimation and Time-Series Analysis", chapter 8.
    """

    def __init__(
        self,
        structure: Structure,
        dt: float,
        *,
        filter: StateVariableFilter | RefinedFilter | str = AUTO,  # noqa: A002 - the field's word
        scaling: Scaling | str | None = AUTO,
        optimizer: Optimizer | str = AUTO,
        replay: Replay | str | None = AUTO,
        instruments: bool | str = AUTO,
        normalize: bool = True,
        preprocess: Preprocess = Preprocess(),  # noqa: B008 - frozen
        startup: int = 500,
    ) -> None:
        self._request = Request(
            structure, dt, filter, scaling, optimizer, replay, instruments, normalize, preprocess, startup
        )
        self.reset()

    def reset(self) -> None:
        """Forget every sample and begin again, choices left to "auto" included."""
        self._settings: Settings | None = None
        self._held: list[tuple[float, float, float]] = []
        self._held_rejects = dict.fromkeys(REASONS, 0)
        self._resolve_at = 0  # accepted samples at which to solve the record again; 0: not planned
        self._state: State
        if self._request.asks_for_data:
            self._hold = max(self._request.startup, self._least_startup)
        else:
            self._hold = 0 if self._request.preprocess.needs == "nothing" else 1
            if self._hold == 0:
                self._begin()

    def clone(self) -> Identifier:
        """Return an independent copy in the same state."""
        return copy.deepcopy(self)

    def update(self, u: float, y: float, t: float | None = None) -> float:
        """Take one sample; return its a-priori output error y - theta' phi, in the unit of y.

        NaN stands for "no prediction": the sample was rejected, or is held back for start-up.

        Parameters
        ----------
        u, y : float
        t : float, optional
            Time stamp in s, for a clock that is not regular: given with every sample, or with none.  Filters and model
            are exact for the interval that really passed.  A stamp that does not advance is rejected; after a gap of
            20 dt the filters begin anew, and learning waits until what is unknown of the gap has died out.

        Raises
        ------
        ArgumentTypeError
            If an argument is not a number; the state stays as it was.
        """
        if type(u) is not float:
            u = number("u", u)
        if type(y) is not float:
            y = number("y", y)
        t = math.nan if t is None else self._stamp(t)
        if self._settings is None:
            return self._hold_back(u, y, t)
        if self._mapped:
            u = float(self._request.preprocess.call_map(np.array([u]))[0])
        state = self._state
        error: float = self._step(state.ints, state.reals, state.banks, state.buffer, state.recent, u, y, t)
        if self._attends:
            self._attend()
        return error

    def update_many(self, u: Any, y: Any, t: Any = None) -> Trace:
        """Take a chunk of samples in compiled code: equal, to the bit, to a loop of `update`.

        Parameters
        ----------
        u, y : (K,) arrays
        t : (K,) array, optional
            Time stamps in s, see `update`.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        # kernels are compiled for arrays that can be written to
        u, y = (array if array.flags.writeable else array.copy() for array in record(u, y))
        t = self._stamps(t, u.size)
        trace = Trace(self.names, self.parameters, np.empty((u.size, self.structure.size)), np.full(u.size, np.nan))
        taken = 0
        while self._settings is None and taken < u.size:
            stamp = float(t[taken]) if t.size else math.nan
            trace.errors[taken] = self._hold_back(float(u[taken]), float(y[taken]), stamp)
            trace.parameters[taken] = self.parameters
            taken += 1
        if taken < u.size and self._mapped:
            u = np.concatenate([u[:taken], self._request.preprocess.call_map(u[taken:])])
        while taken < u.size:
            end = u.size
            for due in (
                self._resolve_at,
                int(self._state.ints[at.LOOK_AT]),
            ):  # no further than where one would be were all accepted
                end = min(end, taken + due - self.samples) if due else end
            taken += self._take(
                u[taken:end], y[taken:end], t[taken:end], trace.errors[taken:end], trace.parameters[taken:end]
            )
        return trace

    def _take(self, u: FloatArray, y: FloatArray, t: FloatArray, errors: FloatArray, parameters: FloatArray) -> int:
        """Run a chunk, up to where something is to be looked into; do so, and return how many samples were taken."""
        state = self._state
        taken: int = self._steps(
            state.ints, state.reals, state.banks, state.buffer, state.recent, u, y, t, errors, parameters
        )
        if self._attends:
            self._attend()
            parameters[taken - 1] = self.parameters
        return taken

    def _attend(self) -> None:
        """After a sample: look into an alarm, or solve again, where either is due."""
        state = self._state
        settings = self._settings
        assert settings is not None
        samples = state.ints[at.SAMPLES]
        if state.ints[at.ALARM] == 1:
            state.ints[at.LOOK_AT] = first_look(state, settings)
        if samples == self._resolve_at:
            self._state = solved_again(state, settings) or state
            self._resolve_at = next_solution(self._state, settings)
        if samples == self._state.ints[at.LOOK_AT]:
            before = self._state
            self._state, later = look(before, settings)
            self._state.ints[at.LOOK_AT] = later
            if self._state is not before:
                self._resolve_at = next_solution(self._state, settings)

    def finish_startup(self) -> None:
        """Begin with the samples held so far, and learn them; without effect once begun.

        For records shorter than the start-up.
        """
        if self._settings is None and self._held:
            self._begin(at_any_rate=True)

    def freeze(self) -> None:
        """Stop adapting: samples go on through the filters, the estimate stays."""
        self._adapt(False)

    def resume(self) -> None:
        """Adapt again after `freeze`."""
        self._adapt(True)

    def _adapt(self, adapt: bool) -> None:
        if self._settings is None:
            raise InvalidArgumentError("the identifier is still starting: there is no estimate to freeze yet")
        self._state.ints[at.ADAPT] = adapt
        self._state.ints[at.CHANGE_BEGAN], self._state.reals[at.CUSUM] = self._state.ints[at.SAMPLES], 0.0
        if not adapt:
            # a later solution would learn what came in meanwhile
            self._resolve_at = self._state.ints[at.LOOK_AT] = self._state.ints[at.ALARM] = 0

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
    def settings(self) -> Settings | None:
        """What the identifier works with; None while samples are held back for start-up."""
        return self._settings

    @property
    def parameters(self) -> FloatArray:
        """The estimate (P,) in physical units, in the order of `names`."""
        size = self.structure.size
        if self._settings is None:
            return np.zeros(size)
        return np.asarray(self._state.theta[:size] * self._state.unit[:size])

    @property
    def transfer_function(self) -> TransferFunction:
        """The estimate as G(s)."""
        return self.structure.transfer_function(self.parameters)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (P, P) of the estimate in physical units, the residual's colour taken into account.

        NaN where no honest one is known: during start-up, and without instruments, where noise biases the estimate.
        """
        if self._settings is None:
            return np.full((self.structure.size, self.structure.size), np.nan)
        return covariance(self._state, self._settings)

    @property
    def uncertainty(self) -> Uncertainty:
        """Standard deviations of the parameters, poles, gain and frequency response."""
        return Uncertainty(self.structure, self.parameters, self.covariance)

    @property
    def samples(self) -> int:
        """Accepted samples, those held back for start-up included."""
        return len(self._held) if self._settings is None else int(self._state.ints[at.SAMPLES])

    @property
    def rejected(self) -> dict[str, int]:
        """Rejected samples by reason."""
        if self._settings is None:
            return dict(self._held_rejects)
        return dict(zip(REASONS, self._state.ints[list(REASONS.values())].tolist(), strict=True))

    @property
    def status(self) -> str:
        """One of "starting", "running", or "diverged": an update was undone because it would have left float64."""
        if self._settings is None:
            return "starting"
        return "diverged" if self._state.ints[at.REFUSED] else "running"

    def assess(self) -> Assessment:
        """Return the verdict: whether to trust the estimate, why in plain words, and the figures behind it.

        The state stays as it is.  Takes some tens of milliseconds.  See `replant.assessment.Assessment`.
        """
        if self._settings is None:
            return assess_starting(self._request, self._held, self._hold)
        return assess_running(self._state, self._settings)

    @property
    def _least_startup(self) -> int:
        """How many samples a first model needs at the least."""
        return 4 * (2 * self.structure.poles + self.structure.zeros + 2) if self._request.wants_instruments else 1

    def _stamp(self, t: Any) -> float:
        """Return a time stamp for the kernel: infinite, which it rejects, where it is not finite."""
        chosen = self._request.filter
        if isinstance(chosen, StateVariableFilter) and chosen.method == "gbt":
            raise InvalidArgumentError("the gbt filter knows a regular clock only: give no t, or use method='exact'")
        t = number("t", t)
        if self._settings is not None and self._regular:
            self._choose_kernels(regular=False)
        return t if math.isfinite(t) else math.inf

    def _stamps(self, t: Any, samples: int) -> FloatArray:
        if t is None:
            return REGULAR
        stamps = vector("t", t)
        if stamps.size != samples:
            raise InvalidArgumentError(f"t must have one stamp for each of {samples} samples, got {stamps.size}")
        self._stamp(0.0)
        return np.where(np.isfinite(stamps), stamps, np.inf)

    def _hold_back(self, u: float, y: float, t: float) -> float:
        """Keep a sample for start-up; with the last one, begin."""
        mapped = self._request.preprocess.map_input(np.array([u]))
        accepted, rejected = screen(mapped, np.array([y]))
        if accepted[0] and math.isinf(t):
            accepted, rejected = np.array([False]), {"not finite": 1}
        elif accepted[0] and self._held and not math.isnan(t) and not t > self._held[-1][2]:
            accepted, rejected = np.array([False]), {"not later": 1}
        for reason, count in rejected.items():
            self._held_rejects[reason] += count
        if not accepted[0]:
            return math.nan
        self._held.append((u, y, t))
        return self._begin() if len(self._held) == self._hold else math.nan

    def _begin(self, *, at_any_rate: bool = False) -> float:
        """Make every setting definite, lay out the state and learn the held samples; return the last one's error."""
        u, y, t = np.array(self._held, np.float64).reshape(-1, 3).T.copy()
        clean = without_spikes(y) if self._request.wants_instruments else y
        settings = settle(self._request, u, clean)
        refined = None
        if settings.instruments:
            stamps = None if np.isnan(t).any() else t
            hold = settings.filter.input_hold
            ready = ready_record(self.structure, self.dt, settings.preprocess, u, clean, stamps, hold)
            refined = first_model(self.structure, ready)
            if refined is None or not (refined.acceptable or at_any_rate or 2 * self._hold > LARGEST):
                return self._wait_longer()
        self._settings, self._mapped = settings, callable(self._request.preprocess.input_map)
        self._state = State.of_settings(settings, RECENT)
        self._choose_kernels(regular=bool(np.isnan(t).any()) or not t.size)
        self._state.ints[list(REASONS.values())] = list(self._held_rejects.values())
        self._held = []
        if u.size == 0:
            return math.nan
        if self._mapped:
            u = settings.preprocess.call_map(u)
        if refined is None:
            return float(self._warm_up(u, y, t, learn=True)[-1])
        seed(self._state, settings, refined, ready)
        errors = self._warm_up(u, y, t, learn=not settings.optimizer.keeps_covariance)
        self._resolve_at = next_solution(self._state, settings)
        return float(errors[-1])

    def _choose_kernels(self, *, regular: bool) -> None:
        """Choose who takes the samples; those for a regular clock do until the first time stamp."""
        self._regular = regular
        self._attends = bool(self._state.ints[at.GUARDED])  # whether something may be due after a sample
        self._step, self._steps = kernels_for(self._state, regular=regular)

    def _warm_up(self, u: FloatArray, y: FloatArray, t: FloatArray, *, learn: bool) -> FloatArray:
        errors = warm_up(self._state, u, y, REGULAR if np.isnan(t).any() else t, learn=learn)
        self._state.reals[at.READY] = self._state.reals[at.ELAPSED]
        return errors

    def _wait_longer(self) -> float:
        """Hold twice as much for start-up; at the limit, let the older half go: a rig may idle before it moves."""
        if 2 * self._hold <= LARGEST:
            self._hold *= 2
        else:
            self._held = self._held[len(self._held) // 2 :]
        return math.nan
