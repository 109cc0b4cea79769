"""A bank of structures: they learn side by side, weights say how probable each is, and one of them is served."""

from __future__ import annotations

import copy
import math
import pickle
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.kernels.schema import LAGS
from replant.numerics.arguments import FloatArray
from replant.online import bank_weights
from replant.online.bank import Bank
from replant.online.bank_weights import FORGETTING, Weights, shares_of
from replant.signals import prbs
from support.cases import every

DT = 0.05
STRUCTURES = [rp.Structure(1), rp.Structure(2)]
THREE = [*STRUCTURES, rp.Structure(3)]
PLANTS = {
    1: rp.Structure(1).transfer_function(np.array([1.5, 3.0])),
    2: rp.Structure(2).transfer_function(np.array([2.0, 9.0, 9.0])),
}


def begun(structures: Any = STRUCTURES, **more: Any) -> Any:
    return rp.Identifier(structure=structures, dt=DT, **more)


def record(order: int = 2, samples: int = 1200, seed: int = 1, decibels: float = 25.0) -> tuple[FloatArray, FloatArray]:
    u = prbs(samples, hold=8, seed=seed)
    clean = PLANTS[order].simulate(u, DT)
    noise = np.random.default_rng(seed).standard_normal(samples)
    return u, clean + float(clean.std()) * 10.0 ** (-decibels / 20.0) * noise


def passed(order: int = 2, structures: Any = STRUCTURES, **more: Any) -> Any:
    bank = begun(structures)
    bank.update_many(*record(order, **more))
    return bank


def passed_with(u: FloatArray, y: FloatArray, structures: Any = THREE) -> Any:
    bank = begun(structures)
    bank.update_many(u, y)
    return bank


def weights_of(variances: FloatArray) -> Weights:
    """Return equal weights of members whose residuals are white, of these variances."""
    fresh = Weights.of(THREE)
    new = copy.deepcopy(fresh)
    new.joined[:], new.logs[:] = 1, 0.0
    new.variances[:] = variances[:, None]
    return new


@every("order", PLANTS)
def test_the_order_is_found_and_served(order: int) -> None:
    bank = passed(order, THREE, samples=800)
    assert bank.structures[int(np.argmax(bank.weights))].poles == order
    assert bank.weights[order - 1] > 0.9
    assert bank.structure.poles == order
    assert bank.assess().status == "trusted"
    true = PLANTS[order]
    assert bank.transfer_function.den == pytest.approx(true.den, rel=0.05)
    assert bank.model.structure == bank.structure
    assert bank.parameters.shape == (order + 1,) == (len(bank.names),)
    assert bank.covariance.shape == (order + 1, order + 1)


def test_members_have_the_bits_that_they_have_alone() -> None:
    u, y = record()
    bank = begun()
    trace = bank.update_many(u, y)
    for structure, member, course in zip(STRUCTURES, bank.members, trace.members, strict=True):
        alone = rp.Identifier(structure, dt=DT)
        of_alone = alone.update_many(u, y)
        assert alone.to_bytes() == member.to_bytes()
        assert course.errors.tobytes() == of_alone.errors.tobytes()
        assert course.parameters.tobytes() == of_alone.parameters.tobytes()
        assert course.start.tobytes() == of_alone.start.tobytes()
    assert trace.errors.shape == trace.weights.shape == (u.size, 2)
    assert trace.weights.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    assert (trace.weights[:499] == 0.5).all()
    assert trace.weights[-1].tolist() == bank.weights.tolist()
    assert trace.lead[-1] == bank.lead == 1


def test_chunks_of_any_size_give_the_same_bits() -> None:
    u, y = record()
    whole, parts = begun(), begun()
    trace = whole.update_many(u, y)
    errors = [parts.update(*pair) for pair in zip(u[:530].tolist(), y[:530].tolist(), strict=True)]
    assert parts.weights.tolist() == trace.weights[529].tolist()
    pieces = [parts.update_many(u[a:b], y[a:b]) for a, b in ((530, 531), (531, 531), (531, 1100), (1100, 1200))]
    assert whole.to_bytes() == parts.to_bytes()
    assert np.concatenate([each.weights for each in pieces]).tobytes() == trace.weights[530:].tobytes()
    assert np.concatenate([each.lead for each in pieces]).tobytes() == trace.lead[530:].tobytes()
    served = trace.errors[np.arange(530), np.concatenate([[0], trace.lead[:529]])]
    assert np.array(errors).tobytes() == served.tobytes()


