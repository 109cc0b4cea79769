"""RowIdentifier: several inputs online, each with poles, zeros and a dead time of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.estimation.engine.dimensions import RECENT
from replant.estimation.settings import STORED, check_kept
from replant.fitting.miso_fit import RowFit, row_fit, structures_of
from replant.fitting.miso_model import RowModel
from replant.fitting.miso_solve import references_of
from replant.fitting.model_fields import Provenance, input_names_of
from replant.model.noise import NoiseModel
from replant.model.structure import Structure, names_of, places_of
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.numerics.arguments import FloatArray, array_of_reals, number, one_of, vector, whole
from replant.numerics.limits import duration, stamps_of
from replant.online.identification import Identification, check_begun
from replant.online.locking import Turn, changes, reads
from replant.online.miso_samples import RowSamples, RowSettings, fewest
from replant.online.miso_state import RowState
from replant.online.miso_step import Kept, RowStep
from replant.online.running_model import NO_COLUMNS, NewestSamples, is_regular, newest_of
from replant.online.trace import Trace
from replant.verdict.verdict import Verdict

if TYPE_CHECKING:
    from replant.online.checkpoint_file import Progress

PIECE = 8192  # samples after which Ctrl-C is handled while a chunk is taken [samples]


class RowIdentifier(Identification):
    r"""Identify a plant of several inputs online; `Identifier` returns it if ``poles`` has an entry for each input.

    .. math:: y = \sum_i \frac{B_i(s)}{A_i(s)} e^{-s\,\mathrm{delay}_i} u_i + \mathrm{offset} + \mathrm{noise}

    Parameters
    ----------
    poles, zeros : tuple of int
        Number of poles and of zeros of each input.
    delay : tuple of float
        Dead time of each input in s.
    dt : float
        Sampling time in s.
    startup : int
        Number of outputs for the first model.
    history : int
        Raw samples kept, from 10000 to 30000; `finish` needs the whole record.
    input_hold : {"zoh", "foh"}
        Whether the inputs between two samples are held or linear.
    input_names : tuple of str
        By default u1, u2, ..

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        For an argument that cannot be used; the message names it.

    Notes
    -----
    Each time that the record has grown by half, up to 10000 samples, it is solved again as a whole; also when the
    number of moves of an input has grown by half.  In between, and later, a joint update of all coefficients follows
    the samples.  At each solution and once in between the record is tested for a change: for a load, which changes the
    offset, or for another plant, with which the record begins anew.

    A sample whose inputs or time are not finite, or larger than 1e150, is rejected; without time stamps it takes dt,
    and for three samples after the newest output such an input lasts as before instead.  A sample without an output
    (NaN) drives the model, but nothing is learned from it.  When the record is solved again, and for the verdict,
    outliers and outputs of a stuck sensor are left out, as by `fit`; until then an error counts as at most six standard
    deviations.  After `freeze` there are no solutions and tests for changes until `reset`: `resume` adapts sample by
    sample.

    Examples
    --------
    >>> from replant import Identifier
    >>> first, second = TransferFunction([2.0], [1.0, 0.5]), TransferFunction([1.0], [1.0, 3.0], delay=0.3)
    >>> u = np.random.default_rng(0).choice([-1.0, 1.0], (100, 2)).repeat(10, axis=0)
    >>> y = first.simulate(u[:, 0].copy(), dt=0.1) + second.simulate(u[:, 1].copy(), dt=0.1)
    >>> ident = Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1)
    >>> trace = ident.update_many(u, y)
    >>> print(*ident.transfer_functions, sep=", ")
    2 / (s + 0.5), 1 / (s + 3) exp(-0.3 s)
    """

    def __init__(
        self, *, poles: Any, zeros: Any = 0, delay: Any = 0.0, dt: float | None = None, startup: int = 500,
        history: int = STORED, input_hold: str = "zoh", input_names: tuple[str, ...] = (), **others: Any,
    ) -> None:  # fmt: skip
        for name in others:
            raise InvalidArgumentError(f"several inputs take no {name} yet: leave it out")
        if dt is None:
            raise ArgumentTypeError("give the sampling time in s, dt: Identifier(poles=(2, 1), dt=0.01)")
        if isinstance(poles, list | tuple) and not poles:
            raise InvalidArgumentError("poles must have one entry for each input, got none")
        inputs = next((len(each) for each in (poles, zeros, delay) if isinstance(each, list | tuple)), 1)
        structures = structures_of(inputs, poles, zeros, delay)
        history = whole("history", history, RECENT, STORED)
        startup = max(whole("startup", startup, 1, history), fewest(structures))
        names = input_names_of(input_names, len(structures))
        check_kept(max(each.delay for each in structures), duration("dt", dt))
        hold = one_of("input_hold", input_hold, ("zoh", "foh"))
        settings = RowSettings(structures, duration("dt", dt), startup, history, hold, names)
        self._turn, self._now = Turn(), RowState.of(settings)

    @property
    def _now(self) -> RowState:
        """The state, with the single samples since the last chunk."""
        return self._kept.now

    @_now.setter
    def _now(self, state: RowState) -> None:
        self._kept = Kept(state, None, [])

    @changes
    def reset(self) -> None:
        """Forget every sample and begin again."""
        self._now = RowState.of(self.request)

    @reads
    def __getstate__(self) -> dict[str, Any]:
        now = self._now
        return {"_now": replace(now, kept=now.kept.copy())}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        self._turn, self._now = Turn(), attributes["_now"]

    def __deepcopy__(self, memo: Any) -> RowIdentifier:
        (made := object.__new__(type(self))).__setstate__(self.__getstate__())
        return made

    @classmethod
    def of(cls, request: RowSettings) -> RowIdentifier:
        """Return a new identifier with the settings of another one, see `request`."""
        (made := object.__new__(cls)).__setstate__({"_now": RowState.of(request)})
        return made

    @property
    def request(self) -> RowSettings:
        """The settings as they were given, checked."""
        return self._kept.state.settings

    def _encoded(self, progress: Progress | None) -> bytes:
        from replant.online.checkpoint.bank_and_row import row_parts
        from replant.online.checkpoint.encoding import ROW, encode_other

        return encode_other(ROW, *row_parts(self._now), progress)

    def update(self, u: Any, y: float, t: float | None = None, r: Any = None) -> float:
        """Take one sample; return its a-priori output error, in the unit of y.

        NaN stands for "no prediction": the sample was rejected, has no output, or is collected for the start-up.

        Parameters
        ----------
        u : sequence of float
            One per input.
        y : float
            NaN: no output.
        t : float, optional
            Time stamp in s, with every sample or with none, see `Identifier.update`: one that does not advance is
            rejected, ten of them in a row mean that the clock was set, and one that leaps waits for the next.  After a
            gap of 20 dt offset and initial states are estimated anew.
        r : float or sequence of float, optional
            References, if a controller makes an input: set-points or dithers, with every sample or with none, as for
            `replant.fit`.  NaN leaves the output of the sample out.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If an argument is not a number; the state stays as it was.
        """
        y = y if type(y) is float else number("y", y)
        u = u.tolist() if type(u) is np.ndarray else u
        if r is None and isinstance(u, tuple | list) and all(isinstance(each, float | int) for each in (*u, t or 0.0)):
            error = self._take_one(u, y, t)
            if error is not None:
                return error
        count, given = len(self.structures), array_of_reals("u", u)
        if given.shape != (count,):
            raise InvalidArgumentError(f"u must be a number for each of {count} inputs, got {shown(u)}")
        trace = self.update_many([u], [y], None if t is None else [number("t", t)], None if r is None else [r])
        return float(trace.errors[0])

    @changes
    def _take_one(self, u: Sequence[float], y: float, t: float | None) -> float | None:
        """Take a sample that needs the recursion alone and return its error; return None, untaken, for others."""
        kept = self._kept
        interval = kept.interval_to(u, y, t)
        if interval is None:
            return None
        self._kept = kept._replace(step=None)  # an interrupt leaves the state before, and the step is made anew
        step = kept.step or RowStep(kept.now)
        error, is_alarm = step.take(u, y, interval)
        self._kept = kept.with_more(step, (*u, y, 0.0 if t is None else t), is_alarm=is_alarm)
        return error

    @changes
    def update_many(self, u: Any, y: Any, t: Any = None, r: Any = None) -> Trace:
        """Take a chunk of samples: equal, to the bit, to a loop of `update`.

        Parameters
        ----------
        u : (K, q) array
            A column per input.
        y : (K,) array
        t : (K,) array, optional
            See `update`.
        r : (K,) or (K, p) array, optional
            One reference, or a column for each.

        Returns
        -------
        Trace
            Error and estimate after each sample.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        given = self._checked(u, y, t, r)
        size = given.y.size
        trace = Trace(self.names, self.parameters, np.empty((size, self.request.size)), np.full(size, np.nan), given.t)
        taken = 0
        while taken < size:
            some = slice(taken, taken + PIECE)
            self._now, count = self._now.take(given.part(some), trace.errors[some], trace.parameters[some])
            taken += count
        return trace

    def _checked(self, u: Any, y: Any, t: Any, r: Any) -> RowSamples:
        columns, output, count = array_of_reals("u", u), vector("y", y), len(self.structures)
        if columns.shape != (output.size, count):
            raise InvalidArgumentError(
                f"u must be a number for each of {count} inputs, (K, {count}) of K samples; got shape "
                f"{shown(columns.shape)} for {output.size} outputs"
            )
        stamped = self._now.stamped
        if output.size and stamped is not None and stamped != (t is not None):
            raise InvalidArgumentError("give t with every sample, or with none")
        given = references_of(r, output.size)
        references = np.empty((output.size, 0)) if given is None else given
        if output.size and self._now.samples and references.shape[1] != self._now.references:
            raise InvalidArgumentError(
                f"give r with every sample, or with none: {self._now.references} references came before, now "
                f"{references.shape[1]}"
            )
        stamps = None if t is None else stamps_of(t, output.size, is_first=not self._now.samples)
        return RowSamples(columns, output, stamps, references)

    @changes
    def finish(self) -> None:
        """Solve for the estimate with every sample so far, as `replant.fit` does: for the end of a record.

        All samples kept are tested for changes again: a change that was found may be dropped.  The estimate does not
        change if it is or was frozen, as a solution would learn the samples that came meanwhile, and if older samples
        are no longer kept.  Samples may follow.
        """
        now = self._now
        if not now.kept.measured or now.was_frozen:
            return
        done = now.finished()
        if now.recursion is not None:  # later solutions keep their schedule
            self._now = replace(done, solve_at=now.solve_at, look_at=now.look_at)
        elif done.recursion is not None:
            self._now = done

    def _adapt(self, adapt: bool) -> None:
        if adapt:
            self._now = replace(self._now, adapts=True)
            return
        check_begun(self._kept.state.recursion is not None)
        # a later solution would learn the samples that come while frozen
        self._now = replace(self._now, adapts=False, solve_at=0, look_at=0)

    @property
    def structures(self) -> tuple[Structure, ...]:
        """The structure of each input."""
        return self.request.structures

    @property
    def dt(self) -> float:
        """Sampling time in s."""
        return self.request.dt

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in their order, each with that of its input: a0.u1, b0.u1, a0.u2, .."""
        return names_of(self.structures, self.request.input_names)

    @property
    def has_model(self) -> bool:
        """Whether there is an estimate."""
        return self._kept.state.recursion is not None

    @property
    def input_hold(self) -> str:
        """The inputs between two samples: "zoh" (held) or "foh" (linear)."""
        return self.request.input_hold

    @property
    def begins(self) -> tuple[int, ...]:
        """Accepted samples before the record of the estimate, then before each load that was found in it."""
        return self._now.record_began, *self._now.loads

    @property
    def rejected(self) -> dict[str, int]:
        """Number of rejected samples by reason; those without an output also count as accepted."""
        return dict(self._kept.state.rejected)

    @property
    def adapting(self) -> bool:
        """Whether the estimate follows the samples, or is frozen."""
        return self._kept.state.adapts

    @property
    def parameters(self) -> FloatArray:
        """The estimate (P,) in physical units, in the order of `names`; zero before the first one."""
        state, step, _ = self._kept
        return state.parameters if step is None else step.parameters

    @property
    def covariance(self) -> FloatArray:
        """Covariance (P, P) of the estimate in physical units; NaN before the first one."""
        known, size = self._now.recursion, self.request.size
        return np.full((size, size), np.nan) if known is None else known.covariance

    @property
    def transfer_functions(self) -> tuple[TransferFunction, ...]:
        """G(s) from each input."""
        return tuple(structure.transfer_function(theta) for structure, theta, _ in self._parts())

    @property
    def uncertainty(self) -> tuple[Uncertainty, ...]:
        """Standard deviations of each G(s): of its parameters, poles, gain and response."""
        return tuple(Uncertainty(*each) for each in self._parts())

    def _parts(self) -> Iterator[tuple[Structure, FloatArray, FloatArray]]:
        """Yield structure, parameters and covariance of each input."""
        parameters, covariance = self.parameters, self.covariance
        for each, rows in zip(self.structures, places_of(self.structures), strict=True):
            yield each, parameters[rows], covariance[rows, rows]

    @property
    def noise(self) -> NoiseModel | None:
        """The model of the residual's noise; None during start-up."""
        return None if self._now.recursion is None else self._now.recursion.noise_model

    @property
    def recent(self) -> tuple[FloatArray, FloatArray]:
        """Inputs (K, q) and outputs (K,) of the newest accepted samples, as many as the verdict uses."""
        values = self._now.newest_rows
        return values[:, : len(self.structures)].copy(), values[:, -2].copy()

    @property
    def recent_intervals(self) -> FloatArray:
        """Intervals (K,) in s before each of the same samples."""
        return self._now.newest_intervals

    @property
    def recent_reference(self) -> FloatArray:
        """References (K, p) of the same samples."""
        return self._now.newest_rows[:, len(self.structures) : -2].copy()

    @property
    def samples(self) -> int:
        """Number of accepted samples."""
        state, _, since = self._kept
        return state.samples + len(since)

    @property
    def taken(self) -> int:
        """Number of samples given so far, with rejected ones: where to continue after an interrupt."""
        return self._now.taken

    @property
    def status(self) -> str:
        """One of "starting", "running", or "diverged": an update was undone as it would have exceeded float64."""
        known = self._now.recursion
        return "starting" if known is None else "diverged" if known.counts[2] else "running"

    @property
    def model(self) -> RowModel:
        """The model to keep: each G(s) with working point, joint uncertainty, noise model, fit and verdict.

        Fit and working point are those of the newest samples, at most 10000.

        Raises
        ------
        InvalidArgumentError
            While there is no estimate; see `has_model`.
        """
        found = self.fit_of_newest()
        if found is None:
            raise InvalidArgumentError(f"there is no model of the newest samples: {self.assess().reasons[0]}")
        return found.model

    def fit_of_newest(self, others: Mapping[str, FloatArray] = NO_COLUMNS) -> RowFit | None:
        """Return the estimate as a fit of the newest samples, at most 10000; None if they are too few.

        The verdict also tests ``others``, further columns of the samples of `recent`.  The output is NaN where it
        depends on inputs from before the samples, or from before a gap in them.
        """
        state = self._now
        found = newest_of(state, others)
        if found is None:
            return None
        ready, solution, verdict = found
        made = Provenance("recursive srivc", samples=state.samples)
        return row_fit(solution, ready, state.newest_rows[:, -2], self.dt, verdict, made, state.rejected)

    def newest_samples(self, found: RowFit | None) -> NewestSamples:
        """Return the samples of `recent`, with the first reference; ``found``: their fit, or None."""
        state, inputs = self._now, len(self.structures)  # one state: another thread may give samples meanwhile
        rows, intervals = state.newest_rows, state.newest_intervals
        u, r, y = rows[:, :inputs].copy(), rows[:, inputs:-2], rows[:, -2].copy()
        judged = np.isfinite(y)
        if found is not None:
            judged[np.concatenate([found.outliers, found.stuck])] = False
        return NewestSamples(u, y, intervals, r[:, :1].ravel(), judged, is_regular(intervals, self.dt))

    def assess(self) -> Verdict:
        """Return the verdict: whether to trust the estimate, and why in plain words.

        It is made from the newest samples, at most 10000; the state stays as it is.
        """
        state = self._now
        found = newest_of(state)
        if found is not None:
            return found[-1]
        reason = f"starting: {state.kept.measured} of the {state.solve_at} outputs for the first model"
        if self.has_model:
            reason = "the newest samples have too few outputs"
        return Verdict("converging", (reason if state.samples else "no sample yet",))

    def __repr__(self) -> str:
        pairs = zip(self.request.input_names, self.transfer_functions, strict=True) if self.has_model else ()
        lines = [f"\n  {name}: {g}" for name, g in pairs]
        return f"<Identifier of {len(self.structures)} inputs, {self.samples:,} samples, {self.status}{''.join(lines)}>"
