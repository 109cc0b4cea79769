"""The checkpoint of an identifier of several inputs: its settings, samples and recursion, to the bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from replant.errors import DamagedCheckpointError
from replant.estimation.simulation.auxiliary_model import Branches
from replant.estimation.simulation.miso_exogenous import Law
from replant.estimation.solver.miso_change import Judge
from replant.kernels.schema import LAGS, LAGUERRE
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, one_of
from replant.numerics.autoregression import Autoregression
from replant.numerics.limits import duration
from replant.online.checkpoint.encoding import ARRAYS, ROW, described
from replant.online.miso_recursion import Instruments, RowRecursion
from replant.online.miso_samples import RowClock, RowHistory, RowSettings
from replant.online.miso_state import JUDGES, RowState
from replant.verdict.verdict import STATUSES, Finding

#: The fields of a recursion that are arrays, and those that are numbers.
VECTORS = "theta", "weights", "scale", "origin", "tail", "delta", "factor", "diagonal", "counts", "squares"
NUMBERS = "dt", "size", "power", "level", "waits"
#: The same of what makes instruments, and of the law in it.
OF_INSTRUMENTS, OF_LAW = ("origin", "tail"), ("poles", "origins", "states", "weights")
#: The same of a noise model.
OF_NOISE = "coefficients", "models", "powers", "sums"
HOLDS = "zoh", "foh"
FINDINGS = "findings", "of_references"
CLOCK = 3  # numbers of a clock, beside the sample that waits [count]
COUNTS = "samples", "solve_at", "solved_at", "started_at", "look_at", "record_began"


def parts_of(state: RowState) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return settings and state as values of JSON, and as arrays."""
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
            arrays |= {f"instruments.{name}": getattr(made, name) for name in OF_INSTRUMENTS}
            arrays["instruments.is_moved"] = made.is_moved.astype(np.int64)
            arrays |= {f"law.{name}": getattr(made.law, name) for name in OF_LAW}
            arrays |= _of_branches(made.models, "instruments.")
    if state.rivals:
        arrays["rivals"] = np.array(state.rivals)
    for number, judge in enumerate(state.judges):
        arrays |= {f"judges.{number}.theta": judge.theta} | _of_noise(judge.noise, f"judges.{number}.")
    return plain, arrays


def _of_noise(noise: Autoregression, before: str = "") -> dict[str, Any]:
    fields = {f"{before}noise.{name}": getattr(noise, name) for name in OF_NOISE}
    return {**fields, f"{before}noise": np.array([noise.power, noise.count])}


def _findings(plain: list[list[Any]]) -> tuple[Finding, ...]:
    return tuple(Finding(*map(str, each)) for each in plain)


def _of_branches(models: Branches, before: str = "") -> dict[str, Any]:
    states = enumerate(models.arrays)
    return {f"{before}{name}.{i}": each for i, arrays in states for name, each in arrays.items()}