def test_the_weights_are_the_posterior_of_the_predictions() -> None:
    """By the formula: the product of normal densities, of residuals that are white with known variances."""
    variances, generator = np.array([1.0, 2.0, 0.5]), np.random.default_rng(0)
    errors = generator.standard_normal((60, 3)) * np.array([1.0, 1.3, 0.9])
    new, shares = weights_of(variances).take(errors)
    told = -0.5 * (errors**2 / variances + np.log(variances))
    prior, logs = weights_of(variances).prices, np.zeros(3)
    for row, each in enumerate(told):
        logs = FORGETTING * (logs - prior) + prior + each
        expected = np.exp(logs - logs.max())
        assert shares[row] == pytest.approx(expected / expected.sum(), rel=1e-9)
    assert new.logs == pytest.approx(logs, rel=1e-9)
    plain = np.exp(told.sum(axis=0) - told.sum(axis=0).max())
    assert shares[-1] == pytest.approx(plain / plain.sum(), abs=0.05)  # of 60 samples little is forgotten


def test_what_was_told_is_forgotten_towards_the_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bank_weights, "FORGETTING", 0.9)
    start = weights_of(np.ones(3))
    start.logs[:] = [0.0, 500.0, -500.0]
    _, shares = start.take(np.zeros((300, 3)))
    prior = np.exp(start.prices - start.prices.max())
    assert shares[-1] == pytest.approx(prior / prior.sum(), rel=1e-9)
    assert shares[-1, 0] > shares[-1, 1] > shares[-1, 2]  # fewer numbers cost less


def test_a_coloured_residual_is_whitened_by_the_samples_before() -> None:
    """Of two members with the same error but one's colour known, that one is the likelier by ln(V_0 / V_1) / 2 each."""
    generator, error = np.random.default_rng(3), np.zeros(4000)
    for k in range(1, error.size):
        error[k] = 0.9 * error[k - 1] + generator.standard_normal()
    new, _ = weights_of(np.full(3, 5.0)).take(np.column_stack([error, error, generator.standard_normal(4000) * 2.3]))
    assert new.orders.tolist()[:2] == [1, 1]
    assert new.models[0, 1, 1] == pytest.approx(-0.9, abs=0.03)
    assert new.variances[0, 1] == pytest.approx(1.0, rel=0.1)
    assert new.logs[0] - new.logs[2] > 0.8 * 0.5 * 3000 * math.log(2.3**2)


def test_missing_samples_and_outliers_count_for_nobody() -> None:
    errors = np.random.default_rng(1).standard_normal((40, 3))
    holed = errors.copy()
    holed[10], holed[20, 1], holed[30] = np.nan, np.inf, 1e6
    new, shares = weights_of(np.ones(3)).take(holed)
    assert (shares[[10, 20, 30]] == shares[[9, 19, 29]]).all()
    kept = np.delete(errors, [10, 20, 30], axis=0)
    assert new.logs == pytest.approx(weights_of(np.ones(3)).take(kept)[0].logs, rel=1e-12)


def test_what_lasts_is_no_outlier() -> None:
    """After five in a row they count, each at most as much as the gate."""
    start = weights_of(np.ones(3))
    new, shares = start.take(np.tile([[1e3, 1e4, 9.0]], (8, 1)))
    assert (shares[:5] == 1.0 / 3.0).all()
    assert new.logs.max() - new.logs.min() == pytest.approx(0.0, abs=1e-2)


def test_a_member_that_has_no_model_has_no_weight() -> None:
    assert shares_of(np.full(3, -math.inf)).tolist() == [1.0 / 3.0] * 3
    assert shares_of(np.array([-math.inf, 2.0, 2.0])).tolist() == [0.0, 0.5, 0.5]
    start = weights_of(np.ones(3))
    start.joined[0], start.logs[0] = 0, -math.inf
    errors = np.ones((5, 3))
    errors[:, 0] = np.nan
    _, shares = start.take(errors)
    assert shares[-1, 0] == 0.0
    assert shares[-1, 1] > 0.5 - 1e-3


def of_two_plants() -> tuple[FloatArray, FloatArray]:
    """A record of which the last 1100 samples come from another plant."""
    u = prbs(2400, hold=8)
    y = np.concatenate([PLANTS[2].simulate(u[:1300], DT), PLANTS[1].simulate(u[1300:], DT)])
    return u, y + 0.02 * np.random.default_rng(2).standard_normal(u.size)


@pytest.mark.slow
def test_another_plant_changes_the_lead_and_the_change_is_an_event() -> None:
    u, y = of_two_plants()
    bank = begun([rp.Structure(1), rp.Structure(2)])
    trace = bank.update_many(u, y)
    first, last = bank.leads[0], bank.leads[-1]
    assert first.structure.poles == 2
    assert first.taken == 500
    assert last.structure.poles == bank.structure.poles == 1
    assert last.taken > 1300
    assert last.weight > 0.9
    assert trace.lead[1299] == 1
    assert trace.lead[last.taken - 2] == 1
    assert trace.lead[last.taken - 1] == 0


