"""The linear regression behind every estimator: from settings to the kernels' arrays, from records to regressors.

With Lambda moved to the left, (4) reads

    s^n/Lambda y = phi' theta,   phi = [-s^(n-1)/Lambda y ... -1/Lambda y, s^m/Lambda u ... 1/Lambda u (, 1)],

so the estimate is in the plant's own parameters, whatever Lambda is; the prediction error is that of (8).
"""

from __future__ import annotations

import numpy as np

from replant.filters import StateVariableFilter
from replant.kernels import layout as at
from replant.preprocess import Preprocess
from replant.scaling import Scaling
from replant.settings import Settings
from replant.structure import Structure
from replant.validation import FloatArray

IntArray = np.ndarray[tuple[int], np.dtype[np.int64]]


def prepare(settings: Settings) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the kernels' ``ints``, ``reals`` and ``buffer`` of an identifier before its first sample."""
    structure, replay, optimizer = settings.structure, settings.replay, settings.optimizer
    memory, numbers = optimizer.memory(structure.size), optimizer.settings(settings.dt)
    batch = replay.batch_size if replay else 1
    ints, reals = _signal_arrays(
        structure, settings.dt, settings.filter, settings.preprocess, settings.scaling, memory.size, numbers.size, batch
    )
    ints[at.ALGORITHM] = optimizer.code
    ints[at.NORMALIZE] = settings.normalize
    # without replay the buffer is one row: the newest sample, which is always learned
    ints[at.CAPACITY] = replay.capacity if replay else 1
    ints[at.WARMUP] = replay.warmup if replay else 0
    ints[at.SEED] = replay.seed if replay else 0
    at.block(ints, reals, at.AT_MEMORY, memory.size)[:] = memory
    at.block(ints, reals, at.AT_SETTINGS, numbers.size)[:] = numbers
    buffer = np.zeros((int(ints[at.CAPACITY]), structure.size + 2))
    return ints, reals, buffer


def regressors(
    structure: Structure,
    dt: float,
    state_filter: StateVariableFilter,
    preprocess: Preprocess,
    u: FloatArray,
    y: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the regressors phi (K, P) and the target s^n/Lambda y (K,) of a record, in physical units.

    Rows of samples that are not finite, or too large for float64, are NaN.
    """
    from replant.kernels.step import regressors as kernel

    ints, reals = _signal_arrays(structure, dt, state_filter, preprocess, Scaling.none(structure), 0, 0, 1)
    phi, target = np.empty((u.size, structure.size)), np.empty(u.size)
    if callable(preprocess.input_map):
        u = preprocess.call_map(u)
    kernel(ints, reals, u, y, phi, target)
    return phi, target


def _signal_arrays(
    structure: Structure,
    dt: float,
    state_filter: StateVariableFilter,
    preprocess: Preprocess,
    scaling: Scaling,
    memory: int,
    numbers: int,
    batch: int,
) -> tuple[IntArray, FloatArray]:
    """Return ``ints`` and ``reals`` with all that turns samples into regressors."""
    n, inputs = structure.poles, structure.zeros + 1
    discrete = state_filter.discretize(n, dt, structure.delay)
    ints, reals = at.plan(n, structure.size, inputs, discrete.lag, memory, numbers, batch)
    ints[at.SQUARE_INPUT] = preprocess.input_map == "square"
    reals[at.INPUT_OFFSET], reals[at.OUTPUT_OFFSET] = float(preprocess.input_offset), float(preprocess.output_offset)
    reals[at.OUTPUT_SCALE] = scaling.output
    sigmas = scaling.sigmas(structure)
    at.block(ints, reals, at.AT_TRANSITION, n * n)[:] = discrete.transition.ravel()
    at.block(ints, reals, at.AT_OUTPUT_TAPS, 2 * n)[:] = discrete.output_taps.ravel()
    at.block(ints, reals, at.AT_INPUT_TAPS, 3 * n)[:] = discrete.input_taps.ravel()
    at.block(ints, reals, at.AT_CHARACTERISTIC, n)[:] = discrete.characteristic
    signs = np.concatenate([-1 / discrete.scale, 1 / discrete.scale[n - inputs :], np.ones(int(structure.bias))])
    at.block(ints, reals, at.AT_GAIN, structure.size)[:] = signs / sigmas
    at.block(ints, reals, at.AT_UNIT, structure.size)[:] = scaling.output / sigmas
    return ints, reals
