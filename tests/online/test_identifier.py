"""Identifier: chunks equal the whole to the bit, bad input leaves no trace, memory does not grow."""

from __future__ import annotations

import dataclasses
import html
import itertools
import math
import tracemalloc
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import replant as rp
from replant.estimation.engine.state import REASONS, State
from replant.estimation.optimizers import OPTIMIZERS
from support.builders import (
    G1,
    G2,
    Thing,
    identifier,
    is_finite,
    random_plant,
    record,
    state,
    true_parameters,
    with_and_without,
)
from support.cases import every, examples
from support.references import TWINS

every_optimizer = every("name", OPTIMIZERS)


def test_at_a_prompt_it_says_in_a_line_what_it_knows() -> None:
    ident = rp.Identifier(poles=1, delay=0.1, dt=0.01)
    assert (
        repr(ident) == "<Identifier: poles 1, zeros 0, dead time 0.1 s, dt 0.01 s; 0 samples, starting, no model yet>"
    )
    u = np.where(np.arange(2000) // 125 % 2 == 0, 1.0, -1.0)
    ident.update_many(u, rp.TransferFunction([2.0], [1.0, 0.5], 0.1).simulate(u, dt=0.01))
    assert repr(ident).endswith(f"; 2,000 samples, running, {ident.transfer_function}>")


def test_a_notebook_shows_what_the_first_model_waits_for() -> None:
    ident = rp.Identifier(poles=2, zeros=1, dt=0.01)
    assert "<p>2 poles and 1 zero; 0 of 500 outputs for the first model</p>" in ident._repr_html_()
    ident.update_many([0.0, 1.0, 1.0], [math.nan, 0.0, 0.0])  # one without an output does not count
    assert "; 2 of 500 outputs for the first model</p>" in ident._repr_html_()


@pytest.mark.slow
def test_a_notebook_shows_the_model() -> None:
    ident = rp.Identifier(poles=2, zeros=1, dt=0.01)
    u = np.where(np.arange(2000) // 125 % 2 == 0, 1.0, -1.0)
    ident.update_many(u, rp.TransferFunction([1.0, 2.0], [1.0, 1.5, 0.5]).simulate(u, dt=0.01))
    shown = ident._repr_html_()
    assert "outputs for the first model" not in shown
    assert html.escape(str(ident.transfer_function)) in shown
    assert "<img src=" in shown


# --- chunks of any size

SAMPLES, STARTUP = 90, 25
CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "definite": {"filter": rp.StateVariableFilter(3.0), "scaling": rp.Scaling(1.0, [0.2, 0.3, 0.5, 0.1])},
    "callable map": {
        "filter": rp.StateVariableFilter(3.0),
        "scaling": None,
        "preprocess": rp.Preprocess(np.cbrt, "first", 0.5),
    },
    "callable map and mean": {
        "filter": rp.StateVariableFilter(3.0),
        "scaling": None,
        "preprocess": rp.Preprocess(np.cbrt, "mean", "mean"),
        "startup": STARTUP,
        "normalize": False,
    },
    "square and dead time": {
        "structure": rp.Structure(2, 1, delay=0.37, bias=True),
        "filter": rp.StateVariableFilter(3.0),
        "preprocess": rp.Preprocess("square", "first", "first"),
        "startup": STARTUP,
    },
}
REPLAY = rp.Replay(capacity=30, batch_size=4, warmup=5, seed=3)
#: The article's method, filter and scaling from the data: what "auto" was made for before there were instruments.
ARTICLE: dict[str, Any] = {"optimizer": "amsgrad", "instruments": False}
NONE = dict.fromkeys(REASONS, 0)
NO_SAMPLE = [(np.nan, 1.0), (1.0, np.nan), (np.inf, 1.0), (1.0, -np.inf), (1e308, 1e308), (1.0, -1e151)]


def make(name: str, configuration: str, replay: rp.Replay | None) -> rp.Identifier:
    """Without instruments; those have tests of their own, in test_default.py and test_interleaving.py."""
    optimizer = OPTIMIZERS[name](**TWINS[name].settings)
    changes = {"structure": rp.Structure(2, 1), "optimizer": optimizer, "instruments": False}
    changes["replay"] = None if optimizer.keeps_covariance else replay
    return rp.Identifier(**{"dt": 0.1, **changes, **CONFIGURATIONS.get(configuration, {"startup": STARTUP})})


def one_by_one(ident: rp.Identifier, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    errors, parameters = [], []
    for k in range(u.size):
        errors.append(ident.update(float(u[k]), float(y[k])))
        parameters.append(ident.parameters)
    return np.array(errors), np.array(parameters)


def in_chunks(ident: rp.Identifier, u: np.ndarray, y: np.ndarray, cuts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    edges = [0, *sorted(cuts), u.size]
    traces = [ident.update_many(u[a:b], y[a:b]) for a, b in itertools.pairwise(edges)]
    return np.concatenate([trace.errors for trace in traces]), np.vstack([trace.parameters for trace in traces])


streams = {
    "seed": st.integers(0, 1000),
    "cuts": st.lists(st.integers(0, SAMPLES), max_size=8),
    "bad": st.lists(st.tuples(st.integers(0, SAMPLES - 1), st.sampled_from(NO_SAMPLE)), max_size=6),
    "replay": st.sampled_from([None, REPLAY]),
}


@settings(deadline=None, derandomize=True, max_examples=examples(160))
@given(name=st.sampled_from(sorted(OPTIMIZERS)), configuration=st.sampled_from(sorted(CONFIGURATIONS)), **streams)
def test_chunks_of_any_size_equal_one_call_equal_a_loop(name: str, configuration: str, **stream: Any) -> None:
    assert_chunks_equal(name, configuration, **stream)


@settings(deadline=None, derandomize=True, max_examples=examples(30))
@given(name=st.sampled_from(sorted(OPTIMIZERS)), **streams)
def test_so_they_do_when_all_is_left_to_auto(name: str, **stream: Any) -> None:
    assert_chunks_equal(name, "auto", **stream)


@every_optimizer
def test_so_they_do_when_a_cut_or_a_bad_sample_falls_into_start_up(name: str) -> None:
    bad = [(0, NO_SAMPLE[0]), (7, NO_SAMPLE[4]), (26, NO_SAMPLE[2]), (60, NO_SAMPLE[5])]
    assert_chunks_equal(name, "auto", seed=1, cuts=[5, 27, 28, 40], bad=bad, replay=REPLAY)


def assert_chunks_equal(
    name: str,
    configuration: str,
    seed: int,
    cuts: list[int],
    bad: list[tuple[int, tuple[float, float]]],
    replay: rp.Replay | None,
) -> None:
    u, y = record(random_plant(seed, 2, 1), seed, SAMPLES, 0.1, noise=0.1)
    for k, (bad_u, bad_y) in bad:
        u[k], y[k] = bad_u, bad_y
    loop, whole, chunked = (make(name, configuration, replay) for _ in range(3))
    errors, parameters = one_by_one(loop, u, y)
    assert loop.settings is not None  # start-up is over
    for ident, (other_errors, other_parameters) in (
        (whole, in_chunks(whole, u, y, [])),
        (chunked, in_chunks(chunked, u, y, cuts)),
    ):
        np.testing.assert_array_equal(other_errors, errors)
        np.testing.assert_array_equal(other_parameters, parameters)
        assert state(ident) == state(loop)
        taken = [count for reason, count in ident.rejected.items() if reason in ("outlier", "stuck", "no output")]
        assert ident.samples == loop.samples == SAMPLES - sum(ident.rejected.values()) + sum(taken)
        assert ident.rejected == loop.rejected
        assert ident.settings == loop.settings


def test_the_kind_of_array_does_not_matter() -> None:
    """Lists, whole numbers, strided and read-only views carry the same samples."""
    u, y = np.round(10 * np.random.default_rng(0).standard_normal((2, 64)))
    expected = identifier().update_many(u, y).parameters
    locked = u.copy()
    locked.flags.writeable = False
    kinds: dict[str, tuple[Any, Any]] = {
        "lists": (u.tolist(), y.tolist()),
        "integers": (u.astype(np.int16), y.astype(np.int64)),
        "float32": (u.astype(np.float32), y.astype(np.float32)),
        "strided": (np.repeat(u, 3)[::3], np.stack([y, y], axis=1)[:, 0]),
        "big-endian": (u.astype(">f8"), y.astype(">f8")),
        "read-only": (locked, y),
    }
    for kind, (us, ys) in kinds.items():
        np.testing.assert_array_equal(identifier().update_many(us, ys).parameters, expected, err_msg=kind)
    ident = identifier()
    for k in range(64):
        ident.update(int(u[k]), np.float32(y[k]))
    np.testing.assert_array_equal(ident.parameters, expected[-1])


def test_an_empty_chunk_changes_nothing() -> None:
    ident = identifier()
    ident.update_many([1.0, 2.0], [0.5, 0.1])
    before = state(ident)
    trace = ident.update_many([], [])
    assert len(trace) == 0
    assert trace.parameters.shape == (0, 4)
    assert state(ident) == before


# --- start-up


@pytest.mark.parametrize("preprocess", [rp.Preprocess(), rp.Preprocess("square", "mean", "mean")])
def test_start_up_loses_no_sample(preprocess: rp.Preprocess) -> None:
    """Afterwards the estimate is that of an identifier which knew the chosen settings from the first sample on."""
    u, y = record(G2, seed=4, samples=400, dt=0.02, noise=0.01)
    y[[3, 70]] = np.nan
    ident = rp.Identifier(rp.Structure(2, 1), 0.02, preprocess=preprocess, startup=120, **ARTICLE)
    trace = ident.update_many(u, y)
    assert ident.settings is not None
    knowing = rp.Identifier(**ident.settings.arguments)
    expected = knowing.update_many(u, y)
    first = 121  # two of the first samples are rejected: the 120th accepted one has the number 121
    assert not trace.parameters[:first].any()
    np.testing.assert_array_equal(trace.parameters[first:], expected.parameters[first:])
    np.testing.assert_array_equal(trace.errors[first:], expected.errors[first:])
    assert np.isnan(trace.errors[:first]).all()
    assert without_past(ident) == without_past(knowing)
    assert (ident.samples, ident.rejected) == (398, {**NONE, "not finite": 2})


def without_past(ident: rp.Identifier) -> dict[str, bytes]:
    """The state, but for what start-up leaves out: estimates to be judged by later samples, and a model to wait for."""
    ident = ident.clone()
    ident._state.past[:] = 0.0
    ident._state.past_kept = ident._state.past_due = 0
    ident._state.ready_at, ident._state.solved_at = 0.0, 0
    return state(ident)


def test_the_stages_of_start_up() -> None:
    ident = rp.Identifier(rp.Structure(1), 0.1, startup=3, **ARTICLE)
    assert (ident.status, ident.settings, ident.samples) == ("starting", None, 0)
    ident.update(1.0, 0.0)
    ident.update(math.nan, 0.0)
    assert math.isnan(ident.update(2.0, 0.5))
    assert (ident.status, ident.settings, ident.samples) == ("starting", None, 2)
    assert ident.rejected == {**NONE, "not finite": 1}
    assert ident.transfer_function == rp.TransferFunction([0.0], [1.0, 0.0])
    assert math.isfinite(ident.update(1.0, 0.7))
    assert (ident.status, ident.samples) == ("running", 3)
    assert ident.rejected == {**NONE, "not finite": 1}


@pytest.mark.parametrize("method", [ARTICLE, {}], ids=["article", "default"])
def test_a_short_record_can_end_start_up(method: dict[str, Any]) -> None:
    u, y = record(G1, seed=1, samples=50, dt=0.1)
    early, late = (rp.Identifier(rp.Structure(1), 0.1, startup=held, **method) for held in (500, 50))
    early.finish()  # nothing held yet: nothing to choose from
    assert early.status == "starting"
    early.update_many(u, y)
    early.finish()
    late.update_many(u, y)
    assert early.settings == late.settings
    late._state.finished_at = 50  # all that tells the two apart: the end of a record is judged in sample
    assert state(early) == state(late)
    before = state(early)
    early.finish()
    assert state(early) == before


def test_an_end_that_gives_no_model_loses_no_sample() -> None:
    u, y = record(G1, seed=1, samples=600, dt=0.1)
    ident = rp.Identifier(rp.Structure(1), 0.1)
    ident.update_many(np.zeros(60), np.zeros(60))
    for _ in range(6):
        ident.finish()
    assert (ident.status, ident.samples) == ("starting", 60)
    ident.update_many(u, y)
    assert ident.status == "running"


def test_what_needs_no_data_waits_for_none() -> None:
    assert identifier().status == "running"
    assert identifier("rmsprop", replay="auto").status == "running"
    assert identifier(scaling="auto").status == "starting"
    first = identifier(preprocess=rp.Preprocess(output_offset="first"))
    assert first.status == "starting"
    assert first.update(0.0, 5.0) == 0.0
    assert first.settings.preprocess.output_offset == 5.0


# --- what the settings mean


@every(
    ("preprocess", "by_hand"),
    [
        (rp.Preprocess("square"), lambda u, y: (u * u, y)),
        (rp.Preprocess(input_offset=0.5, output_offset=-2.0), lambda u, y: (u - 0.5, y + 2.0)),
        (rp.Preprocess("square", "first", "first"), lambda u, y: (u * u - u[0] * u[0], y - y[0])),
        (rp.Preprocess(np.cbrt), lambda u, y: (np.cbrt(u), y)),
    ],
)
def test_preprocessing_equals_doing_it_by_hand(
    preprocess: rp.Preprocess, by_hand: Callable[..., tuple[np.ndarray, np.ndarray]]
) -> None:
    u, y = np.random.default_rng(5).normal(2.0, 1.0, (2, 100))
    inside, outside = identifier(preprocess=preprocess).update_many(u, y), identifier().update_many(*by_hand(u, y))
    np.testing.assert_array_equal(inside.parameters, outside.parameters)
    np.testing.assert_array_equal(inside.errors, outside.errors)


def test_the_error_is_that_of_the_estimate_before_the_sample() -> None:
    """With a = b = 0 at the start the first errors are the target itself: y at the first sample, filters at rest."""
    ident = identifier(scaling=rp.Scaling(0.3, [0.1, 0.2, 0.3, 0.4]))
    assert ident.update(1.0, 0.75) == pytest.approx(0.75, rel=1e-15)


def test_the_estimate_as_a_transfer_function() -> None:
    structure = rp.Structure(2, 1, delay=0.2, bias=True)
    u, y = record(G2, seed=2, samples=300, dt=0.05)
    ident = identifier(structure=structure)
    ident.update_many(u, y + 0.1)
    a1, a0, b1, b0, bias = ident.parameters
    assert bias != 0.0
    assert ident.names == ("a1", "a0", "b1", "b0", "bias")
    assert ident.transfer_function == rp.TransferFunction([b1, b0], [1.0, a1, a0], 0.2)


def each_kind() -> list[rp.Identifier]:
    """One that is ready at once, and two that start up: by the article's method and by the default's."""
    return [identifier(), *(rp.Identifier(rp.Structure(1), 0.1, startup=80, **method) for method in (ARTICLE, {}))]


def test_a_clone_goes_on_alone() -> None:
    u, y = record(G1, seed=6, samples=120, dt=0.1, noise=0.1)
    for ident in (
        identifier(),
        *(rp.Identifier(rp.Structure(1), 0.1, startup=80, **method) for method in (ARTICLE, {})),
    ):
        ident.update_many(u[:60], y[:60])
        twin = ident.clone()
        expected = ident.update_many(u[60:], y[60:])
        twin.update(9.0, 9.0)
        assert state(twin) != state(ident) if twin.settings else twin.samples == 61
        again = ident.clone()
        assert state(again) == state(ident)
        assert again is not ident
        assert len(expected) == 60


def test_reset_begins_again() -> None:
    u, y = record(G1, seed=7, samples=120, dt=0.1, noise=0.1)
    for ident in (
        identifier(),
        *(rp.Identifier(rp.Structure(1), 0.1, startup=80, **method) for method in (ARTICLE, {})),
    ):
        first = ident.update_many(u, y)
        after = state(ident)
        ident.reset()
        assert (ident.samples, ident.rejected) == (0, NONE)
        assert not ident.parameters.any()
        again = ident.update_many(u, y)
        np.testing.assert_array_equal(again.parameters, first.parameters)
        assert state(ident) == after


@pytest.mark.parametrize("poles", [1, 4, 10])
def test_every_order_runs(poles: int) -> None:
    u, y = record(random_plant(poles, poles, poles - 1), poles, 300, 0.1, noise=0.01)
    ident = identifier(structure=rp.Structure(poles, poles - 1), filter=rp.StateVariableFilter(2.0))
    trace = ident.update_many(u, y)
    assert np.isfinite(trace.parameters).all()
    assert (trace.parameters[-1] != 0).all()
    assert ident.status == "running"


def test_with_defaults_alone_it_finds_the_plants() -> None:
    """Noise-free, a minute of a random binary input, nothing but the structure given: each coefficient within 10 %."""
    for plant, zeros in ((G1, 0), (random_plant(1, 2, 0), 0)):
        u, y = record(plant, seed=8, samples=6000, dt=0.01, hold=60)
        ident = rp.Identifier(rp.Structure(plant.den.size - 1, zeros), 0.01)
        ident.update_many(u, y)
        np.testing.assert_allclose(ident.parameters, true_parameters(plant, zeros), rtol=0.1)


# --- bad samples


@every(("u", "y"), NO_SAMPLE)
@every("many", [False, True], ids=["update", "update_many"])
def test_a_rejected_sample_changes_its_count_alone(u: float, y: float, many: bool) -> None:
    ident = identifier(rp.Adam(step_size=0.01))
    ident.update_many(*record(G1, seed=1, samples=70, dt=0.05, noise=0.1))
    ints, before, estimate, counts = ident._state.ints.copy(), state(ident), ident.parameters, ident.rejected
    error = ident.update_many([u], [y]).errors[0] if many else ident.update(u, y)
    reason = "too large" if np.isfinite([u, y]).all() else "not finite"
    assert math.isnan(error)
    assert ident.rejected == {**counts, reason: counts[reason] + 1}
    ints[(State.too_large if reason == "too large" else State.not_finite).index] += 1
    assert state(ident) == {**before, "ints": ints.tobytes()}
    np.testing.assert_array_equal(ident.parameters, estimate)
    assert ident.status == "running"


@pytest.mark.slow
@every("spike", [1e308, -1e308, 1e151], quick=1)
@every("preprocess", [rp.Preprocess("square", "mean"), rp.Preprocess("square"), rp.Preprocess()], quick=1)
def test_a_spike_is_counted_and_leaves_the_estimate_alone(spike: float, preprocess: rp.Preprocess) -> None:
    """With the spike in or the sample missing: the same estimate, during start-up and after it."""
    u, y = record(G1, seed=3, samples=200, dt=0.05, noise=0.05)
    for position in (0, 20, 150):
        spiked, clean = (rp.Identifier(rp.Structure(1), 0.05, preprocess=preprocess, startup=60) for _ in range(2))
        t = 0.05 * np.arange(u.size)
        spiked.update_many(
            np.insert(u, position, spike), np.insert(y, position, 0.0), np.insert(t, position, t[position])
        )
        clean.update_many(u, y, t)
        assert sum(spiked.rejected.values()) == 1 + sum(clean.rejected.values())
        np.testing.assert_array_equal(spiked.parameters, clean.parameters)


@every("bad", ["a", b"1", None, 1j, np.complex128(1), Thing(), [1.0], np.ones(1), 10**400], ids=repr)
@every("ready", [True, False], ids=["running", "starting"])
def test_update_refuses_what_is_no_number(bad: Any, ready: bool) -> None:
    ident = identifier() if ready else rp.Identifier(rp.Structure(1), 0.1)
    ident.update(1.0, 0.5)
    before, samples, counts = state(ident) if ready else None, ident.samples, ident.rejected
    for name, arguments in (("u", (bad, 1.0)), ("y", (1.0, bad))):
        with pytest.raises((rp.ArgumentTypeError, rp.InvalidArgumentError), match=f"^{name} must") as caught:
            ident.update(*arguments)
        assert "\n" not in str(caught.value)
    assert (ident.samples, ident.rejected) == (samples, counts)
    assert before is None or state(ident) == before


@every(
    ("u", "y", "message"),
    [
        ([1.0, 2.0], [1.0], "u and y must have the same length, got 2 and 1 samples"),
        ([], [1.0], "u and y must have the same length, got 0 and 1 samples"),
        (np.ones((3, 1)), np.ones(3), r"u must be a vector of shape \(K,\), got shape \(3, 1\)"),
        (np.ones(3), np.ones((1, 3)), r"y must be a vector of shape \(K,\), got shape \(1, 3\)"),
        (1.0, 1.0, r"u must be a vector of shape \(K,\), got shape \(\)"),
        (["a", "b"], [1.0, 2.0], "u must hold real numbers, got dtype <U1"),
        ("ab", [1.0, 2.0], "u must hold real numbers"),
        (None, [1.0], "u must hold real numbers, got dtype object"),
        ([1.0], [None], "y must hold real numbers, got dtype object"),
        ([1.0], [1j], "y must hold real numbers, got dtype complex128"),
        ([1.0], [Thing()], "y must hold real numbers, got dtype object"),
        ([1.0], np.array(["2020-01-01"], "M8[D]"), r"y must hold real numbers.*: seconds are \(y - y\[0\]\)"),
        ([1.0], [datetime(2020, 1, 1)], r"y must hold real numbers.*: timestamp\(\) gives the seconds"),
        ([1.0], np.array([1], "m8[s]"), "y must hold real numbers.*: seconds are y / np.timedelta64"),
        ([[1.0], [1.0, 2.0]], [1.0, 2.0], "u must be an array of numbers"),
    ],
    ids=repr,
)
def test_update_many_refuses_what_is_no_record(u: Any, y: Any, message: str) -> None:
    ident = identifier()
    ident.update_many(*record(G1, seed=1, samples=30, dt=0.05))
    before = state(ident)
    with pytest.raises((rp.ArgumentTypeError, rp.InvalidArgumentError), match=f"^{message}") as caught:
        ident.update_many(u, y)
    assert "\n" not in str(caught.value)
    assert state(ident) == before


def test_a_map_that_breaks_its_contract_leaves_the_state_alone() -> None:
    broken = False
    ident = identifier(preprocess=rp.Preprocess(lambda v: v[:0] if broken else v))
    ident.update_many(*record(G1, seed=1, samples=30, dt=0.05))
    before, broken = state(ident), True
    for call, arguments in ((ident.update, (1.0, 1.0)), (ident.update_many, ([1.0, 2.0], [1.0, 2.0]))):
        with pytest.raises(rp.InvalidArgumentError, match="input_map"):
            call(*arguments)
    assert state(ident) == before


# --- bad settings


@every(
    ("changes", "named", "kind"),
    [
        ({"structure": "a"}, "structure", TypeError),
        ({"structure": 2}, "structure", TypeError),
        ({"dt": 0.0}, "dt", ValueError),
        ({"dt": -0.1}, "dt", ValueError),
        ({"dt": math.nan}, "dt", ValueError),
        ({"dt": math.inf}, "dt", ValueError),
        ({"dt": "a"}, "dt", TypeError),
        ({"dt": None}, "dt", TypeError),
        ({"dt": 1j}, "dt", TypeError),
        ({"dt": [0.1]}, "dt", TypeError),
        ({"filter": 50.0}, "filter", TypeError),
        ({"filter": None}, "filter", TypeError),
        ({"filter": "exact"}, "filter", TypeError),
        ({"filter": rp.StateVariableFilter(denominator=[1.0, 1.0])}, "denominator", ValueError),
        ({"scaling": 1.0}, "scaling", TypeError),
        ({"scaling": "none"}, "scaling", TypeError),
        ({"scaling": np.ones(4)}, "scaling", TypeError),
        ({"scaling": rp.Scaling(1.0, [1.0])}, "scaling", ValueError),
        ({"optimizer": "sgd"}, "optimizer", TypeError),
        ({"optimizer": rp.Adam}, "optimizer", TypeError),
        ({"optimizer": None}, "optimizer", TypeError),
        ({"replay": 1000}, "replay", TypeError),
        ({"replay": True}, "replay", TypeError),
        ({"replay": "no"}, "replay", TypeError),
        ({"normalize": 1}, "normalize", TypeError),
        ({"normalize": None}, "normalize", TypeError),
        ({"preprocess": "square"}, "preprocess", TypeError),
        ({"startup": 0}, "startup", ValueError),
        ({"startup": 1.5}, "startup", TypeError),
    ],
    ids=repr,
)
def test_a_bad_setting_is_refused_by_name(changes: dict[str, Any], named: str, kind: type[Exception]) -> None:
    with pytest.raises(kind, match=named) as caught:
        identifier(**changes)
    assert isinstance(caught.value, rp.ReplantError)
    assert "\n" not in str(caught.value)


# --- signals that do not excite, and gains that diverge


@every_optimizer
@every("level", [0.0, 1.0, -1e-200, 1e140])
def test_a_constant_input_keeps_everything_finite(name: str, level: float) -> None:
    for ident in (
        rp.Identifier(rp.Structure(2, 1), 0.1, optimizer=name, startup=50),
        identifier(OPTIMIZERS[name](**TWINS[name].settings)),
    ):
        trace = ident.update_many(np.full(300, level), np.full(300, 2 * level))
        assert np.isfinite(trace.parameters).all()
        if ident.settings is None:  # instruments wait for an input that moves
            assert OPTIMIZERS[name].keeps_covariance
            assert not trace.parameters.any()
        else:
            assert is_finite(ident._state)


@with_and_without(rp.Replay(capacity=20, batch_size=3, warmup=2))
def test_a_diverging_estimate_stops_at_its_last_finite_value(name: str, replay: rp.Replay | None) -> None:
    huge = {"gain": 1e200, "step_size": 1e200, "initial_covariance": 1e300}
    huge = {field: value for field, value in huge.items() if field in TWINS[name].settings}
    optimizer = dataclasses.replace(OPTIMIZERS[name](**TWINS[name].settings), **huge)
    ident = identifier(optimizer, replay=replay, normalize=False)
    u, y = record(G2, seed=1, samples=200, dt=0.05, noise=0.1)
    refused = 0
    for k in range(200):
        before, memory = ident.parameters, memory_of(ident)
        ident.update(1e100 * u[k], 1e100 * y[k])
        assert np.isfinite(ident.parameters).all()
        assert np.isfinite(memory_of(ident)).all()
        if ident._state.refused > refused:
            refused = int(ident._state.refused)
            np.testing.assert_array_equal(ident.parameters, before)
            np.testing.assert_array_equal(memory_of(ident), memory)
            assert ident.status == "diverged"
    assert refused > 0
    assert ident.samples == 200
    assert ident.rejected == NONE
    # and the filters go on: calm samples pass, the state stays finite
    ident.update_many(u, y)
    assert is_finite(ident._state)
    assert np.isfinite(ident.parameters).all()
    assert ident.samples == 400


def memory_of(ident: rp.Identifier) -> np.ndarray:
    """The optimizer's moments."""
    return ident._state.memory.copy()


def test_a_sane_gain_runs_on_after_an_update_was_refused() -> None:
    """One sample near the largest magnitude makes a gradient beyond float64; the estimate then converges all the same.

    Without replay, so that the sample does not come back.
    """
    u, y = record(G1, seed=2, samples=3000, dt=0.05, hold=20)
    ident = identifier(rp.Gradient(gain=4.0), structure=rp.Structure(1), normalize=False, replay=None)
    ident.update_many(u[:100], y[:100])
    ident.update(1e149, 1e149)
    ident.update(0.0, 0.0)
    assert ident.status == "diverged"
    before = ident.parameters
    assert np.isfinite(before).all()
    ident.update_many(u, y)
    assert np.isfinite(ident.parameters).all()


# --- memory


def test_memory_does_not_grow_with_the_stream() -> None:
    """10^5 samples one by one and 10^6 in chunks: the arrays keep their size, Python's heap stays within 100 kB.

    One number kept per sample would be 800 kB and more.
    """
    u, y = record(G1, seed=1, samples=1000, dt=0.05, noise=0.1)
    ident = identifier(structure=rp.Structure(1))
    ident.update_many(u, y)
    pairs = list(zip(u.tolist(), y.tolist(), strict=True))
    sizes = {name: len(array) for name, array in state(ident).items()}
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(100):
            for sample_u, sample_y in pairs:
                ident.update(sample_u, sample_y)
        for _ in range(1000):
            ident.update_many(u, y)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert ident.samples == 1000 + 100_000 + 1_000_000
    assert sizes == {name: len(array) for name, array in state(ident).items()}
    assert after - before < 100_000


def test_rejected_samples_do_not_pile_up_either() -> None:
    ident = rp.Identifier(rp.Structure(1), 0.1)
    u = np.full(10_000, np.nan)
    ident.update_many(u, u)
    assert ident.rejected == {**NONE, "not finite": 10_000}
    assert ident.samples == 0


def test_a_choice_that_is_none_is_named_with_those_there_are() -> None:
    with pytest.raises(rp.ArgumentTypeError, match=r"^optimizer must be an Optimizer or 'auto' or .* got str 'adamw'$"):
        rp.Identifier(rp.Structure(1), 0.1, optimizer="adamw")
    with pytest.raises(rp.ArgumentTypeError, match=r"^replay must be a Replay or 'auto' or None, got int 3$"):
        rp.Identifier(rp.Structure(1), 0.1, replay=3)  # type: ignore[arg-type]


def test_room_that_is_written_before_it_is_read_may_hold_anything() -> None:
    """A checkpoint with it is taken, and goes on to the bit."""
    u, y = record(G1, seed=3, samples=300, dt=0.05, noise=0.05)
    ident = rp.Identifier(rp.Structure(1), 0.05, startup=60)
    ident.update_many(u[:200], y[:200])
    twin = ident.clone()
    ident._state.output_before[:] = np.nan
    ident._state.work[:] = np.inf
    loaded = rp.Identifier.from_bytes(ident.to_bytes())
    expected, found = (one.update_many(u[200:], y[200:]) for one in (twin, loaded))
    np.testing.assert_array_equal(found.errors, expected.errors)
    np.testing.assert_array_equal(found.parameters, expected.parameters)
