"""Filter: what every filter tells the rest of the package about itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from replant.arguments import FloatArray
from replant.model.structure import Structure

if TYPE_CHECKING:
    from replant.regressor.filters.state_variable import StateVariableFilter


class Filter:
    """What a filter tells about itself; the rest of the package asks for nothing else.

    Attributes
    ----------
    input_hold : {"zoh", "foh"}
        What u does between samples.
    follows_estimate : bool
        Whether it is made from the estimate, and anew as that moves; it then needs instruments and a start-up.
    """

    input_hold: str
    follows_estimate: ClassVar[bool] = False

    @property
    def regular_only(self) -> bool:
        """Whether it is for a regular clock alone."""
        return False

    @property
    def fixed(self) -> StateVariableFilter | None:
        """The fixed filter that this is; None for one that follows the estimate."""
        return None

    def fixed_at(self, denominator: FloatArray, dt: float) -> StateVariableFilter:
        """Return the fixed filter that this is where the estimate's denominator (n + 1,), monic, is this one.

        Parameters
        ----------
        denominator : (n + 1,) array
            A(s).
        dt : float
            Sampling time in s.
        """
        raise NotImplementedError

    def check(self, structure: Structure) -> None:
        """Raise InvalidArgumentError where this filter is not for this structure."""
        return
