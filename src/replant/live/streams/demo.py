"""Sources without a rig: a recorded log in real time or faster, and the simulated actuator and motor."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.live.streams.addresses import Address
from replant.live.streams.reader_thread import Source
from replant.live.streams.source import UY, Batch, Columns, Signals, together
from replant.logs import read_columns
from replant.logs.merged_channels import on_one_clock, written_apart
from replant.logs.read import columns_by_role
from replant.logs.sampling_time import FIRST, time_columns, unit_of_column
from replant.model import state_space
from replant.model.state_space import Response
from replant.numerics.arguments import FloatArray
from replant.rigs import Rig, deap_rig, motor_rig
from replant.signals import random_steps, white_noise

REPLAYED = 1 << 12  # most samples handed over at once [samples]
LONGEST_PAUSE = 3600.0  # longest single pause: the system's timers may refuse a longer one [s]


#: Gives blocks of a record with their times in s; it may skip blocks up to the number of the last sample, if given.
Blocks = Callable[[int | None], Iterable[tuple[Batch, FloatArray]]]


class Played(Source):
    """A record that is played at a multiple of real time."""

    waits = True
    capacity = 4 * REPLAYED

    def __init__(self, name: str, speed: float, blocks: Blocks, refused: int = 0) -> None:
        super().__init__(name)
        self._speed, self._blocks = speed, blocks
        self._counts["time not finite"] += refused

    def _read(self) -> None:
        self._connected()
        last, start, begun = self._numbering.last, math.nan, 0.0
        for block, times in self._blocks(last):
            assert block.sequence is not None
            at = 0 if last is None else int(np.searchsorted(block.sequence, last, side="right"))
            if math.isnan(start) and at < len(block):
                start, begun = float(times[at]), time.monotonic()
            while at < len(block):
                if self._stop.requested:
                    return
                now = math.inf if math.isinf(self._speed) else start + (time.monotonic() - begun) * self._speed
                due = int(np.searchsorted(times, now, side="right"))
                end = min(due, at + REPLAYED)
                if end > at:
                    self._deliver(replace(block.select(slice(at, end)), arrived=time.monotonic()))
                    at = end
                else:
                    self._stop.wait(min((float(times[at]) - now) / self._speed, LONGEST_PAUSE))


def open_replay(address: Address, columns: Columns, signals: Signals) -> Played:
    """Return the source of a log, ``log.csv?input=u&output=y&reference=r&speed=10``; its rows are numbered from 0."""
    address.allow("input", "output", "reference", "time", "dt", "speed")
    options, table = address.options, read_columns(Path(address.path))
    speed, dt = speed_of(address, math.inf), address.number("dt")
    if dt is not None and "time" in options:
        raise InvalidArgumentError(f"{address.name}: give either time or dt")
    named = [table.find(options["time"])] if "time" in options else time_columns(table)
    inputs, output = signals.inputs, signals.output
    if signals == UY:
        inputs, output = (options.get("input", "u"),), options.get("output", "y")
    elif {"input", "output"} & options.keys():
        raise InvalidArgumentError(f"{address.name}: name the signals in the address or with -i and -o, not both")
    keys = columns_by_role(inputs, output, options.get("reference"))
    roles, is_timed = {role: table.find(key) for role, key in keys.items()}, dt is not None or "time" in options
    if len(named) == 1 and dt is None and (is_timed or table.stamps is None):
        roles["time"] = named[0]
    merged = written_apart(table, roles, dt) if dt is not None or "time" in roles else None
    table, roles = merged or on_one_clock(table, roles, is_timed=is_timed)
    read = table.columns(list(roles.values()))
    rows = min(column.size for column in read)
    of = dict(zip(roles, (column[:rows] for column in read), strict=True))
    u = together([column for role, column in of.items() if role.startswith("input")])
    record = Batch(u, of["output"], None, np.arange(rows), 0.0, of.get("reference"))
    if "time" not in of:
        if dt is None and not math.isinf(speed):
            raise InvalidArgumentError(f"{address.name}: no time column found; add &time=COLUMN or &dt=SECONDS")
        elapsed = np.arange(rows, dtype=np.float64) * (dt or 0.0)
        return Played(address.name, speed, lambda last: [(record, elapsed)])
    t = of["time"] * unit_of_column(table, roles["time"], of["time"][:FIRST]).seconds
    kept = np.isfinite(t)
    elapsed = np.maximum.accumulate(t[kept]) - t[kept][:1]
    timed, refused = replace(record, t=t).select(kept), int(kept.size - kept.sum())
    return Played(address.name, speed, lambda last: [(timed, elapsed)], refused)


def speed_of(address: Address, default: float) -> float:
    """Return the option ``speed`` of a URL: a positive number, or infinity for ``max``."""
    if address.options.get("speed") == "max":
        return math.inf
    return address.number("speed") or default


_LOOP_BLOCK = 1 << 12  # samples simulated at once; seed and block number determine their random signals [samples]
PROPORTIONAL = 0.3  # gain of the controller: the loop's poles are at -7 and -43 rad/s [V per rad/s]
INTEGRAL = 0.6  # integral gain of the controller [V per rad]
LOWEST, HIGHEST = 30.0, 70.0  # range of the set-point [rad/s]
SHORTEST, LONGEST = 50, 400  # shortest and longest step of the set-point [samples]
DITHER = 1.0  # amplitude of a binary dither of the set-point, which excites the loop between steps [rad/s]
DITHER_HOLD = 5  # samples that each value of the dither is held [samples]
LOAD = 0.4  # standard deviation of the load, as an equivalent voltage [V]
LOAD_TIME = 0.5  # correlation time of the load [s]


def controlled(seed: int, skip: int = 0) -> Iterator[tuple[int, FloatArray, FloatArray, FloatArray]]:
    """Yield blocks of 4096 samples: the number of the first one, voltage in V, speed and reference in rad/s.

    The controller sets u_k = 0.3 (r_k - y_k) + integral of 0.6 (r - y) at each sample; y = G(s) (u + load) + noise.
    """
    rig, state = motor_rig(), np.zeros(4)
    for number, draw in _draws(seed, 1):
        r = set_point(_LOOP_BLOCK, draw)
        u, y, state = _one_block(rig, r, state, draw)
        if number >= skip:
            yield number * _LOOP_BLOCK, u, y, r


def _draws(seed: int, *more: int) -> Iterator[tuple[int, int]]:
    """Yield the number of each block, and the seed of its random signals."""
    for number in itertools.count():
        yield number, int(np.random.SeedSequence([seed, number, *more]).generate_state(1, np.uint64)[0])


def set_point(samples: int, seed: int) -> FloatArray:
    """Return a reference (K,) in rad/s: steps of 0.5 to 4 s between 30 and 70 rad/s, with a dither added."""
    steps = random_steps(samples, shortest=SHORTEST, longest=LONGEST, low=LOWEST, high=HIGHEST, seed=seed)
    return steps + _up_and_down(samples, DITHER, DITHER_HOLD, seed)


def _up_and_down(samples: int, size: float, hold: int, seed: int) -> FloatArray:
    """Return a random binary signal (K,) of values +-``size``, each held for ``hold`` samples."""
    signs = np.random.default_rng([seed, 1]).choice([-1.0, 1.0], -(-samples // hold))
    return size * np.repeat(signs, hold)[:samples]


def _one_block(rig: Rig, r: FloatArray, state: FloatArray, draw: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return voltage and speed (K,) for the reference ``r`` (K,), and the final state."""
    model = state_space.companion(rig.plant.den)
    transition, column, _ = state_space.exact(model.matrix, model.column, rig.dt, "zoh")
    (a, b), (c, d) = transition.tolist()
    to_first, to_second = column.tolist()
    gain = float(rig.plant.num[0] / model.scale[-1])
    keep = math.exp(-rig.dt / LOAD_TIME)
    kicks = white_noise(r.size, LOAD * math.sqrt(1.0 - keep * keep), draw + 1).tolist()
    first, second, load, integral = state.tolist()
    voltages, speeds = [], []
    for set_to, noise, kick in zip(r.tolist(), white_noise(r.size, rig.noise, draw + 2).tolist(), kicks, strict=True):
        speed = gain * second + noise
        voltage = PROPORTIONAL * (set_to - speed) + integral
        voltages.append(voltage)
        speeds.append(speed)
        integral += INTEGRAL * rig.dt * (set_to - speed)
        acts = voltage + load
        first, second = a * first + b * second + to_first * acts, c * first + d * second + to_second * acts
        load = keep * load + kick
    return np.array(voltages), np.array(speeds), np.array([first, second, load, integral])


