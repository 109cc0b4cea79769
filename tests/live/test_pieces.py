"""The small pieces of a live session, one after the other."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.estimation.settings import Request
from replant.live.dashboard.app import Hub, python_of
from replant.live.make_view import EstimateHistory, bode_of, make_view, step_of, truth_of
from replant.live.outputs.message import EstimateMessage, time_to_live
from replant.live.outputs.sinks import open_sink
from replant.live.progress import Limits, Progress, RigClock, Throughput, resume, stop_on_signals
from replant.live.view import Bode, SessionInfo
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.online.identifier import Identifier

UNKNOWN = Uncertainty(Structure(1), np.array([2.0, 4.0]), np.full((2, 2), np.nan))
PLANT = TransferFunction([4.0], [1.0, 2.0])


def test_a_model_becomes_a_program() -> None:
    model = {"num": [1.25], "den": [1.0, 0.5], "delay": 0.0, "verdict": {"status": "trusted\nimport os"}, "samples": 7}
    first, *rest = python_of(model).splitlines()
    assert first == "# identified by replant from 7 samples; verdict: trusted import os"
    assert rest[-2:] == ["G = TransferFunction(num=[1.25], den=[1.0, 0.5], delay=0.0)", "print(G)"]


def test_the_hub_holds_the_newest_view_and_passes_commands_on() -> None:
    given: list[str] = []
    hub = Hub(command=given.append, report=bytes)
    hub.publish({"at": 0.5})
    hub.command("freeze")
    assert hub.newest is not None
    assert (hub.newest["at"], given) == (0.5, ["freeze"])


def test_responses_without_a_covariance_have_no_band() -> None:
    bode, step = bode_of(PLANT, UNKNOWN, dt=0.01), step_of(PLANT, UNKNOWN)
    assert bode.magnitude_db[0] == pytest.approx(20.0 * np.log10(2.0), abs=0.01)
    assert np.isnan(bode.magnitude_low).all()
    assert step.t[-1] == pytest.approx(3.0)
    assert step.y[-1] == pytest.approx(2.0 * (1.0 - np.exp(-6.0)))


def test_the_true_plant_beside_a_structure_with_a_bias() -> None:
    found = truth_of(PLANT, Structure(1, bias=True), PLANT, Bode(np.ones(1), *[np.zeros(0)] * 4))
    assert found is not None
    np.testing.assert_array_equal(found.parameters, [2.0, 4.0, np.nan])
    assert found.step[-1] == pytest.approx(2.0, abs=0.01)


def test_a_view_before_the_first_sample() -> None:
    view = make_view(Identifier(Structure(1), dt=0.1), SessionInfo(source="demo"), EstimateHistory(2))
    assert (view.status, view.source) == ("starting", "demo")


def test_an_estimate_as_a_line() -> None:
    known = np.array([2.128]), np.array([0.056])
    line = EstimateMessage(0.5, None, 25, ("a0",), *known, "running", "trusted", True, ttl=5.0).as_json()
    begin = (
        b'{"schema_version":1,"timestamp":0.5,"samples":25,"a0":2.128,"std_a0":0.056,"trusted":1,"excited":1,"ttl":5.0,'
    )
    assert line.startswith(begin)
    assert (time_to_live(0.001), time_to_live(2.0)) == (5.0, 20.0)
    assert open_sink("-").name == "-"


def test_the_clock_of_a_device_that_is_reset() -> None:
    clock = RigClock()
    assert clock.follow(np.array([500.0, 500.1]), 0.1).tolist() == [500.0, 500.1]
    # its second stamp confirms the reset
    np.testing.assert_allclose(clock.follow(np.array([0.0, 0.1, 0.2]), 0.1), [0.0, 504.1, 504.2])
    # a misread stamp, which the identifier rejects, leaves the clock where it was
    np.testing.assert_allclose(clock.follow(np.array([1e4, 0.3]), 0.1), [10504.0, 504.3])
    assert clock.last == pytest.approx(504.3)


def test_progress_through_a_checkpoint() -> None:
    again = Progress.of(Progress(3, 7, RigClock(0.5)).with_counters({"lost": 1}))
    assert again == Progress(taken=3, clock=RigClock(last=0.5), sequence=7, earlier={"lost": 1})
    assert Progress(earlier={"lost": 2, "duplicate": 1}).counted({"lost": 3}) == {"lost": 5, "duplicate": 1}
    assert resume(Path("no-such-file.replant"), Request(Structure(1), dt=0.1)) is None


def test_a_checkpoint_of_several_inputs_is_refused_in_a_line(tmp_path: Path) -> None:
    rp.Identifier(poles=(1, 1), dt=0.1).save(tmp_path / "row")
    with pytest.raises(rp.InvalidArgumentError, match=r"row: the checkpoint is of several inputs"):
        resume(tmp_path / "row", Request(Structure(1), dt=0.1))


def test_the_lag_is_the_age_of_the_oldest_sample() -> None:
    throughput = Throughput()
    throughput.count(10, arrived=time.monotonic() - 0.5)
    rate, lag = throughput.read()
    assert rate == 0.0
    assert 0.5 <= lag < 30.0


def test_the_limit_on_samples() -> None:
    limits = Limits(samples=1000)
    assert limits.left(900) == 100
    assert not limits.reached(seconds=1.5, samples=900, trusted=True)
    assert limits.reached(seconds=1.5, samples=1000, trusted=False)


def test_the_first_signal_asks_for_the_end() -> None:
    stops: list[bool] = []
    with stop_on_signals(lambda: stops.append(True)):
        signal.raise_signal(signal.SIGINT)
    assert stops == [True]
