"""Bank: a few structures that learn side by side, and the choice of the one served; `Identifier(structure=[...])`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import methodcaller
from typing import TYPE_CHECKING, Any

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.fitting.structure_evidence import numbers_of
from replant.numerics.arguments import FloatArray, record
from replant.numerics.levels import ALPHA
from replant.online.bank_members import Members
from replant.online.bank_weights import EVENTS, Lead, Weights
from replant.online.change_response import AGAIN
from replant.online.locking import Turn, changes, reads
from replant.online.trace import BankTrace, Trace

if TYPE_CHECKING:
    from replant.online.checkpoint_file import Progress

# the work of a call to a member is then some ten times its overhead
LOOKED = 512  # samples between two checks of the weights [samples]
LEAST = 4  # least samples of a record from which weights begin [count for each unknown]


class Bank(Members):
    r"""Identify G(s) of unknown structure online; `Identifier` returns a bank for a list of structures.

    The weight of a structure is its probability, given the samples so far,

    .. math:: w_i \propto w_i^\lambda\, p_i^{1 - \lambda}\; p(y_k \mid y_{k-1}, \ldots, i),

    from each member's prediction before it learns a sample, its residual whitened by an autoregression of its own:
    dynamic model averaging.  The prior p_i penalises each fitted parameter.  While the record is shorter than the
    memory of 10000 samples, the weights begin anew with its evidence each time that it has grown by half.

    Parameters
    ----------
    structure : sequence of Structure
        From two to ten different ones.
    dt, filter, preprocess, startup, history : as of `Identifier`
        The same for all; ``history`` from 10000 to 30000.

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        For an argument that cannot be used; the message names it.

    Notes
    -----
    A member has the same bits as an identifier of its structure alone.  `model`, `transfer_function` and so on are
    those of one member: among those with a weight of at least 1e-4, the most probable trusted one, or the most probable
    one if none is trusted.  It is chosen each time that the record has grown by half, later every 5000 samples, and
    when another member has become ten thousand times as probable as the most probable one before, which is checked
    every 512 samples; in between it stays.  A sample that no member explains is an outlier, and changes no weight.
    While the bank is frozen the lead stays, weights still change, and members without a model take no part.

    References
    ----------
    Raftery, Karny and Ettler (2010), "Online prediction under model uncertainty via dynamic model averaging",
    Technometrics 52.

    Examples
    --------
    >>> from replant import Identifier, Structure
    >>> from replant.signals import prbs, white_noise
    >>> u = prbs(3000, hold=8)
    >>> y = Structure(2).transfer_function([4.0, 3.0, 2.0]).simulate(u, 0.05) + white_noise(3000, 0.02)
    >>> bank = Identifier(structure=[Structure(poles) for poles in (1, 2, 3)], dt=0.05)
    >>> trace = bank.update_many(u, y)
    >>> bank.structure.poles, bank.assess().status, bool(bank.weights[1] > 0.9)
    (2, 'trusted', True)
    """

    def __init__(self, members: Sequence[Any]) -> None:
        self._turn, self._members = Turn(), tuple(members)
        self._begin_again()

    def _begin_again(self) -> None:
        first = max(each.request.first_hold for each in self._members)
        vars(self).update(
            _weights=Weights.of(self.structures), _held=[], _chunk=None, _taken=0, _due=first, _stop=min(first, LOOKED),
            _origin=0, _ready=0, _likeliest=0, _lead=0, _leads=(), _adapts=True,
        )  # fmt: skip

    _weights: Weights  # after all samples except those of `_held`
    _held: list[list[float]]  # errors of single samples since then
    _chunk: tuple[Any, ...] | None  # u, y, t and r that are being taken
    _taken: int
    _due: int  # samples at which members are assessed again
    _stop: int  # samples at which the weights are checked
    _origin: int  # accepted samples before the change that the most probable member has accepted
    _ready: int  # members with a first model when the weights last began
    _likeliest: int
    _leads: tuple[Lead, ...]
    _adapts: bool

    @changes
    def reset(self) -> None:
        """Forget every sample and begin again."""
        self._begin_again()
        for member in self._members:
            member.reset()

    def __deepcopy__(self, memo: Any) -> Bank:
        (made := object.__new__(type(self))).__setstate__(self.__getstate__())
        return made

    @reads
    def __getstate__(self) -> dict[str, Any]:
        self._count_held()
        members = tuple(member.clone() for member in self._members)
        return vars(self) | {"_members": members, "_held": [], "_turn": None}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        self.__dict__.update(attributes | {"_turn": Turn()})

    def _encoded(self, progress: Progress | None) -> bytes:
        from replant.online.checkpoint.bank_and_row import bank_parts
        from replant.online.checkpoint.encoding import BANK, encode_other

        self._count_held()
        return encode_other(BANK, *bank_parts([member.to_bytes() for member in self._members], vars(self)), progress)

    def _enter(self) -> None:
        """Let the members take the rest of an interrupted chunk; the predictions for it are lost."""
        if self._chunk is not None:
            u, y, t, r = (None if each is None else np.atleast_1d(each) for each in self._chunk)
            assert u is not None
            assert y is not None
            for member in self._members:
                rest = slice(member.taken - self._taken, None)
                if u[rest].size:
                    member.update_many(u[rest], y[rest], *(None if each is None else each[rest] for each in (t, r)))
            self._note(np.full((u.size, len(self._members)), np.nan))
        if self._taken >= self._stop:
            self._look()

    @changes
    def update(self, u: float, y: float, t: float | None = None, r: float | None = None) -> float:
        """Take one sample; return the a-priori output error of the leading member, in the unit of y.

        Parameters
        ----------
        u, y, t, r : float
            As of `Identifier.update`.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If an argument cannot be used; the state stays as it was.
        """
        self._chunk = u, y, t, r
        errors = self._each("update")
        self._held.append(errors)
        vars(self).update(_chunk=None, _taken=self._taken + 1)
        error: float = errors[self._lead]
        if self._taken >= self._stop:
            self._look()
        return error

    def _each(self, method: str) -> list[Any]:
        """Let each member take the chunk by a method; return the results."""
        assert self._chunk is not None
        take, (first, *others) = methodcaller(method, *self._chunk), self._members
        try:
            taken = take(first)
        except Exception:
            if first.taken == self._taken:  # refused by the first, as by the others: no member has taken it
                self._chunk = None
            raise
        return [taken, *map(take, others)]

    @changes
    def update_many(self, u: Any, y: Any, t: Any = None, r: Any = None) -> BankTrace:
        """Take a chunk of samples: equal, to the bit, to a loop of `update`.

        Parameters
        ----------
        u, y, t, r : (K,) arrays
            As of `Identifier.update_many`.

        Returns
        -------
        BankTrace
            The members' traces, their weights, and the lead after each sample.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        u, y = record(u, y)
        size, first = u.size, self._members[0]
        references, stamps = first._references(r, size), first._stamps(t, size)
        weights, lead = np.empty((size, len(self._members))), np.empty(size, np.int64)
        parts: list[tuple[Trace, ...]] = []
        taken = 0
        while taken < size or not parts:
            rows = slice(taken, min(taken + self._stop - self._taken, size))
            self._chunk = (
                u[rows], y[rows], None if t is None else stamps[rows], None if r is None else references[rows],
            )  # fmt: skip
            parts.append(tuple(self._each("update_many")))
            weights[rows], lead[rows] = self._note(np.column_stack([each.errors for each in parts[-1]])), self._lead
            if self._taken >= self._stop:
                self._look()
                weights[rows.stop - 1], lead[rows.stop - 1] = self._weights.shares, self._lead
            taken = rows.stop
        return BankTrace(tuple(parts), weights, lead)

    def _note(self, errors: FloatArray) -> FloatArray:
        """Update the weights by the errors (K, M) of samples that all members have taken; return them after each."""
        self._count_held()
        new, shares = self._weights.take(errors)
        vars(self).update(_weights=new, _chunk=None, _taken=self._taken + len(errors))
        return shares

    def _count_held(self) -> None:
        if self._held:
            vars(self).update(_weights=self._weights.take(np.array(self._held))[0], _held=[])

    def _look(self) -> None:
        """Check the weights; if due, begin them anew and choose the leading member."""
        self._count_held()
        origin, is_due = self._changed_at(), self._taken >= self._due
        weights, length = self._weights, self._taken - origin
        is_known = length >= LEAST * max(numbers_of(each) for each in self.structures)
        ready = sum(member.settings is not None for member in self._members)
        has_changed = origin != self._origin or ready != self._ready
        if self._adapts and is_known and (has_changed or (is_due and length <= RECENT)):
            weights, is_due = weights.begun(self._members, origin), True
        else:
            origin, ready = self._origin, self._ready
        due = self._due
        if is_due:
            due = self._taken + min(max(math.ceil((AGAIN - 1.0) * length), 1), RECENT // 2)
        likeliest, chosen = weights.likeliest(self._likeliest), {}
        if self._adapts and (is_due or likeliest != self._likeliest):
            chosen = self._chosen(weights)
        stop = min(due, (self._taken // LOOKED + 1) * LOOKED)
        vars(self).update(
            _weights=weights, _due=due, _stop=stop, _origin=origin, _ready=ready, _likeliest=likeliest, **chosen
        )

    def _changed_at(self) -> int:
        """Return the accepted samples before the last change of the plant found by the most probable member."""
        state = self._members[self._likeliest]._state
        return state.changed_at if self._weights.joined[self._likeliest] and state.change.is_of_plant else 0

    def _chosen(self, weights: Weights) -> dict[str, Any]:
        """Return the attributes of a new lead and its event; empty if the lead stays."""
        shares, found = weights.shares, None
        for i in np.argsort(-shares, kind="stable").tolist():
            if not weights.joined[i] or shares[i] < ALPHA:
                continue
            status = self._members[i].assess().status
            if found is None or status == "trusted":
                found = Lead(self._taken, self._members[i].structure, float(shares[i]), status), i
            if status == "trusted":
                break
        if found is None or (self._leads and found[1] == self._lead):
            return {}
        return {"_lead": found[1], "_leads": (*self._leads, found[0])[-EVENTS:]}

    @changes
    def finish(self) -> None:
        """Solve for the estimates with every sample so far, see `Identifier.finish`, and weight them by the record."""
        for member in self._members:
            member.finish()
        self._count_held()
        weights = self._weights.begun(self._members, self._changed_at())
        likeliest = weights.likeliest(self._likeliest)
        vars(self).update(_weights=weights, _likeliest=likeliest, **self._chosen(weights))

    def _adapt(self, adapt: bool) -> None:
        lead = self._members[self._lead]
        (lead.resume if adapt else lead.freeze)()  # raises during its start-up
        self._adapts = adapt
        for member in self._members:
            if member.settings is not None:
                (member.resume if adapt else member.freeze)()

    @property
    @reads
    def weights(self) -> FloatArray:
        """Probability (M,) of each structure, given the samples so far; equal while no member has a model."""
        self._count_held()
        return self._weights.shares

    @property
    @reads
    def leads(self) -> tuple[Lead, ...]:
        """The newest hundred changes of the served structure."""
        return self._leads

    @property
    @reads
    def taken(self) -> int:
        """Samples given so far, rejected ones included: where to go on after an interrupt."""
        return self._taken

    def __repr__(self) -> str:
        pairs = zip(self.structures, self.weights.tolist(), strict=True)
        each = ", ".join(f"{one.poles}/{one.zeros} {weight:.2g}" for one, weight in pairs)
        return f"<Identifier of {len(self._members)} structures, poles/zeros and weight: {each}; {self._served!r}>"
