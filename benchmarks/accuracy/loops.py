"""Plants under a controller: their records, and the estimator that knows the controller.

y = G (u + d) + v at the samples, y sampled before u is set, u held from then on; u = C (F r - y) with a reference that
enters as the set-point (F = 1) or at the plant's input (F = 1 / C).  Everything is linear, so u and y are filtered from
r, d and v by the polynomials of the closed loop; plants are discretised by SciPy, not by what is measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import replant as rp
from accuracy.methods import Figures
from accuracy.records import Measured
from replant.numerics.arguments import FloatArray
from replant.signals import prbs

Polynomials = tuple[FloatArray, FloatArray]  # numerator and denominator, in powers of 1/z

SETTLE = 500  # samples of coloured noise before a record


@dataclass(frozen=True)
class Controller:
    """kp + ki / s + kd s / (tf s + 1), its integral by forward, its derivative by backward differences."""

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    tf: float = 0.0

    def discretised(self, dt: float) -> Polynomials:
        """Return C(z)."""
        num, den = np.array([self.kp]), np.ones(1)
        slow = self.tf / (self.tf + dt)
        lag = self.kd / (self.tf + dt)
        for gain, top, bottom in (
            (self.ki, [0.0, self.ki * dt], [1.0, -1.0]),
            (self.kd, [lag, -lag], [1.0, -slow]),
        ):
            if gain:
                num = _sum(np.convolve(num, bottom), np.convolve(den, top))
                den = np.convolve(den, bottom)
        return num, den


@dataclass(frozen=True)
class Disturbance:
    """White noise behind a filter in 1/z, each value held for ``held`` samples.

    Attributes
    ----------
    num, den : tuple of float
    decibels : float
        Its standard deviation at the output lies so far below that of the loop without it: as it is where it enters at
        the output, in closed loop where it enters at the plant's input.
    at_input : bool
    held : int
        The first value is cut at another place each run.
    """

    num: tuple[float, ...]
    den: tuple[float, ...]
    decibels: float
    at_input: bool = False
    held: int = 1

    def drawn(self, generator: np.random.Generator, samples: int) -> FloatArray:
        """Return it before it is scaled (K,)."""
        from scipy.signal import lfilter

        if self.held == 1:
            return np.asarray(lfilter(self.num, self.den, generator.standard_normal(samples + SETTLE))[SETTLE:])
        first = int(generator.integers(self.held))
        steps = lfilter(self.num, self.den, generator.standard_normal(samples // self.held + 2))
        return np.repeat(steps, self.held)[first : first + samples]


@dataclass(frozen=True)
class Loop:
    """Makes the records of a plant under a controller.

    Attributes
    ----------
    plant : TransferFunction
        Strictly proper; its dead time is a multiple of ``dt``.
    dt : float
    controller : Controller
    hold : int
        Samples that the reference is held.
    disturbances : tuple of Disturbance
    seeds : tuple of int
        With the run's number they make its seed.
    samples : int
    bits : int
        Of the pseudorandom binary sequence that the reference is; 0: uniform between -1 and 1, another one each run.
    at_input : bool
        Whether the reference is added to the controller's output; else it is the set-point.
    analogue : bool
        Whether the controller (PI) works between the samples as well, its input y and v held; r at the plant's input.
    """

    plant: rp.TransferFunction
    dt: float
    controller: Controller
    hold: int
    disturbances: tuple[Disturbance, ...]
    seeds: tuple[int, ...]
    samples: int = 4000
    bits: int = 0
    at_input: bool = False
    analogue: bool = False

    @property
    def truth(self) -> FloatArray:
        """The plant's coefficients, as `Structure` orders them."""
        return np.concatenate([self.plant.den[1:], self.plant.num])

    def __call__(self, run: int) -> Measured:
        """Return the record of a run."""
        generator = np.random.default_rng([run, *self.seeds])
        silent = np.zeros(self.samples)
        r = self.reference(generator)
        respond = self.between_samples if self.analogue else self.respond
        _, clean = respond(r, silent, silent)
        at_input, at_output = silent, silent
        for each in self.disturbances:
            w = each.drawn(generator, self.samples)
            reach = respond(silent, w, silent)[1].std() if each.at_input else w.std()
            w = w * clean.std() * 10.0 ** (-each.decibels / 20.0) / reach
            at_input, at_output = (at_input + w, at_output) if each.at_input else (at_input, at_output + w)
        u, y = respond(r, at_input, at_output)
        return Measured(u, y, r=r)

    def reference(self, generator: np.random.Generator) -> FloatArray:
        """Return r (K,)."""
        if self.bits:
            return prbs(self.samples, bits=self.bits, hold=self.hold)
        levels = generator.uniform(-1.0, 1.0, self.samples // self.hold + 1)
        return np.repeat(levels, self.hold)[: self.samples]

    def respond(
        self, r: FloatArray, d: FloatArray, v: FloatArray, plant: rp.TransferFunction | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return u and y (K,), from rest: of this loop, or with another plant in it."""
        b, a = discretised(plant or self.plant, self.dt)
        top, bottom = self.controller.discretised(self.dt)
        forward = bottom if self.at_input else top
        closed = _sum(np.convolve(a, bottom), np.convolve(b, top))
        u = _filtered(closed, (a, forward, r), (-b, top, d), (-a, top, v))
        return u, _filtered(closed, (b, forward, r), (b, bottom, d), (a, bottom, v))

    def between_samples(self, r: FloatArray, d: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return u and y (K,) of a controller in continuous time, r, d and v being held: exact, sample by sample."""
        from scipy.linalg import expm
        from scipy.signal import tf2ss

        assert self.at_input
        assert self.plant.delay == 0.0
        a, b, c, _ = tf2ss(self.plant.num, self.plant.den)
        n, kp, ki = a.shape[0], self.controller.kp, self.controller.ki
        block = np.zeros((n + 4, n + 4))  # the plant's states, the integral of y + v, and r, d, v
        block[:n, :n], block[:n, n : n + 1] = a - kp * b @ c, -ki * b
        block[:n, n + 1 :] = b * np.array([1.0, 1.0, -kp])
        block[n, :n], block[n, n + 3] = c[0], 1.0
        step = expm(block * self.dt)[: n + 1]
        state, held = np.zeros(n + 1), np.column_stack([r, d, v])
        states = np.empty((r.size, n + 1))
        for k in range(r.size):
            states[k] = state
            state = step[:, : n + 1] @ state + step[:, n + 1 :] @ held[k]
        y = states[:, :n] @ c[0] + v
        return r - kp * y - ki * states[:, n], y


@dataclass(frozen=True)
class KnowsTheController:
    """The anchor: output error of the whole loop, begun at the truth, whitened by an autoregression of order 8.

    y is compared with what r makes of the loop, the controller being known; consistent for every disturbance that does
    not depend on r, and close to the least variance that u, y, r and the controller allow.
    """

    loop: Loop
    order: int = 8

    def __call__(self, structure: rp.Structure, dt: float, measured: Measured) -> Figures:
        """Return the coefficients with their standard deviations."""
        from scipy.optimize import least_squares
        from scipy.signal import lfilter

        assert measured.r is not None
        r, y, silent, n = measured.r, measured.y, np.zeros(measured.y.size), structure.poles
        whitening = np.ones(1)

        def left(theta: FloatArray) -> FloatArray:
            plant = rp.TransferFunction(theta[n:], np.concatenate([[1.0], theta[:n]]), self.loop.plant.delay)
            with np.errstate(over="ignore", invalid="ignore"):
                return y - self.loop.respond(r, silent, silent, plant)[1]

        def residual(theta: FloatArray) -> FloatArray:
            e = lfilter(whitening, [1.0], left(theta))
            return np.where(np.abs(e) < UNUSABLE, e, UNUSABLE)  # of a loop that the trial makes unstable

        theta = self.loop.truth
        size = np.maximum(np.abs(theta), 0.1)
        for _ in range(2):
            found = least_squares(residual, theta, x_scale=size, max_nfev=25)
            theta, whitening = found.x, whitening_filter(left(found.x), self.order)
        rest = residual(theta)
        slopes = np.column_stack([(residual(theta + h) - rest) / h.sum() for h in 1e-5 * np.diag(size)])
        std = np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)) * rest.var())
        return dict(zip(structure.names, zip(theta.tolist(), std.tolist(), strict=True), strict=True))