@pytest.mark.slow
@every("wrong", ["outliers", "missing", "stamps", "lost"])
def test_what_goes_wrong_in_a_record_leaves_the_order(wrong: str) -> None:
    u, y = record(samples=1000)
    generator, t = np.random.default_rng(5), DT * np.arange(u.size)
    some = generator.choice(np.arange(520, u.size), 25, replace=False)
    if wrong == "outliers":
        y[some] += generator.choice([-40.0, 40.0], some.size)
    elif wrong in ("missing", "lost"):
        y[some] = np.nan
    if wrong == "lost":
        u[some] = np.inf
    bank = begun()
    trace = bank.update_many(u, y, t) if wrong in ("stamps", "lost") else bank.update_many(u, y)
    assert bank.structure.poles == 2
    assert bank.weights[1] > 0.9
    assert np.isfinite(trace.weights).all()
    assert bank.taken == u.size
    assert (bank.rejected["not finite"] == some.size) == (wrong == "lost")


@pytest.mark.slow
@every(
    "places, seed, size",
    product([(300,), (700,), (700, 749)], (1, 2), [1e1, 1e4, 1e6, 1e9, 1e12]),
    quick=3,  # of each place one, the smallest and the largest
)
def test_an_outlier_of_any_size_counts_for_nobody(places: tuple[int, ...], seed: int, size: float) -> None:
    """The weights begin anew at 750 samples, and behind `finish`."""
    u, y = record(samples=800, seed=seed)
    y[list(places)] += size
    bank = passed_with(u, y)
    assert bank.weights[1] > 0.9
    assert [each.structure.poles for each in bank.leads] == [2]
    bank.finish()
    assert bank.weights[1] > 0.9
    assert bank.structure.poles == 2


@pytest.mark.slow
def test_an_outlier_beside_a_change_of_the_lead_leaves_it() -> None:
    u, y = of_two_plants()
    plain = passed_with(u, y, STRUCTURES)
    changed = plain.leads[-1].taken
    for place in (changed - 1, changed, changed + 1):
        spoiled = y.copy()
        spoiled[place] = 1e6
        bank = passed_with(u, spoiled, STRUCTURES)
        assert [each.structure.poles for each in bank.leads] == [each.structure.poles for each in plain.leads] == [2, 1]
        assert bank.weights[0] > 0.9


def test_the_whole_state_is_saved(tmp_path: Path) -> None:
    u, y = record(samples=1000)
    bank = begun()
    bank.update_many(u[:600], y[:600])
    bank.update(float(u[600]), float(y[600]))
    bank.save(tmp_path / "rig", {"sequence": 3})
    again = rp.load(tmp_path / "rig")
    others = [again, copy.copy(bank), copy.deepcopy(bank), pickle.loads(pickle.dumps(bank)), bank.clone()]
    bank.update_many(u[601:], y[601:])
    for other in others:
        assert isinstance(other, Bank)
        other.update_many(u[601:], y[601:])
        assert other.to_bytes() == bank.to_bytes()
        assert other.leads == bank.leads


def test_a_bank_is_saved_before_its_first_sample() -> None:
    fresh = begun()
    again: Any = rp.Identifier.from_bytes(fresh.to_bytes())
    assert again.to_bytes() == fresh.to_bytes()
    assert again.weights.tolist() == [0.5, 0.5]
    assert not again.leads
    assert not again.has_model


@cache
def _data() -> bytes:
    data: bytes = passed(samples=600).to_bytes()
    return data


@every(
    "forged",
    [
        {"_lead": 2}, {"_taken": 901}, {"_stop": 5}, {"members": 3}, {"members": 10**9},
        {"leads": [[1, [9], 1.0, "?"]]}, {"_due": -1}, {"least": "a"}, {},
    ],
    ids=str,
)  # fmt: skip
def test_a_forged_checkpoint_is_refused(forged: dict[str, Any]) -> None:
    from replant.online.checkpoint.bank_and_row import restored_bank
    from replant.online.checkpoint.encoding import ARRAYS, BANK, decode

    data = _data()
    found = decode(data).attributes
    found[BANK] |= forged
    found[BANK].pop("adapts", None) if not forged else None
    with pytest.raises(rp.DamagedCheckpointError):
        restored_bank(found, rp.Identifier.from_bytes)
    found = decode(data).attributes
    found[ARRAYS]["orders"][0] = LAGS + 1
    with pytest.raises(rp.DamagedCheckpointError, match="weights"):
        restored_bank(found, rp.Identifier.from_bytes)


