"""Samples of several outputs, or of one: the same way for `fit`, `search` and `run`; and the row of each."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.fitting.miso_fit import RowFit, columns_of, is_row
from replant.fitting.samples import Samples, is_frame
from replant.fitting.several_outputs import MatrixFit, outputs_of
from replant.logs.log import Log, check_one_reference
from replant.numerics.arguments import array_of_reals, iterable

Beside = TypeVar("Beside", Log, Samples)


def samples_of_outputs(
    u: Any,
    y: Any,
    dt: float | None,
    t: Any,
    reference: Any,
    input: Any = None,  # noqa: A002 - the word of `fit`
    output: Any = None,
) -> list[Samples]:
    """Return the samples of each output: of each column of y, or of each column of a table that a list names."""
    if is_frame(u) and isinstance(output, list | tuple) and output:
        each = [Samples.of(u, y, dt, t, reference, input, name) for name in output]
        if len({one.output_name for one in each}) < len(each):
            raise InvalidArgumentError(f"name each column once, got {', '.join(map(shown, output))}")
        return [without_outputs(one, output) for one in each]
    if not (isinstance(y, np.ndarray) and y.ndim == 2 and y.shape[1] > 1):
        return [Samples.of(u, y, dt, t, reference, input, output)]
    each = [Samples.of(u, column, dt, t, reference, input, output) for column in outputs_of(y)]
    return [replace(one, output_name=f"y{number}") for number, one in enumerate(each, 1)]


def without_outputs(given: Beside, names: Collection[str]) -> Beside:
    """Return a log or samples beside which no other output stands: that is no column to explain it."""
    return replace(given, others={name: each for name, each in given.others.items() if name not in names})


def are_rows(outputs: list[Samples], not_yet: dict[str, bool], *orders: Any) -> bool:
    """Return whether several outputs or inputs are asked for, and refuse what they do not take yet."""
    if len(outputs) == 1 and not is_row(outputs[0], *orders):
        r = outputs[0].references
        check_one_reference(r.shape[1] if isinstance(r, np.ndarray) and r.ndim == 2 else 1)
        return False
    for name, is_given in not_yet.items():
        if is_given:
            several = "outputs" if len(outputs) > 1 else "inputs"
            raise InvalidArgumentError(f"several {several} take no {name} yet: leave it out")
    return True


def solved_rows(
    outputs: list[Samples], orders: dict[str, Any], solve: Callable[[Samples, dict[str, Any]], RowFit]
) -> RowFit | MatrixFit:
    """Return the row of each output by itself; ``orders`` are those of all outputs, or a tuple for each."""
    if len(outputs) == 1:
        return solve(outputs[0], orders)
    rows = []
    for number, given in enumerate(outputs):
        own = {name: of_output(name, each, number, len(outputs)) for name, each in orders.items()}
        samples = in_columns(given)
        if columns_of(samples.inputs).shape[1] == 1 and not iterable(own["poles"]):
            own["poles"] = (own["poles"],)
        rows.append(solve(samples, own))
    return MatrixFit(tuple(rows))


def in_columns(given: Samples) -> Samples:
    """Return the same samples, an array of one input as a column."""
    if given.is_log:
        return given
    inputs = np.asarray(array_of_reals("u", given.u), np.float64)
    return replace(given, u=inputs[:, None] if inputs.ndim == 1 else inputs)


def of_output(name: str, given: Any, number: int, count: int) -> Any:
    """Return poles, zeros or dead times of one output: those of all, or its own of a tuple for each."""
    if not (iterable(given) and any(map(iterable, given))):
        return given
    if len(given) != count:
        raise InvalidArgumentError(
            f"{name} has {len(given)} tuples and y {count} outputs: give one for each, or one for all"
        )
    return given[number]