UNUSABLE = 1e6  # takes the place of residuals beyond


def whitening_filter(e: FloatArray, order: int) -> FloatArray:
    """Return 1, d1 .. of the autoregression of a residual, by Yule and Walker."""
    from scipy.linalg import solve_toeplitz

    e = e - e.mean()
    products = np.array([e[: e.size - lag] @ e[lag:] for lag in range(order + 1)]) / e.size
    column = products[:-1].copy()
    column[0] *= 1.0 + 1e-9
    return np.concatenate([[1.0], solve_toeplitz(column, -products[1:])])


def discretised(plant: rp.TransferFunction, dt: float) -> Polynomials:
    """Return the plant behind a zero-order hold, in powers of 1/z."""
    from scipy.signal import cont2discrete

    num, den, _ = cont2discrete((plant.num, plant.den), dt)
    lost = round(plant.delay / dt)
    assert abs(lost * dt - plant.delay) < 1e-9 * dt
    return np.concatenate([np.zeros(lost), num.ravel()]), den


def _filtered(closed: FloatArray, *parts: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
    """Return the sum of the signals, each filtered by the product of its two polynomials over ``closed``."""
    from scipy.signal import lfilter

    return np.asarray(sum(lfilter(np.convolve(p, q), closed, signal) for p, q, signal in parts if signal.any()))


def _sum(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the sum of two polynomials in 1/z."""
    size = max(p.size, q.size)
    return np.pad(p, (0, size - p.size)) + np.pad(q, (0, size - q.size))
