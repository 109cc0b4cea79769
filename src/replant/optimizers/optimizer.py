"""Optimizer: what every optimizer tells the identifier about itself."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np

from replant.arguments import FloatArray


def rounded(value: float) -> float:
    """Return ``value`` to three digits: a setting that one can type again.

    Examples
    --------
    >>> rounded(0.000122159)
    0.000122
    """
    return float(f"{value:.3g}")


class Optimizer:
    """Base of the optimizers, which are frozen dataclasses of their settings; the state lives in the identifier."""

    code: ClassVar[int]  # of its kernel, as `replant.kernels` numbers them
    keeps_covariance: ClassVar[bool] = False  # whether its memory begins with the factors U and D of a covariance
    keeps_colour: ClassVar[bool] = False  # whether it leaves alpha at the end of its memory, and forgets by settings[0]

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return this optimizer for auto-scaled signals, sampling time ``dt`` and about ``updates`` updates to come.

        The more updates there are, the smaller each can be: the estimate gets there all the same, and less noisy.
        """
        raise NotImplementedError

    def check(self, size: int) -> None:
        """Raise InvalidArgumentError where these settings are not for ``size`` parameters."""
        return

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return the kernel's settings for the sampling time ``dt`` in s; ``unit`` (T,) is physical over scaled."""
        raise NotImplementedError

    def memory(self, size: int) -> FloatArray:
        """Return the kernel's memory before the first sample, for ``size`` parameters."""
        return np.zeros(0)
