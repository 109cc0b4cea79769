"""An identifier that was saved and loaded goes on to the bit, whatever it is, wherever it was saved."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import replant as rp
from replant.estimation.optimizers import OPTIMIZERS
from replant.online.checkpoint.encoding import (
    ATTRIBUTES,
    STATE,
)
from replant.online.identifier import DERIVED
from support.builders import random_plant, record
from support.cases import every, examples

DT, STARTUP, SAMPLES = 0.1, 30, 150
REPLAY = rp.Replay(capacity=40, batch_size=4, warmup=5, seed=7)
FIXED: dict[str, Any] = {"filter": rp.StateVariableFilter(3.0)}

#: Every optimizer alone, with a buffer, and with instruments; then what else makes a state of another kind.
KINDS: dict[str, dict[str, Any]] = {
    "default": {},
    "bias, first sample": {
        "structure": rp.Structure(2, 1, bias=True),
        "preprocess": rp.Preprocess("square", "first", "first"),
    },
    "mean": {**FIXED, "optimizer": rp.Gradient(2.0), "preprocess": rp.Preprocess("identity", "mean", "mean")},
    "dead time": {"structure": rp.Structure(2, 1, delay=0.237)},
    "biproper": {"structure": rp.Structure(2, 2, feedthrough=True)},
    "first-order hold": {"filter": rp.RefinedFilter(input_hold="foh")},
    "gradient beside a model": {"filter": rp.RefinedFilter(), "optimizer": rp.Gradient(0.05)},
    "forgetting": {"optimizer": rp.RecursiveLeastSquares(time_constant=20.0)},
    "gbt": {"filter": rp.StateVariableFilter(3.0, method="gbt", alpha=0.7), "optimizer": rp.Adam(1e-3)},
    "begins at once": {**FIXED, "scaling": None, "instruments": False, "normalize": False, "replay": REPLAY}
    | {"optimizer": rp.AMSGrad(1e-3)},
    **{name: {**FIXED, "optimizer": name, "instruments": False, "replay": None} for name in OPTIMIZERS},
    **{
        f"{name}, buffer": {**FIXED, "optimizer": name, "instruments": False, "replay": REPLAY}
        for name, kind in OPTIMIZERS.items()
        if not kind.keeps_covariance
    },
    **{f"{name}, instruments": {**FIXED, "optimizer": name, "instruments": True} for name in OPTIMIZERS},
}


def fresh(kind: str) -> rp.Identifier:
    changes = dict(KINDS[kind])
    return rp.Identifier(changes.pop("structure", rp.Structure(2, 1)), DT, **{"startup": STARTUP, **changes})


@dataclass(frozen=True)
class Stream:
    """Samples good and bad: some not finite or too large, stamps that stand still, a gap; when adaptation rests."""

    u: np.ndarray
    y: np.ndarray
    t: np.ndarray
    stamped: bool
    frozen: range

    def feed(self, ident: rp.Identifier, start: int, end: int) -> list[bytes]:
        """Every error to the bit."""
        errors = []
        for k in range(start, end):
            if ident.settings is not None and k == self.frozen.start:
                ident.freeze()
            if ident.settings is not None and k == self.frozen.stop:
                ident.resume()
            error = ident.update(self.u[k], self.y[k], self.t[k] if self.stamped else None)
            errors.append(np.float64(error).tobytes())
        return errors


def stream(seed: int, *, stamped: bool = False, frozen: range = range(0), samples: int = SAMPLES) -> Stream:
    generator = np.random.default_rng(seed)
    u, y = record(random_plant(seed % 5, 2, 1), seed, samples, DT, noise=0.005)
    u += 0.5  # whose square is no constant
    intervals = DT * generator.uniform(0.6, 1.4, samples)
    intervals[generator.random(samples) < 0.03] = 0.0
    intervals[samples // 2] = 40 * DT
    for bad in (math.nan, math.inf, 1e200):
        y[generator.integers(samples)] = u[generator.integers(samples)] = bad
    return Stream(u, y, np.cumsum(intervals), stamped, frozen)


def again(ident: rp.Identifier) -> rp.Identifier:
    return rp.Identifier.from_bytes(ident.to_bytes())


def assert_equal(ident: rp.Identifier, other: rp.Identifier) -> None:
    assert ident.to_bytes() == other.to_bytes()
    assert (ident.samples, ident.rejected, ident.status) == (other.samples, other.rejected, other.status)
    np.testing.assert_array_equal(ident.parameters, other.parameters)
    np.testing.assert_array_equal(ident.covariance, other.covariance)


#: Each kind on one of two clocks, the default on both; a filter that approximates knows a regular one only.
CLOCKS = [("default", True), *((kind, number % 2 == 1 and kind != "gbt") for number, kind in enumerate(KINDS))]


@every(("kind", "stamped"), CLOCKS, quick=2)
def test_saved_and_loaded_after_every_single_sample(kind: str, stamped: bool) -> None:
    """Through start-up, new solutions of the record, a gap, a pause of adaptation."""
    samples = stream(0, stamped=stamped, frozen=range(70, 85), samples=100)
    whole, chained = fresh(kind), fresh(kind)
    for k in range(100):
        expected = samples.feed(whole, k, k + 1)
        chained = again(chained)
        assert samples.feed(chained, k, k + 1) == expected, f"sample {k}"
    assert_equal(whole, chained)
    assert whole.settings is not None
    assert sum(whole.rejected.values()) > 0
    assert repr(again(whole).assess()) == repr(whole.assess())


@settings(max_examples=examples(40, quick=3), deadline=None)
@given(
    kind=st.sampled_from(list(KINDS)),
    seed=st.integers(0, 10_000),
    stamped=st.booleans(),
    frozen=st.tuples(st.integers(0, SAMPLES), st.integers(0, SAMPLES)),
    cuts=st.lists(st.integers(0, SAMPLES), max_size=4),
)
def test_saved_and_loaded_anywhere(
    kind: str, seed: int, stamped: bool, frozen: tuple[int, int], cuts: list[int]
) -> None:
    samples = stream(seed, stamped=stamped and kind != "gbt", frozen=range(*frozen))
    whole, parts = fresh(kind), fresh(kind)
    expected = samples.feed(whole, 0, SAMPLES)
    got, edges = [], [0, *sorted(cuts), SAMPLES]
    for start, end in itertools.pairwise(edges):
        got += samples.feed(parts, start, end)
        parts = again(parts)
    assert got == expected
    assert_equal(whole, parts)


@every("kind", KINDS, quick=6)
def test_chunks_after_loading_equal_samples_before_saving(kind: str) -> None:
    samples = stream(5)
    whole, parts = fresh(kind), fresh(kind)
    whole.update_many(samples.u, samples.y)
    parts.update_many(samples.u[:71], samples.y[:71])
    parts = again(parts)
    parts.update_many(samples.u[71:], samples.y[71:])
    assert_equal(whole, parts)


def test_a_full_ring_of_raw_samples_and_the_last_solution() -> None:
    """10000 raw samples are kept: past that, the ring has turned, and the record is never solved again."""
    u, y = record(random_plant(1, 1), 1, 12_000, DT, noise=0.01)
    whole = rp.Identifier(rp.Structure(1), DT, startup=300)
    parts = whole.clone()
    whole.update_many(u, y)
    for start in range(0, 12_000, 1_500):
        parts = again(parts)
        parts.update_many(u[start : start + 1_500], y[start : start + 1_500])
    assert_equal(whole, parts)


@every("samples", [SAMPLES, 0, 10], quick=1)
def test_what_can_be_done_with_an_identifier_can_be_done_with_a_loaded_one(samples: int) -> None:
    data = stream(2)
    ident = fresh("default")
    data.feed(ident, 0, samples)
    loaded = again(ident)
    assert (loaded.structure, loaded.dt, loaded.settings) == (ident.structure, ident.dt, ident.settings)
    for act in (rp.Identifier.finish, rp.Identifier.clone, rp.Identifier.reset):
        for one in (ident, loaded):
            act(one)
        assert_equal(ident, loaded)
        assert data.feed(ident, samples // 2, SAMPLES) == data.feed(loaded, samples // 2, SAMPLES)
    assert_equal(ident, loaded)


def test_loading_leaves_the_saved_one_alone() -> None:
    data, ident = stream(4), fresh("amsgrad, buffer")
    data.feed(ident, 0, 100)
    before = ident.to_bytes()
    data.feed(again(ident), 100, SAMPLES)
    assert ident.to_bytes() == before


@every("samples", [0, 10, SAMPLES])
@every("kind", ["default", "begins at once", "mean"])
def test_no_attribute_of_an_identifier_is_forgotten(kind: str, samples: int) -> None:
    """A new attribute belongs in the list of `replant.online.checkpoint.encoding`."""
    ident = fresh(kind)
    stream(2).feed(ident, 0, samples)
    assert set(vars(ident)) - DERIVED == {*ATTRIBUTES, STATE}
    assert set(vars(again(ident))) == set(vars(ident))


def test_after_a_reset_nothing_of_the_past_is_stored() -> None:
    ident = fresh("default")
    stream(2).feed(ident, 0, SAMPLES)
    ident.reset()
    assert ident.to_bytes() == fresh("default").to_bytes()


def test_equal_states_give_equal_bytes_and_other_states_others() -> None:
    data, ident, other = stream(2), fresh("default"), fresh("default")
    seen = set()
    for k in range(100):
        data.feed(ident, k, k + 1)
        data.feed(other, k, k + 1)
        assert ident.to_bytes() == other.to_bytes()
        seen.add(ident.to_bytes())
    assert len(seen) == 100
