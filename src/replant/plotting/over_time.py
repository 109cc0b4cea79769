"""Plots over time: signals thinned without loss of peaks, and panels of curves, for pictures and pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.numerics.arguments import FloatArray
from replant.plotting.style import FARTHEST, MODEL, MUTED, SIGMAS, label_time, say, tidy, title


@dataclass(frozen=True, eq=False)
class Thinned:
    """A signal thinned to evenly spaced points, whose positions are counted in samples of the whole signal."""

    values: FloatArray  # (V,): NaN where the signal has no finite value
    first: float  # first, step: position of the first point and distance of the points, in samples
    step: float

    @property
    def places(self) -> FloatArray:
        """Position (V,) of each point in samples; a fraction lies between two samples."""
        return np.asarray(self.first + self.step * np.arange(self.values.size))

    def among(self, t: FloatArray) -> FloatArray:
        """Return the time (V,) of each point in a signal with samples at the times ``t`` (K,), evenly spaced or not."""
        if not t.size:
            return self.values
        last = float(t[-1] - t[-2]) if t.size > 1 else 0.0
        beyond = last * np.maximum(self.places - (t.size - 1), 0.0)
        return np.asarray(np.interp(self.places, np.arange(t.size), t) + beyond)

    def indices(self, length: int) -> npt.NDArray[np.intp]:
        """Return the index (V,) of the sample nearest below each point, in the signal of ``length`` samples."""
        return np.minimum(self.places.astype(np.intp), length - 1)


def thin(signal: FloatArray, points: int) -> Thinned:
    """Thin ``signal`` (K,) to at most ``points`` points: the extremes of each stretch, in their order."""
    thinner = Thinner(signal.size, points)
    thinner.take(signal)
    return thinner.thinned


class Thinner:
    """`thin` for a signal of ``length`` samples that comes in batches."""

    def __init__(self, length: int, points: int) -> None:
        self._width = 1 if length <= points else -(-length // max(1, points // 2))
        self._rest, self._parts = np.empty(0), [np.empty(0)]

    def take(self, signal: FloatArray) -> None:
        """Take the next samples (K,)."""
        if self._width == 1:
            self._parts.append(np.where(np.isfinite(signal), signal, np.nan))
            return
        known = np.concatenate([self._rest, signal])
        whole = known.size // self._width * self._width
        self._parts.append(_extremes(known[:whole].reshape(-1, self._width)))
        self._rest = known[whole:].copy()

    @property
    def thinned(self) -> Thinned:
        """The signal so far, thinned."""
        if self._width == 1:
            return Thinned(np.concatenate(self._parts), 0.0, 1.0)
        last = np.full(self._width if self._rest.size else 0, np.nan)
        last[: self._rest.size] = self._rest
        values = np.concatenate([*self._parts, _extremes(last.reshape(-1, self._width))])
        return Thinned(values, 0.25 * self._width, 0.5 * self._width)


def _extremes(rows: FloatArray) -> FloatArray:
    """Return the smallest and the largest finite value of each row, in their order, as (2 R,)."""
    missing = ~np.isfinite(rows)
    least, greatest = np.where(missing, np.inf, rows), np.where(missing, -np.inf, rows)
    places = np.sort(np.stack([least.argmin(axis=1), greatest.argmax(axis=1)]), axis=0)
    values = np.take_along_axis(rows, places.T, axis=1).ravel()
    values[~np.isfinite(values)] = np.nan
    return np.asarray(values)


POINTS = 36_000  # most points of a signal: 2,000 columns zoomed nine-fold lose nothing [count]
SHOWN = 3_000  # most points of a curve; a longer one is drawn as minimum and maximum of each stretch [count]
SHOWN_SMALL = 1_000  # the same for a panel of half the width [count]


@dataclass(frozen=True, eq=False)
class Curve:
    """A signal over time."""

    t: FloatArray  # (V,): in s
    values: FloatArray  # (V,): NaN where the curve is interrupted
    label: str
    colour: str = MODEL
    std: FloatArray | None = None  # (V,): standard deviations, drawn as a band; NaN if unknown
    band: str = ""  # the band's label
    kind: str = "line"  # {"line", "step", "constant", "dot"}
    width: float = 1.4
    dashes: Any = "solid"


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves on common axes."""

    label: str
    curves: Sequence[Curve]
    ends: tuple[float, float] = (0.0, 1.0)  # range of time in s
    limits: tuple[float, float] | None = None
    name: str = ""  # its name in a page
    words: str = ""  # a text in place of curves
    is_log: bool = False
    has_zero: bool = False  # whether a line is drawn at 0
    left_out: FloatArray | None = None  # (L, 2): stretches in s that are shaded
    gaps: FloatArray | None = None  # (G,): times in s through which no line runs


