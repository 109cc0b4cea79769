"""Identifier: wires filters, regressor, scaling, buffer and optimizer together and owns their state."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

from replant.defaults import settle
from replant.filters import StateVariableFilter
from replant.kernels import layout as at
from replant.optimizers import Optimizer
from replant.preprocess import Preprocess
from replant.regression import prepare
from replant.replay import Replay
from replant.scaling import Scaling
from replant.settings import AUTO, Request, Settings
from replant.structure import Structure
from replant.trace import Trace
from replant.transfer_function import TransferFunction
from replant.validation import FloatArray, number, record, whole


class Identifier:
    r"""Identify G(s) online: samples go in one by one, the estimate is there after each.

    What is left to "auto" is chosen from the first ``startup`` accepted samples, which are held back for that and
    then learned in their order, so none is lost; until then the estimate stays at zero and `settings` is None.

    Parameters
    ----------
    structure : Structure
    dt : float
        Sampling time in s.
    filter : StateVariableFilter or "auto"
    scaling : Scaling, "auto" or None
        None changes nothing.
    optimizer : Optimizer or "auto"
        Or the name of one (see `replant.optimizers.OPTIMIZERS`), its settings chosen from the data.
    replay : Replay, "auto" or None
        None learns each sample once.
    normalize : bool
        Divide the error by :math:`m^2 = 1 + \varphi^T \varphi`, (13).
    preprocess : Preprocess
        Input map and working point.
    startup : int
        Samples from which "auto" and a mean working point are chosen.

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        For an argument that cannot be used; the message names it.

    Notes
    -----
    A sample that is not finite, or whose magnitude exceeds 1e150, is rejected before it touches anything, and counted
    in `rejected`.  An update that would leave float64 is undone: the last finite estimate stays and `status` says
    "diverged".  Memory does not grow with the stream.

    Examples
    --------
    >>> true = TransferFunction([2.0], [1.0, 0.5])
    >>> u = np.where(np.arange(4000) // 125 % 2 == 0, 1.0, -1.0)
    >>> y = true.simulate(u, dt=0.01)
    >>> ident = Identifier(Structure(poles=1), dt=0.01, filter=StateVariableFilter(cutoff=5.0))
    >>> trace = ident.update_many(u, y)
    >>> print(ident.transfer_function)
    2 / (s + 0.5)

    References
    ----------
    Bernat and Kolota (2023), (8)-(14).
    """

    def __init__(
        self,
        structure: Structure,
        dt: float,
        *,
        filter: StateVariableFilter | str = AUTO,  # noqa: A002 - the field's word
        scaling: Scaling | str | None = AUTO,
        optimizer: Optimizer | str = AUTO,
        replay: Replay | str | None = AUTO,
        normalize: bool = True,
        preprocess: Preprocess = Preprocess(),  # noqa: B008 - frozen
        startup: int = 500,
    ) -> None:
        self._request = Request(structure, dt, filter, scaling, optimizer, replay, normalize, preprocess)
        self._startup = whole("startup", startup, 1)
        self.reset()

    def reset(self) -> None:
        """Forget every sample and begin again, choices left to "auto" included."""
        self._settings: Settings | None = None
        self._held: list[tuple[float, float]] = []
        self._held_rejects = [0, 0]
        if self._request.asks_for_data:
            self._hold = self._startup
        else:
            self._hold = 0 if self._request.preprocess.needs == "nothing" else 1
            if self._hold == 0:
                self._begin()

    def clone(self) -> Identifier:
        """Return an independent copy in the same state."""
        return copy.deepcopy(self)

    def update(self, u: float, y: float) -> float:
        """Take one sample; return its a-priori output error y - theta' phi, in the unit of y.

        NaN stands for "no prediction": the sample was rejected, or is held back for start-up.

        Raises
        ------
        ArgumentTypeError
            If ``u`` or ``y`` is not a number; the state stays as it was.
        """
        if type(u) is not float:
            u = number("u", u)
        if type(y) is not float:
            y = number("y", y)
        if self._settings is None:
            return self._hold_back(u, y)
        if self._mapped:
            u = float(self._request.preprocess.call_map(np.array([u]))[0])
        error: float = self._step(self._ints, self._reals, self._buffer, u, y)
        return error

    def update_many(self, u: Any, y: Any) -> Trace:
        """Take a chunk of samples in compiled code: equal, to the bit, to a loop of `update`.

        Parameters
        ----------
        u, y : (K,) arrays

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        u, y = record(u, y)
        trace = Trace(self.names, self.parameters, np.empty((u.size, self.structure.size)), np.full(u.size, np.nan))
        taken = 0
        while self._settings is None and taken < u.size:
            trace.errors[taken] = self._hold_back(float(u[taken]), float(y[taken]))
            trace.parameters[taken] = self.parameters
            taken += 1
        if taken < u.size:
            rest = u[taken:]
            if self._mapped:
                rest = self._request.preprocess.call_map(rest)
            self._steps(
                self._ints, self._reals, self._buffer, rest, y[taken:], trace.errors[taken:], trace.parameters[taken:]
            )
        return trace

    def finish_startup(self) -> None:
        """Choose what is left to "auto" from the samples held so far and learn them; without effect once begun.

        For records shorter than the start-up.
        """
        if self._settings is None and self._held:
            self._begin()

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
        if self._settings is None:
            return np.zeros(self.structure.size)
        size = self.structure.size
        theta = at.block(self._ints, self._reals, at.AT_THETA, size)
        return np.asarray(theta * at.block(self._ints, self._reals, at.AT_UNIT, size))

    @property
    def transfer_function(self) -> TransferFunction:
        """The estimate as G(s)."""
        return self.structure.transfer_function(self.parameters)

    @property
    def samples(self) -> int:
        """Accepted samples, those held back for start-up included."""
        return len(self._held) if self._settings is None else int(self._ints[at.SAMPLES])

    @property
    def rejected(self) -> dict[str, int]:
        """Rejected samples by reason."""
        counts = self._held_rejects if self._settings is None else self._ints[[at.NOT_FINITE, at.TOO_LARGE]]
        return {"not finite": int(counts[0]), "too large": int(counts[1])}

    @property
    def status(self) -> str:
        """One of "starting", "running", or "diverged": an update was undone because it would have left float64."""
        if self._settings is None:
            return "starting"
        return "diverged" if self._ints[at.REFUSED] else "running"

    def _hold_back(self, u: float, y: float) -> float:
        """Keep a sample for start-up; with the last one, begin."""
        mapped = self._request.preprocess.map_input(np.array([u]))[0]
        if not (math.isfinite(mapped) and math.isfinite(y)):
            self._held_rejects[0] += 1
            return math.nan
        if max(abs(mapped), abs(y)) > at.LARGEST:
            self._held_rejects[1] += 1
            return math.nan
        self._held.append((u, y))
        return self._begin() if len(self._held) == self._hold else math.nan

    def _begin(self) -> float:
        """Make every setting definite, lay out the state and learn the held samples; return the last one's error."""
        from replant.kernels.step import step, steps

        u, y = np.array(self._held, np.float64).reshape(-1, 2).T.copy()
        self._settings = settle(self._request, u, y)
        self._step, self._steps = step, steps
        self._mapped = callable(self._request.preprocess.input_map)
        self._ints, self._reals, self._buffer = prepare(self._settings)
        self._ints[[at.NOT_FINITE, at.TOO_LARGE]] = self._held_rejects
        self._held = []
        return float(self.update_many(u, y).errors[-1]) if u.size else math.nan
