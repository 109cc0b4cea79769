"""View: what can be seen of a running identification, for people and pages; and Pulse, the session's part of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray


@dataclass(frozen=True)
class Pulse:
    """What the session knows and its identifier does not.

    Attributes
    ----------
    at : float
        Rig time of the newest sample in s.
    source, source_state : str
        The source's URL, and what it says of itself: "connecting", "connected", "waiting", "ended".
    counters : mapping
        What the source counted: malformed lines by reason, duplicates, lost, dropped, reconnects.
    rate : float
        Samples a second, over the last second or so.
    lag : float
        Seconds from a sample's arrival until it was learned; the longest since the pulse before.
    silence : float
        Seconds since a sample was accepted, once nothing may be trusted any more for want of one; else 0.
    """

    at: float = 0.0
    source: str = ""
    source_state: str = "connecting"
    counters: Mapping[str, int] = field(default_factory=dict)
    rate: float = 0.0
    lag: float = 0.0
    silence: float = 0.0


@dataclass(frozen=True, eq=False)
class Window:
    """The newest samples, thinned so that no peak is lost, and the model run over them from the input alone.

    Attributes
    ----------
    t, u, y, model : (V,) arrays
        Rig time in s; input behind its map, measured and modelled output, in their units; NaN where unknown.
    left_out : (L, 2) array
        From when to when, in rig time, samples take no part in verdict, fit and offset: bridged, or before the last
        interruption.
    """

    t: FloatArray
    u: FloatArray
    y: FloatArray
    model: FloatArray
    left_out: FloatArray


@dataclass(frozen=True, eq=False)
class Bode:
    """The frequency response with a band of two standard deviations around its magnitude.

    Attributes
    ----------
    omega : (F,) array
        In rad/s.
    magnitude_db, phase_deg, magnitude_low, magnitude_high : (F,) arrays
        The band in dB as well; NaN where it is not known.
    """

    omega: FloatArray
    magnitude_db: FloatArray
    phase_deg: FloatArray
    magnitude_low: FloatArray
    magnitude_high: FloatArray


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
    """What can be seen of a running identification at one moment.

    Attributes
    ----------
    at : float
        Rig time of the newest sample in s.
    samples : int
        Accepted samples.
    rejected, counters : mapping
        Samples that the identifier, and lines that the source, did not take, by reason.
    source, source_state : str
    rate, lag : float
        Samples a second; seconds from a sample's arrival until it was learned.
    silence : float
        See `Pulse`.
    status : {"starting", "running", "diverged"}
    adapting : bool
        Whether the estimate follows the samples, or is frozen.
    names : tuple of str
    parameters, std : (P,) arrays
        NaN where unknown.
    num, den : arrays
    delay : float
    poles : (n,) complex array
    pole_covariance : (n, 2, 2) array
        Of each pole's real and imaginary part; NaN where unknown.
    zeros : (m,) complex array
    dc_gain, dc_gain_std : float
    verdict : str
    reasons : tuple of str
    simulated : float
        Fit in percent over the window, the model run from the input alone: over the samples that the verdict stands
        on.
    window : Window
    bode : Bode
    history : Rows
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
    reasons: tuple[str, ...]
    simulated: float
    window: Window
    bode: Bode
    history: Rows

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and numbers under these very names; what is not finite is None, a root {real, imag}."""
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
    if isinstance(value, Window | Bode | Rows | View):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    return value
