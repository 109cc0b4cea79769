"""The checkpoints of a bank and of an identifier of several inputs: JSON values and arrays, equal to the bit.

The checkpoint of a bank holds those of its members, its weights and its leads; that of several inputs settings, samples
and recursion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from replant.errors import DamagedCheckpointError
from replant.estimation.engine.dimensions import RECENT
from replant.estimation.simulation.auxiliary_model import Branches
from replant.estimation.simulation.miso_exogenous import Law
from replant.estimation.solver.miso_change import Judge
from replant.kernels.schema import LAGS, LAGUERRE
from replant.kernels.step.bank import KNOWN
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, number, one_of
from replant.numerics.autoregression import Autoregression
from replant.numerics.limits import duration
from replant.online.bank_weights import EVENTS, MOST, Lead, Weights
from replant.online.checkpoint.encoding import ARRAYS, BANK, ROW, described
from replant.online.estimate import Estimate
from replant.online.miso_recursion import Instruments, RowRecursion
from replant.online.miso_samples import REASONS, RowClock, RowHistory, RowSettings
from replant.online.miso_state import JUDGES, RowState
from replant.verdict.verdict import STATUSES, Finding

#: The attributes of a bank that are counts, and the fields of its weights that are arrays.
OF_BANK = "_taken", "_due", "_stop", "_origin", "_ready", "_likeliest", "_lead"
OF_WEIGHTS = tuple(each.name for each in fields(Weights) if each.name != "least")
#: The fields of a recursion that are arrays, and those that are numbers; then the arrays of a noise model.
VECTORS = "theta", "nuisances", "scale", "origin", "tail", "delta", "factor", "diagonal", "counts", "squares"
NUMBERS = "dt", "size", "power", "level", "waits"
OF_NOISE = "coefficients", "models", "powers", "sums"
#: The fields of a state that are findings, and those that are counts; the holds of the input.
FINDINGS = "findings", "of_references"
COUNTS = "samples", "solve_at", "solved_at", "started_at", "look_at", "record_began"
HOLDS = "zoh", "foh"
CLOCK = 3  # numbers of a clock, without those of a sample held back [count]

Arrays = dict[str, FloatArray]


def bank_parts(members: Sequence[bytes], state: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return members and state as JSON values and arrays; the length of a member's bytes is a multiple of eight."""
    weights: Weights = state["_weights"]
    arrays = {f"member.{i}": np.frombuffer(each, np.int64) for i, each in enumerate(members)}
    arrays |= {name: getattr(weights, name) for name in OF_WEIGHTS}
    plain = {name: state[name] for name in OF_BANK} | {"members": len(members), "least": weights.least}
    plain["adapts"] = state["_adapts"]
    leads = [[each.taken, list(vars(each.structure).values()), each.weight, each.status] for each in state["_leads"]]
    return plain | {"leads": leads}, arrays


@described()
def restored_bank(attributes: dict[str, Any], member_of: Callable[[bytes], Any]) -> dict[str, Any]:
    """Return the attributes of the bank in the content of a checkpoint, checked."""
    plain, arrays = attributes[BANK], attributes[ARRAYS]
    count = plain["members"]
    if type(count) is not int or not 2 <= count <= MOST:
        raise DamagedCheckpointError("its members are not valid")
    members = [member_of(arrays[f"member.{i}"].tobytes()) for i in range(count)]
    if any(not isinstance(each, Estimate) or each.request.history < RECENT for each in members):
        raise DamagedCheckpointError("its members are not valid")
    if len({(each.dt, each.taken) for each in members}) > 1 or any(
        type(plain[name]) is not int or plain[name] < 0 for name in OF_BANK
    ):
        raise DamagedCheckpointError("its members or counts are not valid")
    structures = {each.structure for each in members}
    if len(structures) != count or max(plain["_lead"], plain["_likeliest"]) >= count:
        raise DamagedCheckpointError("its structures or its lead are not valid")
    if plain["_taken"] != members[0].taken or plain["_stop"] <= plain["_taken"]:
        raise DamagedCheckpointError("its samples are not those of its members")
    fresh = Weights.of([each.structure for each in members])
    given: dict[str, Any] = {name: arrays[name] for name in OF_WEIGHTS}
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
    state = {"_members": tuple(members), "_weights": weights, "_leads": leads, "_held": [], "_chunk": None}
    return state | {"_adapts": bool(plain["adapts"])} | {name: plain[name] for name in OF_BANK}


def _lead(structures: dict[Any, Any], taken: int, structure: list[Any], weight: float, status: str) -> Lead:
    if type(taken) is not int or status not in STATUSES:
        raise DamagedCheckpointError("its events are not valid")
    return Lead(taken, structures[tuple(structure)], number("weight", weight), status)


