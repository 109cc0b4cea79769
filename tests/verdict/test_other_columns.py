"""Another column of the file is named where it is the cause of what a model leaves, and not where it looks like one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.verdict import Assessment
from replant.verdict.other_columns import OtherColumn, with_other_columns
from support.builders import binary, random_plant, record
from support.cases import every
from support.loops import closed_loop, coloured, steps

HEATER, PUMP = rp.TransferFunction([2 / 12], [1.0, 1 / 12], delay=3.0), rp.TransferFunction([-0.06], [1.0, 0.05])


def log_of(u: np.ndarray, y: np.ndarray, dt: float, **others: np.ndarray) -> rp.Log:
    return rp.Log(u, y, dt, None, "heater", "temp", Path("log.csv"), others=others)


def heated(seed: int, samples: int = 2000, share: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heater, pump and temperature: both move it, by independent steps."""
    u, p = binary(seed, samples, 25), binary(seed + 1, samples, 40)
    noise = 0.05 * np.random.default_rng(seed).standard_normal(samples)
    return u, p, HEATER.simulate(u, 1.0) + share * PUMP.simulate(p, 1.0) + noise


def named(log: rp.Log, poles: int = 1, delay: float = 3.0) -> tuple[OtherColumn, ...]:
    return rp.fit(log, poles=poles, delay=delay).other_columns


@every("seed", range(4), quick=1)
def test_a_second_input_is_named_with_its_part_of_what_is_left(seed: int) -> None:
    u, p, y = heated(seed)
    fitted = rp.fit(log_of(u, y, 1.0, pump=p), poles=1, delay=3.0)
    (pump,) = fitted.other_columns
    assert (pump.name, pump.left > 0.9, pump.bias < 0.02) == ("pump", True, True)
    assert any(reason.startswith("column pump explains ") for reason in fitted.verdict.reasons)
    assert fitted.model.verdict.reasons == fitted.verdict.reasons


