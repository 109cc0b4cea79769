"""Start-up: the first samples are collected; settings (docs/defaults.md) and a first model are made from them.

A compiled step (`replant.kernels.step.single`) collects them in the ring of raw samples, by the same rules as for
later samples.

Until they suffice there is a provisional model of the first outputs, of growing numbers of them.  Nothing later depends
on it, so that it is computed only when it is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from replant.estimation.engine.dimensions import room_for
from replant.estimation.engine.recent_samples import RecentSamples
from replant.estimation.engine.state import NOTHING, REGULAR, State, step_kernels
from replant.estimation.filters import RefinedFilter
from replant.estimation.optimizers.optimizer import Replay
from replant.estimation.settings import AUTO, Request, Scaling, Settings
from replant.estimation.solver.least_squares import choose_filter, regressors
from replant.estimation.solver.refined_estimate import Refined
from replant.estimation.solver.solve import Solution, solve
from replant.kernels.schema import BELIEVED
from replant.model.preprocess import Preprocess, centre
from replant.numerics.arguments import FloatArray, IntArray
from replant.numerics.linear_algebra import quiet
from replant.numerics.robust import without_spikes
from replant.online.begin_recursion import REJECTED, initialize, note_doubts, warm_up
from replant.verdict.assess import assess_record

UNKNOWN_LENGTH = 2_000  # length of a record that an optimizer is tuned for if it is unknown [samples]

Solved = dict[int, Refined | None]  # estimates by the number of measured outputs that they are made from


def collected(state: State) -> RecentSamples:
    """Return the samples of a start-up: mapped input, output as given."""
    return RecentSamples.of(state, len(state.recent))


def measured(state: State) -> int:
    """Return the number of collected samples with an output."""
    return int(np.count_nonzero(collected(state).is_measured))


def take_held(state: State, steps: Callable[..., Any]) -> None:
    """Take the sample that was held back, which the next one has confirmed."""
    u, y, t, r = np.array([[state.held_input], [state.held_output], [state.held_time], [state.held_reference]])
    state.attention = False
    try:
        with state.without_preprocessing():
            steps(*state.arrays, u, y, t, r, np.empty(1), np.empty((1, 0)))
    finally:
        state.held_at = 0


def drop_misread(state: State, request: Request) -> bool:
    """Reject collected samples with a misread input, as the spread of inputs is now known; return whether any were."""
    kept = collected(state)
    u = kept.input.copy()
    moved = np.flatnonzero(u != u[:1])[:1]
    if not moved.size:
        return False
    # the kernel does not know the spread of inputs from the first two values; from the end backwards it knows it there
    first = np.append(0, moved) if moved[0] == 1 else moved
    misread = np.setdiff1d(first, u.size - 1 - _believed(request, u[::-1].copy()))
    if not misread.size:
        return False
    rest = np.delete(np.arange(u.size), misread)
    rows = np.isin(np.arange(u.size), rest[_believed(request, u[rest])])
    lost = u.size - int(rows.sum())
    _replace(state, kept.select(rows))
    state.input_leaps += lost
    return True


def _believed(request: Request, u: FloatArray) -> IntArray:
    """Return the indices of the mapped inputs (K,) that a start-up accepts in this order."""
    state = State.collecting(replace(request, startup=max(u.size, 1)), u.size, reference=False)
    _, steps = step_kernels(state, regular=True)
    index, errors, taken = np.arange(u.size, dtype=np.float64), np.empty(u.size), 0
    with state.without_preprocessing():
        while taken < u.size:
            rest = slice(taken, None)
            taken += steps(*state.arrays, u[rest], index[rest], REGULAR, NOTHING, errors[rest], np.empty((u.size, 0)))
            if state.held_at == BELIEVED:
                take_held(state, steps)
                taken -= 1
    return collected(state).output.astype(np.int64)


def keep_newer_half(state: State) -> None:
    """Discard the older half of the samples collected."""
    kept = collected(state)
    _replace(state, kept[len(kept) // 2 :])


def _replace(state: State, kept: RecentSamples) -> None:
    """Replace the samples collected by some of them, from the first one with an output on."""
    there = np.flatnonzero(kept.is_measured)
    values = kept.values[there[0] if there.size else len(kept) :].copy()
    state.gap_at = max(state.gap_at - (state.samples - len(values)), 0)
    state.recent[: len(values)], state.recent[len(values) :] = values, 0.0
    state.samples, state.recent_head, state.held_at = len(values), len(values) % len(state.recent), 0
    state.finished_at = 0


@quiet
def modelled(
    request: Request, preprocess: Preprocess, kept: RecentSamples, given: Sequence[FloatArray] = ()
) -> Solution | None:
    """Return the solution of the samples of a start-up; its bridged outputs are relative to ``preprocess``'s offset."""
    level = replace(preprocess, input_map="identity")
    if not request.structure.bias:
        level = centre(level, kept.input.copy(), kept.output.copy())
    record = _less(kept, level).record(request.dt, request.input_hold, parted=True)
    solution = solve(request.structure, record, given)
    if solution is None:
        return None
    moved = float(level.output_offset) - float(preprocess.output_offset)
    return replace(solution, bridged=solution.record.y + moved)


