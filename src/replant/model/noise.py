"""NoiseModel: the autoregression of a model's residual, and its spectrum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.kernels.schema import NoiseSlots
from replant.numerics.arguments import FloatArray, array_of_reals, keep, not_negative
from replant.numerics.arguments import coefficients as checked
from replant.numerics.limits import duration
from replant.numerics.linear_algebra import quiet


@dataclass(frozen=True, eq=False)
class NoiseModel:
    r"""The model :math:`e_k + d_1 e_{k-1} + \ldots + d_p e_{k-p} = w_k` of the residual e of G(s), w white.

    The residual is the output less the response of G(s) to the input.  For an unstable G = B/A it is A/D y - B/D u,
    where D is A with its unstable roots reflected: the noise filtered by an all-pass.

    Parameters
    ----------
    coefficients : (p + 1,) array
        1, d_1 .. d_p; p = 0 for white noise.
    variance : float
        Variance of the innovation w, in the output's unit squared.
    residual_variance : float
        Variance of the residual e, in the same unit.
    dt : float
        Sampling time in s.

    Examples
    --------
    >>> noise = NoiseModel(np.array([1.0, -0.9]), variance=0.19, residual_variance=1.0, dt=0.1)
    >>> noise.order, noise.spectrum([0.0, 10.0]).round(4)
    (1, array([1.9   , 0.0227]))
    """

    coefficients: FloatArray
    variance: float
    residual_variance: float
    dt: float

    def __post_init__(self) -> None:
        keep(self, "coefficients", checked)
        keep(self, "variance", not_negative)
        keep(self, "residual_variance", not_negative)
        keep(self, "dt", duration)
        if self.coefficients[0] != 1.0:
            raise InvalidArgumentError(f"coefficients must begin with 1, got {shown(self.coefficients.tolist())}")

    @property
    def order(self) -> int:
        """Number of past residuals that predict the next one: 0 for white noise."""
        return self.coefficients.size - 1

    @property
    def is_white(self) -> bool:
        """Whether past residuals do not predict the next one."""
        return self.order == 0

    @quiet
    def spectrum(self, frequency: Sequence[float] | FloatArray) -> FloatArray:
        r"""Return the power spectral density at each ``frequency`` omega in rad/s, in the output's unit squared per Hz.

        It is two-sided, :math:`\Phi(\omega) = \sigma_w^2\, dt / |D(e^{i \omega dt})|^2`: its integral from -1/(2 dt) to
        1/(2 dt) Hz is the variance of the residual.
        """
        shift = np.exp(-1j * array_of_reals("frequency", frequency) * self.dt)
        return np.asarray(self.variance * self.dt / np.abs(np.polyval(self.coefficients[::-1], shift)) ** 2)

    @classmethod
    def of_slots(cls, noise: NoiseSlots, dt: float, scale: float = 1.0) -> NoiseModel:
        """Return the noise model in use in a state or an estimate; ``scale`` converts residuals to the unit of y."""
        order = int(noise.order)
        variances = [float(noise.variances[j]) * scale**2 for j in (order, 0)]
        known = [variance if math.isfinite(variance) else 0.0 for variance in variances]
        return cls(noise.models[order, : order + 1].copy(), known[0], known[1], dt)
