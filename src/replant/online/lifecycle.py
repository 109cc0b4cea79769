"""Lifecycle: the start of an identifier, the work due between samples, and the change to another state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NoReturn, Self, TypeVar

import numpy as np

from replant.estimation.engine.dimensions import collects_at_most
from replant.estimation.engine.state import NOTHING, State, Step, step_kernels
from replant.estimation.settings import LONGEST_STARTUP
from replant.kernels.native import OPEN, SHUT, Kernel
from replant.kernels.schema import BELIEVED, Alarm, Attention
from replant.numerics.arguments import FloatArray, IntArray
from replant.online import background, second_process
from replant.online.change_response import look, note_alarm
from replant.online.estimate import Estimate
from replant.online.identification import check_begun
from replant.online.revision import next_revision, revise, solve_whole
from replant.online.startup import (
    begin,
    collected,
    drop_misread,
    keep_newer_half,
    measured,
    modelled,
    next_provisional,
    settled,
    take_held,
)
from replant.online.trace import Later, write

NO_GATE = np.full(1, SHUT)  # gate of an identifier without a bound kernel for single samples

T = TypeVar("T")


def in_turn(u: float, y: float, t: float, r: float) -> NoReturn:
    """Take no sample but raise `Attention`: the kernel for single samples is not bound."""
    raise Attention


class Lifecycle(Estimate):
    """The life of an `Identifier`: its state, the kernels that take samples, and the schedule of other work."""

    _resolve_at: int  # accepted samples at which to solve the record again; 0: not planned
    _begun_with: float  # error of the last sample of the start-up
    _step: Step  # takes the next single sample
    _gate: IntArray
    _regular: bool  # whether no time stamp has come
    _mapped: bool  # whether the input map is a function
    _kernel: Kernel
    _steps: Callable[..., int]
    _background = False  # whether a second process does the work that is due
    _job: background.Job | None = None  # its present job
    _place: second_process.Place | None = None  # the memory shared with it
    _forced_waits = 0
    _spare: FloatArray  # the ring of the state in use before
    _wakes_at: int  # accepted samples shortly before work is due

    def _begin_again(self) -> None:
        self._drop_job()
        self._settings, self._spare, self._wakes_at = None, NOTHING, 0
        self._solved, self._begun_with = {}, math.nan
        self._dropped = self._resolve_at = 0
        self._regular = True
        self._hold = self._request.first_hold  # measured outputs that the start-up waits for
        self._collect(reference=False)
        if self._hold == 0:
            self._begin()

    def _collect(self, *, reference: bool) -> None:
        """Begin the start-up; the first sample determines whether samples come with a reference."""
        self._reference = reference
        self._work_on(State.collecting(self._request, reference=reference), regular=self._regular)
        if self._hold:
            self._plan()

    def _work_on(self, state: State, *, regular: bool, kernels: tuple[Kernel, Kernel] | None = None) -> None:
        """Continue with a state and choose its kernels: those for a regular clock until the first time stamp."""
        kernel, steps = kernels or step_kernels(state, regular=regular)
        vars(self).update(
            _state=state, _regular=regular, _kernel=kernel, _steps=steps, _step=in_turn, _gate=NO_GATE,
            _mapped=callable(self._request.preprocess.input_map),
        )  # fmt: skip

    def _go_on_with(self, state: State) -> None:
        """Replace the present state, unless it is the same one."""
        if state is not self._state:
            self._work_on(state, regular=self._regular)

    def _but(self, **own: Any) -> Self:
        """Return a shallow copy with some attributes replaced."""
        made = object.__new__(type(self))
        made.__dict__.update(vars(self) | own)
        return made

    def _moved_to(self, state: State) -> Self:
        """Return a copy that works on a state of equal content, with a regular clock."""
        moved = self._but()
        moved._work_on(state, regular=True)
        return moved

    def _draft(self, *, recent: bool = True) -> Self:
        """Return a copy with its own arrays and the same turn; without ``recent`` it shares the raw samples."""
        return self._but(_state=self._state.copy(recent=recent), _step=in_turn, _gate=NO_GATE)

    def _as_one(self, work: Callable[..., T], *given: Any, recent: bool = True) -> T:
        """Do some work on a draft, and assign its attributes in one bytecode: an interrupt leaves the state before."""
        draft = self._draft(recent=recent)
        result = work(draft, *given)
        # a kernel bound to the former arrays takes no sample: they wait for attention, or their gate is shut
        vars(self).update(vars(draft))
        return result

    def _enter(self) -> None:
        self._gate[0] = SHUT
        while self._state.attention:
            if self._background and self._settings is not None and self._state.held_at != BELIEVED:
                self._attend_in_background()
            else:  # a review does not change the raw samples
                self._as_one(Lifecycle._attend, recent=self._settings is None or self._state.held_at == BELIEVED)

    def _leave(self) -> None:
        self._gate[0] = OPEN

    def _take(
        self, u: FloatArray, y: FloatArray, t: FloatArray, r: FloatArray, errors: FloatArray, parameters: FloatArray,
        later: Later | None = None,
    ) -> int:  # fmt: skip
        """Take samples up to one that needs attention, do the work due, and return how many were taken."""
        # parameters are (K, P), or (K, 0) if not wanted; those of a start-up are computed later
        chunk, starting = (u, y, t, r, errors, parameters, later), self._settings is None
        other = (t.size and self._regular) or (r.size and not self._reference)
        taken = self._as_one(Lifecycle._change_kernels, *chunk) if other else self._run(*chunk)
        if not self._state.attention:
            return taken
        reached = self._attend_after(taken, parameters, later)
        if reached == taken and starting and self._settings is not None and not math.isnan(y[taken - 1]):
            errors[taken - 1] = self._begun_with
        return reached

    def _attend_after(self, taken: int, parameters: FloatArray, later: Later | None = None) -> int:
        """Do the work due after the last sample; return how many were taken, without one that must be repeated."""
        believed = self._state.held_at == BELIEVED
        self._enter()
        if believed:
            return taken - 1  # the sample that confirms the one held back is taken after it
        if parameters.size:
            write(self._estimate(), parameters[taken - 1], later)
        return taken

    def _run(
        self, u: FloatArray, y: FloatArray, t: FloatArray, r: FloatArray, errors: FloatArray, parameters: FloatArray,
        later: Later | None,
    ) -> int:  # fmt: skip
        """Run the kernel up to a sample that needs attention; return how many samples it has taken."""
        taken: int
        if self._settings is not None:
            taken = self._steps(*self._state.arrays, u, y, t, r, errors, parameters)
            return taken
        estimate = self._estimate()  # during start-up the kernel has no estimate to write
        taken = self._steps(*self._state.arrays, u, y, t, r, errors, np.empty((u.size, 0)))
        if parameters.size:
            write(estimate, parameters[:taken], later)
        return taken

    def _change_kernels(self, *chunk: Any) -> int:
        """Change the kernels, as the first time stamp or the first reference has come, and run them."""
        _, _, t, r, *_ = chunk
        if r.size and not self._reference:
            self._collect(reference=True)
        if t.size:
            self._work_on(self._state, regular=False)
        return self._run(*chunk)

    def _attend(self) -> None:
        """Do the work due: make room, take a sample held back, end the start-up, examine an alarm, solve again."""
        self._state.make_room(self._most)
        if self._state.held_at == BELIEVED:
            take_held(self._state, self._steps)
        elif self._settings is None:
            self._end_startup()
        else:
            state, self._resolve_at = revise(self._state, self._settings, self._resolve_at, self._most)
            self._go_on_with(state)
            self._plan()

    def _plan(self) -> None:
        """Set the sample at which the kernels next ask for attention."""
        self._state.attention_at = self._next_stop()
        self._state.attention = False  # last, so that an interrupted call is repeated

    def _come_back(self) -> None:
        """Ask for attention with the next sample."""
        self._state.attention_at = self._state.samples + 1
        self._state.attention = False  # last, as in `_plan`

    def _next_stop(self) -> int:
        state, now = self._state, self._state.samples
        if self._settings is None:
            # the start-up may end, or the provisional model change
            there = measured(state)
            missing = min(self._hold, next_provisional(self._request, there)) - there
            return min(now + max(missing, 1), max(state.recent_size, now + 1))
        if self._job is not None:
            if now == self._job.numbers.samples:
                return now + 1
            self._wakes_at = self._job.schedule.looks_from
            return self._job.schedule.next_stop(now)
        dues = [now + 1 if 0 < due <= now else due for due in (self._resolve_at, state.look_at)]
        self._resolve_at, state.look_at = dues
        dues.append(state.room_until(self._most))
        first = min((due for due in dues if due), default=0)
        # in the background also two samples before: code that has not run for long takes 60 us at first, then 5
        self._wakes_at = first - 2 if self._background else 0
        return max(self._wakes_at, now + 1) if self._background and first else first

    def _attend_in_background(self) -> None:
        """Do the work due without a copy of the state; an interrupted call is repeated."""
        state, settings = self._state, self._settings
        assert settings is not None
        if state.samples == self._wakes_at:
            self._come_back()
            return
        note_alarm(state, settings)
        if self._job is None:
            if state.samples in (self._resolve_at, state.look_at):
                self._job = background.Job.of(state)
        elif state.samples >= self._job.schedule.until:
            self._take_up(self._job)
            return
        elif state.samples == self._job.schedule.begun + 1:
            pass  # making the schedule takes an update of its own
        elif self._job.place is None:
            self._job.take_place(self._made_place())
        elif not self._job.go_on(state, settings, self._resolve_at, self._most):
            self._job.look(state, settings, self._spare, regular=self._regular)
        self._plan()

    def _take_up(self, job: background.Job) -> None:
        """Use the result of a job."""
        state, settings = self._state, self._settings
        assert settings is not None
        if job.wait():
            self._forced_waits += 1
            second_process.start(wait=False)  # in case it has ended
        found = job.outcome(state, settings, self._resolve_at, self._most)
        if job.needs_new(found, state):
            draft = self._but()  # as in `_as_one`; nothing is written to the state in use
            draft._go_on_from(job, found)
            vars(self).update(vars(draft))
            return
        for slot in background.PLANNED:
            if getattr(found.state, slot.name) != getattr(job.numbers, slot.name):
                setattr(state, slot.name, getattr(found.state, slot.name))
        vars(self).update(_job=None, _resolve_at=found.due)
        self._plan()

    def _go_on_from(self, job: background.Job, found: background.Outcome) -> None:
        assert self._settings is not None
        ahead = job.caught_up(found, self._state, self._settings, regular=self._regular)
        self._spare = self._state.recent
        self._work_on(ahead.state, regular=self._regular, kernels=ahead.kernels)
        if ahead.bound is not None:
            self._step, self._gate = ahead.bound
        self._job, self._resolve_at = None, found.due
        self._come_back()  # to plan what is next

    def _drop_job(self) -> None:
        """Drop the present job: its work is due again."""
        if self._job is not None:
            self._job = None
            self._plan()

    def _made_place(self) -> second_process.Place:
        """Return memory shared with the second Python; a new one if there is none, or it is busy or of a parent."""
        if self._place is None or not self._place.is_mine or self._place.is_busy:
            self._place = second_process.Place(self._request.history)
        return self._place

    @property
    def _most(self) -> int:
        """The most raw samples that are kept."""
        return collects_at_most(self._request) if self._settings is None else self._request.history

    def _end_startup(self, *, at_any_rate: bool = False) -> None:
        """End the start-up if enough outputs are collected, or ``at_any_rate``; then plan the next attention."""
        state, given = self._state, self.taken
        is_full = state.samples >= self._most
        if at_any_rate:
            self._begin(at_any_rate=True)
        elif measured(state) >= self._hold or is_full:
            if drop_misread(state, self._request):
                self._solved = {}
            else:
                self._begin(is_full=is_full)
        self._dropped += given - self.taken
        self._plan()

    def _begin(self, *, at_any_rate: bool = False, is_full: bool = False) -> None:
        """Choose the settings, allocate the state and learn the samples collected; wait longer if there is no model."""
        old, request = self._state, self._request
        kept, solution = collected(old), None
        settings = settled(request, kept)
        if settings.instruments:
            solution = modelled(request, settings.preprocess, kept)
            if solution is None and at_any_rate:  # the samples are kept, as others may follow
                return
            last = at_any_rate or 2 * self._hold > LONGEST_STARTUP
            if solution is None or not (solution.found.acceptable or last):
                self._solved[measured(old)] = None if solution is None else solution.found
                self._wait_longer(is_full=is_full)
                return
        at_once = self._background  # lengthening the ring later would take longer than a sample
        state, self._begun_with = begin(old, settings, kept, solution, request.history, at_once=at_once)
        self._settings, self._solved = settings, {}
        self._work_on(state, regular=self._regular)
        if self._place is not None:
            self._place.told(settings, background.text_of)
        if solution is not None:
            self._resolve_at = next_revision(state, settings, self._most)

    def _wait_longer(self, *, is_full: bool) -> None:
        """Double the start-up; at its limit drop the older half of the samples, as a plant may rest at first."""
        if 2 * self._hold <= LONGEST_STARTUP and not is_full:
            self._hold *= 2
        else:
            keep_newer_half(self._state)
            self._solved = {}

    def _finish(self) -> None:
        self._drop_job()
        is_begun = self._settings is not None
        if not is_begun and self._state.samples:
            self._end_startup(at_any_rate=True)
        if self._settings is None:
            self._state.finished_at = self._state.samples
            return
        before = self._state
        if before.alarm:
            self._go_on_with(look(before, self._settings)[0])
        if (found := solve_whole(self._state, self._settings)) is not None:
            self._go_on_with(found)
        elif not is_begun:  # the model that ended the start-up is that of all samples
            self._state.finished_at, self._state.gap_at = self._state.samples, 0
        if self._state is not before:
            self._resolve_at = next_revision(self._state, self._settings, self._most)
        self._plan()

    def _adapt_draft(self, adapt: bool) -> None:
        check_begun(self._settings is not None)
        self._drop_job()
        self._state.adapt = adapt
        self._state.change_began, self._state.cusum = self._state.samples, 0.0
        if not adapt:
            # a later solution would learn the samples that come while frozen
            self._resolve_at = self._state.look_at = 0
            self._state.alarm = Alarm.NONE
            self._plan()
