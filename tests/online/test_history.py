"""Raw samples kept: the room that they take, what is made of fewer, and of none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.dimensions import FIRST_ROOM, room_for
from replant.estimation.settings import STORED
from support.cases import every

DT = 0.1


def record(samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 10 + 1), 10)[:samples]
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, DT)
    return u, y + 0.05 * rng.standard_normal(samples)


def test_there_is_room_for_the_samples_and_at_most_as_many_again() -> None:
    u, y = record(STORED + 5000)
    ident = rp.Identifier(poles=1, dt=DT)
    for end in (400, 600, FIRST_ROOM - 1, FIRST_ROOM, FIRST_ROOM + 1, 5000, STORED - 1, STORED, u.size):
        begin = ident.samples
        ident.update_many(u[begin:end], y[begin:end])
        rows = len(ident._state.recent)
        assert rows == room_for(end - 1, STORED) or rows == room_for(end, STORED)
        assert min(end, STORED) <= rows <= max(2 * end, FIRST_ROOM)
    np.testing.assert_allclose(ident.recent[:, 0], u[-len(ident.recent) :], atol=1e-12)


def test_the_room_does_not_depend_on_how_the_samples_come() -> None:
    u, y = record(FIRST_ROOM + 10)
    chunk, single = rp.Identifier(poles=1, dt=DT), rp.Identifier(poles=1, dt=DT)
    chunk.update_many(u, y)
    for sample in zip(u.tolist(), y.tolist(), strict=True):
        single.update(*sample)
    assert chunk.to_bytes() == single.to_bytes()


def test_a_long_start_up_has_room_as_well() -> None:
    u, y = record(3000)
    ident = rp.Identifier(poles=1, dt=DT, startup=2500)
    ident.update_many(u[:2400], y[:2400])
    assert (ident.status, len(ident._state.recent)) == ("starting", 4096)
    again = rp.Identifier.from_bytes(ident.to_bytes())
    for one in (ident, again):
        one.update_many(u[2400:], y[2400:])
    assert ident.status == "running"
    assert again.to_bytes() == ident.to_bytes()


def of(history: int, u: np.ndarray, y: np.ndarray, poles: int = 1) -> rp.Identifier:
    ident = rp.Identifier(poles=poles, dt=DT, history=history)
    ident.update_many(u, y)
    return ident


@every("history", [0, 1, 100, 199, 200, 1000, 5000], quick=2)
def test_no_more_raw_samples_are_kept_than_wanted(history: int) -> None:
    u, y = record(6000)
    ident = of(history, u, y)
    assert len(ident._state.recent) == history
    np.testing.assert_allclose(ident.recent[:, 1], y[y.size - history :], atol=1e-12)
    again = rp.Identifier.from_bytes(ident.to_bytes())
    assert again.to_bytes() == ident.to_bytes()
    for one in (ident, again):
        one.update_many(u, y)
        one.finish()
    assert again.to_bytes() == ident.to_bytes()
    np.testing.assert_array_less(np.abs(ident.parameters - [0.5, 2.0]), 5.0 * np.sqrt(np.diag(ident.covariance)))


@pytest.mark.parametrize("history", [-1, STORED + 1, 0.5, "all"])
def test_a_history_that_cannot_be_kept_is_refused(history: object) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match="history"):
        rp.Identifier(poles=1, dt=DT, history=history)  # type: ignore[arg-type]


def test_without_samples_an_identifier_of_two_poles_takes_eight_kilobytes() -> None:
    u, _ = record(3000)
    y = rp.TransferFunction([1.0], [1.0, 1.2, 0.5]).simulate(u, DT) + 0.05 * np.random.default_rng(1).standard_normal(
        3000
    )
    ident = of(0, u, y, poles=2)
    assert ident.status == "running"
    assert sum(array.nbytes for array in ident._state.arrays) <= 8000
    assert len(ident.to_bytes()) <= 8000


def test_without_samples_the_verdict_is_made_from_sums_and_says_so() -> None:
    u, y = record(4000)
    ident = of(0, u, y)
    verdict, model = ident.assess(), ident.model
    assert verdict.status == "trusted"
    assert any("history=0" in reason and "to solve the record again" in reason for reason in verdict.reasons)
    noise = 0.05 / float(np.std(y))  # of the output's amplitude
    assert verdict.fit == pytest.approx(100.0 * (1.0 - noise), abs=0.5)
    assert model.simulated_fit == verdict.fit
    assert model.output_level == pytest.approx(float(ident.settings.preprocess.output_offset))  # type: ignore[union-attr]


def test_without_samples_the_verdict_of_a_model_before_the_input_rests_stays() -> None:
    u, y = record(4000)
    u = np.append(u, np.full(8000, u[-1]))
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, DT) + 0.05 * np.random.default_rng(1).standard_normal(12_000)
    verdict = of(0, u, y).assess()
    assert (verdict.status, verdict.excited) == ("trusted", False)
    still = of(0, np.ones(2000), y[:2000])
    assert still.assess().status in {"not excited", "converging"}


def test_without_samples_a_change_is_noticed_and_nothing_is_learned() -> None:
    u, y = record(6000)
    y[3000:] = rp.TransferFunction([4.0], [1.0, 0.5]).simulate(u, DT)[3000:]
    ident = of(0, u[:3000], y[:3000])
    before = ident.parameters
    ident.update_many(u[3000:], y[3000:])
    verdict = ident.assess()
    assert verdict.status == "inconsistent"
    assert "reset begins anew" in verdict.reasons[0]
    np.testing.assert_allclose(ident.parameters, before, rtol=0.02)
    ident.reset()
    ident.update_many(u[3000:], y[3000:])
    assert ident.assess().status == "trusted"
    np.testing.assert_allclose(ident.parameters, [0.5, 4.0], rtol=0.02)


def test_a_short_history_finds_a_change() -> None:
    u, y = record(6000)
    y[3000:] += rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, DT)[3000:]
    ident = of(1000, u, y)
    assert ident.assess().status == "trusted"
    np.testing.assert_allclose(ident.parameters, [0.5, 4.0], rtol=0.02)


def test_an_optimizer_without_sums_says_that_it_needs_samples() -> None:
    u, y = record(1000)
    ident = rp.Identifier(poles=1, dt=DT, optimizer="amsgrad", history=0)
    ident.update_many(u, y)
    assert "give history=1000" in ident.assess().reasons[0]


def test_a_checkpoint_of_the_version_before_goes_on() -> None:
    """It is of 60 samples, made by the version that wrote format 5.

    Its numbers are those of today but for rounding.
    """
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 20), 5)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, DT) + 0.01 * rng.standard_normal(100)
    old = rp.load(Path(__file__).parent / "checkpoint" / "version_5.replant")
    new = rp.Identifier(poles=1, dt=DT, startup=30)
    new.update_many(u[:60], y[:60])
    for one in (old, new):
        one.update_many(u[60:], y[60:])
        one.finish()
    np.testing.assert_allclose(old.parameters, new.parameters, rtol=1e-11)
    np.testing.assert_allclose(old.covariance, new.covariance, rtol=1e-4)  # as its last steps end elsewhere
    assert (old.assess().status, old.assess().reasons) == (new.assess().status, new.assess().reasons)
