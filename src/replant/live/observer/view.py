"""View: a running identification as people and pages see it; SessionInfo: the session's part of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.live.outputs.message import UNKNOWN


@dataclass(frozen=True)
class SessionInfo:
    """The session's part of a view: what the identifier does not know.

    Attributes
    ----------
    at : float
        Rig time of the newest sample in s.
    source, source_state : str
        The source's URL, and its state: "connecting", "connected", "waiting", "ended".
    counters : mapping
        The source's counters: malformed lines by reason, duplicates, lost, dropped, reconnects.
    rate : float
        Samples a second, over about the last second.
    lag : float
        Seconds from a sample's arrival until it was learned; the longest since the last handover.
    silence : float
        Seconds since a sample was accepted, once the time to live is over; else 0.
    """

    at: float = 0.0
    source: str = ""
    source_state: str = "connecting"
    counters: Mapping[str, int] = field(default_factory=dict)
    rate: float = 0.0
    lag: float = 0.0
    silence: float = 0.0


@dataclass(frozen=True)
class SignalNames:
    """Names of a rig's signals, with their units in brackets where known; of the input before its map.

    Attributes
    ----------
    input, output : str
    """

    input: str = "input"
    output: str = "output"


UNNAMED = SignalNames()


@dataclass(frozen=True, eq=False)
class Window:
    """The newest samples, thinned to their extremes, and the model's output simulated from the input alone.

    Attributes
    ----------
    t, u, y, model : (V,) arrays
        Rig time in s; mapped input, measured and modelled output, in their units; NaN where unknown.
    residual : (V,) array
        Measured minus modelled output; NaN for samples that are left out.
    left_out : (L, 2) array
        Begin and end, in rig time, of the stretches that verdict, fit and offset leave out: samples that were bridged
        or lie before the last interruption.
    r : (V,) or (0,) array
        Reference; empty where there is none.
    """

    t: FloatArray
    u: FloatArray
    y: FloatArray
    model: FloatArray
    residual: FloatArray
    left_out: FloatArray
    r: FloatArray


@dataclass(frozen=True, eq=False)
class Bode:
    """The frequency response with a band of two standard deviations around its magnitude.

    Attributes
    ----------
    omega : (F,) array
        In rad/s.
    magnitude_db, phase_deg, magnitude_low, magnitude_high : (F,) arrays
        Magnitude and its band in dB, phase in degrees; the band is NaN where it is not known.
    """

    omega: FloatArray
    magnitude_db: FloatArray
    phase_deg: FloatArray
    magnitude_low: FloatArray
    magnitude_high: FloatArray


@dataclass(frozen=True, eq=False)
class Step:
    """The step response with a band of two standard deviations.

    Attributes
    ----------
    t : (S,) array
        Time since the step in s, closer where a fast mode settles; empty where the response is not finite.
    y, low, high : (S,) arrays
        Output by a unit step of the mapped input, and its band; the band is NaN where it is not known.
    """

    t: FloatArray
    y: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class Truth:
    """The true plant of a simulated rig, at the frequencies and times of the estimate's responses.

    Attributes
    ----------
    parameters : (P,) array
        NaN for those that the plant does not have.
    poles, zeros : complex arrays
    magnitude_db, phase_deg : (F,) arrays
    step : (S,) array
    """

    parameters: FloatArray
    poles: npt.NDArray[np.complex128]
    zeros: npt.NDArray[np.complex128]
    magnitude_db: FloatArray
    phase_deg: FloatArray
    step: FloatArray


@dataclass(frozen=True, eq=False)
class Rows:
    """The estimate over the whole run, thinned.

    Attributes
    ----------
    t : (H,) array
        Rig time in s.
    parameters, std : (H, P) arrays
    """

    t: FloatArray
    parameters: FloatArray
    std: FloatArray


@dataclass(frozen=True, eq=False)
class View:
    """A running identification at one moment.

    Attributes
    ----------
    at : float
        Rig time of the newest sample in s.
    samples : int
        Accepted samples.
    rejected, counters : mapping
        Samples that the identifier rejected, and lines that the source refused, by reason.
    source, source_state : str
    rate, lag : float
        Samples a second; seconds from a sample's arrival until it was learned.
    silence : float
        See `SessionInfo`.
    status : {"starting", "running", "diverged"}
    adapting : bool
        Whether the estimate is updated; False while it is frozen.
    names : tuple of str
    parameters, std : (P,) arrays
        NaN where unknown.
    num, den : arrays
    delay : float
    poles : (n,) complex array
    pole_covariance : (n, 2, 2) array
        Covariance of each pole's real and imaginary part; NaN where unknown.
    zeros : (m,) complex array
    dc_gain, dc_gain_std : float
    verdict : str
    excited : bool
        See `Assessment`; False while the verdict is not known.
    reasons : tuple of str
    simulated : float
        Fit in percent of the model, simulated from the input alone, over those samples of the window that the verdict
        uses.
    residual_std : float
        Standard deviation of the residual by the noise model; NaN where there is none.
    input_label, output_label : str
        Names of the mapped input and of the output, with their units where known.
    window : Window
    bode : Bode
    step : Step
    truth : Truth or None
        None if the plant is not known.
    history : Rows
    model : mapping
        The model to be kept, as JSON; empty while there is none.
    """

    at: float
    samples: int
    rejected: Mapping[str, int]
    counters: Mapping[str, int]
    source: str
    source_state: str
    rate: float
    lag: float
    silence: float
    status: str
    adapting: bool
    names: tuple[str, ...]
    parameters: FloatArray
    std: FloatArray
    num: FloatArray
    den: FloatArray
    delay: float
    poles: npt.NDArray[np.complex128]
    pole_covariance: FloatArray
    zeros: npt.NDArray[np.complex128]
    dc_gain: float
    dc_gain_std: float
    verdict: str
    excited: bool
    reasons: tuple[str, ...]
    simulated: float
    residual_std: float
    input_label: str
    output_label: str
    window: Window
    bode: Bode
    step: Step
    truth: Truth | None
    history: Rows
    model: Mapping[str, Any]

    def unjudged(self, reason: str) -> View:
        """Return the view without a verdict, for a reason."""
        verdict = {"status": "converging", "excited": False, "reasons": [reason]}
        model = {**self.model, "verdict": verdict} if self.model else {}
        return replace(self, verdict=UNKNOWN, excited=False, reasons=(reason,), model=model)

    def to_json(self) -> dict[str, Any]:
        """Return the attributes as JSON values under their names; non-finite numbers are None, a root {real, imag}."""
        plain: dict[str, Any] = _plain(self)
        return plain


def _plain(value: Any) -> Any:
    """Return what JSON can hold."""
    if isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return [{"real": root.real, "imag": root.imag} for root in value.tolist()]
        if np.isfinite(value).all():
            return value.tolist()
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Window | Bode | Step | Truth | Rows | View):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    return value
