"""Dispatch: which compiled kernel steps this state, one sample at a time or many."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from replant.estimation.engine.state import State
from replant.kernels.native import Kernel, library
from replant.model.preprocess import Preprocess
from replant.numerics.arguments import IntArray

Step = Callable[[float, float, float, float], float]  # takes a sample (u, y, t, r) and returns its error


def step_kernels(state: State, *, regular: bool) -> tuple[Kernel, Kernel]:
    """Return the step kernels for one sample and for many, which work on the same arrays; see `kernels.step`."""
    from replant.kernels.step import collecting, covariance, fixed_filter, gradient

    if state.collects:
        return collecting.step, collecting.steps
    if state.examines_output:
        return covariance.step, covariance.steps
    without_model = not (state.instruments or state.rests_with_input)
    strictly_proper = state.input_entries <= state.order
    if regular and without_model and strictly_proper and state.delay == 0.0:
        return fixed_filter.step, fixed_filter.steps
    return gradient.step, gradient.steps


def bound_step(state: State, kernel: Kernel, preprocess: Preprocess) -> tuple[Step, IntArray]:
    """Return a function of (u, y, t, r) that takes one sample of this state as ``kernel`` does, and its gate (1,).

    Where the input map is a Python function, which no kernel can call, it is called first.  As long as the gate is
    shut, as it is at first, the function raises Attention and takes nothing (see `replant.kernels.native`).
    """
    from replant.kernels.step.soundness import is_sound

    # a step looks at nothing by itself; kernels that take many samples look each time
    if not is_sound(*state.arrays):
        raise ValueError("the state is damaged: its arrays are not as long as its own numbers say")
    call, gate = library().step(kernel.name, state.arrays)
    if callable(preprocess.input_map):
        return lambda u, y, t, r: call(float(preprocess.call_map(np.array([u]))[0]), y, t, r), gate
    return call, gate
