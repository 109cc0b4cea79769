"""Ensemble: many independent identifiers stepped at once, in vectors and in threads."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.estimation.engine.vector_blocks import Block, Room, aligned
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray, array_of_reals, iterable, whole
from replant.numerics.limits import count
from replant.online.ensemble_members import (
    Chunk,
    Company,
    Helper,
    Take,
    carry_out,
    form_blocks,
    is_ready,
    lane_of,
    may_join,
)
from replant.online.identification import Adapting
from replant.online.identifier import Identifier
from replant.online.locking import Turn, changes, reads
from replant.online.trace import Trace

OBJECT = 2048  # approximate memory of an identifier in addition to its arrays [numbers of eight bytes]
MOST_JOBS = 2**31  # processors that may be left free [count]


class Ensemble(Adapting):
    """Step M identifiers at once: on M streams, or on one stream with M settings.

    Each member gives the result of a single identifier, to the bit: it has its own start-up, rejected samples and
    random numbers.  All members take their samples at the same time.

    Parameters
    ----------
    identifiers : Identifier or sequence of Identifier
        One to be copied for all members, or one for each; their structures must have the same parameters.  The ensemble
        works on copies.
    members : int, optional
        Number of copies, if one identifier is given.
    n_jobs : int, optional
        Number of threads for `update_many` and `trace`, as in joblib: None is one, -1 is all processors, -2 all but
        one.  They release the interpreter lock.

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        For an argument that cannot be used; the message names it.

    Notes
    -----
    The processor's vector unit steps eight members at a time.  Members with the default method use it while their
    samples are ordinary; they need a refined filter, `RecursiveLeastSquares`, chunks of at least 32 samples and no dead
    time.  Other samples (no output, an outlier, an input at rest, a renewed model), start-ups and solutions are done
    member by member.  Members with a gradient optimizer need a fixed filter, no instruments, no dead time and fewer
    zeros than poles; with or without replay, each with its own settings, scaling and cutoff.  Eight of them must have
    the same optimizer, capacity and batch.  With equal seeds and equally filled buffers they read the same rows, which
    is faster still.  All other members (`KalmanTracking`, a dead time) are stepped one after the other, as by
    `Identifier.update_many`, with threads but without vectors.

    Ensembles take no time stamps and no references: all clocks are regular.

    Examples
    --------
    A plant's record through three step sizes at once:

    >>> import numpy as np, replant as rp
    >>> u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 1000), 10)
    >>> y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    >>> settings = {"filter": rp.StateVariableFilter(cutoff=1.0), "scaling": None, "instruments": False}
    >>> steps = [rp.AMSGrad(1e-5), rp.AMSGrad(1e-4), rp.AMSGrad(1e-3)]
    >>> sweep = Ensemble([rp.Identifier(rp.Structure(1), 0.1, optimizer=step, **settings) for step in steps])
    >>> errors = sweep.update_many(u, y)
    >>> errors.shape, sweep.parameters.shape
    ((10000, 3), (3, 2))
    >>> sweep.parameters[-1].round(2)
    array([0.5, 2. ])
    """

    def __init__(
        self, identifiers: Identifier | Iterable[Identifier], members: int | None = None, *, n_jobs: int | None = None
    ) -> None:
        self._turn = Turn()
        self._members = _copies(identifiers, members)
        self._blocks: list[Block] = []
        self._companies: list[list[int]] = []  # numbers of members that were last stepped together as whole companies
        self._room, self._helpers = Room(), [Helper() for _ in range(_threads(n_jobs, len(self._members)) - 1)]
        self._before = [member.taken for member in self._members]  # samples of the members before they were copied
        self._taken = 0  # samples that all members have taken since
        self._chunk: Chunk | None = None  # the samples of a call that was interrupted

    def __len__(self) -> int:
        return len(self._members)

    @reads
    def __repr__(self) -> str:
        statuses = ", ".join(f"{count} {status}" for status, count in Counter(self.status).items())
        return f"<Ensemble of {len(self)} identifiers of {', '.join(self.names)}: {self.taken:,} samples, {statuses}>"

    @reads
    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes for a copy, with single members; the copy forms its blocks anew."""
        return vars(self) | {
            "_turn": None,
            "_members": [member.clone() for member in self._members],
            "_blocks": [],
            "_companies": [],
            "_room": Room(),
        }

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        vars(self).update(attributes | {"_turn": Turn()})

    def _enter(self) -> None:
        """Let all members take as many samples of an interrupted chunk as the most advanced one has."""
        if self._chunk is None:
            return
        self._set_aside()
        u, y, done = self._chunk.u, self._chunk.y, self._done()
        rows, size = len(u), len(self)
        for block in self._blocks:
            start = done[block.numbers[0]]
            block.take(self._room, start, u, y, np.empty((rows, size)), np.empty((size, rows, 0)))
        done = self._done()
        for number in range(size):
            if done[number] < rows:
                self._members[number].update_many(
                    *(part[done[number] :, number * (part.shape[1] > 1)] for part in (u, y))
                )
        vars(self).update(_taken=self._taken + rows, _chunk=None)

    def _set_aside(self) -> None:
        """Keep the part of an interrupted chunk that some members have taken and others have not."""
        assert self._chunk is not None
        self._chunk.stop()
        done = self._done()
        first, end = min(done), max(done)
        rest = Chunk(self._chunk.u[first:end].copy(), self._chunk.y[first:end].copy(), 0)
        vars(self).update(_taken=self._taken + first, _chunk=rest)

    def _done(self) -> list[int]:
        """Return the number of samples of the present chunk that each member has taken."""
        before = zip(self._members, self._before, strict=True)
        return [member.taken - number - self._taken for member, number in before]

    @changes
    def update(self, u: Any, y: Any) -> FloatArray:
        """Take one sample of each member; return the a-priori output errors (M,), as `Identifier.update` does.

        Parameters
        ----------
        u, y : (M,) arrays or floats
            A number is used for all members.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        errors, _ = self._run(self._row("u", u), self._row("y", y), 0, ())
        return errors.reshape(-1)

    @changes
    def update_many(self, u: Any, y: Any) -> FloatArray:
        """Take a chunk of samples of each member; return the a-priori output errors (K, M).

        Parameters
        ----------
        u, y : (K, M) or (K,) arrays
            A vector is used for all members.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        return self._run(self._rows("u", u), self._rows("y", y), 0, self._helpers)[0]

    @changes
    def trace(self, u: Any, y: Any) -> tuple[Trace, ...]:
        """Take a chunk of samples as `update_many` does; return the `Trace` of each member, K (P + 1) numbers each.

        Parameters
        ----------
        u, y : (K, M) arrays
            A column for each member, or (K,) for all, as in `update_many`.

        Raises
        ------
        InvalidArgumentError, ArgumentTypeError
            If shapes or types do not fit; the state stays as it was.
        """
        start = self.parameters
        errors, parameters = self._run(self._rows("u", u), self._rows("y", y), start.shape[1], self._helpers)
        each = np.ascontiguousarray(errors.T)
        return tuple(Trace(self.names, *one) for one in zip(start, parameters, each, strict=True))

    @changes
    def reset(self) -> None:
        """Forget every sample and begin again with all members."""
        self._on_drafts(Identifier._begin_again, _before=[0] * len(self), _taken=0)

    @reads
    def member(self, number: int) -> Identifier:
        """Return a copy of one member, an identifier in the same state."""
        number = whole("number", number, -len(self))
        if number >= len(self):
            raise InvalidArgumentError(
                f"number must be less than {len(self)}, the number of members, got {shown(number)}"
            )
        return self._members[number].clone()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order."""
        return self._members[0].names

    @property
    @reads
    def parameters(self) -> FloatArray:
        """The estimates (M, P) in physical units."""
        return np.array([member.parameters for member in self._members])

    @property
    @reads
    def transfer_functions(self) -> tuple[TransferFunction, ...]:
        """The estimates as G(s), one for each member."""
        return tuple(member.transfer_function for member in self._members)

    @property
    @reads
    def taken(self) -> int:
        """Samples given to each member so far, rejected ones included: where to go on after an interrupt."""
        return self._taken

    @property
    @reads
    def samples(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Number of accepted samples (M,); during start-up of those collected."""
        return np.array([member.samples for member in self._members])

    @property
    @reads
    def status(self) -> tuple[str, ...]:
        """`Identifier.status` of each member."""
        return tuple(member.status for member in self._members)

    def _row(self, name: str, value: Any) -> FloatArray:
        """Return one sample of each member as a chunk (1, M), or (1, 1) if it is the same for all."""
        array = array_of_reals(name, value)
        if array.shape not in ((), (len(self),)):
            raise InvalidArgumentError(f"{name} must be a number or have shape ({len(self)},), got shape {array.shape}")
        return array.reshape(1, -1)

    def _rows(self, name: str, value: Any) -> FloatArray:
        """Return a chunk as (K, M), or as (K, 1) if it is the same for all members."""
        array = array_of_reals(name, value)
        if array.ndim == 1:
            return array[:, None]
        if array.ndim != 2 or array.shape[1] != len(self):
            raise InvalidArgumentError(
                f"{name} must have shape (K,) or (K, {len(self)}), a column a member, got shape {array.shape}"
            )
        return array

    def _adapt(self, adapt: bool) -> None:
        if "starting" in self.status:
            raise InvalidArgumentError(
                "freezing needs a model, and some members still collect the samples for their first: try again later"
            )
        self._on_drafts(lambda member: member._adapt_draft(adapt))

    def _on_drafts(self, work: Callable[[Identifier], None], **more: Any) -> None:
        """Let all members do some work as one: an interrupt leaves all as they were."""
        members = [member._draft() for member in self._members]
        for member in members:
            work(member)
        vars(self).update(_members=members, _blocks=[], **more)

    def _run(self, u: FloatArray, y: FloatArray, size: int, helpers: Sequence[Helper]) -> tuple[FloatArray, FloatArray]:
        """Take a chunk; return errors (K, M) and the first ``size`` parameters (M, K, size) after each sample."""
        if u.shape[0] != y.shape[0]:
            raise InvalidArgumentError(f"u and y must have the same length, got {u.shape[0]} and {y.shape[0]} samples")
        new = partial(aligned, new=np.empty) if helpers else np.empty  # threads must not write to one cache line
        results = new((u.shape[0], len(self))), np.empty((len(self), u.shape[0], size))
        self._chunk = Chunk(u, y, len(helpers))
        try:
            self._take(self._chunk, helpers, *results)
        except BaseException:  # also KeyboardInterrupt; if this is interrupted, too, the next call does it
            self._set_aside()
            raise
        vars(self).update(_taken=self._taken + len(u), _chunk=None)
        return results

    def _take(self, samples: Chunk, helpers: Sequence[Helper], *results: FloatArray) -> None:
        """Let all members take the samples, in blocks, in company or by themselves."""
        from replant.kernels.lanes import LANES

        chunk = samples.u, samples.y, *results
        tasks: list[tuple[Take, int]] = [(block.take, 0) for block in self._blocks]
        groups, self._companies = self._companies, []
        placed = {n for block in self._blocks for n in block.numbers.tolist()}.union(*groups)
        reached = {n: self._lead_in(n, *chunk) for n in range(len(self)) if n not in placed}
        for block, start in self._form_blocks(reached):
            tasks.append((block.take, start))
            reached = {n: k for n, k in reached.items() if n not in block.numbers}
        lanes = {n: lane for n in reached if (lane := lane_of(self._members[n])) is not None}
        together = sorted(lanes, key=lanes.__getitem__)
        groups = groups + [together[first : first + LANES] for first in range(0, len(together), LANES)]
        companies = [Company(group, self._members, self._take_alone) for group in groups]
        tasks += [(company.take, 0) for company in companies]
        tasks += [(partial(self._take_alone, n), start) for n, start in reached.items() if n not in lanes]
        carry_out(tasks, self._room, helpers, samples, *results)
        self._companies = [company.numbers for company in companies if company.all_together]

    def _lead_in(self, number: int, *chunk: FloatArray) -> int:
        """Step a member alone until it is ready for a block; return the number of samples taken."""
        member, taken = self._members[number], 0
        while taken < chunk[0].shape[0] and may_join(member) and not is_ready(member):
            self._take_alone(number, self._room, taken, *(part[: taken + 1] for part in chunk[:2]), *chunk[2:])
            taken += 1
        return taken

    def _take_alone(self, number: int, _: Room, start: int, *chunk: FloatArray) -> None:
        """Take the samples from ``start`` on as a single identifier does."""
        u, y, errors, parameters = chunk
        member, end, own_u, own_y = self._members[number], len(u), number * (u.shape[1] > 1), number * (y.shape[1] > 1)
        if errors.shape[0] == 1 and not parameters.size:
            errors[0, number] = member.update(float(u[0, own_u]), float(y[0, own_y]))
            return
        trace = member.update_many(u[start:, own_u], y[start:, own_y])
        errors[start:end, number] = trace.errors
        if parameters.size:
            parameters[number, start:end] = trace.parameters

    def _form_blocks(self, reached: dict[int, int]) -> list[tuple[Block, int]]:
        """Form blocks, see `form_blocks`, and let their members use the arrays of the blocks from now on."""
        formed = form_blocks(self._members, reached)
        members = list(self._members)
        for block, _ in formed:
            for lane in range(block.members):
                number = int(block.numbers[lane])
                members[number] = members[number]._moved_to(block.state(lane))
        vars(self).update(_members=members, _blocks=[*self._blocks, *(block for block, _ in formed)])
        return formed


