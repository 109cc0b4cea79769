"""Optimizer: what every optimizer tells the identifier about itself."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from replant.validation import FloatArray


class Optimizer:
    """Base of the optimizers, which are frozen dataclasses of their settings; the state lives in the identifier."""

    code: ClassVar[int]  # of its kernel, as `replant.kernels.step` numbers them

    def settings(self, dt: float) -> FloatArray:
        """Return the kernel's settings for the sampling time ``dt`` in s."""
        raise NotImplementedError

    def memory(self, size: int) -> FloatArray:
        """Return the kernel's memory before the first sample, for ``size`` parameters."""
        return np.zeros(0)