def cleaned(request: Request, kept: RecentSamples) -> tuple[Request, RecentSamples]:
    """Return the request and the samples for settings and first model: input mapped, with instruments no spikes."""
    mapped = replace(request, preprocess=replace(request.preprocess, input_map="identity"))  # inputs are mapped already
    if not request.wants_instruments:
        return mapped, kept
    output, there = kept.output.copy(), kept.is_measured
    output[there] = without_spikes(output[there])
    return mapped, kept.changed(output=output)


def _less(kept: RecentSamples, level: Preprocess) -> RecentSamples:
    """Return samples with the working point subtracted."""
    u, y = kept.input - float(level.input_offset), kept.output - float(level.output_offset)
    return kept.changed(input=u, output=y)


def settled(request: Request, kept: RecentSamples) -> Settings:
    """Return the settings chosen from the samples of a start-up, with the input map of the request."""
    mapped, clean = cleaned(request, kept)
    settings = settle(mapped, clean.input.copy(), clean.output.copy(), reference=kept.have_reference)
    return replace(settings, preprocess=replace(settings.preprocess, input_map=request.preprocess.input_map))


def begin(
    old: State, settings: Settings, kept: RecentSamples, solution: Solution | None, most: int, *, at_once: bool = False
) -> tuple[State, float]:
    """Return the state after learning a start-up, which keeps ``most`` samples, and the error of the last one."""
    # room for all from the beginning, ``at_once`` or if the kernels do not ask for more
    room = room_for(len(kept), most) if settings.optimizer.keeps_covariance and not at_once else most
    state, error = State.of_settings(settings, room), math.nan
    if len(kept) > 0:
        if solution is not None:
            initialize(state, settings, solution.found, solution.record)
        raw = _less(kept, settings.preprocess)
        u, y, t = raw.input.copy(), np.where(raw.is_measured, raw.output, math.nan), REGULAR
        if solution is not None:
            y = np.where(solution.is_bad & raw.is_measured, solution.bridged, y)
        if not raw.is_regular(settings.dt):
            t = np.cumsum(raw.interval)
        learn = solution is None or not settings.optimizer.keeps_covariance
        with state.without_preprocessing():
            error = warm_up(state, u, y, t, raw.reference if settings.reference else None, learn=learn)
        if solution is not None:
            note_doubts(state, solution, raw.output)
            if not state.path_size:  # too few raw samples will be kept to test this later
                state.sums.refuted = float(_is_refuted(settings, solution))
        state.ready_at, state.solved_at = state.elapsed, state.samples
    state.take_over(old, *REJECTED, State.no_output, State.last_time, State.earlier_stamps)
    return state, error


