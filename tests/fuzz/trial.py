"""What is done with one mutant, and what counts as a finding: anything but a refusal or a life as any identifier's."""

from __future__ import annotations

import random
import resource
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

import replant as rp
from fuzz.mutation import mutant
from fuzz.seeds import record, reference, seed, seeds
from replant.estimation.engine.state import State

ZONE = 4096  # numbers before and behind each array that nothing may touch
CANARY = {"i": np.int64(0x5AFE5AFE5AFE5AFE), "f": np.float64(1.2345678912345e-123)}
MOST_MEMORY = 500  # MiB more than before, of one trial


class FindingError(AssertionError):
    """Something that must not happen."""


@dataclass
class Zones:
    """An identifier's arrays, each in the middle of a larger one."""

    identifier: rp.Identifier
    around: list[np.ndarray]

    @classmethod
    def of(cls, identifier: rp.Identifier) -> Zones:
        """Move the identifier's arrays into guard zones."""
        around, arrays = [], []
        for array in identifier._state.arrays:
            if array.nbytes > 2**27:  # never touched as a whole: it is left where it is
                arrays.append(array)
                continue
            wide = np.full(array.size + 2 * ZONE, CANARY[array.dtype.kind])
            inner = wide[ZONE : ZONE + array.size].reshape(array.shape)
            inner[...] = array
            around.append(wide)
            arrays.append(inner)
        identifier._work_on(State(*arrays), regular=identifier._regular)
        return cls(identifier, around)

    def check(self) -> None:
        """Raise FindingError where something was written beside an array."""
        for wide in self.around:
            canary = CANARY[wide.dtype.kind]
            if not ((wide[:ZONE] == canary).all() and (wide[-ZONE:] == canary).all()):
                raise FindingError(f"written beside an array of {wide.size - 2 * ZONE} numbers")


def trial(number: int, *, plainly: bool = False) -> str:
    """Try one mutant, the ``number``-th; return "refused" or "accepted".

    Raises
    ------
    FindingError
        With what happened.
    """
    chance = random.Random(number)
    data = mutant(seed(*chance.choice(seeds())), chance)
    memory = _memory()
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            outcome = lived(data, chance, plainly=plainly)
        except (FindingError, KeyboardInterrupt):
            raise
        except BaseException as error:
            if plainly and not isinstance(error, IndexError):
                return "accepted"  # Python's own numbers overflow, and divide by zero, otherwise than compiled ones
            raise FindingError(f"{type(error).__name__}: {error}") from error
    if _memory() - memory > MOST_MEMORY:
        raise FindingError(f"took {_memory() - memory} MiB")
    return outcome


def lived(data: bytes, chance: random.Random, *, plainly: bool = False) -> str:
    """Load a checkpoint and, where it is accepted, do with the identifier all that can be done with one."""
    try:
        ident = rp.Identifier.from_bytes(data)
    except rp.DamagedCheckpointError as error:
        if not str(error) or "\n" in str(error) or len(str(error)) > 400:
            raise FindingError(f"no reason in one line: {error!r}") from error
        return "refused"
    except rp.SystemRefusedError:  # no memory for as large a buffer
        return "refused"
    _live(ident, chance, plainly=plainly)
    return "accepted"


def _live(ident: rp.Identifier, chance: random.Random, *, plainly: bool) -> None:
    # a large batch takes its time by right
    replay = ident.settings.replay if ident.settings is not None else None
    samples = 6 if plainly else max(4, min(40, 40_000 // (replay.batch_size if replay else 1)))
    u, y, t = record(2 * samples)
    stamped = chance.random() < 0.3
    first = float(np.nan_to_num(ident._state.last_time))
    r = reference(2 * samples) if ident.reference else None
    t = t + first
    looks = chance.random() < 0.4

    def at(k: int | slice) -> list[Any]:
        return [u[k], y[k], t[k] if stamped else None, None if r is None else r[k]]

    if not plainly:
        _step(ident, lambda: [ident.update(*at(k)) for k in range(3)])
        if looks:
            _step(ident, lambda: _look(ident))
    _step(ident, lambda: ident.update_many(*at(slice(3, samples))))
    if plainly:
        return
    saved = ident.to_bytes({"sequence": 1})
    again = _loaded(saved)
    if again is None:
        return
    if again.to_bytes({"sequence": 1}) != saved:
        raise FindingError("saved and loaded it is another one")
    _step(again, again.finish)
    if again.settings is not None and chance.random() < 0.3:
        _step(again, again.freeze)
        _step(again, again.resume)
    _step(again, lambda: again.update_many(*at(slice(samples, None))))
    if not looks:
        _step(again, lambda: _look(again))
    if chance.random() < 0.2 and not again.reference and (again.settings is None or again._state.buffer.nbytes < 2**20):
        rp.Ensemble(again, members=3).update_many(u[:8], y[:8])


def _loaded(data: bytes) -> rp.Identifier | None:
    """What was saved; None where a number has left float64 meanwhile, as numbers that someone made up may make it."""
    try:
        return rp.Identifier.from_bytes(data)
    except rp.DamagedCheckpointError as error:
        if "numbers that are not valid" in str(error) or "raw samples that are not valid" in str(error):
            return None
        raise FindingError(f"what it saved is refused: {error}") from error


def _look(ident: rp.Identifier) -> Any:
    known = ident.uncertainty
    return ident.assess(), ident.parameters, known.std, known.modes, str(ident.transfer_function), ident.recent


def _step(ident: rp.Identifier, act: Any) -> None:
    """Do something, between guard zones; only our own errors may be raised."""
    zones = Zones.of(ident)
    try:
        act()
    except rp.ReplantError:
        pass
    finally:
        zones.check()


def _memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


# --- narrow structures

NARROW = [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64, int]


def narrow_trial(number: int) -> str:
    """Build an identifier of numbers of any type; it is refused by name, or the same as that of plain ones."""
    chance = random.Random(number)

    def whole(low: int, high: int) -> Any:
        value, kind = chance.randint(low, high), chance.choice(NARROW)
        return np.array(value, kind) if chance.random() < 0.1 else kind(value) if value <= 127 else value

    def plain(value: Any) -> int:
        return int(value)

    poles = whole(1, 10)
    zeros = whole(0, plain(poles) - 1)
    cutoff, delay, dt = (
        chance.choice([float, np.float32, np.float64])(x) for x in (2.0, chance.choice([0, 0.5]), 0.25)
    )
    capacity, batch, warmup, init = whole(1, 100), whole(1, 5), whole(0, 9), whole(0, 9)

    def built(convert: Any, real: Any) -> rp.Identifier:
        return rp.Identifier(
            rp.Structure(convert(poles), convert(zeros), real(delay)),
            real(dt),
            filter=rp.StateVariableFilter(real(cutoff)),
            scaling=None,
            optimizer=rp.Gradient(real(cutoff)),
            replay=rp.Replay(convert(capacity), convert(batch), convert(warmup), convert(init)),
            instruments=False,
        )

    one, other = built(lambda x: x, lambda x: x), built(plain, float)
    if [array.shape for array in one._state.arrays] != [array.shape for array in other._state.arrays]:
        raise FindingError("arrays of another size")
    u, y, _ = record(12)
    zones = Zones.of(one)
    for ident in (one, other):
        ident.update_many(u, y)
    zones.check()
    if one.to_bytes() != other.to_bytes():
        raise FindingError("another identifier than that of plain numbers")
    return "accepted"
