"""Optimizer: what every optimizer tells the identifier about itself."""

from __future__ import annotations

from typing import Any, ClassVar, Self

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
    """Base of the optimizers, which are frozen dataclasses of their settings; the state lives in the identifier.

    Attributes
    ----------
    code : int
        Of its loop in `replant.kernels.optimizers`, where its memory is declared.  It is stored in checkpoints: any
        number that no other optimizer has or had.
    keeps_covariance : bool
        Whether its memory begins with the factors U and D of a covariance and ends with alpha; the loop is then in
        `replant.kernels.optimizers.covariance`, else in `replant.kernels.optimizers.gradient`.
    keeps_colour : bool
        Whether power and colour of the residual are kept beside it, forgotten by the first of its settings.
    """

    code: ClassVar[int]
    keeps_covariance: ClassVar[bool] = False
    keeps_colour: ClassVar[bool] = False

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

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return the blocks of the memory that are not zero before the first sample, for ``size`` parameters."""
        return {}

    def memory(self, size: int) -> FloatArray:
        """Return the kernel's memory before the first sample, for ``size`` parameters."""
        from replant.kernels.optimizers import covariance, gradient

        declared = covariance.MEMORY if self.keeps_covariance else gradient.MEMORY
        return declared[self.code].filled(size, **self.begins_with(size))