@every(
    "given, words",
    [
        ({"structure": []}, "list of 2 to 10"),
        ({"structure": STRUCTURES[:1]}, "list of 2 to 10"),
        ({"structure": [rp.Structure(1, delay=0.1 * k) for k in range(11)]}, "list of 2 to 10"),
        ({"structure": [*STRUCTURES, STRUCTURES[0]]}, "twice"),
        ({"structure": [1, 2]}, "write Structure"),
        ({"structure": STRUCTURES, "poles": 2}, "leave out poles"),
        ({"structure": STRUCTURES, "delay": 0.1}, "leave out delay"),
        ({"structure": STRUCTURES, "optimizer": "adam"}, "take no optimizer"),
        ({"structure": STRUCTURES, "background": True}, "take no background"),
        ({"structure": STRUCTURES, "history": 100}, "history"),
        ({"structure": STRUCTURES, "poles": (1, 1)}, "leave out poles"),
        ({"structure": STRUCTURES, "filter": rp.StateVariableFilter(1.0)}, "filter"),
        ({"structure": STRUCTURES, "startup": 0}, "startup"),
        ({"structure": STRUCTURES, "poles": np.ones(2)}, "leave out poles"),
        ({"structure": STRUCTURES, "filter": np.ones(2)}, "filter"),
    ],
    ids=str,
)
def test_arguments_that_cannot_be_used_are_refused_in_one_line(given: dict[str, Any], words: str) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=words) as refused:
        rp.Identifier(**{"dt": DT} | given)
    assert "\n" not in str(refused.value)


def test_the_sampling_time_may_follow_the_list() -> None:
    assert rp.Identifier(STRUCTURES, DT).dt == DT
    with pytest.raises(rp.ArgumentTypeError, match="dt"):
        rp.Identifier(STRUCTURES)


def test_samples_that_are_refused_change_nothing() -> None:
    bank: Any = rp.Identifier.from_bytes(_data())
    before = bank.to_bytes()
    for wrong in (("a", 1.0), (1.0, None), (1.0, 1.0, "t"), (1.0, 1.0, None, 2.0)):
        with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError)):
            bank.update(*wrong)
    for many in (([1.0], [1.0, 2.0]), ([[1.0]], [1.0]), ([1.0], [1.0], [1.0, 2.0]), ([1.0], [1.0], None, [1.0])):
        with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError)):
            bank.update_many(*many)
    assert bank.to_bytes() == before
    with pytest.raises(rp.InvalidArgumentError, match="try again later"):
        begun().freeze()


def test_an_interrupt_leaves_no_member_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was being taken is taken by all at the next call; the members then have the bits that they have alone."""
    u, y = record(samples=900)
    bank, whole = begun(), begun()
    whole.update_many(u, y)
    bank.update_many(u[:700], y[:700])
    last, reached = bank._members[-1], []

    def interrupted() -> None:
        raise KeyboardInterrupt

    for name, samples in (("update_many", (u[700:740], y[700:740])), ("update", (float(u[740]), float(y[740])))):
        with monkeypatch.context() as patch:
            patch.setattr(type(last), name, _after(last, getattr(type(last), name), interrupted))
            with pytest.raises(KeyboardInterrupt):
                getattr(bank, name)(*samples)
        reached.append(bank.taken)
    assert reached == [740, 741]
    bank.update_many(u[741:], y[741:])
    assert [each.to_bytes() for each in bank.members] == [each.to_bytes() for each in whole.members]
    assert bank.structure == whole.structure


def _after(which: rp.Identifier, usual: Any, raised: Any) -> Any:
    def called(self: rp.Identifier, *args: Any) -> Any:
        return raised() if self is which else usual(self, *args)

    return called


def test_at_the_end_every_sample_counts() -> None:
    u, y = record(samples=1000)
    bank = begun()
    bank.update_many(u, y)
    bank.finish()
    alone = rp.Identifier(STRUCTURES[1], dt=DT)
    alone.update_many(u, y)
    alone.finish()
    assert bank.structure.poles == 2
    assert bank.parameters.tolist() == alone.parameters.tolist()
    early = begun()
    early.update_many(u[:400], y[:400])
    early.finish()
    assert early.structure.poles == 2
    assert early.has_model


def test_frozen_members_stay_and_a_reset_forgets() -> None:
    u, y = record(samples=1000)
    bank = begun()
    bank.update_many(u[:800], y[:800])
    bank.freeze()
    before = bank.parameters
    bank.update_many(u[800:], y[800:])
    assert bank.parameters.tolist() == before.tolist()
    assert bank.structure.poles == 2
    bank.resume()
    bank.reset()
    assert bank.to_bytes() == begun().to_bytes()


def test_it_shows_itself_in_a_line() -> None:
    assert "2/0 1" in repr(rp.Identifier.from_bytes(_data()))
    assert "of 70 samples" in repr(begun().update_many(*record(samples=70)))
    assert "none" in repr(begun().update_many([], []))
