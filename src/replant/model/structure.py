"""Structure: the number of poles and zeros, the dead time, and whether a bias is identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray, instance, iterable, keep, owned, truth, whole
from replant.numerics.limits import dead_time


@dataclass(frozen=True)
class Structure:
    r"""The structure of the transfer function to be identified.

    .. math:: G(s) = \frac{b_m s^m + \ldots + b_0}{s^n + a_{n-1} s^{n-1} + \ldots + a_0} e^{-s\,\mathrm{delay}}

    Parameters
    ----------
    poles : int
        Order n of the denominator, 1 to 10.
    zeros : int
        Order m of the numerator; fewer than ``poles``.
    delay : float
        Dead time in seconds, any real number >= 0.
    bias : bool
        Also identify a constant of the regression, (24) of the article.  With a fixed filter it has the unit of the
        output; with the refined filter it is the constant of A y = B u + bias, the output's offset times a0.
    feedthrough : bool
        Allow as many zeros as poles: the output then jumps with the input, as with an accelerometer.

    Raises
    ------
    InvalidArgumentError
        If the structure is impossible.

    References
    ----------
    Bernat and Kolota (2023), equations (1) and (24).

    Examples
    --------
    >>> Structure(poles=3, zeros=1, bias=True).names
    ('a2', 'a1', 'a0', 'b1', 'b0', 'bias')
    """

    poles: int
    zeros: int = 0
    delay: float = 0.0
    bias: bool = False
    feedthrough: bool = False

    MOST_POLES = 10  # with more, float64 does not resolve the regression

    def __post_init__(self) -> None:
        keep(self, "poles", whole, 1, self.MOST_POLES)
        keep(self, "zeros", whole, 0)
        keep(self, "delay", dead_time)
        keep(self, "bias", truth)
        keep(self, "feedthrough", truth)
        poles, zeros = self.poles, self.zeros
        if zeros > poles or (zeros == poles and not self.feedthrough):
            most = "at most as many as" if self.feedthrough else "fewer than"
            at_once = "; if the input acts on the output at once, allow it (feedthrough=True, --feedthrough)"
            hint = at_once if zeros == poles else ""
            raise InvalidArgumentError(f"zeros must be {most} poles, got {shown(zeros)} and {poles}{hint}")

    def __str__(self) -> str:
        """Return the structure in words.

        >>> print(Structure(poles=2, zeros=1, delay=0.3))
        2 poles, 1 zero and a dead time of 0.3 s
        """
        parts = {
            f"{self.poles} pole{'s' if self.poles > 1 else ''}": True,
            f"{self.zeros} zero{'s' if self.zeros > 1 else ''}": self.zeros,
            f"a dead time of {self.delay} s": self.delay,
            "a bias": self.bias,
            "a direct path": self.feedthrough,
        }
        *first, last = [part for part, has_it in parts.items() if has_it]
        return f"{', '.join(first)} and {last}" if first else last

    @classmethod
    def wanted(cls, structure: Structure | None, poles: int | None, zeros: int, delay: float) -> Structure:
        """Return the given structure, or the one with these numbers of poles and zeros, and ``delay`` in s.

        >>> Structure.wanted(None, 2, 1, 0.0)
        Structure(poles=2, zeros=1, delay=0.0, bias=False, feedthrough=False)
        """
        if structure is None:
            if poles is None:
                raise ArgumentTypeError("give the number of poles, poles=2, or structure=Structure(poles=2)")
            for name, given in (("poles", poles), ("zeros", zeros), ("delay", delay)):
                if iterable(given):
                    raise ArgumentTypeError(
                        f"{name} must be one number, got {shown(given)}: search chooses among several"
                    )
            return cls(poles, zeros, delay)
        given_as: object = structure
        if isinstance(given_as, int | np.integer):
            raise ArgumentTypeError(
                f"structure must be a Structure, got {shown(given_as)}; write poles={shown(given_as)}"
            )
        structure = instance("structure", structure, Structure)
        if poles is not None or whole("zeros", zeros, 0) or dead_time("delay", delay):
            raise InvalidArgumentError("give either a structure, or poles, zeros and delay")
        return structure

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the article's order: a_{n-1} .. a_0, b_m .. b_0, then bias."""
        a = tuple(f"a{i}" for i in reversed(range(self.poles)))
        b = tuple(f"b{i}" for i in reversed(range(self.zeros + 1)))
        return a + b + (("bias",) if self.bias else ())

    def transfer_function(self, parameters: FloatArray) -> TransferFunction:
        """Return G(s) with the ``parameters`` (P,), in the order of `names`.

        Parameters
        ----------
        parameters : (P,) array
            In physical units.

        Examples
        --------
        >>> print(Structure(poles=2).transfer_function([4.0, 3.0, 2.0]))
        2 / (s^2 + 4 s + 3)
        """
        values = owned("parameters", parameters, (self.size,))
        return TransferFunction(values[self.numerator], np.concatenate([[1.0], values[self.denominator]]), self.delay)

    @property
    def is_biproper(self) -> bool:
        """Whether there are as many zeros as poles: the input acts on the output at once."""
        return self.zeros == self.poles

    @property
    def coefficients(self) -> int:
        """Number of coefficients of G(s): n of the denominator and m + 1 of the numerator."""
        return self.poles + self.zeros + 1

    @property
    def size(self) -> int:
        """Number P of identified parameters: the coefficients, and the bias if there is one."""
        return self.coefficients + self.bias

    @property
    def denominator(self) -> slice:
        """Which of the parameters are a_{n-1} .. a_0."""
        return slice(0, self.poles)

    @property
    def numerator(self) -> slice:
        """Which of the parameters are b_m .. b_0."""
        return slice(self.poles, self.coefficients)


def places_of(structures: Sequence[Structure]) -> list[slice]:
    """Return the slice of each input in the parameters of several inputs."""
    ends = list(accumulate(each.size for each in structures))
    return [slice(*rows) for rows in zip([0, *ends], ends, strict=False)]


def names_of(structures: Sequence[Structure], inputs: Sequence[str]) -> tuple[str, ...]:
    """Return the parameter names of several inputs, each with the name of its input: a0.u1, b0.u1, a0.u2, .."""
    pairs = zip(inputs, structures, strict=True)
    return tuple(f"{parameter}.{name}" for name, structure in pairs for parameter in structure.names)
