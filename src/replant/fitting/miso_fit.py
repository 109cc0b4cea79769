"""fit with several inputs: a row of transfer functions to one output, each with its own poles and dead time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.estimation.simulation.miso import Row, RowRecord
from replant.fitting.miso_model import RowModel, one_step_percent
from replant.fitting.miso_solve import RowSolution, held, references_of
from replant.fitting.model_fields import Provenance, unnamed
from replant.fitting.parted_record import solve_parted_row
from replant.fitting.samples import Samples
from replant.kernels.schema import Doubt
from replant.logs.log import without_added
from replant.model.noise import NoiseModel
from replant.model.preprocess import accepted, check_moves, screen
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.numerics.arguments import FloatArray, IntArray, array_of_reals, iterable, vector
from replant.numerics.limits import duration, increasing
from replant.numerics.linear_algebra import quiet
from replant.verdict import fit_percent
from replant.verdict.miso_tests import judged, left_out
from replant.verdict.sensor_and_excitation import left_out_finding
from replant.verdict.verdict import Verdict


@dataclass(frozen=True, eq=False, repr=False)
class RowFit:
    r"""The result of `fit` with several inputs.

    .. math:: y = \sum_i \frac{B_i(s)}{A_i(s)} e^{-s\,\mathrm{delay}_i} u_i + \mathrm{offset} + \mathrm{noise}

    Attributes
    ----------
    model : RowModel
        Each G(s), working point, names, joint uncertainty, noise model, fit and verdict.
    output : (K,) array
        Simulated from the inputs alone, offset and initial states estimated; NaN where an input cannot be used, or the
        output depends on inputs before the record or in a gap.
    outliers, stuck, missing : (N,) arrays of int
        Outputs that were left out: outliers, those of a sensor that is stuck or at its limit, missing ones.
    loads : (N,) array of int
        Samples at which another load begins, with new offset and initial states.
    """

    model: RowModel
    output: FloatArray
    outliers: IntArray
    stuck: IntArray
    missing: IntArray
    loads: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def transfer_functions(self) -> tuple[TransferFunction, ...]:
        """G(s) from each input."""
        return self.model.transfer_functions

    @property
    def parameters(self) -> FloatArray:
        """In physical units (P,): a_{n-1} .. a_0, b_m .. b_0 of the first input, then of the next."""
        return self.model.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in their order, each with that of its input."""
        return self.model.names

    @property
    def covariance(self) -> FloatArray:
        """Of the parameters (P, P), jointly."""
        assert self.model.covariance is not None, "a fit has a covariance"
        return self.model.covariance

    @property
    def uncertainty(self) -> tuple[Uncertainty, ...]:
        """Standard deviations of each G(s): of its parameters, poles, gain and response."""
        assert self.model.uncertainty is not None, "a fit has a covariance"
        return self.model.uncertainty

    @property
    def noise(self) -> NoiseModel:
        """The autoregression of the residual; white if the noise model was rejected, see `verdict`."""
        assert self.model.noise is not None, "a fit has a noise model"
        return self.model.noise

    @property
    def fit(self) -> float:
        """Fit of ``output`` in percent."""
        return self.model.simulated_fit

    @property
    def samples(self) -> int:
        """Number of outputs used."""
        return self.model.provenance.samples

    @property
    def rejected(self) -> dict[str, int]:
        """How many samples were left out, by reason."""
        return dict(self.model.rejected)

    @property
    def verdict(self) -> Verdict:
        """Whether to trust the row, and why in plain words."""
        return self.model.verdict

    def _repr_html_(self) -> str:
        return self.model._repr_html_()

    def __repr__(self) -> str:
        pairs = zip(self.model.input_names, self.transfer_functions, strict=True)
        head = f"RowFit of {self.samples} samples, fit {self.fit:.2f} %, {self.verdict.status}"
        reasons = (f"  {reason}" for reason in self.verdict.reasons)
        return "\n".join([head, *(f"  {name}: {g}" for name, g in pairs), *reasons])


def is_row(given: Samples, *orders: Any) -> bool:
    """Return whether a row is asked for: by columns of u, by a log with several inputs, or by an entry for each."""
    columns = isinstance(given.u, np.ndarray) and given.u.ndim == 2
    return columns or bool(given.more_inputs) or any(isinstance(each, tuple) for each in orders)


def ready_row(
    given: Samples, poles: Any, zeros: Any, delay: Any
) -> tuple[RowRecord, tuple[Structure, ...], FloatArray | None, dict[str, int]]:
    """Return the prepared record of a row, its structures, references (J, p), and rejected samples by reason."""
    columns = columns_of(given.inputs)
    output, dt = vector("y", given.y), duration("dt", given.dt)
    if output.size != len(columns):
        raise InvalidArgumentError(f"u has {len(columns)} rows and y {output.size} samples: give one row for each")
    structures = structures_of(columns.shape[1], poles, zeros, delay)
    stamps = None if given.t is None else increasing(given.t, output.size)
    references = references_of(given.references, output.size)
    check_numbers(given, columns, output, references)
    if references is not None:
        output = np.where(np.isfinite(references).all(axis=1), output, np.nan)
    rejected = without_added(screen(np.abs(columns).max(axis=1), output)[1], "not finite", given.added)
    ready = RowRecord.of(columns, output, dt, stamps, given.input_hold, given.begins)
    record, longest = ready.record, max(each.delay for each in structures)
    size = sum(each.size + each.poles for each in structures) + 1
    is_long = record.count > size
    if is_long and not longest < record.span:
        raise InvalidArgumentError(
            f"the dead time of {longest:g} s is no shorter than the record, which lasts {record.span:.6g} s"
        )
    count = Row(structures, record, ready.inputs).count if is_long else record.count
    if count <= size:
        where = " after the dead time and gaps" if is_long else ""
        raise InvalidArgumentError(
            f"the record has {count} usable samples{where}, fewer than the {size + 1} that {size} unknowns need: "
            "record more, or ask for fewer poles and zeros"
        )
    return ready, structures, None if references is None else held(references[ready.used]), rejected


