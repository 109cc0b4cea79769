"""State: the arrays that the kernels work on, laid out and filled for one identifier or one record.

The regression behind every estimator, with Lambda moved to the left of (4), reads

    s^n/Lambda y = phi' theta,   phi = [-s^(n-1)/Lambda y ... -1/Lambda y, s^m/Lambda u ... 1/Lambda u (, 1)],

so the estimate is in the plant's own parameters, whatever Lambda is; the prediction error is that of (8).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.kernels import schema as at
from replant.model.structure import Structure
from replant.regressor.filters import RefinedFilter, StateVariableFilter
from replant.regressor.preprocess import Preprocess
from replant.settings import Settings

IntArray = np.ndarray[tuple[int], np.dtype[np.int64]]

NOTHING = np.zeros(0)
GAP = 20.0  # sampling times without a sample, after which the filters begin anew
# Times the nominal rate at which samples may come where there is a dead time: so many past inputs are kept.
DENSEST = 4.0
# Samples between two past estimates kept: of the 10000 raw samples kept at most half are then held out from the oldest,
LONGEST_STEP = 1250
# ... a few hundred where the estimate follows a plant that changes, and is soon out of date by right.
SHORTEST_STEP = 128


@dataclass(frozen=True, eq=False)
class State:
    """The kernels' arrays; see `replant.kernels.schema` and `replant.kernels.filters.bank` for what lies where.

    Attributes
    ----------
    ints : int64 array
    reals : float64 array
    banks : (3, size) array
    buffer : (capacity, width) array
        Replay: a learned sample a row.
    recent : (R, 3) or (R, 5) array
        Raw samples kept: input, output, interval; guarded, then also the output that the filters saw, and why (see
        `replant.kernels.monitoring.outliers`).
    """

    ints: IntArray
    reals: FloatArray
    banks: FloatArray
    buffer: FloatArray
    recent: FloatArray

    @property
    def arrays(self) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """All of them, in the order in which the kernels take them."""
        return self.ints, self.reals, self.banks, self.buffer, self.recent

    @classmethod
    def build(
        cls,
        structure: Structure,
        dt: float,
        *,
        state_filter: StateVariableFilter | None,
        input_hold: str = "zoh",
        instruments: bool = False,
        sigma: FloatArray | None = None,
        output_scale: float = 1.0,
        memory: FloatArray = NOTHING,
        numbers: FloatArray = NOTHING,
        capacity: int = 1,
        batch: int = 1,
        recent: int = 0,
        guarded: bool = False,
    ) -> State:
        """Lay out the arrays; ``state_filter`` None stands for the refined filter, which has nuisances."""
        from replant.kernels.filters import bank as bk
        from replant.kernels.monitoring import estimate_path, residual_colour

        refined = state_filter is None
        n = structure.poles
        entries = n + structure.zeros + 1 + (1 + n if refined else int(structure.bias))
        ring = math.ceil(DENSEST * structure.delay / dt) + 8
        ints, reals = at.plan(
            order=n,
            entries=entries,
            ring=ring,
            memory=memory.size,
            settings=numbers.size,
            batch=batch,
            colour=residual_colour.size(entries),
            path=estimate_path.size(entries),
        )
        ints[at.PARAMETERS] = structure.size
        ints[at.INPUT_ENTRIES] = structure.zeros + 1
        ints[at.STRAIGHT_INPUT] = input_hold == "foh"
        ints[at.CONSTANT] = refined or structure.bias
        ints[at.REFINED], ints[at.INSTRUMENTS] = refined, instruments or refined
        ints[at.CAPACITY], ints[at.RECENT] = capacity, recent
        ints[at.ADAPT] = ints[at.ACTIVE] = 1
        ints[at.GUARDED] = guarded
        reals[at.OUTPUT_SCALE], reals[at.DELAY], reals[at.INTERVAL] = output_scale, structure.delay, dt
        reals[at.READY], reals[at.LONGEST_GAP] = math.inf, math.inf
        state = cls(
            ints,
            reals,
            np.zeros((3, bk.size(n, entries))),
            np.zeros((capacity, (2 * entries if ints[at.INSTRUMENTS] else entries) + 2)),
            np.zeros((recent, 5 if guarded else 3)),
        )
        sigma = np.ones(entries) if sigma is None else sigma
        state.block(at.AT_SIGMA, entries)[:] = sigma
        state.block(at.AT_UNIT, entries)[:] = output_scale / sigma
        state.block(at.AT_MEMORY, memory.size)[:] = memory
        state.block(at.AT_SETTINGS, numbers.size)[:] = numbers
        if state_filter is not None:
            state.fix_filter(structure, dt, state_filter)
        return state

    @classmethod
    def of_settings(cls, settings: Settings, recent: int) -> State:
        """Return the arrays of an identifier with these settings, before its first sample."""
        structure, replay, optimizer = settings.structure, settings.replay, settings.optimizer
        refined = isinstance(settings.filter, RefinedFilter)
        entries = structure.size + (structure.poles + 1 - int(structure.bias) if refined else 0)
        sigma = np.ones(entries)
        sigma[: structure.size] = settings.scaling.sigmas(structure)
        unit = settings.scaling.output / sigma
        state = cls.build(
            structure,
            settings.dt,
            state_filter=None if isinstance(settings.filter, RefinedFilter) else settings.filter,
            input_hold=settings.filter.input_hold,
            instruments=settings.instruments,
            sigma=sigma,
            output_scale=settings.scaling.output,
            memory=optimizer.memory(entries),
            numbers=optimizer.settings(settings.dt, unit),
            capacity=replay.capacity if replay else 1,  # without replay: the newest sample, which is always learned
            batch=replay.batch_size if replay else 1,
            recent=recent,
            guarded=optimizer.keeps_covariance,
        )
        ints, reals = state.ints, state.reals
        ints[at.ALGORITHM], ints[at.NORMALIZE] = optimizer.code, settings.normalize
        ints[at.WARMUP] = min(replay.warmup, replay.capacity - 1) if replay else 0  # a full buffer is warm
        ints[at.SEED] = replay.seed if replay else 0
        ints[at.SQUARE_INPUT] = settings.preprocess.input_map == "square"
        ints[at.COLOURED] = optimizer.keeps_covariance and optimizer.keeps_colour
        remembers_all = optimizer.keeps_colour and state.block(at.AT_SETTINGS, 1)[0] == 1.0
        follows = optimizer.keeps_covariance and not remembers_all
        ints[at.PAST_STEP] = SHORTEST_STEP if follows else LONGEST_STEP
        reals[at.INPUT_OFFSET] = float(settings.preprocess.input_offset)
        reals[at.OUTPUT_OFFSET] = float(settings.preprocess.output_offset)
        reals[at.LONGEST_GAP] = GAP * settings.dt
        return state

    @classmethod
    def for_regressors(
        cls, structure: Structure, dt: float, state_filter: StateVariableFilter, preprocess: Preprocess
    ) -> State:
        """Return arrays that turn a raw record into unscaled regressors of a fixed filter."""
        state = cls.build(structure, dt, state_filter=state_filter, input_hold=state_filter.input_hold)
        state.ints[at.SQUARE_INPUT] = preprocess.input_map == "square"
        state.reals[at.INPUT_OFFSET] = float(preprocess.input_offset)
        state.reals[at.OUTPUT_OFFSET] = float(preprocess.output_offset)
        return state

    @classmethod
    def refined(cls, structure: Structure, dt: float, input_hold: str) -> State:
        """Return arrays that turn a record made ready into regressors and instruments of the refined filter."""
        return cls.build(structure, dt, state_filter=None, input_hold=input_hold)

    @property
    def entries(self) -> int:
        """How many entries the regressor has, T: the parameters and the nuisances."""
        return int(self.ints[at.ENTRIES])

    def block(self, slot: int, size: int) -> FloatArray:
        """Return a view of one block of ``reals``."""
        return at.block(self.ints, self.reals, slot, size)

    @property
    def theta(self) -> FloatArray:
        """View of the scaled estimate, (T,)."""
        return self.block(at.AT_THETA, self.entries)

    @property
    def past(self) -> FloatArray:
        """View of the past estimates (PAST, 1 + T), scaled, each behind the samples that it had taken in."""
        size = 1 + self.entries
        return self.block(at.AT_PAST, at.PAST * size).reshape(at.PAST, size)

    @property
    def prior(self) -> FloatArray:
        """View of the estimate before a change, physical, and of its standard deviations, (2, T)."""
        return self.block(at.AT_PRIOR, 2 * self.entries).reshape(2, -1)

    @property
    def was_revised(self) -> bool:
        """Whether the estimate is one revised after a change, by a record without a gap since."""
        return bool(self.ints[at.REVISED] > 0 and self.ints[at.REVISED] == self.ints[at.GAP_AT])

    @property
    def unit(self) -> FloatArray:
        """View of what turns scaled into physical parameters, (T,)."""
        return self.block(at.AT_UNIT, self.entries)

    def install(self, theta: FloatArray) -> None:
        """Make ``theta`` (T,), in physical units, the serving auxiliary model, its filters at rest."""
        from replant.kernels.filters.chain import install_model

        self.ints[at.ACTIVE], self.ints[at.WARMING] = 1, 0
        install_model(self.ints, self.reals, self.banks, 1, theta / self.unit)

    @contextmanager
    def without_preprocessing(self) -> Iterator[None]:
        """Take samples as they are kept in ``recent``: mapped, working point taken off."""
        square, offsets = self.ints[at.SQUARE_INPUT], self.reals[[at.INPUT_OFFSET, at.OUTPUT_OFFSET]]
        self.ints[at.SQUARE_INPUT] = 0
        self.reals[[at.INPUT_OFFSET, at.OUTPUT_OFFSET]] = 0.0
        try:
            yield
        finally:
            self.ints[at.SQUARE_INPUT] = square
            self.reals[[at.INPUT_OFFSET, at.OUTPUT_OFFSET]] = offsets

    def fix_filter(self, structure: Structure, dt: float, state_filter: StateVariableFilter) -> None:
        """Give the fixed bank its denominator; the bilinear filter also its one discretisation."""
        from replant.kernels.filters import bank as bk

        n, entries, ints = structure.poles, self.entries, self.ints
        fixed = self.banks[0]
        bk.set_denominator(
            fixed, n, entries, int(ints[at.INPUT_ENTRIES]), bool(ints[at.CONSTANT]), False, True,
            state_filter.polynomial(n)[1:], self.block(at.AT_SIGMA, entries),
        )  # fmt: skip
        if state_filter.method == "gbt":
            ints[at.BILINEAR] = 1
            discrete = state_filter.discretize(n, dt)
            kept = fixed[bk.at_kept(n, entries) :]
            kept[0] = dt
            kept[1 : 1 + n * n] = discrete.transition.ravel()
            kept[1 + n * n : 1 + n * n + n] = discrete.output_taps[0]
            fixed[bk.NEXT] = 1.0
