"""Units in labels, frames, systems of other libraries, and their words for our arguments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

import replant as rp
from replant.errors import ArgumentTypeError
from replant.model.interop import (
    _answer,
    in_our_words,
    log_dataset,
    log_frame,
    of_scipy,
    of_state_space,
    parameter_units,
    trace_dataset,
    trace_frame,
    unit_of,
    without_unit,
)
from support.cases import every

LABELS = [
    ("speed [rpm]", "rpm", "speed"),
    ("force (N)", "N", "force"),
    ("flow [1/min]", "1/min", "flow"),
    ("u", "", "u"),
    ("data.y[:,0]", "", "data.y[:,0]"),
]
TRACE = (["a0"], np.array([[0.0], [0.5]]), np.array([1.0, 0.1]))


@every("label, unit, name", LABELS)
def test_units_of_labels(label: str, unit: str, name: str) -> None:
    assert (unit_of(label), without_unit(label)) == (unit, name)


def test_units_of_parameters() -> None:
    assert parameter_units(["a1", "a0", "b0", "bias"]) == {"a1": "1/s", "a0": "1/s^2", "b0": "y/u/s^2", "bias": "y"}
    assert parameter_units(["a0.u1", "b0.u1", "a1.u2", "a0.u2", "b0.u2"]) == {
        "a0.u1": "1/s", "b0.u1": "y/u1/s", "a1.u2": "1/s", "a0.u2": "1/s^2", "b0.u2": "y/u2/s^2",
    }  # fmt: skip


def test_a_trace_of_several_inputs_as_a_frame_and_a_dataset() -> None:
    u = np.random.default_rng(0).standard_normal((300, 2))
    trace = rp.Identifier(poles=(1, 1), dt=0.1).update_many(u, u.sum(axis=1))
    assert list(trace.to_pandas().columns) == ["a0.u1", "b0.u1", "a0.u2", "b0.u2", "error"]
    assert trace.to_xarray()["unit"].values.tolist() == ["1/s", "y/u1/s", "1/s", "y/u2/s"]


def test_a_trace_as_a_frame() -> None:
    frame = trace_frame(*TRACE, dt=0.1)
    assert frame.index.name == "time [s]"
    assert frame.to_dict("list") == {"a0": [0.0, 0.5], "error": [1.0, 0.1]}


def test_a_trace_as_a_dataset() -> None:
    assert dict(trace_dataset(*TRACE, dt=0.1).sizes) == {"time": 2, "parameter": 1}


def test_logs_as_frames() -> None:
    signals = {"input": ("u", np.zeros(2)), "output": ("y [rpm]", np.ones(2))}
    assert log_frame(signals, {}, None, {"dt": 0.5}).attrs["units"] == {"y [rpm]": "rpm"}
    assert list(log_dataset(signals, {"pump": np.ones(2)}, None, {"dt": 0.5})) == ["input", "output", "pump"]


def test_systems_of_other_libraries() -> None:
    num, den = of_scipy(signal.ZerosPolesGain([], [-0.5], 2.0))
    assert (num.tolist(), den.tolist()) == ([2.0], [1.0, 0.5])
    num, den = of_state_space([[0.0, 1.0], [-3.0, -4.0]], [[0.0], [1.0]], [[2.0, 0.0]], [[0.0]])
    assert num[:2].tolist() == [0.0, 0.0]
    assert num[2] == pytest.approx(2.0)
    assert den == pytest.approx([1.0, 4.0, 3.0])


def test_words_of_other_libraries_are_answered() -> None:
    @in_our_words
    def fit(poles: int = 1) -> int:
        return poles

    with pytest.raises(ArgumentTypeError, match="there is no argument 'order': poles=2 is the number of poles"):
        fit(order=2)  # type: ignore[call-arg]
    assert _answer("pole", ("poles", "zeros")) == "did you mean poles?"
    assert _answer("magic", ("poles", "zeros")) == "the arguments are poles, zeros"