@described()
def restored(attributes: dict[str, Any]) -> RowState:
    """Return the state in the content of a checkpoint, checked."""
    plain, arrays = attributes[ROW], attributes[ARRAYS]
    structures = tuple(Structure(*each) for each in plain["structures"])
    hold, names = one_of("input_hold", plain["hold"], HOLDS), tuple(map(str, plain["names"]))
    settings = RowSettings(structures, duration("dt", plain["dt"]), plain["startup"], plain["history"], hold, names)
    kept, state = arrays.pop("kept"), RowState.of(settings)
    clock = arrays.pop("clock", np.zeros(CLOCK))  # checkpoints of before have none
    references = plain.get("references", 0)  # checkpoints of before have none
    if type(references) is not int or references < 0:
        raise DamagedCheckpointError("its references are not valid")
    _check({"kept": kept}, kept=(len(kept), len(structures) + references + 2))
    held = clock.size - CLOCK
    _check({"clock": clock}, clock=(CLOCK + held if held in (0, kept.shape[1]) else CLOCK,))
    numbers = np.delete(clock, -2) if held else clock  # the output of the sample that waits may be missing
    waits = not held or plain["rejected"].get("time leap", 0) > 0  # it counts as rejected so long
    if not (np.isfinite(numbers).all() and clock[1] >= 0.0 and waits):
        raise DamagedCheckpointError("its clock is not valid")
    plain = {**plain, "rejected": dict.fromkeys(state.rejected, 0) | plain["rejected"]}  # fewer reasons before
    # checkpoints of before look for no change
    looks = len(arrays) and plain["adapts"]
    before: dict[str, Any] = {"look_at": plain["samples"] + 1 if looks else 0, "record_began": 0, "loads": []}
    plain = {**before, "solved_at": 0, "started_at": plain.get("afresh_at", 0) // 2, **plain}
    loads = tuple(plain["loads"])
    counts = [
        settings.startup,
        settings.history,
        *(plain[name] for name in COUNTS),
        *loads,
        *plain["rejected"].values(),
    ]
    if any(type(each) is not int or each < 0 for each in counts) or set(plain["rejected"]) != set(state.rejected):
        raise DamagedCheckpointError("its counts are not valid")
    if any(each > plain["samples"] for each in loads) or plain["record_began"] >= max(plain["samples"], 1):
        raise DamagedCheckpointError("its changes are not valid")
    findings = {name: plain.get(name, []) for name in FINDINGS}  # checkpoints of before know of no references
    if len(kept) > settings.history or any(status not in STATUSES for each in findings.values() for status, _ in each):
        raise DamagedCheckpointError("its samples or findings are not valid")
    return replace(
        state, kept=RowHistory(kept, settings.history, 0, len(kept)), rejected=plain["rejected"],
        stamped=plain["stamped"], adapts=bool(plain["adapts"]),
        clock=RowClock(float(clock[0]), int(clock[1]), float(clock[2]), tuple(clock[CLOCK:].tolist())),
        is_sure=bool(plain.get("is_sure", False)), **{name: plain[name] for name in COUNTS}, loads=loads,
        findings=_findings(findings["findings"]), of_references=_findings(findings["of_references"]),
        recursion=_recursion(structures, hold, references, arrays) if arrays else None,
        rivals=_rivals(settings.size, arrays), judges=tuple(_judges(structures, arrays)),
    )  # fmt: skip


def _recursion(
    structures: tuple[Structure, ...], hold: str, references: int, arrays: dict[str, FloatArray]
) -> RowRecursion:
    coefficients, states = sum(each.size for each in structures), 1 + sum(each.poles for each in structures)
    size = coefficients + states
    for name, before, places in (("counts", 3, 4), ("squares", 1, 3)):  # checkpoints of before have no Page's sum
        if arrays[name].shape == (before,):
            arrays[name] = np.append(arrays[name], np.zeros(places - before, arrays[name].dtype))
    _check(
        arrays, theta=(coefficients,), weights=(states,), scale=(coefficients,), origin=(len(structures),),
        tail=(LAGS, size + 1), delta=(size,), factor=(size, size), diagonal=(size,), counts=(4,), squares=(3,),
        numbers=(len(NUMBERS),),
    )  # fmt: skip
    if arrays["counts"].dtype.kind != "i" or not (arrays["counts"].min() >= 0 and arrays["counts"][0] <= LAGS):
        raise DamagedCheckpointError("its counts are not valid")
    if not all((arrays[name] >= 0.0).all() for name in ("diagonal", "squares")):
        raise DamagedCheckpointError("its numbers are not valid")
    numbers = dict(zip(NUMBERS, arrays["numbers"].tolist(), strict=True))
    models = _branches(structures, numbers["dt"], hold, arrays)
    fields: dict[str, Any] = {**numbers, **{name: arrays[name] for name in VECTORS}}
    instruments = None
    if "instruments.tail" in arrays:
        instruments = _instruments(structures, numbers["dt"], hold, references, arrays, size)
    return RowRecursion(noise=_noise(arrays), models=models, instruments=instruments, **fields)


def _noise(arrays: dict[str, FloatArray], before: str = "") -> Autoregression:
    noise, lags = {name: arrays[f"{before}noise.{name}"] for name in OF_NOISE}, LAGS + 1
    order, numbers = noise["coefficients"].size - 1, arrays[f"{before}noise"]
    _check(noise, f"{before}noise.", coefficients=(order + 1,), models=(lags, lags), powers=(lags,), sums=(lags, lags))
    _check({"noise": numbers}, before, noise=(2,))
    if not 0 <= order <= LAGS:
        raise DamagedCheckpointError("its numbers are not valid")
    return Autoregression(power=float(numbers[0]), count=float(numbers[1]), **noise)


def _rivals(size: int, arrays: dict[str, FloatArray]) -> tuple[FloatArray, ...]:
    rivals = arrays.get("rivals", np.zeros((0, size)))
    _check({"rivals": rivals}, rivals=(len(rivals), size))
    return tuple(rivals)


def _judges(structures: tuple[Structure, ...], arrays: dict[str, FloatArray]) -> Iterator[Judge]:
    for number in range(JUDGES):  # checkpoints of before have none
        theta = arrays.get(f"judges.{number}.theta")
        if theta is not None:
            _check({"judges": theta}, judges=(sum(each.size for each in structures),))
            yield Judge(theta, _noise(arrays, f"judges.{number}."))


def _branches(
    structures: tuple[Structure, ...], dt: float, hold: str, arrays: dict[str, FloatArray], before: str = ""
) -> Branches:
    models = Branches(structures, dt, hold)
    for i, each in enumerate(models.arrays):
        given = {name: arrays[f"{before}{name}.{i}"] for name in each}
        _check(given, **{name: fresh.shape for name, fresh in each.items()})
        for name, fresh in each.items():
            fresh[:] = given[name]
    if not models.are_sound:
        raise DamagedCheckpointError("its state points outside of its arrays")
    return models


def _instruments(
    structures: tuple[Structure, ...], dt: float, hold: str, references: int, arrays: dict[str, FloatArray], size: int
) -> Instruments:
    made, law = ({name: arrays[f"{part}.{name}"] for name in names} for part, names in
                 (("instruments", OF_INSTRUMENTS), ("law", OF_LAW)))  # fmt: skip
    is_moved = np.asarray(arrays["instruments.is_moved"], bool)
    _check({"is_moved": is_moved}, is_moved=(len(structures),))
    moved = int(np.count_nonzero(is_moved))
    signals = references + len(structures) - moved
    _check(
        made | law, origin=(len(structures),), tail=(LAGS, size), poles=(signals,), origins=(signals,),
        states=(signals, LAGUERRE), weights=(moved, signals * LAGUERRE + 1),
    )  # fmt: skip
    models = _branches(structures, dt, hold, arrays, "instruments.")
    return Instruments(Law(**law), is_moved, models, made["origin"], made["tail"])


def _check(arrays: dict[str, Any], before: str = "", /, **shapes: tuple[int, ...]) -> None:
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise DamagedCheckpointError(
                f"its {before}{name} have the shape {arrays[name].shape}, and its settings need {shape}"
            )
