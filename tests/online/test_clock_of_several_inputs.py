"""Time stamps of several inputs: one that is misread costs its sample, a clock that is set costs ten."""

import numpy as np
import pytest

import replant as rp
from replant.online.miso_samples import RowClock
from support.cases import every

SIZE, DT = 1200, 0.1
MODELS = rp.TransferFunction([2.0], [1.0, 0.5]), rp.TransferFunction([1.0], [1.0, 3.0], delay=0.3)


@pytest.fixture(scope="module")
def signals():
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], (SIZE // 10, 2)).repeat(10, axis=0)
    y = sum(model.simulate(each.copy(), dt=DT) for model, each in zip(MODELS, u.T, strict=True))
    return DT * np.arange(SIZE), u, y + 0.05 * rng.standard_normal(SIZE)


def identifier():
    return rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=DT)


def set_at(t, places, stamps):
    t = t.copy()
    t[places] = stamps
    return t


CLOCKS = {  # stamps, counts of rejected samples beside others that are nought
    "misread far ahead": (lambda t: set_at(t, 700, 1e6), {"time leap": 1}),
    "misread far ahead, beyond float64": (lambda t: set_at(t, 700, 1e150), {"time too coarse": 1}),
    "misread far back": (lambda t: set_at(t, 700, -1e6), {"not later": 1}),
    # the past inputs that are kept reach over the dead time of 0.3 s from 17 ms on
    "denser than the dead time allows": (lambda t: set_at(t, 700, t[699] + 0.01), {"too dense": 1}),
    "twice the same": (lambda t: set_at(t, 700, t[699]), {"not later": 1}),
    "a pause": (lambda t: t + 1e4 * (t > 70.0), {}),
    "a pause before the first model": (lambda t: t + 1e4 * (t > 49.75), {}),
    "set back": (lambda t: t - 60.0 * (t > 70.0), {"not later": 10}),
    "two misread together": (lambda t: set_at(t, [700, 701], [1e6, 1e9]), {"time leap": 2}),
    "the last one leaps": (lambda t: set_at(t, SIZE - 1, 1e6), {"time leap": 1}),
    "slow": (lambda t: 60.0 * t, {"time leap": 1}),  # the last of 1200: 599 others were believed
}


@pytest.mark.slow
@every("name", list(CLOCKS), quick=3)
def test_chunks_and_single_samples_and_checkpoints_agree_on_the_stamps_that_are_believed(signals, name):
    t, u, y = signals
    stamps, turned_away = CLOCKS[name]
    t = stamps(t)
    whole, single, parts = identifier(), identifier(), identifier()
    trace = whole.update_many(u, y, t)
    errors = [single.update(row, output, stamp) for row, output, stamp in zip(u, y, t, strict=True)]
    for begin in range(0, SIZE, 7):  # 700 is a multiple of 7, so that a sample waits in a checkpoint
        rows = slice(begin, begin + 7) if begin != 700 else slice(700, 701)
        parts.update_many(u[rows], y[rows], t[rows])
        parts = rp.Identifier.from_bytes(parts.to_bytes())
        if begin == 700:
            parts.update_many(u[701:707], y[701:707], t[701:707])
    assert {reason: count for reason, count in whole.rejected.items() if count} == turned_away
    assert whole.samples == SIZE - sum(turned_away.values())
    np.testing.assert_array_equal(trace.errors, errors)
    assert whole.to_bytes() == single.to_bytes() == parts.to_bytes()


@every("name", [name for name in CLOCKS if name != "slow"], quick=2)
def test_the_estimate_is_near_the_truth_all_the_same(signals, name):
    t, u, y = signals
    ident = identifier()
    ident.update_many(u, y, CLOCKS[name][0](t))
    for found, model in zip(ident.transfer_functions, MODELS, strict=True):
        np.testing.assert_allclose(found.num, model.num, rtol=0.1)
        np.testing.assert_allclose(found.den, model.den, rtol=0.1)


def test_a_stamp_beside_the_usual_ones_is_judged_as_of_one_input(signals):
    t, u, y = signals
    rng = np.random.default_rng(1)
    t = t.copy()
    places = rng.choice(np.arange(1, SIZE), 40, replace=False)
    t[places] += rng.choice([-1e3, 1e3, 5.0, -0.1, 1e7], 40)
    t[900:] -= 33.0
    one = rp.Identifier(poles=1, dt=DT)
    one.update_many(u[:, 0], y, t)
    several = identifier()
    several.update_many(u, y, t)
    for reason in ("not later", "time leap", "time too coarse"):
        assert several.rejected[reason] == one.rejected[reason]
    assert several.samples == one.samples


def test_a_clock_in_a_checkpoint_is_checked(signals):
    t, u, y = signals
    ident = identifier()
    ident.update_many(u, y, set_at(t, SIZE - 1, 1e6))
    assert ident._now.clock == RowClock(0.0, 0, 0.0, (*u[-1], y[-1], 1e6))
    again = rp.Identifier.from_bytes(ident.to_bytes())
    assert again._now.clock == ident._now.clock
    ident.update(u[-1], y[-1], 1e6 + DT)
    again.update(u[-1], y[-1], 1e6 + DT)
    assert again.to_bytes() == ident.to_bytes()
    assert again.rejected["time leap"] == 0
