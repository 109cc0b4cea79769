"""View: the state of a running identification for terminal and dashboard; SessionInfo: the session's part of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.live.outputs.message import UNKNOWN
from replant.live.streams import Signals
from replant.numerics.arguments import FloatArray


@dataclass(frozen=True)
class SessionInfo:
    """The session's part of a view, which the identifier does not have."""

    at: float = 0.0  # rig time of the newest sample in s
    source: str = ""  # the source's URL
    source_state: str = "connecting"  # "connecting", "connected", "waiting" or "ended"
    # the source's counters: malformed lines by reason, duplicates, lost, dropped, reconnects
    counters: Mapping[str, int] = field(default_factory=dict)
    rate: float = 0.0  # samples a second, over about the last second
    lag: float = 0.0  # seconds from a sample's arrival until it was learned; the longest since the last handover
    silence: float = 0.0  # seconds since a sample was accepted, if longer than the time to live; else 0


#: Default names of a rig's signals, here without units; the input's name is that before its map.
UNNAMED = Signals(("input",), "output")


@dataclass(frozen=True, eq=False)
class Window:
    """The newest samples, thinned to their extremes, and the model's output simulated from the input alone."""

    # t, u, y, model: (V,): rig time in s; mapped input, measured and modelled output, in their units; NaN where unknown
    t: FloatArray
    u: FloatArray
    y: FloatArray
    model: FloatArray
    residual: FloatArray  # (V,): measured minus modelled output; NaN for samples that are left out
    # (L, 2): begin and end, in rig time, of the stretches that verdict, fit and offset leave out: bridged samples, and
    # samples before the last interruption
    left_out: FloatArray
    r: FloatArray  # (V,) or (0,): reference; empty if there is none


@dataclass(frozen=True, eq=False)
class Bode:
    """The frequency response with a band of two standard deviations around its magnitude."""

    # each (F,): rad/s, dB, degrees, and the band in dB, NaN if unknown
    omega: FloatArray
    magnitude_db: FloatArray
    phase_deg: FloatArray
    magnitude_low: FloatArray
    magnitude_high: FloatArray


@dataclass(frozen=True, eq=False)
class Step:
    """The step response with a band of two standard deviations."""

    t: FloatArray  # (S,): time since the step in s, denser while a fast mode settles; empty if y is not finite
    # y, low, high: (S,): response to a unit step of the mapped input, and its band; the band is NaN if unknown
    y: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class Truth:
    """The true plant of a simulated rig, at the frequencies and times of the estimate's responses."""

    parameters: FloatArray  # (P,): NaN if the plant has another structure
    poles: npt.NDArray[np.complex128]
    zeros: npt.NDArray[np.complex128]
    magnitude_db: FloatArray  # magnitude_db, phase_deg: (F,)
    phase_deg: FloatArray
    step: FloatArray  # (S,)


@dataclass(frozen=True, eq=False)
class Rows:
    """The estimate over the whole run, thinned."""

    t: FloatArray  # (H,): rig time in s
    parameters: FloatArray  # parameters, std: (H, P)
    std: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class FromInput:
    """The model from one input to the output, and its responses."""

    input_label: str  # name of the mapped input, with its unit if known
    num: FloatArray
    den: FloatArray
    delay: float
    poles: npt.NDArray[np.complex128]  # (n,)
    pole_covariance: FloatArray  # (n, 2, 2): covariance of each pole's real and imaginary part; NaN where unknown
    zeros: npt.NDArray[np.complex128]  # (m,)
    dc_gain: float
    dc_gain_std: float
    bode: Bode
    step: Step
    truth: Truth | None  # None if the plant is not known


@dataclass(frozen=True, eq=False, kw_only=True)
class FurtherInput(FromInput):
    """The model from a further input to the output, with the samples of that input."""

    u: FloatArray  # (V,): at the times of the window


@dataclass(frozen=True, eq=False, kw_only=True)
class View(SessionInfo, FromInput):
    """A running identification at one moment: the session's info and the identifier's state."""

    samples: int  # accepted samples
    rejected: Mapping[str, int]  # samples that the identifier rejected, by reason
    status: str  # {"starting", "running", "diverged"}
    adapting: bool  # whether the estimate is updated; False while it is frozen
    names: tuple[str, ...]
    parameters: FloatArray  # parameters, std: (P,): NaN where unknown
    std: FloatArray
    verdict: str
    excited: bool  # see `Assessment`; False while the verdict is unknown
    coefficients: bool  # whether the coefficients are known one by one, if the verdict is "trusted"
    reasons: tuple[str, ...]
    # fit in percent of the output simulated from the input alone, over the samples that the verdict uses
    simulated: float
    residual_std: float  # standard deviation of the residual by the noise model; NaN if there is none
    output_label: str  # name of the output, with its unit if known
    window: Window
    history: Rows
    model: Mapping[str, Any]  # the model to be kept, as JSON; empty while there is none
    more_inputs: tuple[FurtherInput, ...] = ()

    @property
    def inputs(self) -> tuple[FromInput, ...]:
        """The model from each input."""
        return self, *self.more_inputs

    def unjudged(self, reason: str) -> View:
        """Return the view with the verdict "unknown" and its reason."""
        verdict = {"status": "converging", "excited": False, "reasons": [reason]}
        model = {**self.model, "verdict": verdict} if self.model else {}
        return replace(self, verdict=UNKNOWN, excited=False, reasons=(reason,), model=model)

    def to_json(self) -> dict[str, Any]:
        """Return the attributes as JSON values; non-finite numbers become None, complex ones {real, imag}."""
        plain: dict[str, Any] = _plain(self)
        return plain


def _plain(value: Any) -> Any:
    """Convert a value to JSON types."""
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return [{"real": root.real, "imag": root.imag} for root in value.tolist()]
        return value.tolist() if np.isfinite(value).all() else _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if is_dataclass(value):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    return dict(value) if isinstance(value, Mapping) else value
