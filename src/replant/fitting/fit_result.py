"""FitResult: the result of `fit`, its model and verdict, and the use of a reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.record import Record
from replant.estimation.filters import Filter, StateVariableFilter
from replant.estimation.solver.record_changes import plant_changed
from replant.estimation.solver.refined_estimate import Refined
from replant.fitting.model import Model, in_lines, with_picture
from replant.fitting.model_fields import Identified, Provenance, has_rest
from replant.fitting.other_causes import judged_further
from replant.kernels.schema import LAGUERRE
from replant.model.noise import NoiseModel
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, IntArray, vector
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import chi2_quantile, quiet, sum_of_squares
from replant.verdict import Assessment, Simulation, assess_record
from replant.verdict.assess import MOST_SAMPLES
from replant.verdict.evidence import CONSTANT
from replant.verdict.loop import COPIED, Reference
from replant.verdict.other_columns import OtherColumn, other_columns

WITHOUT = "the fit does without it"


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(Identified):
    """The result of `fit`.

    Attributes
    ----------
    structure : Structure
    dt : float
        Sampling time in s.
    method : str
        "srivc" or "least_squares".
    filter : StateVariableFilter or RefinedFilter
        The filter used, chosen from the record or given.
    preprocess : Preprocess
        Input map and working point used, the latter as numbers.
    parameters : (P,) array
        In physical units, in the order of ``structure.names``.
    covariance : (P, P) array or None
        Of the parameters; None for least squares, which noise biases.
    condition : float
        Condition number of the scaled regressors; infinite if the input does not excite every parameter.
    one_step : float
        Fit in percent of the output predicted one step ahead: by (8), or with "srivc" by the free run and an
        autoregression of its residual.
    simulation : Simulation
        The free run from the input alone, with offset and initial state estimated.  For an unstable model, which would
        run away, the output predicted one step ahead: the one that makes the residual A/D y - B/D u zero, where D is A
        with its unstable poles reflected.
    samples : int
        Samples used.
    rejected : dict
        Number of samples left out, by reason.
    noise : NoiseModel or None
        The autoregression of the residual; None for least squares.
    reference : ReferenceUse or None
        The use of the reference; None if none was given.
    outliers : (N,) array of int
        Indices of the outputs that were left out as outliers.
    stuck : (N,) array of int
        Indices of the outputs that were left out because the sensor was stuck, or at its limit.
    missing : (N,) array of int
        Indices of the samples without an output, whose input was used.
    loads : (N,) array of int
        Indices of the samples at which another load begins, with new offset and initial state.
    rival : FitResult or None
        A division of the record that speaks against this fit: another G(s), with loads, that explains the record
        better, but not surely; or parts between which the plant changes.
    record : Record or None
        The prepared record that the verdict uses, with the model's outputs in place of those left out.
    means : tuple of two floats
        Of the mapped input and of the output, over samples where both can be used.
    input_level : float
        The mapped input that is zero in ``record``.
    filtered : bool
        Whether the model was found with the noise model as a filter.
    disagreement : float
        See `replant.estimation.solver.refined_estimate.Refined.disagreement`.
    slowness : float
        See `replant.estimation.solver.refined_estimate.Refined.slowness`.
    usual_interval : float or None
        Median interval of the time stamps in s; None for a regular clock.
    others : mapping of str to (K,) array
        Further columns of the file, over the samples of the record.
    input_name, output_name : str
        Names of the signals, with their units in brackets at the end.
    source, sha256 : str
        Name and digest of the log's file, if there is one.
    """

    structure: Structure
    dt: float
    method: str
    filter: Filter
    preprocess: Preprocess
    parameters: FloatArray
    covariance: FloatArray | None
    condition: float
    one_step: float
    simulation: Simulation
    samples: int
    rejected: dict[str, int]
    noise: NoiseModel | None = None
    reference: ReferenceUse | None = None
    outliers: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    stuck: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    missing: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    loads: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    rival: FitResult | None = None
    record: Record | None = None
    means: tuple[float, float] = (0.0, 0.0)
    input_level: float = 0.0
    filtered: bool = False
    disagreement: float = 0.0
    slowness: float = 1.0
    usual_interval: float | None = None
    others: Mapping[str, FloatArray] = field(default_factory=dict)
    input_name: str = "u"
    output_name: str = "y"
    source: str = ""
    sha256: str = ""

    @property
    def _kept(self) -> Record:
        assert self.record is not None, "`fit` keeps the record"
        return self.record

    @cached_property
    def verdict(self) -> Assessment:
        """Whether to trust the model, why in plain words, and the figures behind it."""
        change, loaded = None, self.rival or self
        parted = loaded._kept
        if self.method == "srivc":
            loads = loaded.loads.size > 0
            change = plant_changed(self.structure, parted, loaded.parameters, loads=loads, most=MOST_SAMPLES)
        verdict = assess_record(
            self.structure,
            self.parameters,
            self._kept,
            self.dt,
            self.covariance,
            instruments=self.method != "least_squares",
            usual_interval=self.usual_interval,
            filtered=self.filtered,
            disagreement=self.disagreement,
            slowness=self.slowness,
            input_zero=-self.input_level,
            left_out=self.stuck.size,
            plant_change=change,
            loads=tuple(parted.since_first(begin) for begin in parted.begins) if loaded.loads.size else (),
            undecided=self.rival is not None,
        )
        verdict = judged_further(
            verdict, self.structure, self.parameters, self.covariance, self._kept, self.input_level, self.other_columns
        )
        finding = self.reference.finding if self.reference else ""
        if not finding or any(finding.partition(":")[0] in reason for reason in verdict.reasons):
            return verdict
        return replace(verdict, reasons=(*verdict.reasons, finding))

    @cached_property
    def other_columns(self) -> tuple[OtherColumn, ...]:
        """The further columns that explain a part of the residual, the largest part first."""
        return other_columns(self.structure, self.parameters, self._kept, self.dt, self.others)

    @cached_property
    def model(self) -> Model:
        """G(s) with working point, names, uncertainty, fit and verdict."""
        entered, given = self.working_point
        return Model(
            self.structure,
            self.parameters,
            self.dt,
            covariance=self.covariance,
            noise=self.noise,
            input_hold=self.filter.input_hold,
            input_map=self.preprocess.input_map,
            input_level=entered,
            output_level=given,
            input_name=self.input_name,
            output_name=self.output_name,
            simulated_fit=self.simulation.fit,
            one_step_fit=self.one_step,
            rejected=tuple(self.rejected.items()),
            verdict=self.verdict,
            provenance=Provenance(self.method, self.source, self.sha256, self.samples),
        )

    @property
    def working_point(self) -> tuple[float, float]:
        """Levels of the mapped input and of the output about which G(s) acts: a point of rest, or the means."""
        if not self.simulation.is_prediction and has_rest(self.transfer_function, self._kept.span):
            return float(self.preprocess.input_offset), self.simulation.offset
        return self.means

    def bridged(self, y: FloatArray) -> FloatArray:
        """Return an output (K,) with the model's in place of outputs that were left out, as the fit used it."""
        rows = np.concatenate([self.outliers, self.stuck, self.missing])
        y = vector("y", y).copy()
        if y.size != self.simulation.output.size:
            raise InvalidArgumentError(
                f"y must be the output of the record, {self.simulation.output.size} samples long, got {y.size}"
            )
        y[rows] = self.simulation.output[rows]
        return y

    @property
    def has_model(self) -> bool:
        """Whether G(s) tells anything; of a constant input its coefficients are those of the noise."""
        return CONSTANT not in self.verdict.reasons

    def __repr__(self) -> str:
        reasons = self.verdict.reasons
        return in_lines("FitResult", self.model, self.samples, reasons, has_model=self.has_model)

    def _repr_html_(self) -> str:
        return with_picture(self.model)

    @property
    def fixed_filter(self) -> StateVariableFilter:
        """The filter used; 1/A of the result if it was the refined filter."""
        return self.filter.fixed_at(self.transfer_function.den, self.dt)


