"""Identifier: the public interface of online identification; it owns the state and the kernels."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from inspect import Signature, signature
from typing import TYPE_CHECKING, Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.estimation.engine.state import NOTHING, REGULAR, bound_step
from replant.estimation.filters import Filter
from replant.estimation.optimizers import Optimizer
from replant.estimation.optimizers.optimizer import Replay
from replant.estimation.settings import AUTO, NO_USE_OF_REFERENCE, STORED, Request, Scaling
from replant.fitting.model import Model, with_picture
from replant.kernels.native import OPEN
from replant.kernels.schema import Attention
from replant.model.interop import in_our_words
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import (
    FloatArray,
    number,
    record,
    truth,
    vector,
)
from replant.numerics.limits import stamps_of
from replant.online.background import prepare
from replant.online.lifecycle import NO_GATE, Lifecycle, in_turn
from replant.online.locking import Turn, changes, reads
from replant.online.miso_identifier import RowIdentifier
from replant.online.running_model import model_of
from replant.online.second_process import start
from replant.online.startup import measured
from replant.online.trace import Later, StartingTrace, Trace, write

NAN, INFINITE = math.nan, math.inf  # NaN and infinity, as module names for fast access at each sample [number]
# attributes that follow from the others
DERIVED = {
    "_begun_with", "_forced_waits", "_gate", "_kernel", "_mapped", "_place", "_solved", "_step", "_steps", "_turn",
    "_wakes_at", "_spare",
}  # fmt: skip
# some 10 ms; the overhead of a call of the kernel, some 10 us, is then negligible
PIECE = 8192  # updates of the estimate after which Ctrl-C is handled while a chunk is taken [updates]

if TYPE_CHECKING:
    from replant.online.checkpoint_file import Progress


class Identifier(Lifecycle):
    r"""Identify G(s) online: the estimate is updated with each sample.

    Settings left at "auto" are chosen from the first samples, up to the ``startup``-th with an output.  These are
    collected and then learned in their order, so that none is lost; until then `settings` is None, and the estimate is
    a provisional one from the samples so far.

    Parameters
    ----------
    structure : Structure or list of Structure
        Or ``poles``, ``zeros`` and ``delay`` instead.  The structures of a list learn side by side, see
        `replant.online.bank.Bank`.
    dt : float
        Sampling time in s.
    poles, zeros : int or tuple of int
        Number of poles and of zeros; a tuple has an entry for each of several inputs, see
        `replant.online.miso_identifier`.
    delay : float or tuple of float
        Dead time in s.
    filter : RefinedFilter, StateVariableFilter or "auto"
        "auto" is the refined filter for optimizers that keep a covariance, otherwise (s + cutoff)^n with the cutoff
        chosen from the data.
    scaling : Scaling, "auto" or None
        None means no scaling.
    optimizer : Optimizer or "auto"
        Or the name of one (see `replant.estimation.optimizers.OPTIMIZERS`), its settings chosen from the data.
    replay : Replay, "auto" or None
        None learns each sample once.
    instruments : bool or "auto"
        Use the instruments zeta, the noise-free regressor, instead of phi in the update.  "auto" does so with the
        refined filter and with optimizers that keep a covariance.
    normalize : bool
        Divide the error by :math:`m^2 = 1 + \varphi^T \varphi`, (13).
    preprocess : Preprocess
        Input map and working point.
    startup : int
        Number of measured outputs for the settings and the first model.  It is doubled, up to 20000, until they suffice
        for a first model that can make instruments.
    history : int
        Raw samples kept after the start-up, from 0 to 30000, for verdicts and later solutions; `finish` needs the whole
        record.  Below 200 the verdict is made from running sums, and says what is not checked.  If it is too small for
        a model of the samples since a change, nothing is solved again, and nothing is learned after a change.
    background : bool
        Run long computations after the start-up in a second Python, and use their results a fixed number of samples
        later: 5 % of the record, at least 20.  See Notes.

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        For an argument that cannot be used; the message names it.
    SystemRefusedError
        With ``background``, where there is no shared memory, or no second Python can be started.

    Notes
    -----
    A sample that is not finite, or whose magnitude exceeds 1e150, is rejected before it changes any state, and counted
    in `rejected`.  An update that would exceed float64 is undone: the last finite estimate stays and `status` is
    "diverged".  Memory does not grow with the stream.

    An optimizer that keeps a covariance ignores implausible outputs: outliers, and those of a sensor that is stuck or
    at its limit.  The filters use the model's output instead; such samples count in `rejected` and in `samples`.  A
    sample without an output (NaN) is treated in the same way, from the first output on.  A single input beyond a
    thousand times its moving standard deviation is assumed to be misread: the sample is held back, and accepted only
    if the next input is as far away.  While it is held back it counts as rejected.
    If the residual grows and stays large, `assess` says that something has changed.  Hypotheses on the cause compete
    by their evidence: see `replant.estimation.solver.change_contest`.

    Each time that the record has grown by half, up to 10000 samples, it is solved again as a whole, so that a poor
    first model has no lasting effect.  Each time that it has grown by a quarter, later every 5000 samples, it is tested
    for a change of the plant.  Such a solution takes some tens of milliseconds, every other update about a microsecond.

    With ``background`` the result of a computation begun at sample n is used at a sample m that follows from n.  A new
    estimate has then learned the samples since n, some with each `update` if the result is early.  If it is not there
    at m, `update` waits for it, which `forced_waits` counts.  So the bits do not depend on the speed of the machine, or
    on whether the second Python ends.  The response to a change is delayed by m - n samples.  One second Python serves
    all identifiers of a process, and ends with it; starting it takes a second, at construction.  If the record is as
    long as ``history``, its oldest m - n samples are left out.  Calls that read, copy or save do not disturb pending
    work, and a checkpoint holds it: the result after loading is the same as without interruption.  `finish`, `freeze`,
    `resume` and `reset` drop it; after `finish` and `resume` it is due again.

    References
    ----------
    Bernat and Kolota (2023), (8)-(14); Young (2011), "Recursive Estimation and Time-Series Analysis", chapter 8.

    Examples
    --------
    >>> from replant import TransferFunction
    >>> true = TransferFunction([2.0], [1.0, 0.5])
    >>> u = np.where(np.arange(4000) // 125 % 2 == 0, 1.0, -1.0)
    >>> y = true.simulate(u, dt=0.01)
    >>> ident = Identifier(poles=1, dt=0.01)
    >>> trace = ident.update_many(u, y)
    >>> print(ident.transfer_function)
    2 / (s + 0.5)
    """

    def __new__(cls, *args: Any, **given: Any) -> Any:
        """Return an identifier: a `Bank` for a list of structures, a `RowIdentifier` for several inputs."""
        structure = args[0] if args else given.get("structure")
        if cls is Identifier and len(args) > 2:
            raise ArgumentTypeError(f"Identifier takes structure and dt without their names, got {len(args)} values")
        if cls is Identifier and isinstance(structure, list | tuple):
            from replant.online.bank import Bank
            from replant.online.bank_members import asked_for

            more = given | dict(zip(("dt",), args[1:], strict=False))
            return Bank([Identifier(**each) for each in asked_for(structure, more)])
        orders = (given.get(name) for name in ("poles", "zeros", "delay"))
        if cls is Identifier and any(isinstance(each, list | tuple) for each in orders):
            named = zip(("structure", "dt"), args, strict=False)
            wanted = {name: each for name, each in given.items() if not _is_default(name, each)}
            return RowIdentifier(**{name: each for name, each in named if each is not None}, **wanted)
        return object.__new__(cls)

    @in_our_words
    def __init__(
        self,
        structure: Structure | Sequence[Structure] | None = None,
        dt: float | None = None,
        *,
        poles: int | tuple[int, ...] | None = None,
        zeros: int | tuple[int, ...] = 0,
        delay: float | tuple[float, ...] = 0.0,
        filter: Filter | str = AUTO,  # noqa: A002 - the field's word
        scaling: Scaling | str | None = AUTO,
        optimizer: Optimizer | str = AUTO,
        replay: Replay | str | None = AUTO,
        instruments: bool | str = AUTO,
        normalize: bool = True,
        preprocess: Preprocess = Preprocess(),  # noqa: B008 - frozen
        startup: int = 500,
        history: int = STORED,
        background: bool = False,
    ) -> None:
        wanted: tuple[Any, Any, Any, Any] = structure, poles, zeros, delay  # lists are of another kind, see `__new__`
        structure = Structure.wanted(*wanted)
        if dt is None:
            raise ArgumentTypeError("give the sampling time in s, dt: Identifier(poles=2, dt=0.01)")
        self._request = Request(
            structure, dt, filter, scaling, optimizer, replay, instruments, normalize, preprocess, startup, history
        )
        self._turn = Turn()
        if truth("background", background):
            self._background = True
            self._start_background()
        self._begin_again()

    #: The signature of ``__init__``, which `__new__` shares.
    __signature__ = Signature([*signature(__init__).parameters.values()][1:])

    @changes
    def reset(self) -> None:
        """Forget every sample and begin again; settings left at "auto" are chosen anew."""
        self._as_one(Identifier._begin_again)

    @classmethod
    def from_bytes(cls, data: bytes) -> Identifier:
        """Return the identifier from the bytes of `to_bytes`.

        Parameters
        ----------
        data : bytes
            The result of `to_bytes`.

        Raises
        ------
        DamagedCheckpointError
            If the bytes are anything else.
        """
        from replant.online.checkpoint.encoding import decode

        made: Identifier = restored(decode(data).attributes, cls)
        return made

    def _encoded(self, progress: Progress | None) -> bytes:
        from replant.online.checkpoint.encoding import encode

        return encode(vars(self), progress)

    @reads
    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self._draft()).items() if name not in DERIVED}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        self.__dict__.update(attributes)
        self._turn, self._solved, self._begun_with = Turn(), {}, NAN
        self._spare, self._wakes_at = NOTHING, 0
        self._work_on(self._state, regular=self._regular)
        if self._background:
            self._start_background()
            if self._job is not None and self._settings is not None:
                self._job.take_place(self._made_place())
                while self._job.go_on(self._state, self._settings, self._resolve_at, self._most):
                    pass

    def _start_background(self) -> None:
        self._made_place()
        start()
        prepare()

    @property
    def background(self) -> bool:
        """Whether a second Python does the work due between samples."""
        return self._background

    @property
    def forced_waits(self) -> int:
        """Number of late results of ``background``, since construction or `replant.load`."""
        return self._forced_waits

    def update(self, u: float, y: float, t: float | None = None, r: float | None = None) -> float:
        """Take one sample; return its a-priori output error y - theta' phi, in the unit of y.

        NaN stands for "no prediction": the sample was rejected, has no output, or is collected for the start-up.

        Parameters
        ----------
        u, y : float
        t : float, optional
            Time stamp in s, for an irregular clock, with every sample or with none.  Filters and model are exact for
            the actual interval.  A stamp that does not advance is rejected; after ten in a row that advance among
            themselves the clock is assumed to have been set, and the next one is accepted.  After a gap of 20 dt the
            filters begin anew.  A sample whose stamp leaps by more than 50 dt is held back until the next one: if that
            follows within 50 dt, or within twice the leap, both are accepted; otherwise the first was misread.  A stamp
            beyond 4.5e13 dt from zero, where float64 does not resolve a hundredth of dt, is rejected.
            Without stamps a rejected sample takes dt; with an optimizer without a covariance it takes no time: then
            give stamps.
        r : float, optional
            Reference, if a controller makes the input: the set-point or a dither, applied from outside and independent
            of the disturbances.  Given with every sample, or with none; its unit does not matter.  A value that is not
            finite is replaced by the last one; before the first finite one, samples are rejected.  Only the default
            filter and optimizer use it.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If an argument is not a number, or r comes with some samples only; the state stays as it was.
        """
        if type(u) is not float:
            u = number("u", u)
        if type(y) is not float:
            y = number("y", y)
        step = self._step
        if r is None and not self._reference:
            r = NAN
        elif not (type(r) is float and self._reference and -INFINITE < r < INFINITE):
            r = self._referenced(r)
            step = step if self._reference else in_turn
        if t is None:
            t = NAN
        else:
            t = self._stamp(t)
            step = in_turn if self._regular else step
        try:
            return step(u, y, t, r)
        except Attention:
            pass
        return self._take_one(u, y, t, r)

    @changes
    def _take_one(self, u: float, y: float, t: float, r: float) -> float:
        """Take one sample that needs more than its bound kernel."""
        if self._reference == math.isnan(r):  # another thread may have taken the first samples
            self._check_reference(None if math.isnan(r) else r)
        if self._settings is None or (self._regular and not math.isnan(t)):
            mapped = self._request.preprocess.call_map(np.array([u])) if self._mapped else np.array([u])
            stamps = REGULAR if math.isnan(t) else np.array([t])
            references, errors = NOTHING if math.isnan(r) else np.array([r]), np.empty(1)
            while not self._take(mapped, np.array([y]), stamps, references, errors, np.empty((1, 0))):
                pass  # a sample held back was taken
            self._bind()
            return float(errors[0])
        while True:
            self._bind()
            self._gate[0] = OPEN
            try:
                return self._step(u, y, t, r)
            except Attention:  # it confirms a sample held back
                self._enter()

    def _bind(self) -> None:
        """Bind the kernel for single samples."""
        if self._step is in_turn:
            step, gate = bound_step(self._state, self._kernel, self._request.preprocess)
            vars(self).update(_step=step, _gate=gate)

    @changes
    def update_many(self, u: Any, y: Any, t: Any = None, r: Any = None) -> Trace:
        """Take a chunk of samples in compiled code: equal, to the bit, to a loop of `update`.

        Parameters
        ----------
        u, y : (K,) arrays
        t : (K,) array, optional
            Time stamps in s, or dates, see `update`.
        r : (K,) array, optional
            Reference, see `update`.

        Returns
        -------
        Trace
            Error and estimate after each sample.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        u, y = record(u, y)
        r = self._references(r, u.size)
        t = self._stamps(t, u.size)
        later: Later | None = [] if self._settings is None else None
        start, parameters = np.empty(self.structure.size), np.empty((u.size, self.structure.size))
        write(self._estimate(), start, later)
        errors, taken = np.full(u.size, np.nan), 0
        if self._mapped and u.size:
            u = self._request.preprocess.call_map(u)
        while taken < u.size:
            some = slice(taken, taken + max(PIECE // self._state.batch_size, 1))
            taken += self._take(u[some], y[some], t[some], r[some], errors[some], parameters[some], later)
        whole = self.names, start, parameters, errors, t if t.size else None
        return Trace(*whole) if later is None else StartingTrace(*whole, later)

    @property
    def model(self) -> Model:
        """The model to keep: G(s) with working point, uncertainty, noise model, fit and verdict.

        Fit and working point are those of the newest samples, at most 10000.  Takes some tens of milliseconds.

        Raises
        ------
        InvalidArgumentError
            While there is no estimate; see `has_model`.
        """
        now = self._snapshot()
        if not now.has_model:
            raise InvalidArgumentError(f"there is no model yet: {now.samples} samples are too few")
        return model_of(now)

    def _repr_html_(self) -> str:
        now, words = self._snapshot(), f"<p>{html.escape(repr(self))}</p>"
        if now.has_model:
            return words + with_picture(model_of(now))
        outputs = f"{measured(now._state):,} of {now._hold:,} outputs for the first model"
        return f"{words}<p>{html.escape(str(self.structure))}; {outputs}</p>"

    @reads
    def _snapshot(self) -> Identifier:
        return self._but(_state=self._state.copy(buffer=False), _turn=Turn(), _gate=NO_GATE)

    @changes
    def finish(self) -> None:
        """Solve for the estimate with every sample so far, as `replant.fit` does: for the end of a record.

        Ends a start-up if the samples give a model.  If loads have acted, the record is divided there, and offset and
        initial state are those since the last one.  The estimate does not change if it is frozen, if older samples are
        forgotten or no longer kept (more than 30000), with a method other than the default, and if the plant has
        changed within the record.  Samples may follow.
        """
        self._as_one(Identifier._finish)

    def _adapt(self, adapt: bool) -> None:
        self._as_one(Identifier._adapt_draft, adapt)

    def _stamp(self, t: Any) -> float:
        """Return a time stamp for the kernel; one that is not finite becomes infinite, which the kernel rejects."""
        self._check_clock()
        t = number("t", t)
        return t if math.isfinite(t) else math.inf

    def _check_clock(self) -> None:
        chosen = self._request.filter
        if isinstance(chosen, Filter) and chosen.regular_only:
            raise InvalidArgumentError("the gbt filter knows a regular clock only: give no t, or use method='exact'")

    def _stamps(self, t: Any, samples: int) -> FloatArray:
        if t is None:
            return REGULAR
        stamps = stamps_of(t, samples, is_first=not self.samples)
        self._check_clock()
        return np.where(np.isfinite(stamps), stamps, np.inf)

    def _referenced(self, r: Any) -> float:
        """Return a reference for the kernel; one that is not finite becomes infinite, which the kernel ignores."""
        self._check_reference(r)
        r = number("r", r)
        return r if math.isfinite(r) else math.inf

    def _references(self, r: Any, samples: int) -> FloatArray:
        if r is None and not self._reference:
            return NOTHING
        self._check_reference(r)
        references = vector("r", r)
        if references.size != samples:
            raise InvalidArgumentError(f"r must have one value for each of {samples} samples, got {references.size}")
        return np.where(np.isfinite(references), references, np.inf)

    def _check_reference(self, r: Any) -> None:
        """Raise InvalidArgumentError unless every sample so far came with a reference, or the first comes now."""
        if r is None:
            raise InvalidArgumentError("the samples before came with r: give it with every sample, or with none")
        if self._reference:
            return
        if not self._request.takes_reference:
            raise InvalidArgumentError(NO_USE_OF_REFERENCE)
        if self.samples or any(self.rejected.values()):
            raise InvalidArgumentError("the samples before came without r: give it with every sample, or with none")


def restored(attributes: dict[str, Any], kind: type[Any] = Identifier) -> Any:
    """Return an identifier with the content of a checkpoint: a bank, one of several inputs, or else one of ``kind``."""
    from replant.online.checkpoint.bank_and_row import restored_bank, restored_row
    from replant.online.checkpoint.encoding import BANK, ROW

    if BANK in attributes:
        from replant.online.bank import Bank

        attributes = restored_bank(attributes, kind.from_bytes)
        kind = Bank
    elif ROW in attributes:
        kind, attributes = RowIdentifier, {"_now": restored_row(attributes)}
    (made := object.__new__(kind)).__setstate__(attributes)
    return made


def _is_default(name: str, value: Any) -> bool:
    """Return whether an argument of `Identifier` has its default value."""
    known = Identifier.__signature__.parameters.get(name)
    return known is not None and type(value) is type(known.default) and bool(value == known.default)
