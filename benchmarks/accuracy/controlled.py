"""Scenario K: plants under a controller."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

import replant as rp
from accuracy.experiment import Experiment, Method
from accuracy.feedback import Feedback, Promised, sizes
from accuracy.loops import Controller, Disturbance, KnowsTheController, Loop
from accuracy.methods import Offline, Online

ONLINE, ONLINE_R = "online", "online, with r"
OFFLINE, OFFLINE_R = "offline", "offline, with r"
ANCHOR = "anchor: knows the controller"
METHODS: dict[str, Method] = {
    ONLINE: Online(judges=True),
    ONLINE_R: Online(with_reference=True, judges=True),
    OFFLINE: Offline(),
    OFFLINE_R: Offline(with_reference=True),
}

#: Plant, sampling time, controller, samples that the set-point is held, number of the seed.
CASES = {
    "lag": (rp.TransferFunction([1.0], [1.0, 1.0]), 0.05, Controller(5.0), 20, 12),
    "second-order": (rp.TransferFunction([1.0], [1.0, 1.4, 1.0]), 0.1, Controller(2.0, 1.0), 30, 18),
    "light": (rp.TransferFunction([1.0], [1.0, 0.2, 1.0]), 0.05, Controller(1.0, 0.5, 1.0, 0.1), 60, 17),
    "integrator": (rp.TransferFunction([1.0], [1.0, 1.0, 0.0]), 0.05, Controller(1.0), 60, 15),
    "unstable": (rp.TransferFunction([1.0], [1.0, -1.0]), 0.05, Controller(3.0), 20, 12),
}
RIGHT = Promised(bias=2.0, rms=1.4, is_covered=True, is_trusted=True)
WITH_R = {ONLINE_R: RIGHT, OFFLINE_R: replace(RIGHT, online=ONLINE_R, is_trusted=False)}
#: Without r: of noise that an autoregression describes, of a load, and of a plant that is not stable.
DESCRIBED = Promised(bias=3.0, rms=1.4, is_trusted=True)
LOAD = Promised(rms=2.5)
UNSTABLE = {ONLINE: Promised(never_wrong=True)}
#: Disturbance, number of the seed, words, what is promised without r of stable plants.
LEVELS = {
    "white-10": (Disturbance((1.0,), (1.0,), 10.0), 5, "white noise, 10 dB", DESCRIBED),
    "ar-20": (Disturbance((1.0,), (1.0, -0.9), 20.0), 2, "noise with a pole at 0.9, 20 dB", DESCRIBED),
    "ar-10": (Disturbance((1.0,), (1.0, -0.9), 10.0), 2, "noise with a pole at 0.9, 10 dB", DESCRIBED),
    "load-10": (Disturbance((1.0,), (1.0, -0.95), 10.0, at_input=True), 4, "load with a pole at 0.95, 10 dB", LOAD),
}
#: Families whose runs are counted together where at most 1 % may be wrong and trusted.
ALL_WITH_R, ALL_LOADS = "with r", "without r, load"


def scenario_k() -> Iterator[Experiment]:
    """The loops of the four levels, the hard plants, the published loop."""
    yield from simple_loops()
    yield from hard_loops()
    yield from published_loops()


def simple_loops() -> Iterator[Experiment]:
    """Plants of order one and two under P, PI and PID, set-point drawn anew every second to three seconds."""
    for key, (plant, dt, controller, hold, chance) in CASES.items():
        for level, (disturbance, other, words, without) in LEVELS.items():
            seeds = (round(disturbance.decibels), chance, other)
            loop = Loop(plant, dt, controller, hold, (disturbance,), seeds)
            families = {ONLINE_R: ALL_WITH_R}
            if plant.poles.real.max() > 0.0:
                promised = WITH_R | UNSTABLE
            else:
                offline = replace(without, online=ONLINE, is_trusted=False)
                promised = WITH_R | {ONLINE: without, OFFLINE: offline}
                families |= {ONLINE: ALL_LOADS} if disturbance.at_input else {}
            yield experiment(f"{key} {level}", f"{plant}, {words}", loop, 50, promised, families)


def hard_loops() -> Iterator[Experiment]:
    """A ball on a beam and an oven: promised is what is promised with a reference."""
    # x'' = 5/7 g angle, a solid ball rolling; the beam's angle (rad) from the ball's place (m); poles at 1.5 rad/s;
    # a new set-point every 1.5 s: one every 5 s tells so little that the anchor is 10 % off
    beam = Loop(rp.TransferFunction([7.0], [1.0, 0.0, 0.0]), 0.02, Controller(0.32, 0.0, 0.3, 0.05), 75, (), (1,), 6000)
    camera = Disturbance((1.0,), (1.0,), 20.0)
    tilt = Disturbance((1.0,), (1.0, -0.98), 20.0, at_input=True)
    for key, what, disturbances in (
        ("camera", "white noise of the camera, 20 dB", (camera,)),
        ("tilt", "the same and a tilt of the beam with a pole at 0.98, 20 dB", (camera, tilt)),
    ):
        loop = replace(beam, disturbances=disturbances)
        yield experiment(f"ball-and-beam {key}", f"7/s^2 under PD, {what}", loop, 50, WITH_R, {ONLINE_R: ALL_WITH_R})
    # 0.8 K/%, 300 s, 30 s of dead time, 48 h; the door opens: another load each hour; set-point anew every 20 min;
    # sampled at a tenth of the time constant
    oven = rp.TransferFunction([0.8 / 300.0], [1.0, 1.0 / 300.0], 30.0)
    load = Disturbance((1.0,), (1.0,), 10.0, at_input=True, held=120)
    thermometer = Disturbance((1.0,), (1.0,), 30.0)
    loop = Loop(oven, 30.0, Controller(2.9, 2.9 / 300.0), 40, (load, thermometer), (2,), 5760)
    title = "0.8/(300s+1) after 30 s under PI, a load that steps once an hour, 10 dB, thermometer 30 dB"
    yield experiment("oven load", title, loop, 50, WITH_R, {ONLINE_R: ALL_WITH_R})


def published_loops() -> Iterator[Experiment]:
    """The loop of Gilson et al.: r is a PRBS of 4 bits held 2.5 s, added at the plant's input; 10 % of noise."""
    plant = rp.TransferFunction([1.0, 1.0], [1.0, 0.5, 1.0])
    white = Disturbance((1.0,), (1.0,), 20.0)
    coloured = Disturbance((1.0, 0.5), (1.0, -0.85), 20.0)
    base = Loop(plant, 0.005, Controller(10.0, 15.0), 500, (), (7,), 7500, bits=4, at_input=True)
    for analogue in (False, True):
        for key, what, disturbance in (("white", "white", white), ("coloured", "coloured", coloured)):
            loop = replace(base, disturbances=(disturbance,), analogue=analogue)
            stays = Promised(stays=True)
            yield published("analogue" if analogue else "discrete", key, what, loop, {ONLINE: stays, ONLINE_R: stays})
    loop = replace(base, disturbances=(coloured,), samples=75_000)
    near = Promised(bias=0.5, standard_errors=0.0, stays=True)
    yield published("discrete", "long", "coloured, 75,000 samples", loop, {ONLINE_R: near, OFFLINE_R: near})


