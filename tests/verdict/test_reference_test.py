"""With a reference the test is right whatever the noise; and what is no reference is said to be none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import run_model
from replant.verdict import Assessment, assess_record
from replant.verdict.alternatives import unexplained_by_reference
from replant.verdict.evidence import Evidence
from replant.verdict.loop import Reference
from support.builders import binary
from support.cases import every
from support.loops import DT, Loop, coloured, controlled, steps

SAMPLES = 3000
PLANT, STRUCTURE, TRUE = rp.TransferFunction([1.0], [1.0, 1.4, 1.0]), rp.Structure(2), np.array([1.4, 1.0, 1.0])
UNSTABLE, ONE = rp.TransferFunction([1.0], [1.0, -1.0]), rp.Structure(1)


def loop_of(
    seed: int, noise: np.ndarray, plant: rp.TransferFunction = PLANT, gain: float = 2.0, integral: float = 1.0
) -> Loop:
    return controlled(plant, steps(seed, SAMPLES, 30), noise, gain=gain, integral=integral)


def verdict(
    loop: Loop, r: np.ndarray | None, structure: rp.Structure = STRUCTURE, model: Any = TRUE, std: float = 0.01
) -> Assessment:
    record = Record(loop.u, loop.y, np.array([DT]), r=r)
    return assess_record(structure, np.array(model), record, DT, np.diag(np.full(len(model), std**2)))


def said(found: Assessment, words: str) -> bool:
    return words in " ".join(found.reasons)


@every("with_reference", [False, True])
@every("colour", [0.0, 0.9])
def test_the_right_model_of_a_controlled_plant_is_trusted(colour: float, with_reference: bool) -> None:
    for seed in range(2):
        loop = loop_of(seed, 0.1 * coloured(seed, SAMPLES, colour))
        found = verdict(loop, loop.r if with_reference else None)
        assert found.status == "trusted", found
        assert said(found, "the loop is closed")


@every("with_reference", [False, True])
@every("model", [[2.2, 1.0, 1.0], [1.4, 1.3, 1.0], [1.4, 1.0, 1.3]])
def test_a_wrong_one_is_not(model: list[float], with_reference: bool) -> None:
    loop = loop_of(1, 0.1 * coloured(1, SAMPLES, 0.0))
    found = verdict(loop, loop.r if with_reference else None, model=model)
    assert found.status == "inconsistent"
    assert said(found, "the reference could explain another") == with_reference
    assert said(found, "give what is applied from outside") != with_reference


def test_whatever_the_noise_the_reference_explains_nothing_of_a_right_model_s_residual() -> None:
    """Noise that the autoregression does not take, an echo after 30 samples; 20 loops.

    The part explained has 14 degrees of freedom over a limit of 44: by chance one of 500 such tables has an alarm.
    """
    found = []
    for seed in range(20):
        noise = coloured(seed, SAMPLES + 30, 0.8)
        loop = loop_of(seed, 0.1 * (noise[30:] + 0.9 * noise[:-30]))
        record = Record(loop.u, loop.y, np.array([DT]))
        run = run_model(STRUCTURE, TRUE, record, DT)
        assert run is not None
        evidence = Evidence(STRUCTURE, DT, record, TRUE, None, TRUE, 0, SAMPLES)
        found.append(unexplained_by_reference(evidence, run, Reference.projected(loop.r, loop.u, loop.y)).statistic)
    assert max(found) < 1.0
    assert 0.15 < np.mean(found) < 0.45


def test_colour_beyond_the_noise_model_is_named_where_the_loop_is_closed() -> None:
    noise = coloured(1, SAMPLES + 3, 0.0)
    loop = loop_of(1, 0.1 * (noise[3:] - 0.9 * noise[:-3]), integral=0.0)
    found = verdict(loop, None)
    assert found.status == "inconsistent"
    assert said(found, "the loop is closed, and either its disturbances have more colour")
    assert said(found, "as the reference")
    assert verdict(loop, loop.r).status == "trusted"
    u = binary(1, SAMPLES, 5)  # in open loop colour is no fault of the model
    opened = Loop(u, PLANT.simulate(u, DT) + 0.1 * (noise[3:] - 0.9 * noise[:-3]), u)
    assert verdict(opened, None).status == "trusted"


def test_an_unstable_plant_is_trusted_with_a_reference_alone() -> None:
    loop = loop_of(2, 0.1 * coloured(2, SAMPLES, 0.5), UNSTABLE, gain=3.0, integral=0.0)
    right = verdict(loop, loop.r, ONE, [-1.0, 1.0])
    assert right.status == "trusted"
    assert said(right, "what the reference explains of the output")
    assert right.fit > 95.0
    alone = verdict(loop, None, ONE, [-1.0, 1.0])
    assert alone.status == "inconsistent"
    assert said(alone, "a pole at +1 rad/s")
    assert said(alone, "only a reference can show that an unstable model is right")
    assert said(alone, f"one step ahead over the last 300 s, the model fits the output to {alone.fit:.1f} %")
    assert verdict(loop, loop.r, ONE, [-1.3, 1.0]).status == "inconsistent"


@pytest.mark.parametrize("pole", [0.002, 0.0, -0.002])
def test_an_integrator_is_one_on_either_side_of_the_axis(pole: float) -> None:
    """Its pole is known to 0.01 rad/s, three times one over the record's length: in a loop that is well known."""
    integrator = rp.TransferFunction([1.0], [1.0, 1.0, 0.0])
    loop = loop_of(3, 0.2 * coloured(3, SAMPLES, 0.0), integrator, gain=1.0, integral=0.0)
    for r in (None, loop.r):
        assert verdict(loop, r, model=[1.0 - pole, -pole, 1.0]).status == "trusted"


def test_in_a_loop_a_coefficient_must_be_known_better() -> None:
    loop = loop_of(1, 0.1 * coloured(1, SAMPLES, 0.0))
    u = binary(1, SAMPLES, 5)
    opened = Loop(u, PLANT.simulate(u, DT) + 0.1 * coloured(1, SAMPLES, 0.0), u)
    for record, status in ((loop, "converging"), (opened, "trusted")):
        covariance = np.diag([0.13, 0.005, 0.005]) ** 2  # 6.5 %
        evidence = Record(record.u, record.y, np.array([DT]))
        assert assess_record(STRUCTURE, TRUE, evidence, DT, covariance).status == status


def test_what_is_no_reference_is_said_in_a_line() -> None:
    noise = 0.2 * coloured(4, SAMPLES, 0.0)
    loop = loop_of(4, noise)
    u = binary(4, SAMPLES, 5)
    opened = Loop(u, PLANT.simulate(u, DT) + noise, u)
    for record, r, status, words in (
        (loop, np.ones(SAMPLES), "not excited", "the reference stands still"),
        (loop, 2.0 * loop.u + 1.0, "inconsistent", "a copy of the input"),
        (opened, -opened.u, "trusted", "a copy of the input"),
        (loop, coloured(9, SAMPLES, 0.5), "not excited", "explains nothing of the input"),
        (loop, loop.r - 0.5 * loop.y, "inconsistent", "follows the disturbances"),
        (loop, loop.r, "trusted", "the loop is closed"),
    ):
        found = verdict(record, r)
        assert found.status == status, (words, found)
        assert said(found, words), found