def row_parts(state: RowState) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return settings and state as JSON values and arrays."""
    structures, dt, startup, history, hold, names = state.settings
    plain: dict[str, Any] = {
        "structures": [[each.poles, each.zeros, each.delay] for each in structures],
        "dt": dt, "startup": startup, "history": history, "hold": hold, "names": names,
        "rejected": state.rejected, "stamped": state.stamped, "references": state.references, "adapts": state.adapts,
        "is_sure": state.is_sure,
        **{name: [[each.status, each.reason] for each in getattr(state, name)] for name in FINDINGS},
        **{name: getattr(state, name) for name in COUNTS}, "loads": state.loads,
    }  # fmt: skip
    arrays, known = {"kept": state.kept.values}, state.recursion
    shift, earlier, earlier_time, held = state.clock
    arrays["clock"] = np.array([shift, earlier, earlier_time, *held])
    if known is not None:
        arrays |= {name: getattr(known, name) for name in VECTORS}
        arrays["numbers"] = np.array([getattr(known, name) for name in NUMBERS])
        arrays |= _of_noise(known.noise) | _of_branches(known.models)
        if (made := known.instruments) is not None:
            arrays |= {"instruments.origin": made.origin, "instruments.tail": made.tail}
            arrays["instruments.is_moved"] = made.is_moved.astype(np.int64)
            arrays |= {f"law.{name}": each for name, each in vars(made.law).items()}
            arrays |= _of_branches(made.models, "instruments.")
    if state.rivals:
        arrays["rivals"] = np.array(state.rivals)
    for i, judge in enumerate(state.judges):
        arrays |= {f"judges.{i}.theta": judge.theta} | _of_noise(judge.noise, f"judges.{i}.")
    return plain, arrays


def _of_noise(noise: Autoregression, before: str = "") -> dict[str, Any]:
    fields = {f"{before}noise.{name}": getattr(noise, name) for name in OF_NOISE}
    return {**fields, f"{before}noise": np.array([noise.power, noise.count])}


def _of_branches(models: Branches, before: str = "") -> dict[str, Any]:
    states = enumerate(models.arrays)
    return {f"{before}{name}.{i}": each for i, arrays in states for name, each in arrays.items()}


@described()
def restored_row(attributes: dict[str, Any]) -> RowState:
    """Return the state in the content of a checkpoint, checked."""
    plain, arrays = attributes[ROW], attributes[ARRAYS]
    structures = tuple(Structure(*each) for each in plain["structures"])
    hold, names = one_of("input_hold", plain["hold"], HOLDS), tuple(map(str, plain["names"]))
    settings = RowSettings(structures, duration("dt", plain["dt"]), plain["startup"], plain["history"], hold, names)
    references, loads = plain["references"], tuple(plain["loads"])
    rejected = dict.fromkeys(REASONS, 0) | plain["rejected"]
    if type(references) is not int or references < 0:
        raise DamagedCheckpointError("its references are not valid")
    counts = [settings.startup, settings.history, *(plain[name] for name in COUNTS), *loads, *rejected.values()]
    if any(type(each) is not int or each < 0 for each in counts) or {*plain["rejected"], "too dense"} != set(REASONS):
        raise DamagedCheckpointError("its counts are not valid")
    if any(each > plain["samples"] for each in loads) or plain["record_began"] >= max(plain["samples"], 1):
        raise DamagedCheckpointError("its changes are not valid")
    kept, clock = arrays.pop("kept"), arrays.pop("clock")
    if (
        not plain["stamped"] and kept.ndim == 2 and kept.size and not kept[:, -1].any()
    ):  # earlier files do not number their samples
        taken = plain["samples"] + sum(rejected.values()) - rejected["no output"]
        kept = np.column_stack([kept[:, :-1], np.arange(taken - len(kept), taken, dtype=np.float64)])
    _checked("kept", kept, (len(kept), len(structures) + references + 2))
    findings: dict[str, Any] = {name: tuple(Finding(*map(str, each)) for each in plain[name]) for name in FINDINGS}
    statuses = {finding.status for each in findings.values() for finding in each}
    if len(kept) > settings.history or not statuses <= set(STATUSES):
        raise DamagedCheckpointError("its samples or findings are not valid")
    rivals = arrays.get("rivals", np.zeros((0, settings.size)))
    _checked("rivals", rivals, (len(rivals), settings.size))
    state = RowState(
        settings, RowHistory(kept, settings.history, 0, len(kept)), **{name: plain[name] for name in COUNTS},
        loads=loads, is_sure=bool(plain["is_sure"]), rejected=rejected, stamped=plain["stamped"],
        clock=_clock(clock, kept.shape[1], rejected["time leap"]), adapts=bool(plain["adapts"]),
        recursion=_recursion(structures, hold, references, arrays) if arrays else None,
        rivals=tuple(rivals), judges=tuple(_judges(settings.size, arrays)), **findings,
    )  # fmt: skip
    times = kept[:, -1] if state.stamped else np.append(kept[:, -1], state.taken)
    if not (np.diff(times) > 0.0).all():
        raise DamagedCheckpointError("its times are not valid")
    return state


def _clock(clock: FloatArray, columns: int, leaps: int) -> RowClock:
    """Return a clock; a sample held back has as many numbers as one that is kept, and is counted as a leap."""
    held = clock[CLOCK:]
    _checked("clock", clock, (CLOCK + held.size if held.size in (0, columns) else CLOCK,))
    numbers = np.delete(clock, -2) if held.size else clock  # the output of the sample held back may be missing
    if not (np.isfinite(numbers).all() and clock[1] >= 0.0 and (not held.size or leaps > 0)):
        raise DamagedCheckpointError("its clock is not valid")
    return RowClock(float(clock[0]), int(clock[1]), float(clock[2]), tuple(held.tolist()))


def _recursion(structures: tuple[Structure, ...], hold: str, references: int, arrays: Arrays) -> RowRecursion:
    coefficients, states = sum(each.size for each in structures), 1 + sum(each.poles for each in structures)
    size = coefficients + states
    fields: dict[str, Any] = _taken(
        arrays, theta=(coefficients,), nuisances=(states,), scale=(coefficients,), origin=(len(structures),),
        tail=(LAGS, size + 1), delta=(size,), factor=(size, size), diagonal=(size,), counts=(4,), squares=(3,),
    )  # fmt: skip
    if fields["counts"].dtype.kind != "i" or not (fields["counts"].min() >= 0 and fields["counts"][0] <= LAGS):
        raise DamagedCheckpointError("its counts are not valid")
    if not all((fields[name] >= 0.0).all() for name in ("diagonal", "squares")):
        raise DamagedCheckpointError("its numbers are not valid")
    numbers = _checked("numbers", arrays["numbers"], (len(NUMBERS),))
    fields |= zip(NUMBERS, numbers.tolist(), strict=True)
    fields["models"] = _branches(Branches(structures, fields["dt"], hold), arrays)
    if "instruments.tail" in arrays:
        made = _taken(arrays, "instruments.", is_moved=(len(structures),), origin=(len(structures),), tail=(LAGS, size))
        is_moved = np.asarray(made.pop("is_moved"), bool)
        moved = int(np.count_nonzero(is_moved))
        signals = references + len(structures) - moved
        law = _taken(
            arrays, "law.", poles=(signals,), origins=(signals,), states=(signals, LAGUERRE),
            weights=(moved, signals * LAGUERRE + 1),
        )  # fmt: skip
        models = _branches(Branches(structures, fields["dt"], hold), arrays, "instruments.")
        fields["instruments"] = Instruments(Law(**law), is_moved, models, **made)
    return RowRecursion(noise=_noise(arrays), **fields)


def _noise(arrays: Arrays, before: str = "") -> Autoregression:
    order, lags = arrays[f"{before}noise.coefficients"].size - 1, LAGS + 1
    shapes = {"coefficients": (order + 1,), "models": (lags, lags), "powers": (lags,), "sums": (lags, lags)}
    noise = _taken(arrays, f"{before}noise.", **shapes)
    power, count = _checked(f"{before}noise", arrays[f"{before}noise"], (2,)).tolist()
    if not 0 <= order <= LAGS:
        raise DamagedCheckpointError("its numbers are not valid")
    return Autoregression(power=power, count=count, **noise)


def _judges(size: int, arrays: Arrays) -> Iterator[Judge]:
    for i in range(JUDGES):  # there are fewer while the record is short
        theta = arrays.get(f"judges.{i}.theta")
        if theta is not None:
            yield Judge(_checked("judges", theta, (size,)), _noise(arrays, f"judges.{i}."))


def _branches(models: Branches, arrays: Arrays, before: str = "") -> Branches:
    """Return the models with their stored states."""
    for i, each in enumerate(models.arrays):
        for name, fresh in each.items():
            fresh[:] = _checked(name, arrays[f"{before}{name}.{i}"], fresh.shape)
    if not models.are_sound:
        raise DamagedCheckpointError("its state points outside of its arrays")
    return models


def _taken(arrays: Arrays, before: str = "", /, **shapes: tuple[int, ...]) -> Arrays:
    """Return the named arrays, after a check of their shapes."""
    return {name: _checked(name, arrays[before + name], shape) for name, shape in shapes.items()}


def _checked(name: str, array: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    if array.shape != shape:
        raise DamagedCheckpointError(f"its {name} have the shape {array.shape}, and its settings need {shape}")
    return array
