"""Several outputs of the same inputs: the samples and the row of each, the matrix of rows; and `load_model`."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, ModelFileError, shown
from replant.fitting import model_file, model_json
from replant.fitting.miso_fit import RowFit, columns_of, is_row
from replant.fitting.miso_model import RowModel, number_of
from replant.fitting.model import Model
from replant.fitting.model_file import AnyPath
from replant.fitting.samples import Samples
from replant.fitting.validation import Validation
from replant.logs.arrays import labels_of
from replant.logs.log import Log, check_one_reference
from replant.model import interop
from replant.model.interop import without_unit
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray, array_of_reals, is_frame, iterable, no_output
from replant.plotting.diagrams import ABOVE_LEGEND
from replant.plotting.style import axes_for, title
from replant.verdict.verdict import Verdict


@dataclass(frozen=True, repr=False)
class MatrixModel(model_file.Written):
    r"""An identified plant of several outputs: a `RowModel` of each, over the same inputs.

    .. math:: y_k = \mathrm{output\_level}_k + \sum_i G_{ki}(s)\,(u_i - \mathrm{input\_levels}_i)

    Parameters
    ----------
    rows : tuple of RowModel
        Of the same inputs and sampling time, with outputs of different names.

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        If the rows do not belong together.

    Examples
    --------
    >>> from replant import Structure
    >>> rows = [RowModel((Structure(1),) * 2, [1.0, 2.0, 3.0, k], dt=0.1, output_name=f"y{k}") for k in (1, 2)]
    >>> model = MatrixModel(rows)
    >>> print(model.transfer_functions[1][1])
    2 / (s + 3)
    >>> model.simulate([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]]).round(4)
    array([[0.    , 0.    ],
           [0.    , 0.    ],
           [0.1903, 0.1903]])
    """

    LAYOUT = model_json.OF_OUTPUTS

    rows: tuple[RowModel, ...]

    def __post_init__(self) -> None:
        rows = tuple(self.rows) if iterable(self.rows) else ()
        if not rows or not all(isinstance(row, RowModel) for row in rows):
            raise ArgumentTypeError(f"rows must be a RowModel for each output, got {shown(self.rows)}")
        for name in ("input_names", "dt", "input_hold"):
            given = [getattr(row, name) for row in rows]
            if any(each != given[0] for each in given):
                raise InvalidArgumentError(f"rows must have the same {name}, got {shown(given)}")
        names = [row.output_name for row in rows]
        if len(set(names)) != len(names):
            raise InvalidArgumentError(f"rows must have outputs of different names, got {shown(names)}")
        object.__setattr__(self, "rows", rows)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.rows[0].input_names

    @property
    def input_name(self) -> tuple[str, ...]:
        """The same, by the name that `Model` uses."""
        return self.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(row.output_name for row in self.rows)

    @property
    def output_name(self) -> tuple[str, ...]:
        """The same, by the name that `Model` uses."""
        return self.output_names

    @property
    def dt(self) -> float:
        """Sampling time in s of the record that the model was made from."""
        return self.rows[0].dt

    @property
    def transfer_functions(self) -> tuple[tuple[TransferFunction, ...], ...]:
        """G(s), a tuple for each output with one from each input."""
        return tuple(row.transfer_functions for row in self.rows)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether to trust each row, and why in plain words."""
        return tuple(row.verdict for row in self.rows)

    def of_output(self, which: int | str) -> RowModel:
        """Return the row of an output, by its name or its number from 0; InvalidArgumentError for any other."""
        return self.rows[number_of(which, self.output_names)]

    def simulate(self, u: Any, t: Any = None) -> FloatArray:
        """Return the outputs (K, p) from the inputs ``u`` (K, q) alone, in absolute units; see `RowModel.simulate`."""
        return np.column_stack([row.simulate(u, t) for row in self.rows])

    def validate(self, log: Log | Any, y: Any = None, t: Any = None) -> tuple[Validation, ...]:
        """Compare each row with another record; see `RowModel.validate`.

        Parameters
        ----------
        log : Log or (K, q) array
            The record, with the outputs by their names in its output and ``others``; or its inputs.
        y : (K, p) array, optional
            The measured outputs, where ``log`` is an array.
        t : (K,) array, optional
            Time stamps in s, where ``log`` is an array.

        Returns
        -------
        tuple of Validation
            One for each output.

        Raises
        ------
        InvalidArgumentError
            If the number of columns is wrong, the log lacks an output or input, or the record is too short.
        """
        if isinstance(log, Log):
            return tuple(row.validate(with_output(log, row.output_name), y, t) for row in self.rows)
        if y is None:
            raise no_output(log, "the inputs and the outputs")
        columns = outputs_of(y)
        if len(columns) != len(self.rows):
            raise InvalidArgumentError(f"y must have a column for each of {len(self.rows)} outputs, got {len(columns)}")
        return tuple(row.validate(log, each, t) for row, each in zip(self.rows, columns, strict=True))

    def plot(self, axes: Any = None) -> Any:
        """Draw the matrix of step responses, into p q ``axes`` if given; return axes (p, q) of matplotlib.

        `RowModel.plot` has Bode diagrams.
        """
        p, q = len(self.rows), len(self.input_names)
        size = 1.0 + 3.4 * q, 0.6 + 2.6 * p
        grid = np.reshape(axes_for("axes", axes, p * q, size, nrows=p, ncols=q), (p, q))
        for row, line in zip(self.rows, grid, strict=True):
            for number, name in enumerate(self.input_names):
                row.of_input(number).step().plot(line[number])
                title(line[number], f"{name} → {row.output_name}", ABOVE_LEGEND)
        return grid

    def to_control(self, pade: int | None = None) -> Any:
        """Return the matrix as `control.TransferFunction` of p outputs, q inputs; see `TransferFunction.to_control`."""
        return interop.control_matrix([[g.to_control(pade) for g in row] for row in self.transfer_functions])

    def _as_object(self) -> dict[str, Any]:
        return model_json.rows_object(self.rows)

    @classmethod
    def _of_object(cls, read: Any) -> Self:
        model_json.check_layout(read, cls.LAYOUT)
        return cls(tuple(RowModel._of_object(row) for row in model_json.entry(read, "rows", list)))

    def _repr_html_(self) -> str:
        return "".join(row._repr_html_() for row in self.rows)

    def __repr__(self) -> str:
        return "\n".join([f"<MatrixModel of {len(self.rows)} outputs:", *map(repr, self.rows)]) + ">"