def _is_refuted(settings: Settings, solution: Solution) -> bool:
    """Return whether the verdict on the first model, by the samples of the start-up, is "inconsistent"."""
    size, found = settings.structure.size, solution.found
    verdict = assess_record(
        settings.structure, found.theta[:size], solution.record, settings.dt, found.covariance[:size, :size],
        disagreement=found.disagreement,
    )  # fmt: skip
    return verdict.status == "inconsistent"


@quiet
def settle(
    request: Request,
    u: FloatArray,
    y: FloatArray,
    length: int | None = None,
    *,
    reference: bool = False,
    t: FloatArray | None = None,
) -> Settings:
    """Return settings with every "auto" replaced by a choice from a record."""
    structure, dt, instruments = request.structure, request.dt, request.wants_instruments
    preprocess = request.preprocess.resolve(u, y)
    replay = request.replay
    if isinstance(replay, str):  # an optimizer that keeps a covariance needs no replay
        replay = None if request.keeps_covariance else Replay()
    optimizer = request.optimizer_kind
    if isinstance(optimizer, type):
        optimizer = optimizer.suggested(dt, (length or UNKNOWN_LENGTH) * (replay.batch_size if replay else 1))
    chosen = request.filter
    if isinstance(chosen, str):
        follows = instruments and optimizer.keeps_covariance
        chosen = RefinedFilter() if follows else choose_filter(structure, dt, preprocess, u, y, t)
    if chosen.follows_estimate and not structure.bias:
        preprocess = centre(preprocess, u, y)
    scaling = request.scaling
    if scaling is None or (scaling == AUTO and optimizer.keeps_colour):  # its estimate does not depend on the scaling
        scaling = Scaling.none(structure)
    elif not isinstance(scaling, Scaling):
        assumed = chosen.fixed or choose_filter(structure, dt, preprocess, u, y, t)
        phi, _ = regressors(structure, dt, assumed, preprocess, u, y, t)
        scaling = Scaling.from_record(y - float(preprocess.output_offset), phi)
    return Settings(
        structure, dt, chosen, scaling, optimizer, replay, instruments, request.normalize, preprocess, u.size, reference
    )


def next_provisional(request: Request, held: int) -> int:
    """Return the number of measured outputs, above ``held``, from which there is another provisional model."""
    later = request.first_hold
    while later <= held:
        later *= 2
    return min((size for size, _ in _sizes(request, later) if size > held), default=later)


def provisional(request: Request, kept: RecentSamples, solved: Solved) -> tuple[int, Refined] | None:
    """Return the number of outputs of the newest provisional model, and this model; None if there is none."""
    if not request.wants_instruments:
        return None
    there = np.flatnonzero(kept.is_measured)
    for size, begun in _sizes(request, there.size):
        for number in (begun, size):
            if number not in solved:
                given = solved[begun] if number > begun else None
                solved[number] = _solved(request, kept[: there[number - 1] + 1], given)
        refined = solved[size]
        if refined is not None and refined.settled:
            return size, refined
    return None


def provisional_parameters(request: Request, kept: RecentSamples, solved: Solved) -> FloatArray:
    """Return the parameters (P,) of the newest provisional model; zero if there is none."""
    found, size = provisional(request, kept, solved), request.structure.size
    return np.zeros(size) if found is None else found[1].theta[:size].copy()


def _solved(request: Request, kept: RecentSamples, given: Refined | None) -> Refined | None:
    """Return the estimate from some samples, started at a given one or as usual."""
    mapped, clean = cleaned(request, kept)
    preprocess = mapped.preprocess.resolve(clean.input.copy(), clean.output.copy())
    solution = modelled(request, preprocess, kept, [] if given is None else [given.theta])
    return None if solution is None else solution.found


def _sizes(request: Request, held: int) -> Iterator[tuple[int, int]]:
    """Yield sizes of provisional models, largest first, each with that of the model it starts from (same: none)."""
    size = request.first_hold
    while 2 * size <= held:
        size *= 2
    while size >= request.least_startup:
        for quarters in (7, 6, 5, 4) if 2 * size >= request.startup else (4,):
            if size * quarters // 4 <= held:
                yield size * quarters // 4, size
        size //= 2
