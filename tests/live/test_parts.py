"""The parts around the loop: views, history, clock, sinks, notices and the thread for the disk."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import re
import socket
import threading
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import replant as rp
from replant.assessment import simulate
from replant.live.observer.history import MOST_ROWS, History
from replant.live.observer.make_view import POINTS, look
from replant.live.observer.terminal import Status, one_line, screen
from replant.live.observer.view import Pulse, View
from replant.live.outputs import sinks
from replant.live.outputs.disk_writer import Background
from replant.live.outputs.message import Estimate
from replant.live.outputs.notices import AGAIN, Notices
from replant.live.outputs.sinks import Lines, open_sink
from replant.live.session.clock import Clock
from support.live_fakes import DT, PLANT, REQUEST, record
from support.waiting import PATIENCE

FIRST_ORDER = rp.Structure(1)


def viewed(samples: int, structure: rp.Structure = FIRST_ORDER, t: np.ndarray | None = None) -> View:
    u, y = record(max(samples, 1))
    identifier = rp.Identifier(**{**vars(REQUEST), "structure": structure})
    identifier.update_many(u[:samples], y[:samples], t)
    before = identifier.to_bytes()
    found = look(identifier, Pulse(at=samples * DT, source="fake://", rate=20.0), History(structure.size))
    assert identifier.to_bytes() == before, "looking changed the identifier"
    return found


# --- views


def test_a_view_agrees_with_its_identifier() -> None:
    u, y = record()
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y)
    found = viewed(u.size)
    np.testing.assert_array_equal(found.parameters, identifier.parameters)
    np.testing.assert_array_equal(found.std, identifier.uncertainty.std)
    assert found.poles == [-identifier.parameters[0]]
    assert found.pole_covariance[0, 0, 0] == pytest.approx(identifier.covariance[0, 0])
    assert found.dc_gain == pytest.approx(identifier.parameters[1] / identifier.parameters[0])
    assert (found.verdict, found.reasons) == (identifier.assess().status, identifier.assess().reasons)
    response = PLANT.response(found.bode.omega)
    np.testing.assert_allclose(found.bode.magnitude_db, 20 * np.log10(np.abs(response)), atol=0.2)
    assert (found.bode.magnitude_low < found.bode.magnitude_db).all()
    assert (found.bode.magnitude_db < found.bode.magnitude_high).all()


def test_the_window_shows_the_newest_samples_in_their_own_units() -> None:
    u, y = record(900)
    window = viewed(900).window
    np.testing.assert_allclose(window.t, DT * np.arange(1, 901), atol=1e-9)
    np.testing.assert_allclose(window.u, u)
    np.testing.assert_allclose(window.y, y)
    assert np.std(window.model - y) < 0.05  # the model runs through the measured output, working point included


def after_a_stuck_sensor(samples: int) -> tuple[rp.Identifier, View]:
    """Seen after so many samples, of which 1500 to 2000 stood still and 2600 was an outlier."""
    u, y = record(4000)
    y[1500:2000] = y[1500]
    y[2600] += 50.0
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u[:samples], y[:samples])
    return identifier, look(identifier, Pulse(at=samples * DT), History(2))


@pytest.mark.parametrize("samples", [1900, 2050, 2500, 3000, 4000])
def test_samples_that_were_bridged_take_no_part_in_the_fit_that_is_shown(samples: int) -> None:
    identifier, view = after_a_stuck_sensor(samples)
    u, y, _ = identifier.recent.T
    bridged = identifier.bridged
    assert bridged[1500:2000][: samples - 1500].mean() > 0.9
    assert view.simulated > 95.0  # with them it is below 80, and below 0 while they last
    run = simulate(identifier.transfer_function, u - 3.0, np.where(identifier.judged, y, np.nan), DT)
    assert view.simulated == pytest.approx(run.fit)


def test_what_is_left_out_is_told_by_when_it_came() -> None:
    samples = 3000
    identifier, view = after_a_stuck_sensor(samples)
    told = np.zeros(samples, bool)
    for begin, end in view.window.left_out:
        told[round(begin / DT) : round(end / DT)] = True
    np.testing.assert_array_equal(told, ~identifier.judged)
    assert view.to_json()["window"]["left_out"][0][1] == pytest.approx(2000 * DT)
    assert after_a_stuck_sensor(1400)[1].window.left_out.size == 0


def test_verdict_and_fit_agree_once_the_sensor_is_free() -> None:
    verdicts = [after_a_stuck_sensor(samples)[1].verdict for samples in (1400, 1900, 4000)]
    assert verdicts == ["trusted", "inconsistent", "trusted"]


def test_a_long_window_is_thinned_and_loses_no_peak() -> None:
    u, y = record(5000)
    y[3210] += 20.0
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y)
    window = look(identifier, Pulse(at=250.0), History(2)).window
    assert window.t.size == window.u.size == window.y.size == window.model.size <= POINTS
    assert window.y.max() == y.max()
    peak = int(np.argmax(window.y))
    assert window.t[peak] == pytest.approx(3211 * DT, abs=10 * DT)
    assert (np.diff(window.t) > 0).all()
    assert window.t[-1] == pytest.approx(250.0, abs=10 * DT)


def test_stamps_with_jitter_are_simulated_as_they_came() -> None:
    t = DT * (np.arange(1, 1501) + 0.3 * np.random.default_rng(0).uniform(-1, 1, 1500))
    found = viewed(900, t=t[:900])
    assert np.isfinite(found.simulated)
    assert np.ptp(np.diff(found.window.t)) > 0.1 * DT
    np.testing.assert_allclose(found.window.t - found.window.t[-1], t[:900] - t[899], atol=1e-9)


@pytest.mark.parametrize("samples", [0, 1, 150])
def test_before_the_first_model_nothing_is_claimed(samples: int) -> None:
    found = viewed(samples)
    assert found.status == "starting"
    assert np.isnan(found.parameters).all()
    assert np.isnan(found.std).all()
    assert found.den.size == found.num.size == found.poles.size == found.bode.omega.size == 0
    assert found.window.y.size == samples
    assert np.isnan(found.window.model).all()


@pytest.mark.parametrize("samples", [0, 150, 1000])
def test_a_view_is_json_under_its_own_names(samples: int) -> None:
    found = viewed(samples, rp.Structure(3, 1))
    plain = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert set(plain) == set(vars(found))
    assert set(plain["window"]) == {"t", "u", "y", "model", "left_out"}
    assert set(plain["history"]) == {"t", "parameters", "std"}
    assert len(plain["parameters"]) == found.parameters.size
    if found.poles.size:
        assert plain["poles"][0] == {"real": found.poles[0].real, "imag": found.poles[0].imag}
    else:
        assert plain["parameters"][0] is None


def test_poles_come_in_pairs_with_mirrored_covariances() -> None:
    u = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 400), 5)
    plant = rp.TransferFunction([4.0], [1.0, 1.0, 4.0])
    y = plant.simulate(u, DT) + 0.01 * np.random.default_rng(3).standard_normal(u.size)
    identifier = rp.Identifier(**{**vars(REQUEST), "structure": rp.Structure(2)})
    identifier.update_many(u, y)
    found = look(identifier, Pulse(), History(3))
    assert found.poles[0] == found.poles[1].conjugate()
    np.testing.assert_allclose(found.poles, [-0.5 + 1.936j, -0.5 - 1.936j], atol=0.02)
    first, second = found.pole_covariance
    np.testing.assert_allclose(np.diag(first), np.diag(second))
    assert first[0, 1] == -second[0, 1]


def test_the_history_covers_the_whole_run_in_bounded_memory() -> None:
    history = History(1)
    for k in range(10_000):
        history.append(float(k), np.array([k + 0.5]), np.array([0.1]))
        rows = history.rows()
        assert rows.t.size <= MOST_ROWS
        assert rows.t[-1] == k
    assert rows.t[0] == 0.0
    apart = np.diff(rows.t)[:-1]  # the newest is shown wherever it stands
    assert set(apart) == {16.0}
    np.testing.assert_array_equal(rows.parameters[:, 0], rows.t + 0.5)
    restored = History(1)
    restored.restore(rows)
    np.testing.assert_array_equal(restored.rows().t, rows.t)


# --- the clock


def test_a_clock_that_only_goes_on_is_left_alone() -> None:
    clock = Clock(DT)
    stamps = np.array([1e9, 1e9 + DT, 1e9 + 86400.0])  # and one that jumps ahead by a day is a gap by itself
    assert clock.follow(stamps) is stamps


def test_late_samples_stay_late() -> None:
    clock = Clock(DT)
    clock.follow(np.array([10.0, 10.05]))
    late = np.array([9.9, 9.95, 10.1, np.nan, 10.15])
    np.testing.assert_array_equal(clock.follow(late), late)
    assert clock.offset == 0.0


def test_a_single_stamp_far_back_is_no_restart() -> None:
    clock = Clock(DT)
    clock.follow(np.array([1000.0]))
    np.testing.assert_array_equal(clock.follow(np.array([3.0, 1000.05])), [3.0, 1000.05])
    assert clock.offset == 0.0


def test_a_clock_set_back_by_a_day_goes_on_after_a_gap() -> None:
    clock = Clock(DT)
    clock.follow(1e6 + DT * np.arange(10))
    last = clock.last
    rig = clock.follow(1e6 - 86400.0 + DT * np.arange(5))
    assert rig[0] < last  # this one is rejected
    assert (np.diff(rig[1:]) > 0).all()
    assert rig[1] - last > 20 * DT
    again = Clock(DT, clock.last, clock.offset)  # as after a resumption
    assert again.follow(np.array([1e6 - 86400.0 + 5 * DT]))[0] == pytest.approx(rig[-1] + DT)


# --- sinks


def estimate(sequence: int | None = 3) -> Estimate:
    values = np.array([0.1 + 0.2, np.nan]), np.array([1e-300, np.nan])
    return Estimate(0.25, sequence, 4, ("a0", "b0"), *values, "starting", "converging")


def test_an_estimate_is_flat_json_with_every_digit() -> None:
    assert json.loads(estimate().as_json()) == {
        "timestamp": 0.25, "sequence": 3, "samples": 4, "a0": 0.1 + 0.2, "b0": None, "std_a0": 1e-300, "std_b0": None,
        "trusted": 0, "ttl": 0.0, "status": "starting", "verdict": "converging", "sent": None,
    }  # fmt: skip
    assert "sequence" not in json.loads(estimate(None).as_json())


def test_lines_go_out_whole_and_at_once() -> None:
    reading, writing = os.pipe()
    Lines(writing).send(estimate())
    assert os.read(reading, 4096) == estimate().as_json() + b"\n"
    os.close(reading)
    with pytest.raises(BrokenPipeError):
        Lines(writing).send(estimate())
    os.close(writing)


def test_datagrams_do_not_need_a_listener() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(PATIENCE)
        port = listener.getsockname()[1]
        sink = open_sink(f"udp://127.0.0.1:{port}")
        sink.send(estimate())
        assert json.loads(listener.recv(4096))["sequence"] == 3
    for _ in range(5):
        sink.send(estimate())
    sink.close()


def test_a_broker_that_is_away_is_said_after_some_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    sink = open_sink(f"mqtt://nobody:secret@127.0.0.1:{port}/rig/1/model")
    assert sink.name == f"mqtt://127.0.0.1:{port}/rig/1/model"  # without the password
    try:
        sink.send(estimate())
        monkeypatch.setattr(sinks, "PATIENCE", -1.0)
        with pytest.raises(ConnectionError, match="the broker does not answer"):
            sink.send(estimate())
    finally:
        sink.close()


# --- notices and the thread for the disk


def test_the_same_thing_is_said_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    said: list[str] = []
    notices = Notices(said.append)
    notices.say("disk", "full")
    notices.say("disk", "still full")
    notices.say("wire", "cut")
    now[0] += AGAIN
    notices.say("disk", "full again")
    assert said == ["full", "cut", "full again"]


def test_a_job_that_fails_is_said_and_the_next_is_done(tmp_path: Path) -> None:
    said: list[str] = []
    background = Background(Notices(said.append))
    done = []

    def fail() -> None:
        raise OSError(28, "No space left on device", "rig")

    assert background.submit("checkpoint", fail)
    assert background.submit("checkpoint", lambda: done.append(1))
    background.close()
    assert said == ["replant: checkpoint: No space left on device: 'rig'; going on"]
    assert done == [1]


def test_a_disk_that_does_not_keep_up_is_said() -> None:
    said: list[str] = []
    background = Background(Notices(said.append))
    held = threading.Event()
    taken = [background.submit("record", held.wait) for _ in range(30)]
    held.set()
    background.close()
    assert not all(taken)
    assert said == ["replant: record: the disk is too slow, some of it is left out"]


# --- the terminal


def test_the_status_says_what_matters_in_one_line() -> None:
    text = one_line(viewed(3000))
    assert "trusted" in text
    assert "3,000 samples" in text
    assert "a0 0.49" in text
    assert "+-" in text


HUGE = [1e300, -1e300, 1.7e308, 1e-300, np.nan, np.inf]


@pytest.mark.parametrize("value", HUGE)
def test_no_number_makes_a_line_long_whatever_its_size(value: float) -> None:
    """Each field of a view, all at once: a line of status stays a line, and the screen in its columns."""
    found = viewed(3000)
    many = {"stuck": 10**400, "lost": 2**64}
    view = dataclasses.replace(
        found, at=value, rate=value, lag=value, silence=value, simulated=value, dc_gain=value, dc_gain_std=value,
        parameters=np.full(2, value), std=np.full(2, value), samples=10**30, rejected=many, counters=many,
    )  # fmt: skip
    text = one_line(view)
    assert len(text) < 300
    assert not re.search(r"[\d,]{25}", text)
    for running in (True, False):
        console = Console(width=400, record=True, file=io.StringIO())
        console.print(screen(view, rp.TransferFunction([1e-300], [1.0, 1e-300]), running=running))
        assert not re.search(r"[\d,]{25}", console.export_text())


@pytest.mark.parametrize("factor", [1e3, 1e60, 1e140])
def test_no_reason_holds_a_number_without_end(factor: float) -> None:
    """A model that has nothing to do with the output fits it worse than any number tells."""
    u, y = record(500)
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y)
    identifier.freeze()
    identifier.update_many(factor * u, y)
    reasons = identifier.assess().reasons
    assert any("fit below -1000 %" in reason for reason in reasons)
    assert not any(re.search(r"[\d,]{15}", reason) for reason in reasons)


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("samples", [0, 3000])
def test_the_screen_keeps_within_its_width(width: int, samples: int) -> None:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(screen(viewed(samples), PLANT))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= width
    assert ("off by" in text) == (samples > 0)


def test_a_terminal_that_has_gone_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after `| head`, or when the window is closed."""

    class Gone(io.StringIO):
        def write(self, _: str) -> int:
            raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("sys.stderr", Gone())
    status = Status()
    for _ in range(2):
        status.show(viewed(300), ["replant: a line"])
    status.close()
