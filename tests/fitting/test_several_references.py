"""Several inputs with a reference each: as columns, of a log, of several logs and of a table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import replant as rp
from support.cases import every

DT, SAMPLES = 0.1, 600
PLANT = rp.TransferFunction([2.0], [1.0, 1.0]), rp.TransferFunction([0.5], [1.0, 0.5])
ASKED: dict[str, Any] = {"poles": (1, 1)}


def record(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two inputs that follow a set-point each, and answer to the noise of the output; output and set-points."""
    rng = np.random.default_rng(seed)
    r = rng.uniform(-1.0, 1.0, (SAMPLES // 20, 2)).repeat(20, axis=0)
    noise = lfilter([0.1], [1.0, -0.9], rng.standard_normal(SAMPLES))
    u = lfilter([0.4], [1.0, -0.6], r, axis=0) - 0.5 * np.column_stack([noise, -noise])
    return u, 5.0 + sum(g.simulate(each.copy(), DT) for g, each in zip(PLANT, u.T, strict=True)) + noise, r


U, Y, R = record(0)
TABLE = pd.DataFrame({"t": DT * np.arange(SAMPLES), "a": U[:, 0], "b": U[:, 1], "y": Y, "ra": R[:, 0], "rb": R[:, 1]})


def log_of(u: np.ndarray, y: np.ndarray, r: np.ndarray) -> rp.Log:
    return rp.Log(
        u[:, 0], y, DT, input_name="a", reference=r[:, 0], reference_name="ra", others={"b": u[:, 1], "rb": r[:, 1]},
        more_inputs=("b",), more_references=("rb",),
    )  # fmt: skip


LOG = log_of(U, Y, R)


@pytest.fixture(scope="module")
def wanted() -> Any:
    return rp.fit(U, Y, DT, **ASKED, reference=R)


def test_each_moves_an_input_of_its_own(wanted: Any) -> None:
    reasons = " ".join(wanted.verdict.reasons)
    for name in ("u1", "u2"):
        assert f"input {name} is moved by the reference" in reasons
    error = wanted.parameters - [1.0, 2.0, 0.5, 0.5]
    assert (np.abs(error) < 4.0 * np.sqrt(np.diag(wanted.covariance))).all()
    one = rp.fit(U, Y, DT, **ASKED, reference=R[:, 0])
    assert "input u2 is moved by the reference" not in " ".join(one.verdict.reasons)


@pytest.mark.slow
@every(
    "given, more",
    [
        (LOG, {}),
        (TABLE, {"input": ["a", "b"], "output": "y", "reference": ["ra", "rb"]}),
        (TABLE.drop(columns="t"), {"input": ["a", "b"], "output": "y", "reference": ("ra", "rb"), "dt": DT}),
    ],
)
def test_a_log_and_a_table_have_them_as_arrays_do(wanted: Any, given: Any, more: dict[str, Any]) -> None:
    found = rp.fit(given, **ASKED, **more)
    np.testing.assert_allclose(found.parameters, wanted.parameters, rtol=1e-9)
    assert found.model.input_names == ("a", "b")
    assert not any("column" in reason for reason in found.verdict.reasons)  # a reference is no further column


def test_a_sample_without_one_of_them_is_left_out_and_counted(wanted: Any) -> None:
    r = R.copy()
    r[[100, 200], [0, 1]] = np.nan
    found = rp.fit(U, Y, DT, **ASKED, reference=r)
    assert found.samples == wanted.samples - 2
    assert found.missing.tolist() == [100, 200]
    assert found.rejected["not finite"] == 2


@pytest.mark.slow
def test_search_and_run_take_them_too(wanted: Any) -> None:
    found = rp.search(LOG, poles=1, zeros=0)
    np.testing.assert_array_equal(
        found.best.parameters, rp.search(U, Y, DT, poles=1, zeros=0, reference=R).best.parameters
    )
    passed = rp.run(LOG, **ASKED)
    np.testing.assert_array_equal(passed.parameters, rp.run(U, Y, DT, **ASKED, reference=R).parameters)
    assert passed.verdict.status == wanted.verdict.status


def test_two_logs_have_them_one_behind_the_other() -> None:
    both = rp.fit([LOG, log_of(*record(1))], **ASKED)
    error = both.parameters - [1.0, 2.0, 0.5, 0.5]
    assert (np.abs(error) < 4.0 * np.sqrt(np.diag(both.covariance))).all()
    assert "input b is moved by the reference" in " ".join(both.verdict.reasons)
    with pytest.raises(
        rp.InvalidArgumentError, match="log 2 of 2 and log 1 of 2 differ in reference names: ra, not ra, rb"
    ):
        rp.fit([LOG, rp.Log(U[:, 0], Y, DT, input_name="a", reference=R[:, 0], reference_name="ra",
                            others={"b": U[:, 1]}, more_inputs=("b",))], **ASKED)  # fmt: skip


@every(
    "call, given, more",
    [
        (rp.fit, (U[:, 0], Y, DT), {"reference": R}),
        (rp.run, (U[:, 0], Y, DT), {"reference": R}),
        (rp.search, (U[:, 0], Y, DT), {"reference": R}),
        (rp.fit, (TABLE,), {"input": "a", "output": "y", "reference": ["ra", "rb"]}),
        (rp.fit, (rp.Log(U[:, 0], Y, DT, reference=Y, others={"r": Y}, more_references=("r",)),), {}),
    ],
)
def test_one_input_takes_one(call: Any, given: Any, more: dict[str, Any]) -> None:
    with pytest.raises(
        rp.InvalidArgumentError, match="one input takes one reference, got 2: give one reference, or name"
    ):
        call(*given, poles=1, **more)


def test_a_model_of_one_input_is_validated_by_one() -> None:
    model = rp.fit(U[:, 0], Y, DT, poles=1).model
    with pytest.raises(rp.InvalidArgumentError, match="one input takes one reference"):
        model.validate(rp.Log(U[:, 0], Y, DT, reference=Y, others={"r": Y}, more_references=("r",)))


@every(
    "references, words",
    [
        (["ra", "ra"], "the table: column 'ra' is a reference twice: name each column once"),
        (["ra", "b"], "column 'b' is an input and a reference: name each column once"),
        (["ra", "y"], "column 'y' is the output and a reference: name each column once"),
        (["ra", "rc"], "reference must name a column, got 'rc'; there are t, a, b, y, ra, rb"),
        ([], "reference must name a column"),
    ],
)
def test_what_is_wrong_in_a_table_is_one_line(references: list[str], words: str) -> None:
    with pytest.raises(rp.ReplantError, match=words) as caught:
        rp.fit(TABLE, input=["a", "b"], output="y", reference=references, **ASKED)
    assert "\n" not in str(caught.value)


def test_one_without_a_number_is_named() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="reference rb has no number that can be used"):
        rp.fit(log_of(U, Y, np.column_stack([R[:, 0], np.full(SAMPLES, np.nan)])), **ASKED)
