"""An alarm that is looked into: what is no plant is not learned, and what has gone astray comes back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.kernels.monitoring import outliers
from replant.kernels.schema import Alarm
from replant.online import change_response, lifecycle, revision
from replant.online.revision import GROWTH
from support.builders import DT, binary, true_parameters
from support.cases import every

PLANT = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
LIGHT = rp.TransferFunction([25.0], [1.0, 0.2, 25.0])
OPTIMIZERS: dict[str, Any] = {
    "default": "auto",
    "forgetting": rp.RecursiveLeastSquares(0.999),
    "tracking": rp.KalmanTracking(1e-6),
}


def afloat(kind: str, scale: float, samples: int) -> np.ndarray:
    noise = np.random.default_rng(3).standard_normal(samples)
    return scale * (noise if kind == "noise" else 0.05 * np.cumsum(noise))


CABLES = [
    ("default", PLANT, "noise", 1.0),
    ("default", LIGHT, "noise", 0.3),
    ("default", LIGHT, "walk", 1.0),
    ("forgetting", PLANT, "noise", 0.3),
    ("tracking", PLANT, "walk", 1.0),
]


@pytest.mark.slow
@every("optimizer, plant, kind, size", CABLES, quick=1)
def test_a_cable_that_floats_teaches_nothing(
    optimizer: str, plant: rp.TransferFunction, kind: str, size: float
) -> None:
    """The parameters hold within 10 % for as long as it lasts; back on, it learns on and is trusted again."""
    u = binary(1, 4000, 8)
    y = plant.simulate(u, DT)
    scale = float(y.std())
    y += 0.03 * scale * np.random.default_rng(0).standard_normal(4000)
    y[1500:2500] = afloat(kind, size * scale, 1000)
    ident = rp.Identifier(rp.Structure(2), DT, optimizer=OPTIMIZERS[optimizer])
    ident.update_many(u[:1500], y[:1500])
    true = true_parameters(plant, 0)
    for k in range(1500, 2500, 500):
        trace = ident.update_many(u[k : k + 500], y[k : k + 500])
        assert np.abs(trace.parameters / true - 1.0).max() < 0.1
        assert ident.assess().status != "trusted"
    assert ident._state.alarm == Alarm.FLOATS
    ident.update_many(u[2500:], y[2500:])
    assert ident._state.alarm == Alarm.NONE
    assert np.abs(ident.parameters / true - 1.0).max() < 0.05
    assert ident.assess().status == "trusted"


def test_an_alarm_that_goes_as_it_came_costs_little() -> None:
    """A burst of noise of 30 samples: learning goes on before it would be looked into; the record stays one."""
    u = binary(1, 6000, 8)
    y = PLANT.simulate(u, DT) + 0.03 * np.random.default_rng(0).standard_normal(6000)
    y[4500:4530] += 0.2 * np.random.default_rng(1).standard_normal(30)
    ident = rp.Identifier(rp.Structure(2), DT)
    ident.update_many(u, y)
    state = ident._state
    assert 30 < int(state.rested) < 125
    assert state.alarm == state.record_began == state.gap_at == 0


@every("seed", range(3), quick=1)
def test_noise_that_triples_is_usual_from_then_on(seed: int) -> None:
    """One alarm tells it, from 50 samples or more: of these the power is known to a fifth, here within a half."""
    u = binary(seed, 5000, 8)
    y = PLANT.simulate(u, DT)
    scale = 0.05 * y.std()
    y += scale * np.where(np.arange(5000) < 4000, 1.0, 3.0) * np.random.default_rng(seed).standard_normal(5000)
    ident = rp.Identifier(rp.Structure(2), DT)
    ident.update_many(u, y)
    assert ident._state.alarm == Alarm.NONE
    assert ident._state.cusum_limit == 2.0 * outliers.LIMIT
    assert ident._state.usual_variance == pytest.approx((3.0 * scale) ** 2, rel=0.5)
    assert ident.assess().status == rp.fit(u, y, DT, poles=2).verdict.status == "trusted"


@every("factor", [0.5, 1.5])
@every("entry", [0, 1, 2], quick=1)
def test_tracking_is_not_trusted_while_it_is_wrong(factor: float, entry: int) -> None:
    """A light mode, a slow walk: after a jump by half no verdict trusts an estimate that is 10 % off."""
    before = true_parameters(LIGHT, 0)
    true = before.copy()
    true[entry] *= factor
    u = binary(3, 6000, 9)
    after = rp.TransferFunction([true[2]], [1.0, *true[:2]])
    y = np.where(np.arange(6000) < 3000, LIGHT.simulate(u, 0.02), after.simulate(u, 0.02))
    y += 0.05 * y.std() * np.random.default_rng(5).standard_normal(6000)
    ident = rp.Identifier(rp.Structure(2), 0.02, optimizer=rp.KalmanTracking(1e-7))
    ident.update_many(u[:3000], y[:3000])
    for k in range(3000, 6000, 100):
        ident.update_many(u[k : k + 100], y[k : k + 100])
        wrong = np.abs(ident.parameters / true - 1.0).max() > 0.1
        assert not (wrong and k > 3200 and ident.assess().status == "trusted")
    assert np.abs(ident.parameters / true - 1.0).max() < 0.1


@pytest.mark.parametrize("factor", [pytest.param(0.5, marks=pytest.mark.slow), 1.5])
def test_a_gain_that_jumps_while_the_input_rests_is_no_disturbance(factor: float) -> None:
    """Until the input has moved another gain looks like another constant; nothing is trusted meanwhile."""
    dt, plant, after = 1e-3, rp.TransferFunction([2.0], [1.0, 2.0]), rp.TransferFunction([2.0 * factor], [1.0, 2.0])
    u = binary(4, 16_000, 300)
    before, then = plant.simulate(u[:8000], dt), after.simulate(u, dt)[8000:]
    end = before[-1] - after.simulate(u[:8001], dt)[-1]
    y = np.concatenate([before, then + end * np.exp(-2.0 * dt * np.arange(8000))])
    ident = rp.Identifier(rp.Structure(1), dt)
    noisy = y + 0.01 * np.random.default_rng(1).standard_normal(16_000)
    ident.update_many(u[:8000], noisy[:8000])
    for k in range(8000, 16_000, 250):
        ident.update_many(u[k : k + 250], noisy[k : k + 250])
        away = np.abs(ident.parameters / [2.0, 2.0 * factor] - 1.0).max()
        assert away < 0.05 or ident.assess().status != "trusted"
    assert away < 0.01
    assert ident.assess().status == "trusted"


def _largest_error(model: rp.TransferFunction, plant: rp.TransferFunction, hold: int, dt: float) -> float:
    """Return the largest relative error of abs G where random steps that last ``hold`` samples excite the plant."""
    omega = np.geomspace(0.1 * float(np.abs(plant.poles).min()), np.pi / dt, 60)
    true = np.abs(plant.response(omega))
    power = (true * np.sinc(omega * hold * dt / (2.0 * np.pi))) ** 2
    excited = power >= 0.01 * power.max()
    return float(np.abs(np.abs(model.response(omega[excited])) / true[excited] - 1.0).max())


CHANGES: dict[str, tuple[list[float], list[float], float, int]] = {
    # denominators before and after (static gain one), factor of the gain, samples of a step of the input
    "slower pole, noisy": ([1.0, 1.25], [1.0, 1.04], 1.0, 32),
    "gain of a light, slow mode": ([1.0, 0.36, 0.51], [1.0, 0.36, 0.51], 0.59, 15),
    "faster poles": ([1.0, 3.0, 2.0], [1.0, 4.5, 4.5], 1.0, 24),
}


@pytest.mark.slow
@every("change", CHANGES)
@every("seed", range(2))
def test_no_model_off_by_a_tenth_is_trusted_640_samples_after_a_change(change: str, seed: int) -> None:
    """Two records each, noise of 7 %, looks from 640 samples on at which the estimate is nearly another one.

    Abs G of a trusted model is known to a thirtieth at each frequency that the input excites.  Over n + 1 = 3
    independent coefficients and two records an error of a tenth, three standard deviations, has a chance of at most
    6 * 0.27 % at the first look at which it can be trusted, and less at each one after.
    """
    before, after, factor, hold = CHANGES[change]
    dt, long = 1.0 / 64.0, 5000
    old = rp.TransferFunction([before[-1]], before)
    plant = rp.TransferFunction([factor * after[-1]], after)
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, (long + 3200) // hold + 1), hold)[: long + 3200]
    joined = [old.simulate(u, dt)[:long], plant.simulate(u, dt)[long:]]
    y = np.concatenate(joined) + 0.07 * joined[0].std() * rng.standard_normal(u.size)
    ident = rp.Identifier(rp.Structure(len(before) - 1), dt)
    begin = 0
    for look in (0, 640, 800, 1000, 1250, 1600, 2000, 2500, 3200):
        ident.update_many(u[begin : long + look], y[begin : long + look])
        begin = long + look
        if look == 0:
            assert ident.assess().status == "trusted"
        elif _largest_error(ident.transfer_function, plant, hold, dt) > 0.1:
            assert ident.assess().status != "trusted"


def a_third_up(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Input and output of 3000 samples, noise of a quarter; the gain is 2, and 2.6 from the middle on."""
    u = binary(seed, 3000, 10)
    low, high = (rp.TransferFunction([gain], [1.0, 1.0]).simulate(u, 0.1) for gain in (2.0, 2.6))
    y = np.where(np.arange(u.size) < u.size // 2, low, high)
    return u, y + 0.25 * high.std() * np.random.default_rng(seed).standard_normal(u.size)


@every("seed", [1, 0, 2], quick=1)  # of record 1 the score alone tells
def test_a_gain_that_the_noise_hides_from_the_alarm_is_found(seed: int) -> None:
    """A third up under noise of a quarter: the power of the residual hides it, its score does not.

    Until it is found the estimate lags behind, a tenth and more: from 300 samples after the change it is not trusted.
    """
    (u, y), samples = a_third_up(seed), 3000
    ident = rp.Identifier(rp.Structure(1), 0.1)
    looks = round(1500 * GROWTH**2)  # the last look has 375 samples since the change, or more
    for begin in range(0, samples, 100):
        ident.update_many(u[begin : begin + 100], y[begin : begin + 100])
        if begin + 100 >= 1800 and abs(ident.transfer_function.dc_gain / 2.6 - 1.0) > 0.1:
            assert begin + 100 < looks
            assert ident.assess().status != "trusted", begin + 100
    assert ident.transfer_function.dc_gain == pytest.approx(2.6, rel=0.05)
    assert ident.assess().status == "trusted"


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="one look in twenty is trusted, between others that are refused")
@every("seed", [6, 8, 17])
def test_no_look_at_a_gain_that_the_noise_hides_is_trusted(seed: int) -> None:
    """As above with a look each 20 samples, on three of the five records of the first 24 that are trusted 20 % off."""
    u, y = a_third_up(seed)
    ident = rp.Identifier(rp.Structure(1), 0.1)
    ident.update_many(u[:1780], y[:1780])
    for begin in range(1780, 1900, 20):
        ident.update_many(u[begin : begin + 20], y[begin : begin + 20])
        off = abs(ident.transfer_function.dc_gain / 2.6 - 1.0)
        assert off < 0.1 or ident.assess().status != "trusted", begin + 20