def constant(value: float, label: str, colour: str = MODEL, dashes: Any = "solid", width: float = 1.4) -> Curve:
    """Return a horizontal line."""
    return Curve(np.zeros(1), np.full(1, value), label, colour, kind="constant", width=width, dashes=dashes)


def draw_panels(axes: Sequence[Any], panels: Sequence[Panel], points: int = SHOWN, *, titled: bool = False) -> Any:
    """Draw each panel into its axes, labelled at the side or titled; label the time below.  Return the axes."""
    for axis, panel in zip(axes, panels, strict=True):
        draw_panel(axis, panel, points)
        title(axis, panel.label) if titled else axis.set_ylabel(panel.label)
    label_time(axes)
    return np.array(axes, dtype=object)


def draw_panel(axis: Any, panel: Panel, points: int = SHOWN) -> None:
    """Draw a panel without its label."""
    if panel.is_log:
        axis.set_yscale("log")
    tidy(axis)
    if panel.ends[0] != panel.ends[1]:  # a single frequency has no range
        axis.set_xlim(*panel.ends)
    if panel.words:
        say(axis, panel.words)
        return
    if panel.limits is not None:
        axis.set_ylim(*panel.limits)  # first, so that the curves do not rescale the axis
    if panel.left_out is not None and len(panel.left_out):
        spans = [(begin, end - begin) for begin, end in panel.left_out.tolist()]
        across = axis.get_xaxis_transform()
        axis.broken_barh(spans, (0.0, 1.0), transform=across, color=MUTED, alpha=0.22, lw=0, label="left out", zorder=0)
    for curve in panel.curves:
        _draw(axis, curve, panel.gaps, points)
    if panel.has_zero:
        axis.axhline(0.0, color=MUTED, lw=0.8)


def _draw(axis: Any, curve: Curve, gaps: FloatArray | None, points: int) -> None:
    look: Any = {"color": curve.colour, "ls": curve.dashes, "lw": curve.width, "label": curve.label or None}
    values = np.clip(curve.values, -FARTHEST, FARTHEST)
    if curve.kind == "constant":
        axis.axhline(float(values[0]), **look)
        return
    begin = int(np.isfinite(values).argmax()) if values.size else 0
    t, values = curve.t[begin:], values[begin:]
    if curve.std is not None and np.isfinite(curve.std).any():
        half = SIGMAS * np.minimum(np.where(np.isfinite(curve.std), curve.std, np.nan), FARTHEST)[begin:]
        low, high = (thin(values + sign * half, points // 2) for sign in (-1.0, 1.0))
        look_of_band: Any = {"alpha": 0.22, "label": curve.band} if curve.band else {"alpha": 0.13}
        axis.fill_between(low.among(t), low.values, high.values, color=curve.colour, lw=0, **look_of_band)
    if curve.kind == "dot":
        look |= {"marker": "o", "clip_on": False}
    drawn = thin(values, points)
    t, values = drawn.among(t), drawn.values
    if gaps is not None and gaps.size:
        places = np.searchsorted(t, gaps)
        t, values = np.insert(t, places, gaps), np.insert(values, places, np.nan)
    axis.plot(t, values, drawstyle="steps-post" if curve.kind == "step" else "default", **look)
