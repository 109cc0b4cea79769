"""fit: the transfer function of a whole record, by refined instrumental variables or least squares."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, overload

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.record import Record
from replant.estimation.filters import Filter, RefinedFilter, StateVariableFilter
from replant.estimation.settings import AUTO, Request
from replant.estimation.simulation.model_run import prediction_error, runs_away
from replant.estimation.solver.least_squares import choose_filter, least_squares, regressors
from replant.estimation.solver.solve import Solution, solve
from replant.fitting.fit_result import WITHOUT, FitResult, ReferenceUse, use_of
from replant.fitting.miso_fit import RowFit, fit_row
from replant.fitting.parted_record import rival_of, solve_parted
from replant.fitting.samples import RawRecord, Samples
from replant.fitting.several_outputs import MatrixFit, are_rows, samples_of_outputs, solved_rows
from replant.kernels.schema import Doubt
from replant.model.interop import in_our_words
from replant.model.noise import NoiseModel
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, one_of
from replant.numerics.linear_algebra import combined, quiet
from replant.verdict import Simulation, fit_percent, simulate
from replant.verdict.evidence import CONSTANT, is_constant

METHODS = (AUTO, "srivc", "least_squares")


@overload
def fit(
    u: Any, y: Any = None, dt: float | None = None, structure: None = None, *, poles: tuple[int, ...],
    zeros: int | tuple[int, ...] = 0, delay: float | tuple[float, ...] = 0.0, t: Any = None, reference: Any = None,
) -> RowFit: ...  # fmt: skip


@overload
def fit(
    u: Any, y: Any = None, dt: float | None = None, structure: Structure | None = None, *, poles: int | None = None,
    zeros: int = 0, delay: float = 0.0, method: str = AUTO, filter: Filter | str = AUTO,
    preprocess: Preprocess | None = None, t: Any = None, reference: Any = None, input: str | None = None,
    output: str | None = None,
) -> FitResult: ...  # fmt: skip


@in_our_words
@quiet
def fit(
    u: Any,
    y: Any = None,
    dt: float | None = None,
    structure: Structure | None = None,
    *,
    poles: int | tuple[int, ...] | None = None,
    zeros: int | tuple[int, ...] = 0,
    delay: float | tuple[float, ...] = 0.0,
    method: str = AUTO,
    filter: Filter | str = AUTO,  # noqa: A002 - the field's word
    preprocess: Preprocess | None = None,
    t: Any = None,
    reference: Any = None,
    input: str | Sequence[str] | None = None,  # noqa: A002 - the field's word
    output: str | Sequence[str] | None = None,
) -> FitResult | RowFit | MatrixFit:
    r"""Fit G(s) to a whole record.

    "srivc" is refined instrumental variables, see `replant.estimation.solver.srivc`: consistent under noise of any
    colour, has no discretisation error, and gives a covariance; the plant need not be stable.  If a controller makes
    the input, it is consistent with a reference; without one, if the noise model is right.  "least_squares" minimises
    the equation error
    :math:`\sum_k (y(t_k) - \theta_\lambda^T \varphi_{uy}(t_k))^2`, as the article does for its Table 6.  Measurement
    noise biases it, because the regressor contains the noisy output.

    With several inputs, the columns of ``u``, each has its own poles and dead time: an entry of ``poles`` for each.
    The row of transfer functions is found by maximum likelihood, with one noise model and one covariance.  With several
    outputs, the columns of ``y``, each has such a row, estimated by itself.

    Parameters
    ----------
    u : (K,) array, Log, list of Log, or table
        Raw input, or (K, q) of q inputs; or a log with input, output and sampling time; or several logs of one rig,
        which give one model.
    y : (K,) array
        Output; samples that are not finite are left out.  Or (K, p) of p outputs.
    dt : float
        Sampling time in s; without it, the usual interval of ``t``.
    structure : Structure
        Or ``poles``, ``zeros`` and ``delay`` in its place.
    poles, zeros : int or tuple of int
        Number of poles and of zeros; with several inputs an entry for each.  With several outputs, the same for all, or
        a tuple for each output.
    delay : float or tuple of float
        Dead time in s.
    method : {"auto", "srivc", "least_squares"}
        "auto" is "srivc", and least squares if that finds no model, for example if the input hardly moves.
    filter : StateVariableFilter, RefinedFilter or "auto"
        "srivc" uses only its `input_hold`, the input between samples; "auto" is that of the log, and "zoh" for
        arrays.  Least squares needs a StateVariableFilter; "auto" tries a range of cutoffs and takes the one
        whose model simulates the record best.
    preprocess : Preprocess
        Input map and working point, by default the means of a log, and 0 for arrays.  "srivc" estimates the offset of
        the output in any case.
    t : (K,) array, optional
        Time stamps in s, or dates, strictly increasing, of an irregular clock; for "srivc".
    reference : (K,) array, optional
        If a controller makes the input: the set-point or a dither, any external signal that is independent of the
        disturbances; for "srivc".  The unit does not matter.  A sample whose reference is not finite is left out.  Or
        (K, p) of p references, with several inputs: an input that none of them moves, or that does not respond to
        disturbances, counts as external.
    input, output : str, optional
        Columns, several as a list, of a table of pandas or polars, which is given in place of ``u``; ``t`` and
        ``reference``, of several a list, may name columns, too.  It is read as `read_log` reads a file of its columns;
        without ``t`` and ``dt`` the index may be the clock.

    Returns
    -------
    FitResult, RowFit or MatrixFit
        The model with its fits, verdict and settings; a RowFit of several inputs, a MatrixFit of several outputs.

    Raises
    ------
    ArgumentTypeError
        If an argument is missing or of the wrong type.
    InvalidArgumentError
        If the record is too short for the parameters, "srivc" finds no model, or an argument is not valid.

    References
    ----------
    Bernat and Kolota (2023), section 4; Garnier and Wang (2008), "Identification of Continuous-time Models from
    Sampled Data", chapters 1 and 4.

    Examples
    --------
    >>> from replant import TransferFunction
    >>> true = TransferFunction([2.0], [1.0, 0.5])
    >>> u = np.where(np.arange(400) // 50 % 2 == 0, 1.0, -1.0)
    >>> found = fit(u, true.simulate(u, dt=0.1), dt=0.1, poles=1)
    >>> print(found.transfer_function, found.verdict.status)
    2 / (s + 0.5) trusted

    Two inputs, the second with a dead time:

    >>> second = TransferFunction([1.0], [1.0, 3.0], delay=0.3)
    >>> both = np.column_stack([u, np.where(np.arange(400) // 30 % 2 == 0, 1.0, -1.0)])
    >>> row = fit(both, true.simulate(u, 0.1) + second.simulate(both[:, 1], 0.1), 0.1, poles=(1, 1), delay=(0.0, 0.3))
    >>> print(*row.transfer_functions, row.verdict.status, sep=", ")
    2 / (s + 0.5), 1 / (s + 3) exp(-0.3 s), trusted
    """
    outputs = samples_of_outputs(u, y, dt, t, reference, input, output)
    orders: dict[str, Any] = {"poles": poles, "zeros": zeros, "delay": delay}
    not_yet = {
        "structure": structure is not None, "method": method != AUTO, "filter": filter != AUTO,
        "preprocess": preprocess is not None,
    }  # fmt: skip
    if are_rows(outputs, not_yet, *orders.values()):
        return solved_rows(outputs, orders, lambda given, asked: fit_row(given, **asked))
    return fit_samples(outputs[0], Structure.wanted(structure, **orders), method, filter, preprocess)


def fit_samples(
    given: Samples, structure: Structure, method: str, chosen: Filter | str, preprocess: Preprocess | None
) -> FitResult:
    """Return the fit of a structure to samples, see `fit`."""
    preprocess = given.preprocess if preprocess is None else preprocess
    method = one_of("method", method, METHODS)
    dt = Request(structure, given.dt, filter=chosen, preprocess=preprocess).dt
    hold = given.input_hold if isinstance(chosen, str) else chosen.input_hold
    if given.reference is not None and method == "least_squares":
        raise InvalidArgumentError("least_squares makes no use of a reference: leave it out, or use method='srivc'")
    raw, r, rejected = given.checked(structure, dt, hold, preprocess)
    use = None
    if method != "least_squares":
        use = None if r is None else use_of(r, raw.made_ready(r))
        solution = _solution(raw, r if use is None or use.used else None)
        if solution is None and use is not None:
            reason = use.finding or f"no model was found with the reference: {WITHOUT}"
            use = dataclasses.replace(use, used=False, finding=reason)
            solution = _solution(raw, None)
        if solution is not None:
            use = None if use is None else use.concluded(structure, solution.found)
            whole = _refined_result(raw, given, solution, rejected, use)
            return whole if given.begins or whole.reference is not None else _parted(whole, raw, solution, given)
        if method == "srivc" or raw.stamps is not None:  # least squares needs a regular clock
            why = "the input hardly moves, or the structure does not fit the plant"
            why = CONSTANT if is_constant(raw.mapped[raw.known]) else why
            raise InvalidArgumentError(f"srivc finds no model for this record: {why}")
    if raw.stamps is not None:
        raise InvalidArgumentError(
            "least_squares needs a regular clock: use the method srivc, or give the sampling time (dt, --dt) and no "
            "time stamps if they are only jitter"
        )
    if not isinstance(chosen, StateVariableFilter):
        chosen = choose_filter(structure, dt, raw.preprocess, raw.u, raw.y, input_hold=hold)
    raw = dataclasses.replace(raw, input_hold=chosen.input_hold)
    return _least_squares_result(raw, given, chosen, rejected, use)


def _parted(whole: FitResult, raw: RawRecord, solution: Solution, given: Samples) -> FitResult:
    """Return the fit of a record divided at its loads if that is surely right, and trusted; else the one given."""
    rows = np.flatnonzero(raw.made_use_of)

    def with_loads(loads: tuple[int, ...]) -> RawRecord:
        return dataclasses.replace(raw, loads=tuple(rows[list(loads)].tolist()))

    def refined(loads: tuple[int, ...], solution: Solution) -> FitResult:
        return _refined_result(with_loads(loads), given, solution, rejected, None)

    @cache
    def solved(loads: tuple[int, ...]) -> Solution | None:
        return _solution(with_loads(loads), None)

    rejected = {name: count for name, count in whole.rejected.items() if name not in ("outlier", "stuck")}
    found = solve_parted(raw.structure, solution, solved)
    if found.loads and found.solution is not None and found.is_sure:
        parted = refined(found.loads, found.solution)
        if parted.verdict.status == "trusted":
            return parted
    # if a division may be right, and speaks against the fit that was given, that must not be trusted
    rival = rival_of(raw.structure, solution, found, solved)
    return whole if rival is None else dataclasses.replace(whole, rival=refined(rival.loads, rival.solution))


def _result(raw: RawRecord, given: Samples, record: Record, use: ReferenceUse | None, **found: Any) -> FitResult:
    """Return a result with the record that its verdict uses, and the names of its signals."""
    if use is not None and record.r is None:
        record = dataclasses.replace(record, r=raw.made_ready(use.signal).r)
    record = dataclasses.replace(record, rest=0 if given.begins else given.rest)
    used = raw.usable
    return FitResult(
        raw.structure, raw.dt, preprocess=raw.preprocess, reference=use, record=record,
        means=(float(raw.mapped[used].mean()), float(raw.y[used].mean())) if used.any() else (0.0, 0.0),
        input_level=raw.input_level(record), loads=np.array(raw.loads, np.int64),
        usual_interval=None if raw.stamps is None else float(np.median(np.diff(raw.stamps))),
        others={name: signal[raw.made_use_of] for name, signal in given.others.items()},
        input_name=given.input_name, output_name=given.output_name, source=given.source, sha256=given.sha256, **found,
    )  # fmt: skip


def _solution(raw: RawRecord, r: FloatArray | None) -> Solution | None:
    return solve(raw.structure, raw.made_ready(r), nested=True)


def _refined_result(
    raw: RawRecord, given: Samples, solution: Solution, rejected: dict[str, int], use: ReferenceUse | None
) -> FitResult:
    structure, found, size = raw.structure, solution.found, raw.structure.size
    doubt = np.full(raw.u.size, Doubt.MISSING)
    doubt[raw.made_use_of] = solution.doubt
    used = doubt == Doubt.NONE
    measured, y = np.where(raw.usable, raw.y, np.nan), np.where(used, raw.y, np.nan)
    model = structure.transfer_function(found.theta[:size])
    error = None
    if runs_away(model.den, solution.record.span):
        error = prediction_error(structure, found.theta[:size], solution.record, raw.dt)
    if error is None:
        simulation = raw.simulated(model, y)
    else:
        output = measured.copy()
        output[raw.made_use_of] -= error
        simulation = Simulation(output, 0.0, fit_percent(y, output), is_prediction=True)
    answers = np.ones(raw.u.size, bool)  # outputs that depend on inputs before the record are in no fit
    answers[raw.made_use_of] = solution.record.answers(structure.delay)
    outliers, stuck = (np.flatnonzero(doubt == each) for each in (Doubt.OUTLIER, Doubt.STUCK))
    return _result(
        raw, given, solution.record, use, method="srivc", filter=RefinedFilter(raw.input_hold),
        parameters=found.theta[:size], covariance=found.covariance[:size, :size], condition=found.condition(size),
        one_step=raw.fit(y, raw.one_step(np.where(answers, y, np.nan) - simulation.output)), simulation=simulation,
        samples=int(used.sum()), rejected=rejected | {"outlier": outliers.size, "stuck": stuck.size},
        noise=NoiseModel.of_slots(found.noise, raw.dt), outliers=outliers, stuck=stuck,
        missing=np.flatnonzero((doubt == Doubt.MISSING) & raw.made_use_of), filtered=found.noise.filters > 0.0,
        disagreement=found.disagreement, slowness=found.slowness,
    )  # fmt: skip


def _least_squares_result(
    raw: RawRecord, given: Samples, chosen: StateVariableFilter, rejected: dict[str, int], use: ReferenceUse | None
) -> FitResult:
    structure, accepted = raw.structure, raw.usable
    y = np.where(accepted, raw.y, np.nan)
    phi, target = regressors(structure, raw.dt, chosen, raw.preprocess, raw.u, y)
    solution = least_squares(phi, target)
    model = structure.transfer_function(solution.parameters)
    linear_input = np.where(accepted, raw.mapped - float(raw.preprocess.input_offset), np.nan)
    return _result(
        raw, given, raw.made_ready(None), use, method="least_squares", filter=chosen, parameters=solution.parameters,
        covariance=None, condition=solution.condition if solution.rank == structure.size else math.inf,
        one_step=fit_percent(y, y - (target - combined(phi, solution.parameters))),
        simulation=simulate(model, linear_input, y, raw.dt, input_hold=chosen.input_hold),
        samples=int(accepted.sum()), rejected=rejected,
    )  # fmt: skip