@pytest.mark.slow
@every(
    "made",
    [
        lambda u, y: 2.0 * y + 1.0,
        lambda u, y: lfilter([0.2], [1.0, -0.8], y),
        lambda u, y: np.round(y, 1),
        lambda u, y: np.roll(y, 5),
        lambda u, y: np.convolve(y, np.ones(9) / 9, "same"),
        lambda u, y: np.gradient(y),
        lambda u, y: 1.0 - y,
        lambda u, y: -3.0 * u,
        lambda u, y: np.roll(u, 3),
        lambda u, y: lfilter([0.2], [1.0, -0.8], u),
        lambda u, y: u + np.where(np.arange(u.size) < 5, np.nan, 0.0),
        lambda u, y: np.arange(float(u.size)),
        lambda u, y: np.full(u.size, np.nan),
        lambda u, y: np.random.default_rng(5).standard_normal(u.size),
        lambda u, y: np.cumsum(np.random.default_rng(5).standard_normal(u.size)),
    ],
)
@pytest.mark.parametrize("poles", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_is_made_from_output_or_input_is_no_cause(made, poles: int) -> None:
    """Though a pump that nobody recorded leaves four fifths of the residual to be explained."""
    u, _, y = heated(3)
    assert named(log_of(u, y, 1.0, other=made(u, y)), poles) == ()


@every("seed", [6, 5, 10], quick=1)
def test_a_slow_effect_explains_no_more_than_the_residual_holds(seed: int) -> None:
    """The plant integrates with a lag and the model has one pole: most of what is left is the input's."""
    u, p = binary(seed, 300, 25), binary(seed + 50, 300, 40)
    noise = 0.001 * np.random.default_rng(seed).standard_normal(300)
    y = rp.TransferFunction([1.0], [1.0, 0.1, 0.0]).simulate(u + p, 0.1) + noise
    (pump,) = named(log_of(u, y, 0.1, pump=p), delay=0.0)
    assert 0.1 < pump.left < 0.5


def test_a_second_sensor_of_the_same_cause_is_not_named_beside_it() -> None:
    u, p, y = heated(3)
    second = PUMP.simulate(p, 1.0) + 0.1 * np.random.default_rng(9).standard_normal(u.size)
    found = named(log_of(u, y, 1.0, second=second, pump=p))
    assert [each.name for each in found] == ["pump"]


def test_the_two_heaters_of_a_laboratory(datasets: Path) -> None:
    from scipy.io import loadmat

    data = loadmat(datasets / "tclab" / "tclab_kuntz_rawlings_2022.mat", squeeze_me=True)["data"][()]
    (first, second), (one, other) = data["udat"].T.astype(float), data["ydat"].T
    assert [each.name for each in named(log_of(first, one, 1.0, Q2=second, T2=other), 2, 0.0)] == ["Q2"]
    assert [each.name for each in named(log_of(second, other, 1.0, Q1=first, T1=one), 1, 0.0)] == ["Q1"]


@every("seed", range(20), quick=6)
def test_independent_columns_are_hardly_ever_named(seed: int) -> None:
    """At the level ALPHA of each, none of 60."""
    u, y = record(random_plant(seed, 1 + seed % 3), seed, 1500, 0.1, noise=0.2)
    generator = np.random.default_rng(1000 + seed)
    log = log_of(
        u,
        y,
        0.1,
        walk=np.cumsum(generator.standard_normal(1500)),
        late=np.roll(u, 3),
        other=binary(seed + 50, 1500, 10),
    )
    assert named(log, 1 + seed // 3 % 3, 0.0) == (), seed


@every("seed", range(6), quick=2)
@every("poles", [1, 2])
def test_a_reference_and_a_control_error_are_not_named(seed: int, poles: int) -> None:
    r, load = steps(seed, 3000, 30), 0.2 * coloured(seed, 3000, 0.95)
    u, y = closed_loop([1.0], [1.0, 1.4, 1.0], (2.0, 1.0), 0.1, r, load, np.zeros(3000))
    assert named(log_of(u, y, 0.1, setpoint=r, error=r - y, integral=0.1 * np.cumsum(r - y)), poles, 0.0) == ()


def test_a_column_that_moves_with_the_input_biases_and_that_is_said() -> None:
    """The pump does as the heater does, three times of four."""
    u = heated(1, 4000)[0]
    together = np.where(np.repeat(np.random.default_rng(2).random(160) < 0.75, 25), u, np.repeat(binary(7, 160), 25))
    y = HEATER.simulate(u, 1.0) + PUMP.simulate(together, 1.0) + 0.05 * np.random.default_rng(4).standard_normal(4000)
    fitted = rp.fit(log_of(u, y, 1.0, pump=together), poles=1, delay=3.0)
    (pump,) = fitted.other_columns
    assert pump.bias > 0.01
    assert fitted.verdict.status == "inconsistent"
    assert "moves with the input" in fitted.verdict.reasons[0]


def test_a_longer_record_is_not_asked_for_where_another_column_is_the_cause() -> None:
    u, p, y = heated(3, 600)
    beside = rp.fit(log_of(u, y, 1.0, pump=p), poles=2, delay=3.0).verdict
    assert not any("times as long" in reason for reason in beside.reasons)
    assert beside.reasons[0].startswith("column pump explains")
    pump, unsure = OtherColumn("pump", 0.3, 0.9, 0.0), "a coefficient has a standard deviation of 40 %: "
    for more in ("record 7.1 times as long, ", "repeat it 2 times, ", "record more than 10000 times as long, or "):
        asked = Assessment("converging", (f"{unsure}{more}move the input more",))
        assert with_other_columns(asked, (pump,)).reasons == (pump.reason, f"{unsure}move the input more")


def test_the_time_is_never_an_input() -> None:
    for name in ("time", "t [s]", "Timestamp"):
        reason = OtherColumn(name, size=0.1, left=0.5, bias=0.2).reason
        assert (
            reason
            == f"column {name} explains 50 % of what is left: the output drifts, or the log holds several recordings"
        )
