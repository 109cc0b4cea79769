"""The members of a bank: their arguments, and the properties of the leading one, whose model is served."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.estimation.engine.dimensions import RECENT
from replant.estimation.filters import RefinedFilter
from replant.estimation.settings import AUTO, STORED
from replant.fitting.model import Model
from replant.model.structure import Structure
from replant.numerics.arguments import whole
from replant.online.bank_weights import MOST
from replant.online.estimate import Estimate
from replant.online.identification import Identification
from replant.online.locking import reads
from replant.verdict import Assessment

T = TypeVar("T")

#: Arguments that the members of a bank choose from the data, so that their predictions are comparable.
CHOSEN = "scaling", "optimizer", "replay", "instruments", "normalize", "background"


def asked_for(structures: Any, given: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the checked arguments of each member."""
    for name in ("poles", "zeros", "delay"):
        if given.get(name) is not None:
            raise InvalidArgumentError(f"a list of structures has its own {name}: leave out {name}")
    for name in CHOSEN:
        if name in given:
            raise InvalidArgumentError(f"the members of a list of structures take no {name}: leave it out")
    chosen = given.get("filter", AUTO)
    if not isinstance(chosen, RefinedFilter) and not (isinstance(chosen, str) and chosen == AUTO):
        raise InvalidArgumentError(
            "the members of a list of structures take the refined filter alone: leave out filter"
        )
    wrong = next((each for each in structures if not isinstance(each, Structure)), None)
    if wrong is not None:
        raise ArgumentTypeError(f"structure must hold Structures, got {shown(wrong)}: write Structure(poles=2)")
    if not 2 <= len(structures) <= MOST:
        raise InvalidArgumentError(f"structure must be a Structure, or a list of 2 to {MOST}, got {len(structures)}")
    twice = next((each for i, each in enumerate(structures) if each in structures[:i]), None)
    if twice is not None:
        raise InvalidArgumentError(f"structure has {shown(twice)} twice: give each once")
    history = whole("history", given.get("history", STORED), RECENT, STORED)
    return [given | {"structure": each, "history": history} for each in structures]


def _of_served(read: Callable[[Estimate], T], meaning: str) -> T:
    """Return a property that reads an attribute of the leading member."""
    return cast("T", property(lambda members: read(members._served), doc=meaning))


class Members(Identification):
    """Identifiers that learn side by side; the model of the leading one is served."""

    _members: tuple[Any, ...]  # identifiers
    _lead: int

    @property
    def structures(self) -> tuple[Structure, ...]:
        """The structures of the members."""
        return tuple(member.structure for member in self._members)

    @property
    @reads
    def members(self) -> tuple[Any, ...]:
        """Copies of the members, identifiers in the same state."""
        return tuple(member.clone() for member in self._members)

    @property
    @reads
    def lead(self) -> int:
        """Number of the member that is served."""
        return self._lead

    @property
    def _served(self) -> Estimate:
        served: Estimate = self._members[self.lead]
        return served

    structure = _of_served(lambda lead: lead.structure, "Structure of the model that is served.")
    dt = _of_served(lambda lead: lead.dt, "Sampling time in s.")
    names = _of_served(lambda lead: lead.names, "Names of the parameters of the model that is served.")
    has_model = _of_served(lambda lead: lead.has_model, "Whether there is an estimate.")
    parameters = _of_served(lambda lead: lead.parameters, "The estimate (P,) that is served.")
    covariance = _of_served(lambda lead: lead.covariance, "Its covariance (P, P).")
    uncertainty = _of_served(lambda lead: lead.uncertainty, "Its standard deviations.")
    noise = _of_served(lambda lead: lead.noise, "The model of its residual's noise.")
    transfer_function = _of_served(lambda lead: lead.transfer_function, "The estimate that is served, as G(s).")
    samples = _of_served(lambda lead: lead.samples, "Samples that the leading member has accepted.")
    rejected = _of_served(lambda lead: lead.rejected, "Samples that the leading member has rejected, by reason.")
    status = _of_served(lambda lead: lead.status, "`Identifier.status` of the leading member.")

    @property
    def model(self) -> Model:
        """The model that is served, to keep; see `Identifier.model`."""
        model: Model = self._members[self.lead].model
        return model

    def assess(self) -> Assessment:
        """Return the verdict on the model that is served; see `Identifier.assess`."""
        return self._served.assess()