@dataclass(frozen=True, eq=False, repr=False)
class MatrixFit:
    """The result of `fit` with several outputs: each row is estimated by itself, on the same inputs.

    Parameters
    ----------
    rows : tuple of RowFit
        One for each output.
    """

    rows: tuple[RowFit, ...]

    @property
    def model(self) -> MatrixModel:
        """The models of all rows."""
        return MatrixModel(tuple(row.model for row in self.rows))

    @property
    def transfer_functions(self) -> tuple[tuple[TransferFunction, ...], ...]:
        """G(s), a tuple for each output with one from each input."""
        return self.model.transfer_functions

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether to trust each row, and why in plain words."""
        return self.model.verdicts

    @property
    def output(self) -> FloatArray:
        """Simulated outputs (K, p)."""
        return np.column_stack([row.output for row in self.rows])

    def _repr_html_(self) -> str:
        return self.model._repr_html_()

    def __repr__(self) -> str:
        return "\n".join(f"{row.model.output_name}: {row!r}" for row in self.rows)


def outputs_of(y: Any) -> list[FloatArray]:
    """Return the columns of outputs (K, p)."""
    columns = np.asarray(array_of_reals("y", y), np.float64)
    if columns.ndim != 2 or not columns.shape[1]:
        raise InvalidArgumentError(f"y must have a column for each output, shape (K, p), got {shown(columns.shape)}")
    return [column.copy() for column in columns.T]


def with_output(log: Log, name: str) -> Log:
    """Return a log whose output is the signal of this name."""
    signals = {log.output_name: log.output, **log.others}
    found = next((each for each in signals if without_unit(each) == without_unit(name)), name)
    if found not in signals or found in log.more_inputs:
        rest = ", ".join(each for each in signals if each not in log.more_inputs)
        raise InvalidArgumentError(
            f"the log has no output {name}, but {rest}: add it to others, or give arrays, model.validate(u, y)"
        )
    return replace(log, output=signals[found], output_name=found)


def load_model(path: AnyPath) -> Model | RowModel | MatrixModel:
    """Return the model in a file that ``save`` of a model or ``--save`` has written.

    Parameters
    ----------
    path : path
        Of the JSON file.

    Returns
    -------
    Model, RowModel or MatrixModel
        A RowModel of several inputs, a MatrixModel of several outputs.

    Raises
    ------
    ModelFileError
        If the file cannot be read, holds no model, or is of a newer version.

    Examples
    --------
    >>> load_model("no-such-file.json")
    Traceback (most recent call last):
    replant.errors.ModelFileError: no-such-file.json: no such file
    """
    written = model_file.read(path)
    try:
        with model_json.in_one_line():
            read = model_json.parsed(written)
            layout = model_json.layout_of(read)
            return next(kind for kind in (Model, RowModel, MatrixModel) if layout == kind.LAYOUT)._of_object(read)
    except ModelFileError as error:
        raise ModelFileError(f"{path}: {error}") from error


Beside = TypeVar("Beside", Log, Samples)


def samples_of_outputs(
    u: Any, y: Any, dt: float | None, t: Any, reference: Any, named: Any, output: Any
) -> list[Samples]:
    """Return the samples of each output: of each column of y, or of each column of a table that a list names.

    ``named``, ``output``: the columns of a table, see `replant.fit`.
    """
    if is_frame(u) and isinstance(output, list | tuple) and output and output not in labels_of(u):
        each = [Samples.of(u, y, dt, t, reference, named, name) for name in output]
        names = {one.output_name for one in each}
        if len(names) < len(each):
            raise InvalidArgumentError(f"name each column once, got {', '.join(map(shown, output))}")
        return [without_outputs(one, names) for one in each]
    for name, each in (("u", u), ("y", y)):
        if isinstance(each, np.ndarray) and each.ndim == 2 and each.shape[0] < each.shape[1]:
            raise InvalidArgumentError(
                f"{name} has a row for each sample and a column for each signal, got shape {each.shape}; "
                f"give the transpose, {name}.T"
            )
    if isinstance(y, np.ndarray) and y.ndim == 2 and y.shape[1] == 1:
        y = y[:, 0]
    if not (isinstance(y, np.ndarray) and y.ndim == 2):
        return [Samples.of(u, y, dt, t, reference, named, output)]
    each = [Samples.of(u, column, dt, t, reference, named, output) for column in outputs_of(y)]
    return [replace(one, output_name=f"y{number}") for number, one in enumerate(each, 1)]


def without_outputs(given: Beside, names: Collection[str]) -> Beside:
    """Return a log or samples without other outputs among the columns that may explain the output."""
    return replace(given, others={name: each for name, each in given.others.items() if name not in names})


def are_rows(outputs: list[Samples], not_yet: dict[str, bool], *orders: Any) -> bool:
    """Return whether several outputs or inputs are asked for; refuse arguments that these do not take yet."""
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
        own = {
            name: own_of(name, each, number, len(outputs), "tuples and y {} outputs") for name, each in orders.items()
        }
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


def own_of(name: str, given: Any, number: int, count: int, words: str) -> Any:
    """Return poles, zeros or dead times of one signal: those for all signals, or its own item of a list for each."""
    is_list = isinstance(given, list | tuple | np.ndarray) and iterable(given)
    if not (is_list and any(map(iterable, given))):
        return given
    if len(given) != count:
        raise InvalidArgumentError(f"{name} has {len(given)} {words.format(count)}: give one for each, or one for all")
    return given[number]
