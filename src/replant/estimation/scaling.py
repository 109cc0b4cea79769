"""Scaling: sigma of the output and of each regressor entry, the article's equations (10)-(12)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replant.errors import InvalidArgumentError
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, instance, keep, numbers, positive


@dataclass(frozen=True)
class Scaling:
    r"""Ranges by which output and regressor are divided, so that every scaled parameter moves at a like pace.

    .. math:: y = y_p / \sigma_y, \quad \varphi_i = \varphi_{uy,i} / \sigma_i, \quad
              \hat\theta_i = \hat\theta_{i,physical}\, \sigma_i / \sigma_y

    Parameters
    ----------
    output : float
        :math:`\sigma_y`, in the unit of y.
    regressor : sequence of float
        :math:`\sigma_i`, in the order of ``Structure.names``: that of the filtered derivatives of y, then of u, then
        of the bias (whose entry before scaling is 1: the article's "0.1" is a sigma of 10).

    References
    ----------
    Bernat and Kolota (2023), (10)-(12).

    Examples
    --------
    >>> Scaling(output=0.25, regressor=[0.05, 0.15]).sigmas(Structure(poles=1))
    array([0.05, 0.15])
    """

    output: float
    regressor: Sequence[float]

    def __post_init__(self) -> None:
        keep(self, "output", positive, called="scaling output")
        keep(self, "regressor", numbers, called="scaling regressor")
        if min(self.regressor) <= 0.0:
            raise InvalidArgumentError(f"scaling regressor must be greater than 0, got {min(self.regressor):g}")
        if not self.output / min(self.regressor) <= np.finfo(np.float64).max:
            raise InvalidArgumentError(
                f"scaling regressor must be larger: {min(self.regressor):g} is too small beside the output's "
                f"{self.output:g}"
            )

    def sigmas(self, structure: Structure) -> FloatArray:
        """Return the regressor's sigmas (P,) for ``structure``.

        Parameters
        ----------
        structure : Structure
            The structure that is identified.

        Raises
        ------
        InvalidArgumentError
            If there are not as many as the structure has parameters.
        """
        structure = instance("structure", structure, Structure)
        sigmas = np.array(self.regressor)
        if sigmas.size != structure.size:
            names = ", ".join(structure.names)
            raise InvalidArgumentError(
                f"scaling regressor must have {structure.size} entries ({names}), got {sigmas.size}"
            )
        return sigmas

    @classmethod
    def none(cls, structure: Structure) -> Scaling:
        """Return the scaling that changes nothing."""
        return cls(1.0, (1.0,) * instance("structure", structure, Structure).size)

    @classmethod
    def from_record(cls, y: FloatArray, regressor: FloatArray) -> Scaling:
        """Return root mean squares of the output (K,) and of unscaled regressors (K, P); 1 where a signal is zero.

        Rows that are not finite are left out: `estimation.solver.least_squares` marks rejected samples so.
        """
        kept = np.isfinite(regressor).all(axis=1) & np.isfinite(y)
        return cls(_rms(y[kept]), tuple(_rms(entry) for entry in regressor[kept].T))


def _rms(signal: FloatArray) -> float:
    largest = float(np.abs(signal).max(initial=0.0))
    if largest == 0.0:
        return 1.0
    return largest * float(np.sqrt(np.mean((signal / largest) ** 2)))  # in parts of the largest: no square overflows