@pytest.mark.slow
@every("seed", range(3), quick=1)
def test_a_gain_that_toggles_is_followed_each_time(seed: int) -> None:
    """One model for both is no explanation: neither the samples before the first change, nor those since, are its."""
    plant, rng = rp.TransferFunction([2.0], [1.0, 2.0]), np.random.default_rng(seed)
    u = binary(seed, 3500, 5)
    doubled = np.arange(u.size) // 700 % 2 == 1
    y = plant.simulate(np.where(doubled, 2.0, 1.0) * u, DT) + 0.05 * rng.standard_normal(u.size)
    ident = rp.Identifier(poles=1, dt=DT)
    for begin in range(0, u.size, 700):
        ident.update_many(u[begin : begin + 700], y[begin : begin + 700])
        true = 2.0 if doubled[begin] else 1.0
        np.testing.assert_allclose(ident.transfer_function.dc_gain, true, rtol=0.1, err_msg=f"sample {begin + 700}")


@pytest.mark.slow
def test_the_verdict_can_be_asked_for_at_any_sample_of_an_alarm_and_after() -> None:
    """Where the record begins anew there is but one sample to judge by: nothing to trust, and nothing to fail on."""
    u = binary(1, 1800, 8)
    y = PLANT.simulate(u, DT)
    y += 0.05 * y.std() * np.random.default_rng(0).standard_normal(1800)
    y[1500:1700] = 0.05 * y.std() * np.random.default_rng(1).standard_normal(200)
    ident = rp.Identifier(rp.Structure(2), DT)
    ident.update_many(u[:1500], y[:1500])
    for k in range(1500, 1800):
        ident.update(u[k], y[k])
        if k % 20 and min(abs(k - edge) for edge in (1500, 1600, 1700)) > 8:
            continue
        status = ident.assess().status
        assert not (1600 < k < 1700 and status == "trusted")