@dataclass(frozen=True, eq=False)
class ReferenceUse:
    """The use of a reference in a fit."""

    signal: FloatArray  # (K,): as it was given
    used: bool  # whether instruments were made from it
    finding: str  # a line about what is wrong with it; empty if nothing is
    explained: float  # share of the input's power that it explains
    # J, the power that it explains of the whitened residual, over its variance: chi-square for a right model; else NaN
    misfit: float = math.nan
    degrees: int = 0  # of freedom of J

    @property
    def misfit_limit(self) -> float:
        """The value that J of a right model exceeds with a chance of 1e-4; NaN if the reference was not used."""
        return float(chi2_quantile(1.0 - ALPHA, self.degrees)) if self.degrees > 0 else math.nan

    def concluded(self, structure: Structure, found: Refined) -> ReferenceUse:
        """Return the use with the results of the fit."""
        if not self.used:
            return self
        degrees = max(LAGUERRE - structure.coefficients, 0)  # the constant counts on both sides
        return replace(self, explained=found.explained, misfit=found.misfit, degrees=degrees)


@quiet
def use_of(signal: FloatArray, record: Record) -> ReferenceUse:
    """Return whether a record's reference can be used, and if not why."""
    r, u = record.r, record.u
    assert r is not None
    found, fault = Reference.tried(r, u, record.y)
    if found is None:
        return ReferenceUse(signal, False, f"{fault}: {WITHOUT}", 1.0 if fault == COPIED else 0.0)
    share = sum_of_squares(found.input) / max(float(np.sum((u - u.mean()) ** 2)), np.finfo(float).tiny)
    return ReferenceUse(signal, not fault, f"{fault}: {WITHOUT}" if fault else "", share)