BLOCK = 1 << 16  # samples simulated at once; input and noise depend on the seed and the block's number [samples]
LONGEST_STEP = 4000  # longest step of the voltage: the slow mode shows within seconds [samples]
FLUTTER = 0.2  # amplitude of a binary dither of the voltage, which also excites the resonance at 12 Hz [kV]
FLUTTER_HOLD = 20  # samples that each value of the dither is held [samples]
#: The values of the option loop: the actuator, driven from outside, or the motor under a controller.
LOOPS = "none", "pi"


def open_demo(address: Address, columns: Columns, signals: Signals) -> Played:
    """Return `deap_rig` driven by `demo_voltage`, or with ``loop=pi`` the controlled motor; seeded."""
    speed = speed_of(address, 1.0)
    address.allow("speed", "seed", "loop")
    looped = address.one_of("loop", LOOPS, "none") == "pi"
    seed = int(address.number("seed", least=0, example=0) or 0)

    def blocks(last: int | None) -> Iterator[tuple[Batch, FloatArray]]:
        at = 0 if last is None else max(last + 1, 0)
        made: Any = controlled(seed, at // _LOOP_BLOCK) if looped else simulated(seed, at // BLOCK)
        dt = motor_rig().dt if looped else deap_rig().dt
        for first, u, y, *reference in made:
            sequence = np.arange(first, first + u.size)
            t = np.asarray(sequence * dt)
            yield Batch(u, y, t, sequence, 0.0, *reference), t

    return Played(address.name, speed, blocks)


def simulated(seed: int, skip: int = 0) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Yield blocks of samples: the number of the first one, voltage (`BLOCK`,) in kV, displacement (`BLOCK`,) in mm."""
    rig = deap_rig()
    preprocess, response = rig.preprocess, Response(rig.plant, rig.dt)
    for number, draw in _draws(seed):
        u = demo_voltage(BLOCK, draw)
        still = rig.output_rest + response.take(preprocess.map_input(u) - float(preprocess.input_offset)).output
        if number >= skip:
            yield number * BLOCK, u, still + white_noise(BLOCK, rig.noise, draw + 1)


def demo_voltage(samples: int, seed: int) -> FloatArray:
    """Return an input (K,) between 2 and 5.5 kV: steps of 10 ms to 4 s with a random binary dither added."""
    steps = random_steps(samples, shortest=10, longest=LONGEST_STEP, low=2.0 + FLUTTER, high=5.5 - FLUTTER, seed=seed)
    return steps + _up_and_down(samples, FLUTTER, FLUTTER_HOLD, seed)
