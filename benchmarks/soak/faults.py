"""What goes wrong at a rig, in samples: each fault changes the rig, or what its sensor and clock say of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from replant.numerics.arguments import FloatArray
from soak.rig import Rig

Samples = tuple[FloatArray, FloatArray, FloatArray]
#: Called with the samples of the fault as they come, in pieces; returns what arrives.
Fault = Callable[[Samples], Samples]


def _seconds(rig: Rig, low: float, high: float) -> float:
    """Return a random length of time, evenly spread in its logarithm."""
    return float(np.exp(rig.rng.uniform(math.log(low), math.log(high))))


def _factor(rig: Rig) -> float:
    """Return by how much the plant changes: a quarter to threefold, up or down."""
    factor = rig.rng.uniform(1.25, 3.0)
    return float(factor if rig.rng.random() < 0.5 else 1.0 / factor)


def outliers(rig: Rig) -> tuple[float, Fault]:
    """Single outputs that are 5 to 10,000 times off."""
    part = rig.rng.uniform(0.0005, 0.02)

    def fault(samples: Samples) -> Samples:
        u, y, t = samples
        hit = rig.rng.random(y.size) < part
        size = rig.spread * 10.0 ** rig.rng.uniform(0.7, 4.0, y.size) * rig.rng.choice([-1.0, 1.0], y.size)
        return u, y + np.where(hit, size, 0.0), t

    return _seconds(rig, 5.0, 600.0), fault


def burst(rig: Rig) -> tuple[float, Fault]:
    """Strong noise for a while."""
    size = rig.spread * 10.0 ** rig.rng.uniform(-0.3, 1.0)
    return _seconds(rig, 0.2, 30.0), lambda s: (s[0], s[1] + size * rig.rng.standard_normal(s[1].size), s[2])


def stuck(rig: Rig) -> tuple[float, Fault]:
    """The sensor says the same number."""
    last: list[float] = []

    def fault(samples: Samples) -> Samples:
        u, y, t = samples
        last.append(float(y[0]))
        return u, np.full(y.size, last[0]), t

    return _seconds(rig, 0.5, 300.0), fault


def saturated(rig: Rig) -> tuple[float, Fault]:
    """The sensor's scale ends within what the output does."""
    end = rig.spread * rig.rng.uniform(0.3, 1.5)
    middle = rig._rest + rig.load

    return _seconds(rig, 10.0, 600.0), lambda s: (s[0], np.clip(s[1], middle - end, middle + end), s[2])


def floating(rig: Rig) -> tuple[float, Fault]:
    """The cable is off: noise, and hum at a random frequency."""
    size, hum = rig.spread * 10.0 ** rig.rng.uniform(-1.0, 0.7), rig.rng.uniform(0.2, 30.0)

    def fault(samples: Samples) -> Samples:
        u, y, t = samples
        return u, size * (rig.rng.standard_normal(y.size) + np.sin(math.tau * hum * t)), t

    return _seconds(rig, 1.0, 300.0), fault


def dropout(rig: Rig) -> tuple[float, Fault]:
    """No output: NaN."""
    return _seconds(rig, 0.1, 120.0), lambda s: (s[0], np.full(s[1].size, np.nan), s[2])


def lost(rig: Rig) -> tuple[float, Fault]:
    """A part of the samples does not arrive."""
    part = rig.rng.uniform(0.01, 0.4)

    def fault(samples: Samples) -> Samples:
        there = rig.rng.random(samples[0].size) >= part
        there[-1] = True
        u, y, t = samples
        return u[there], y[there], t[there]

    return _seconds(rig, 5.0, 300.0), fault


def gap(rig: Rig) -> tuple[float, Fault]:
    """Nothing arrives for a while."""
    rig.skip(_seconds(rig, 1.0, 600.0))
    return 0.0, _nothing


def clock_forward(rig: Rig) -> tuple[float, Fault]:
    """Time stamps leap ahead, for good."""
    rig.now += 2.0 ** rig.rng.integers(8, 31)
    return 0.0, _nothing


def clock_back(rig: Rig) -> tuple[float, Fault]:
    """Time stamps leap back, for good."""
    rig.now -= 2.0 ** rig.rng.integers(4, 20)
    return 0.0, _nothing


def gain_change(rig: Rig) -> tuple[float, Fault]:
    """The plant's gain is another one."""
    rig.change(gain=_factor(rig))
    return 0.0, _nothing


def pole_change(rig: Rig) -> tuple[float, Fault]:
    """The plant's poles are faster or slower, its static gain as before."""
    rig.change(speed=min(max(rig.speed * _factor(rig), 0.4), 2.5) / rig.speed)
    return 0.0, _nothing


def load_step(rig: Rig) -> tuple[float, Fault]:
    """A disturbance steps, for good."""
    rig.load += rig.spread * rig.rng.uniform(0.3, 5.0) * rig.rng.choice([-1.0, 1.0])
    return 0.0, _nothing


def idle(rig: Rig) -> tuple[float, Fault]:
    """The input stands still."""
    rig.held = rig._u
    return _seconds(rig, 30.0, 3600.0), _nothing


def changed_at_rest(rig: Rig) -> tuple[float, Fault]:
    """The input stands still, and meanwhile the plant's gain changes."""
    rig.held = rig._u
    rig.change(gain=_factor(rig))
    return _seconds(rig, 30.0, 1800.0), _nothing


def garbled(rig: Rig) -> tuple[float, Fault]:
    """Numbers of 1e12 to 1e300, infinite ones and none, in input, output and time stamp."""

    def fault(samples: Samples) -> Samples:
        columns = [column.copy() for column in samples]
        for column in columns:
            hit = rig.rng.random(column.size) < 0.002
            column[hit] = rig.rng.choice([1e12, -1e12, 1e16, -1e16, 1e300, np.inf, -np.inf, np.nan], int(hit.sum()))
        return columns[0], columns[1], columns[2]

    return _seconds(rig, 5.0, 120.0), fault


def restart(rig: Rig) -> tuple[float, Fault]:
    """The session ends and goes on from its checkpoint a while later."""
    rig.skip(_seconds(rig, 1.0, 600.0))
    return 0.0, _nothing


def nothing(rig: Rig) -> tuple[float, Fault]:
    """No fault: what is said in good order."""
    return 0.0, _nothing


def _nothing(samples: Samples) -> Samples:
    return samples


FAULTS: dict[str, Callable[[Rig], tuple[float, Fault]]] = {
    function.__name__: function
    for function in (
        nothing, outliers, burst, stuck, saturated, floating, dropout, lost, gap, clock_forward, clock_back,
        gain_change, pole_change, load_step, idle, changed_at_rest, garbled, restart,
    )
}  # fmt: skip


def deck(rng: np.random.Generator) -> Iterator[str]:
    """Yield faults in random order, each as often as any other."""
    while True:
        yield from (str(name) for name in rng.permutation(list(FAULTS)))