def published(controller: str, key: str, noise: str, loop: Loop, promised: Mapping[str, Promised]) -> Experiment:
    """Return an experiment on the published loop; errors are in percent of the coefficients themselves."""
    title = f"{loop.plant} under {'an analogue' if loop.analogue else 'a discrete'} PI, noise {noise}, 10 %"
    methods = METHODS if loop.analogue else METHODS | {ANCHOR: KnowsTheController(loop)}
    own = np.abs(loop.truth)
    return experiment(f"published {controller}-{key}", title, loop, 100, promised, {}, methods, own)


def experiment(
    key: str,
    title: str,
    loop: Loop,
    runs: int,
    promised: Mapping[str, Promised],
    families: Mapping[str, str],
    methods: Mapping[str, Method] | None = None,
    scales: Sequence[float] | np.ndarray | None = None,
) -> Experiment:
    """Return an experiment on a loop, with the anchor that knows its controller."""
    structure = rp.Structure(loop.plant.den.size - 1, loop.plant.num.size - 1, delay=loop.plant.delay)
    scales = sizes(loop.plant) if scales is None else scales
    return Experiment(
        f"K {key}",
        title,
        structure,
        loop.dt,
        runs,
        loop,
        methods or METHODS | {ANCHOR: KnowsTheController(loop)},
        dict(zip(structure.names, loop.truth.tolist(), strict=True)),
        feedback=Feedback(dict(zip(structure.names, map(float, scales), strict=True)), promised, families, ANCHOR),
    )
