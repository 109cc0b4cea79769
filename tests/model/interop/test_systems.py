"""Systems of python-control and SciPy come over whole or are refused by name; traces and logs become tables."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from scipy import signal

import replant as rp
from support.builders import random_plant
from support.cases import every

OMEGA = np.geomspace(0.01, 100.0, 40)


def close(system: rp.TransferFunction, other: rp.TransferFunction) -> None:
    """Equal order, coefficients equal but for round-off."""
    assert system.num.shape == other.num.shape
    np.testing.assert_allclose(system.num, other.num, rtol=1e-7, atol=1e-9 * np.abs(other.num).max())
    np.testing.assert_allclose(system.den, other.den, rtol=1e-9)


@given(some.integers(0, 10_000), some.integers(1, 5), some.integers(0, 4))
def test_there_and_back_again(seed: int, poles: int, zeros: int) -> None:
    plant = random_plant(seed, poles, min(zeros, poles))
    assert rp.TransferFunction.from_control(plant.to_control()) == plant
    close(rp.TransferFunction.from_scipy(plant.to_scipy()), plant)
    close(rp.TransferFunction.from_scipy(plant.to_scipy().to_zpk()), plant)


@given(some.integers(0, 10_000), some.integers(1, 5), some.integers(0, 4))
def test_state_space_keeps_the_order_of_the_numerator(seed: int, poles: int, zeros: int) -> None:
    """Coefficients that are zero in truth must not come back as round-off: that would be a plant with more zeros."""
    plant = random_plant(seed, poles, min(zeros, poles))
    found = signal.StateSpace(*signal.tf2ss(plant.num, plant.den))
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((poles, poles)))[0]
    turned = signal.StateSpace(turn @ found.A @ turn.T, turn @ found.B, found.C @ turn.T, found.D)
    for system in (found, turned):
        close(rp.TransferFunction.from_scipy(system), plant)
        close(rp.TransferFunction.from_control(control.ss(system.A, system.B, system.C, system.D)), plant)


def test_the_response_is_the_same() -> None:
    mass = control.ss([[0.0, 1.0], [-40.0, -0.3]], [[0.0], [2.0]], [[1.0, 0.5]], [[0.25]])
    np.testing.assert_allclose(rp.TransferFunction.from_control(mass).response(OMEGA), mass(1j * OMEGA), rtol=1e-10)


def test_a_gain_alone_has_no_states() -> None:
    for system in (control.ss([], [], [], [[3.0]]), control.tf([6.0], [2.0])):
        assert rp.TransferFunction.from_control(system) == rp.TransferFunction([3.0], [1.0])


def test_dead_time_is_added_where_it_is_known() -> None:
    assert rp.TransferFunction.from_control(control.tf([1.0], [1.0, 1.0]), delay=0.3).delay == 0.3
    assert rp.TransferFunction.from_scipy(signal.lti([1.0], [1.0, 1.0]), delay=0.3).delay == 0.3


TWO = np.eye(2)


FROM_CONTROL, FROM_SCIPY = rp.TransferFunction.from_control, rp.TransferFunction.from_scipy


@every(
    ("make", "system", "error", "words"),
    [
        (FROM_CONTROL, control.tf([[[1.0], [1.0]]], [[[1.0, 1.0], [1.0, 2.0]]]), rp.InvalidArgumentError,
         "one input and one output, got 2 and 1"),
        (FROM_CONTROL, control.ss(-TWO, TWO, TWO, 0 * TWO), rp.InvalidArgumentError,
         "one input and one output, got 2 and 2"),
        (FROM_CONTROL, control.tf([1.0], [1.0, 0.5], 0.1), rp.InvalidArgumentError, "discrete time (dt = 0.1 s)"),
        (FROM_CONTROL, control.ss(-0.5, 1.0, 1.0, 0.0, True), rp.InvalidArgumentError, "discrete time:"),
        (FROM_CONTROL, control.tf([1.0, 0.0, 0.0], [1.0, 2.0]), rp.InvalidArgumentError,
         "improper, its numerator has order 2 and its denominator order 1"),
        (FROM_SCIPY, signal.StateSpace(-TWO, TWO, TWO, 0 * TWO), rp.InvalidArgumentError,
         "one input and one output, got 2 and 2"),
        (FROM_SCIPY, signal.TransferFunction([[1.0, 0.0], [0.0, 1.0]], [1.0, 2.0]), rp.InvalidArgumentError,
         "one input and one output, got 1 and 2"),
        (FROM_SCIPY, signal.TransferFunction([1.0], [1.0, 0.5], dt=0.1), rp.InvalidArgumentError,
         "discrete time (dt = 0.1 s)"),
        (FROM_SCIPY, signal.ZerosPolesGain([1.0, 2.0], [-1.0], 1.0), rp.InvalidArgumentError,
         "improper, its numerator has order 2"),
        (FROM_SCIPY, signal.ZerosPolesGain([], [-1.0 + 2.0j], 1.0), rp.ArgumentTypeError, "real"),
    ],
)  # fmt: skip
def test_what_python_control_and_scipy_know_and_we_do_not(
    make: Callable[[object], object], system: object, error: type[Exception], words: str
) -> None:
    with pytest.raises(error) as caught:
        make(system)
    assert words in str(caught.value)


@every("system", [None, 3.0, ([1.0], [1.0, 1.0]), rp.TransferFunction([1.0], [1.0, 1.0])])
def test_what_is_no_system_is_named(system: object) -> None:
    for make, kind in ((rp.TransferFunction.from_control, "control."), (rp.TransferFunction.from_scipy, "scipy")):
        with pytest.raises(rp.ArgumentTypeError, match=f"{kind}.* got {type(system).__name__}"):
            make(system)


@pytest.fixture
def trace() -> rp.Trace:
    parameters = np.arange(12.0).reshape(4, 3)
    return rp.Trace(("a1", "a0", "b0"), np.zeros(3), parameters, np.array([0.5, np.nan, 0.2, 0.1]))


def log(time: np.ndarray | None = None, *names: str) -> rp.Log:
    names = names or ("voltage [V]", "speed [rpm]")
    return rp.Log(np.arange(3.0), 2.0 * np.arange(3.0), 0.5, time, *names, Path("rig/day.csv"))


def test_a_trace_as_a_data_frame(trace: rp.Trace) -> None:
    frame = trace.to_pandas(dt=0.1)
    assert list(frame.columns) == ["a1", "a0", "b0", "error"]
    np.testing.assert_array_equal(frame[list(trace.names)].to_numpy(), trace.parameters)
    np.testing.assert_array_equal(frame["error"].to_numpy(), trace.errors)
    assert frame.index.name == "time [s]"
    np.testing.assert_allclose(frame.index, [0.0, 0.1, 0.2, 0.3])
    assert frame.attrs["dt"] == 0.1
    assert frame.attrs["units"] == {"a1": "1/s", "a0": "1/s^2", "b0": "y/u/s^2", "error": "y"}


def test_a_trace_as_a_dataset(trace: rp.Trace) -> None:
    data = trace.to_xarray(dt=0.1)
    assert dict(data.sizes) == {"time": 4, "parameter": 3}
    np.testing.assert_array_equal(data["parameters"].sel(parameter="a0"), trace.parameters[:, 1])
    np.testing.assert_array_equal(data["errors"], trace.errors)
    assert data["time"].attrs["units"] == "s"
    assert data["unit"].sel(parameter="b0").item() == "y/u/s^2"
    assert data.attrs == {"dt": 0.1}


def test_without_a_sampling_time_samples_are_counted(trace: rp.Trace) -> None:
    assert trace.to_pandas().index.name == "sample"
    assert list(trace.to_pandas().index) == [0, 1, 2, 3]
    assert dict(trace.to_xarray().sizes) == {"sample": 4, "parameter": 3}


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan])
def test_a_sampling_time_must_be_one(trace: rp.Trace, dt: float) -> None:
    for convert in (trace.to_pandas, trace.to_xarray):
        with pytest.raises(rp.InvalidArgumentError, match="dt"):
            convert(dt=dt)


def test_a_table_is_a_copy(trace: rp.Trace) -> None:
    """Whoever works on it does not change the trace."""
    frame = trace.to_pandas()
    frame.iloc[0, 0] = 99.0
    data = trace.to_xarray()
    data["parameters"][0, 0] = 99.0
    data["errors"][0] = 99.0
    assert (trace.parameters[0, 0], trace.errors[0]) == (0.0, 0.5)


def test_an_empty_trace_is_an_empty_table() -> None:
    nothing = rp.Trace(("a0", "b0"), np.zeros(2), np.empty((0, 2)), np.empty(0))
    assert nothing.to_pandas(dt=1.0).shape == (0, 3)
    assert dict(nothing.to_xarray(dt=1.0).sizes) == {"time": 0, "parameter": 2}


def test_a_log_as_a_data_frame() -> None:
    frame = log().to_pandas()
    assert list(frame.columns) == ["voltage [V]", "speed [rpm]"]
    assert list(frame.index) == [0.0, 0.5, 1.0]
    assert frame.attrs == {
        "dt": 0.5,
        "input_hold": "zoh",
        "input": "voltage [V]",
        "output": "speed [rpm]",
        "units": {"voltage [V]": "V", "speed [rpm]": "rpm"},
        "source": "day.csv",
    }


def test_a_log_as_a_dataset() -> None:
    data = log().to_xarray()
    np.testing.assert_array_equal(data["output"].sel(time=0.5), 2.0)
    assert data["input"].attrs == {"long_name": "voltage", "units": "V"}
    assert data.attrs == {"dt": 0.5, "input_hold": "zoh", "source": "day.csv"}


def test_a_log_comes_back_from_its_frame_with_its_other_columns_and_the_hold_of_its_input() -> None:
    u, others = np.array([0.0, 1.0, 1.0]), {"pump": np.array([2.0, 3.0, 4.0]), "fan": np.array([5.0, 6.0, 7.0])}
    whole = rp.Log(u, u, 0.5, others=others, more_inputs=("fan",), input_hold="foh")
    again = rp.read_log(whole.to_pandas(), input=["u", "fan"], output="y")
    assert (again.input_hold, again.dt, again.more_inputs, set(again.others)) == ("foh", 0.5, ("fan",), {"pump", "fan"})
    np.testing.assert_array_equal(again.others["pump"], whole.others["pump"])
    data = whole.to_xarray()
    assert (list(data), data.attrs["input_hold"]) == (["input", "output", "input_2", "pump"], "foh")


def test_another_column_may_not_have_the_name_of_a_signal() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="input and another column are both named 'u'"):
        rp.Log([0.0, 1.0], [0.0, 0.0], 0.5, others={"u": [0.0, 1.0]}).to_pandas()
    reserved = "another column is named 'time', a name that the dataset uses itself"
    with pytest.raises(rp.InvalidArgumentError, match=reserved):
        rp.Log([0.0, 1.0], [0.0, 0.0], 0.5, others={"time": [0.0, 1.0]}).to_xarray()


def test_time_stamps_of_the_file_are_kept() -> None:
    stamps = np.array([7.0, 7.5, 8.0])
    assert list(log(stamps).to_pandas().index) == [7.0, 7.5, 8.0]
    assert list(log(stamps).to_xarray()["time"]) == [7.0, 7.5, 8.0]


def test_names_in_the_file_may_be_any() -> None:
    assert list(log(None, "time", "input").to_pandas().columns) == ["time", "input"]
    assert log(None, "time", "time").to_xarray()["output"].attrs["long_name"] == "time"
    with pytest.raises(rp.InvalidArgumentError, match="both named 'y'"):
        log(None, "y", "y").to_pandas()


def test_without_the_package_the_message_says_what_to_install(trace: rp.Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    plant = control.tf([1.0], [1.0, 1.0])
    for name in ("pandas", "xarray", "control"):
        monkeypatch.setitem(sys.modules, name, None)
    for convert, needed in (
        (trace.to_pandas, "frames"),
        (trace.to_xarray, "frames"),
        (log().to_pandas, "frames"),
        (log().to_xarray, "frames"),
        (lambda: rp.TransferFunction.from_control(plant), "control"),
    ):
        with pytest.raises(rp.MissingDependencyError) as caught:
            convert()
        assert f"pip install 'replant[{needed}]'" in str(caught.value)


def test_tables_need_one_package_each() -> None:
    """A frame does not load xarray; neither is loaded before it is asked for."""
    script = (
        "import sys, numpy as np, replant as rp\n"
        "trace = rp.Trace(('a0',), np.zeros(1), np.ones((2, 1)), np.zeros(2))\n"
        "assert not {'pandas', 'xarray'} & set(sys.modules)\n"
        "trace.to_pandas()\n"
        "assert 'xarray' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