def check_numbers(given: Samples, columns: FloatArray, output: FloatArray, references: FloatArray | None) -> None:
    """Raise an InvalidArgumentError that names a signal without usable numbers, or whose squares leave float64."""
    names = given.input_names or unnamed(columns.shape[1])
    signals = [
        *zip((f"input {name}" for name in names), columns.T, strict=True),
        (f"output {given.output_name}", output),
    ]
    if references is not None:
        named = (given.reference_name, *given.more_references) if given.more_references else ()
        words = [f"reference {name}" for name in named or range(1, references.shape[1] + 1)]
        signals += zip(words if words[1:] else ["reference"], references.T, strict=True)
    for name, signal in signals:
        if signal.size and not accepted(signal)[1].any():
            raise InvalidArgumentError(f"{name} has no number that can be used: leave it out, or give one that has")
        check_moves(name, signal)


@quiet
def fit_row(given: Samples, poles: Any, zeros: Any = 0, delay: Any = 0.0) -> RowFit:
    """Return the fit of a row to samples of several inputs, see `replant.fitting.fit.fit`."""
    ready, structures, references, rejected = ready_row(given, poles, zeros, delay)
    names = given.input_names or unnamed(len(structures))
    ready, solution, findings, loads, _ = solve_parted_row(structures, ready, references, names)
    if solution is None:
        raise InvalidArgumentError("no model is found for this record: the inputs hardly move, or the output does not")
    row, found, doubt = solution
    rest = {name: signal[ready.used] for name, signal in given.unused.items()}
    others = [
        *findings,
        *left_out(row, found.point, found.noise, rest),
        *left_out_finding(int((doubt == Doubt.STUCK).sum())),
    ]
    verdict = judged(row, found.point, found.noise, found.covariance, found.findings, others)
    made = Provenance("srivc", given.source, given.sha256, row.count)
    output = vector("y", given.y)
    fitted = row_fit(solution, ready, output, ready.record.usual, verdict, made, rejected, given.output_name)
    return replace(fitted, loads=np.flatnonzero(ready.used)[list(loads)])


def row_fit(
    solution: RowSolution,
    ready: RowRecord,
    output: FloatArray,
    dt: float,
    verdict: Verdict,
    made: Provenance,
    rejected: dict[str, int],
    output_name: str = "y",
) -> RowFit:
    """Return the fit of a solution of a record, given the measured output (K,), with the samples that were left out."""
    row, found, doubted = solution
    point, noise = found.point, found.noise
    doubt = np.full(output.size, Doubt.MISSING)
    doubt[ready.used] = doubted
    outliers, stuck = (np.flatnonzero(doubt == each) for each in (Doubt.OUTLIER, Doubt.STUCK))
    missing = np.flatnonzero((doubt == Doubt.MISSING) & ready.used)
    simulated, left = ready.simulated(row, point, noise), max(row.count - point.theta.size - row.nuisances, 1)
    levels, level = ready.levels(row, point)
    model = RowModel(
        row.structures,
        point.theta,
        dt,
        covariance=found.covariance,
        noise=NoiseModel(noise.coefficients, point.cost / left, point.power / left, dt),
        input_hold=row.record.input_hold,
        input_names=row.names,
        output_name=output_name,
        input_levels=levels,
        output_level=level,
        simulated_fit=fit_percent(ready.explained(row, output), simulated),
        one_step_fit=one_step_percent(row, point),
        rejected=tuple((rejected | {"outlier": outliers.size, "stuck": stuck.size}).items()),
        verdict=verdict,
        provenance=made,
    )
    return RowFit(model, simulated, outliers, stuck, missing)


def structures_of(inputs: int, poles: Any, zeros: Any, delay: Any) -> tuple[Structure, ...]:
    """Return the structure of each of several inputs; a single number of zeros or dead time holds for all.

    >>> structures_of(2, (2, 1), 0, (0.0, 0.3))[1].delay
    0.3
    """
    if not iterable(poles):
        there = "is 1 input" if inputs == 1 else f"are {inputs} inputs"
        raise InvalidArgumentError(f"there {there}: give the number of poles of each, poles={(1,) * inputs}")
    given = {"poles": poles, "zeros": zeros, "delay": delay}
    each: dict[str, list[Any]] = {k: list(v) if iterable(v) else [v] * inputs for k, v in given.items()}
    for name, values in each.items():
        if len(values) != inputs:
            raise InvalidArgumentError(
                f"{name} has {len(values)} {'entry' if len(values) == 1 else 'entries'} and u {inputs} "
                f"{'input' if inputs == 1 else 'inputs'}: give one entry for each"
            )
    structures = tuple(Structure(*values) for values in zip(*each.values(), strict=True))
    total = sum(structure.poles for structure in structures)
    if total > Structure.MOST_POLES:
        raise InvalidArgumentError(f"poles must be at most {Structure.MOST_POLES} in all, got {total}")
    return structures


def columns_of(u: Any) -> FloatArray:
    """Return several inputs, checked, as columns (K, q)."""
    columns = np.asarray(array_of_reals("u", u), np.float64)
    if columns.ndim != 2 or not columns.shape[1]:
        raise InvalidArgumentError(
            f"u must have a column for each input, shape (K, q), got shape {shown(columns.shape)}"
        )
    return columns