def _copies(identifiers: Identifier | Iterable[Identifier], members: int | None) -> list[Identifier]:
    """Return the ensemble's own members."""
    number = 1
    if isinstance(identifiers, Identifier):
        each = [identifiers]
        if members is not None:
            about = sum(array.size for array in identifiers._state.arrays) + OBJECT
            number = count("members", members, 1, about)
    elif not iterable(identifiers):
        raise ArgumentTypeError(
            "identifiers must be an Identifier of one input and one structure, or a sequence of them, got "
            f"{type(identifiers).__name__}"
        )
    elif members is not None:
        raise InvalidArgumentError("members goes with one identifier; a sequence of them is as long as it is")
    else:
        each = list(identifiers)
    wrong = next((type(one).__name__ for one in each if not isinstance(one, Identifier)), None)
    if wrong is not None:
        raise ArgumentTypeError(f"identifiers must be an Identifier or a sequence of them, got a {wrong} among them")
    if not each:
        raise InvalidArgumentError("identifiers must not be empty")
    others = {one.names for one in each} - {each[0].names}
    if others:
        raise InvalidArgumentError(f"all members must have the same parameters, got {each[0].names} and {others.pop()}")
    if any(one._background for one in each):
        raise InvalidArgumentError("an ensemble knows no background: give it identifiers with background=False")
    if any(one.reference for one in each):
        raise InvalidArgumentError("an ensemble knows no reference: give it identifiers whose samples came without r")
    return [one.clone() for one in each for _ in range(number)]


def _threads(n_jobs: int | None, members: int) -> int:
    """Return the number of threads by joblib's meaning of ``n_jobs``, at most one for each member."""
    jobs = 1 if n_jobs is None else whole("n_jobs", n_jobs, -MOST_JOBS)
    if jobs == 0:
        raise InvalidArgumentError("n_jobs must not be 0: 1 is one thread, -1 all processors")
    return min(jobs if jobs > 0 else max(multiprocessing.cpu_count() + 1 + jobs, 1), members)
