"""Several logs of one rig give one model, each from a state of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from support.cases import every

TRUE = np.array([0.8, 4.0, 4.0])
DT = 0.05


def log(seed: int, noise: float = 0.05, delay: float = 0.0, samples: int = 1000, **more: Any) -> rp.Log:
    """A record that begins in full motion, at a level of 3."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-1.0, 1.0], (samples + 300) // 10), 10)
    y = 3.0 + rp.TransferFunction([4.0], [1.0, 0.8, 4.0], delay=delay).simulate(u, DT)
    y += noise * random.standard_normal(u.size)
    return rp.Log(u[300:], y[300:], DT, None, "u", "y", Path(f"log{seed}.csv"), **more)


@pytest.mark.slow
@every("delay", [0.4, 0.0], quick=1)
@every("identify", [rp.fit, rp.run])
def test_without_noise_the_plant_comes_out_exactly(identify: Callable[..., Any], delay: float) -> None:
    logs = [log(seed, 0.0, delay) for seed in (1, 2, 3)]
    model = identify(logs, structure=rp.Structure(2, delay=delay)).model
    np.testing.assert_allclose(model.parameters[:3], TRUE, rtol=1e-8)
    assert model.simulated_fit > 99.99
    assert model.provenance.source == "log1.csv, log2.csv, log3.csv"


def test_they_know_as_much_as_all_of_them() -> None:
    """The information adds up: four records have half the standard deviation of one, and the truth lies within."""
    alone, together = (rp.fit([log(seed) for seed in seeds], poles=2) for seeds in ([1], [1, 2, 3, 4]))
    assert alone.uncertainty is not None
    assert together.uncertainty is not None
    assert together.samples == 4000
    np.testing.assert_allclose(together.uncertainty.std / alone.uncertainty.std, 0.5, rtol=0.25)
    assert (np.abs(together.parameters - TRUE) / together.uncertainty.std).max() < 4.0
    assert together.verdict.status == "trusted"


def test_what_states_explain_speaks_for_no_input() -> None:
    """Each log decays from a state of its own, whatever the input does: G(s) is next to nothing, and not known."""
    random, t = np.random.default_rng(3), 0.1 * np.arange(200)
    decays = [
        rp.Log(
            random.choice([-1.0, 1.0], 20).repeat(10), 3.0 * k * np.exp(-0.5 * t) + 0.02 * random.normal(size=200), 0.1
        )
        for k in range(1, 7)
    ]
    verdict = rp.fit(decays, poles=1).verdict
    assert verdict.status != "trusted"
    assert verdict.reasons[0].startswith("the uncertainty of the estimate amounts to")


@pytest.mark.slow
def test_a_search_takes_them_too() -> None:
    found = rp.search([log(1), log(2)], poles=[1, 2], zeros=[0])
    assert found.best.structure == rp.Structure(2)


def test_one_log_in_a_list_is_that_log() -> None:
    np.testing.assert_array_equal(rp.fit([log(1)], poles=2).parameters, rp.fit(log(1), poles=2).parameters)


@pytest.mark.parametrize(
    ("other", "problem"),
    [
        (replace(log(2), dt=0.1), r"log2.csv has the sampling time 0.1 s, log1.csv 0.05 s; resample"),
        (replace(log(2), output_name="z"), r"log2.csv and log1.csv differ in output name: z, not y; give"),
        (replace(log(2), input_hold="foh", path=Path()), r"log 2 of 2 and log1.csv differ in input hold: foh, not zoh"),
        (replace(log(2), reference=np.zeros(1000), reference_name="r"), "differ in reference names: r, not none"),
    ],
)
def test_logs_that_do_not_belong_together_are_refused(other: rp.Log, problem: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=problem):
        rp.fit([log(1), other], poles=2)


@pytest.mark.slow
def test_a_unit_may_be_left_out_in_some_of_them() -> None:
    first, second = (replace(log(k), others={"w": log(k + 2).input}, more_inputs=("w",)) for k in (1, 2))
    stated = replace(second, input_name="u [V]", others={"w [V]": second.others["w"]}, more_inputs=("w [V]",))
    asked: dict[str, Any] = {"poles": [2, 1], "zeros": [0, 0]}
    np.testing.assert_array_equal(
        rp.fit([first, stated], **asked).parameters, rp.fit([first, second], **asked).parameters
    )
    with pytest.raises(rp.InvalidArgumentError, match=r"input names: u \[mV\], w, not u \[V\], w \[V\]; give"):
        rp.fit([stated, replace(second, input_name="u [mV]")], **asked)


def test_an_empty_log_is_named() -> None:
    empty = replace(log(2), input=np.empty(0), output=np.empty(0))
    with pytest.raises(rp.InvalidArgumentError, match=r"log2.csv has no samples"):
        rp.fit([log(1), empty], poles=2)


def test_they_stand_alone() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="give them alone"):
        rp.fit([log(1), log(2)], None, DT, poles=2)


@pytest.mark.parametrize("delay", [0.0, 0.4])
def test_each_may_begin_at_another_level(delay: float) -> None:
    """Without noise the plant comes out exactly, and so does the output of each."""
    logs = []
    for k, seed in enumerate((1, 2, 3)):
        one = log(seed, 0.0, delay)
        logs.append(replace(one, input=one.input + 5.0 * k, output=one.output - 7.0 * k))
    fitted = rp.fit(logs, structure=rp.Structure(2, delay=delay))
    np.testing.assert_allclose(fitted.parameters[:3], TRUE, rtol=1e-6)
    assert fitted.simulation.fit > 99.99
    assert fitted.verdict.status == "trusted"
