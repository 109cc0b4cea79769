"""What every optimizer has in common, and the replay of kept samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

from replant.arguments import FloatArray, keep, whole

LARGEST_BATCH = 100_000  # updates a sample at the most: they take some milliseconds, which nothing interrupts [count]


@dataclass(frozen=True)
class Replay:
    """Experience replay: each new sample is learned together with samples drawn from those kept.

    A batch is ``batch_size - 1`` rows drawn uniformly, with replacement, from the filled part of the buffer (the new
    sample included), then the new sample itself, one update a row.

    Parameters
    ----------
    capacity : int
        Samples kept; the newest replaces the oldest once the buffer is full.
    batch_size : int
        Updates a sample, up to 100000.
    warmup : int
        Batches begin once the buffer holds more than this many samples, or is full; before that, one update a sample.
    seed : int
        Of the random stream, 0 or more; the stream is part of the identifier's state.

    Notes
    -----
    Algorithm 3 as printed sets ``current_buffer_size`` from ``buffer_index``, which returns to zero when the buffer
    wraps: from then on only the newest few samples could be drawn until the buffer refills.  Here a full buffer stays
    full.  The article prints a batch of 20; its tables come out with 10 (see `replant.paper`).

    References
    ----------
    Bernat and Kolota (2023), section 2.2 and Algorithm 3.

    Examples
    --------
    >>> Replay(capacity=5000, batch_size=20).warmup
    20
    """

    capacity: int = 20_000
    batch_size: int = 20
    warmup: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        keep(self, "capacity", whole, 1, 2**31 - 1)
        keep(self, "batch_size", whole, 1, LARGEST_BATCH)
        keep(self, "warmup", whole, 0, 2**63 - 1)
        keep(self, "seed", whole, 0, 2**63 - 1)


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