@pytest.mark.slow
@pytest.mark.parametrize("what", ["renew", pytest.param("look", marks=pytest.mark.slow)])
def test_what_the_user_interrupts_is_made_up_for_before_the_next_sample(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    u = binary(1, 1500, 8)
    y = PLANT.simulate(u, DT) + 0.03 * np.random.default_rng(0).standard_normal(1500)
    y[1200:] = y[1200] + 3.0 * (y[1200:] - y[1200])  # looked into
    ident, twin = (rp.Identifier(rp.Structure(2), DT) for _ in range(2))
    twin.update_many(u, y)
    whole, calls = getattr(revision, what), []

    def interrupted(*given: Any) -> Any:
        calls.append(ident._state.samples)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return whole(*given)

    monkeypatch.setattr(revision, what, interrupted)
    with pytest.raises(KeyboardInterrupt):
        ident.update_many(u, y)
    done = calls[0]
    again = rp.Identifier.from_bytes(ident.to_bytes())
    for each in (ident, again):
        each.update_many(u[done:], y[done:])
    assert calls[1] == done
    assert ident.to_bytes() == again.to_bytes() == twin.to_bytes()


@pytest.mark.parametrize("many", [False, True], ids=["one by one", "at once"])
def test_a_start_up_that_the_user_interrupts_is_ended_before_anything_is_read(
    many: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    u = binary(1, 1000, 8)
    y = PLANT.simulate(u, DT) + 0.03 * np.random.default_rng(0).standard_normal(1000)
    ident, twin = (rp.Identifier(rp.Structure(2), DT, startup=200) for _ in range(2))

    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(lifecycle, "begin", interrupted)
        ident.update_many(u[:199], y[:199])
        last = slice(199, 300) if many else 199
        with pytest.raises(KeyboardInterrupt):
            (ident.update_many if many else ident.update)(u[last], y[last])
    assert ident.samples == 200
    assert ident.status == "running"
    again = rp.Identifier.from_bytes(ident.to_bytes())
    twin.update_many(u[:200], y[:200])
    for each in (ident, again, twin):
        each.update_many(u[200:], y[200:])
    assert ident.parameters.tolist() == again.parameters.tolist() == twin.parameters.tolist()


@pytest.mark.slow
@every("seed", [1, 3], quick=1)
def test_a_gain_of_the_other_sign_is_followed(seed: int) -> None:
    """An output that answers to nothing explains the samples since far better than the old model does, too."""
    rng, since = np.random.default_rng(seed), np.arange(4000) >= 1600
    u = rng.choice([-1.0, 1.0], 500).repeat(8)
    plant, noise = rp.TransferFunction([2.0], [1.0, 0.5]), lfilter([1.0], [1.0, -0.9], rng.standard_normal(4000))
    y = plant.simulate(np.where(since, -u, u), 0.1)
    ident = rp.Identifier(poles=1, dt=0.1)
    ident.update_many(u, y + 0.3 * y.std() / noise.std() * noise)
    assert ident.parameters == pytest.approx([0.5, -2.0], rel=0.1)


def test_one_model_of_all_samples_is_solved_for_only_where_it_may_win(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two poles for a plant of four: each stretch is fitted differently, and no solution of all samples could win."""
    plant = rp.TransferFunction([6e5], [1.0, 78.0, 1940.0, 1.7e4, 3e4])
    rng, called = np.random.default_rng(2), Counter[str]()

    def counted(name: str) -> Callable[..., Any]:
        function = getattr(change_response, name)

        def counting(*arguments: Any, **named: Any) -> Any:
            called[name] += 1
            return function(*arguments, **named)

        return counting

    for name in ("solve", "decided"):
        monkeypatch.setattr(change_response, name, counted(name))
    u = np.repeat(rng.standard_normal(40), 40)
    y = plant.simulate(u, 0.001)
    rp.Identifier(rp.Structure(2, 1), 0.001).update_many(u, y + 0.003 * y.std() * rng.standard_normal(u.size))
    assert called["decided"] >= 4
    assert called["solve"] <= 1
