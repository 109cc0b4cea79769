"""Prior: what is known of a model before a record, as a normal density of its coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray


@dataclass(frozen=True, eq=False)
class Prior:
    """A normal density of a model, and the variance of the residual that it is weighed against.

    Attributes
    ----------
    mean : (T,) array
    information : (T, T) array
        Inverse of the covariance; zero for nuisances, of which nothing is known.
    variance : float
        Of the residual, in the output's unit squared.
    """

    mean: FloatArray
    information: FloatArray
    variance: float

    @classmethod
    def none(cls, size: int) -> Prior:
        """Return that nothing is known of ``size`` entries."""
        return cls(np.zeros(size), np.zeros((size, size)), 1.0)

    @property
    def weight(self) -> FloatArray:
        """What the prior adds to sum zeta zeta', (T, T)."""
        return self.variance * self.information

    def pull(self, model: FloatArray) -> FloatArray:
        """Return what it adds to sum zeta e at a model, (T,)."""
        return np.asarray(self.weight @ (self.mean - model))

    def cost(self, model: FloatArray) -> float:
        """Return what it adds to the sum of squares at a model; rounded far from the mean it is no less than 0, too."""
        return max(float((self.mean - model) @ self.pull(model)), 0.0)
