"""The checkpoint of a bank: the checkpoints of its members, and its weights and leads, to the bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from replant.errors import DamagedCheckpointError
from replant.estimation.engine.dimensions import RECENT
from replant.kernels.schema import LAGS
from replant.kernels.step.bank import KNOWN
from replant.numerics.arguments import number
from replant.online.bank_weights import EVENTS, MOST, Lead, Weights
from replant.online.checkpoint.encoding import ARRAYS, BANK, Progress, described, encode_other
from replant.online.estimate import Estimate
from replant.verdict.verdict import STATUSES

COUNTS = "_taken", "_due", "_stop", "_origin", "_ready", "_likeliest", "_lead"
ARRAYS_OF_WEIGHTS = tuple(each.name for each in fields(Weights) if each.name != "least")


def bytes_of(members: Sequence[bytes], state: dict[str, Any], progress: Progress | None) -> bytes:
    """Return the bytes of a bank; the length of a member's bytes is a multiple of eight."""
    weights: Weights = state["_weights"]
    arrays = {f"member.{i}": np.frombuffer(each, np.int64) for i, each in enumerate(members)}
    arrays |= {name: getattr(weights, name) for name in ARRAYS_OF_WEIGHTS}
    plain = {name: state[name] for name in COUNTS} | {"members": len(members), "least": weights.least}
    plain["adapts"] = state["_adapts"]
    leads = [[each.taken, list(vars(each.structure).values()), each.weight, each.status] for each in state["_leads"]]
    return encode_other(BANK, plain | {"leads": leads}, arrays, progress)


#: The members of a bank, and its other attributes.
Parts = tuple[list[Any], dict[str, Any]]


@described()
def restored(attributes: dict[str, Any], member_of: Callable[[bytes], Any]) -> Parts:
    """Return the parts of the bank in the content of a checkpoint, checked."""
    plain, arrays = attributes[BANK], attributes[ARRAYS]
    count = plain["members"]
    if type(count) is not int or not 2 <= count <= MOST:
        raise DamagedCheckpointError("its members are not valid")
    members = [member_of(arrays[f"member.{i}"].tobytes()) for i in range(count)]
    if any(not isinstance(each, Estimate) or each.request.history < RECENT for each in members):
        raise DamagedCheckpointError("its members are not valid")
    if len({(each.dt, each.taken) for each in members}) > 1 or any(
        type(plain[name]) is not int or plain[name] < 0 for name in COUNTS
    ):
        raise DamagedCheckpointError("its members or counts are not valid")
    structures = {each.structure for each in members}
    if len(structures) != count or max(plain["_lead"], plain["_likeliest"]) >= count:
        raise DamagedCheckpointError("its structures or its lead are not valid")
    if plain["_taken"] != members[0].taken or plain["_stop"] <= plain["_taken"]:
        raise DamagedCheckpointError("its samples are not those of its members")
    fresh = Weights.of([each.structure for each in members])
    given: dict[str, Any] = {name: arrays[name] for name in ARRAYS_OF_WEIGHTS}
    for name, array in given.items():
        usual = getattr(fresh, name)
        if array.shape != usual.shape or array.dtype.kind != usual.dtype.kind:
            raise DamagedCheckpointError(f"its {name} have the shape {array.shape}, and its members need {usual.shape}")
    orders, known, joined = given["orders"], given["counts"][KNOWN], given["joined"]
    if not (orders.min() >= 0 and orders.max() <= LAGS and 0 <= known <= LAGS and np.isin(joined, (0, 1)).all()):
        raise DamagedCheckpointError("its weights are not valid")
    if len(plain["leads"]) > EVENTS:
        raise DamagedCheckpointError("its events are not valid")
    kept = {tuple(vars(each).values()): each for each in structures}
    leads = tuple(_lead(kept, *each) for each in plain["leads"])
    weights = Weights(least=number("least", plain["least"]), **given)
    state = {"_weights": weights, "_leads": leads, "_held": [], "_chunk": None, "_adapts": bool(plain["adapts"])}
    return members, state | {name: plain[name] for name in COUNTS}


def _lead(structures: dict[Any, Any], taken: int, structure: list[Any], weight: float, status: str) -> Lead:
    if type(taken) is not int or status not in STATUSES:
        raise DamagedCheckpointError("its events are not valid")
    return Lead(taken, structures[tuple(structure)], number("weight", weight), status)
