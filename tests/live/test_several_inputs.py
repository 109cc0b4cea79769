"""A live session of several inputs: learned, sent, recorded, resumed, seen and shown, and refused in one line."""

from __future__ import annotations

import csv
import io
import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from rich.console import Console

import replant as rp
from replant.errors import InvalidArgumentError
from replant.live.dashboard.app import python_of
from replant.live.make_view import EstimateHistory, make_view
from replant.live.outputs.message import DiskWriter, Notices, ParquetRecorder
from replant.live.progress import Progress, resume
from replant.live.terminal_status import render, report_of
from replant.live.view import SessionInfo
from replant.online import saving
from support.cases import every
from support.command import call
from support.live_command import estimates, finished, live
from support.live_fakes import FakeSink, FakeSource, make
from support.live_rows import HEATERS, NAMES, T, U, Y, fresh, learned, seen
from support.rows import DT, FAST, SLOW, TRUE

pytestmark = pytest.mark.usefixtures("unrendered")

OPTIONS = ("-i", "Q1", "-i", "Q2", "-o", "T1", "-p", "2,1", "--delay", "0,0.3", "--dt", str(DT))


# --- the session


@pytest.mark.slow
@pytest.mark.parametrize("stamped", [False, True])
def test_batches_of_any_size_give_the_bits_of_the_whole_record(stamped: bool) -> None:
    session, _ = make(FakeSource(U, Y, numbered=False, t=T if stamped else None), identifier=fresh())
    assert session.run()
    whole = fresh()
    whole.update_many(U, Y, T if stamped else None)
    assert session.identifier.to_bytes() == whole.to_bytes()
    assert session.progress.taken == len(U)


@pytest.mark.slow
def test_messages_name_the_input_of_each_parameter() -> None:
    sink = FakeSink()
    make(FakeSource(U, Y, t=T), identifier=fresh(), sinks=[sink])[0].run()
    first, last = (json.loads(each.as_json()) for each in (sink.sent[0], sink.sent[-1]))
    assert [first[name] for name in NAMES] == [None] * 5
    assert [last[name] for name in NAMES] == learned().parameters.tolist()
    schema = json.loads(files("replant.live.outputs").joinpath("schema/message-1.json").read_text())
    (pattern,) = schema["patternProperties"]
    assert all(name in schema["properties"] or re.search(pattern, name) for name in last)


@pytest.mark.slow
def test_a_misread_stamp_costs_its_own_sample_alone() -> None:
    t = T.copy()
    t[1500] = 1e6
    session, _ = make(FakeSource(U, Y, numbered=False, t=t), identifier=fresh())
    session.run()
    assert session.identifier.samples == len(U) - 1
    np.testing.assert_allclose(session.identifier.parameters, learned().parameters, rtol=0.05)


def test_a_device_that_starts_anew_is_followed() -> None:
    session, observer = make(
        FakeSource(U, Y, numbered=False, t=np.where(T < 75.0, T + 500.0, T - 75.0)), identifier=fresh()
    )
    session.run()
    assert session.identifier.samples == len(U) - 1
    assert ["clock" in line for line in observer.shown] == [True]


def test_a_session_that_is_resumed_goes_on_to_the_bit_and_so_does_its_record(tmp_path: Path) -> None:
    path = tmp_path / "rig"
    for part in (slice(0, 1234), slice(0, None)):
        loaded = resume(path, fresh().request)
        disk = DiskWriter(Notices(print))
        recorder = ParquetRecorder(tmp_path / "record", disk, HEATERS, go_on=loaded is not None)
        session, _ = make(
            FakeSource(U[part], Y[part], t=T[part]), path=path, recorder=recorder,
            identifier=loaded.identifier if loaded else fresh(),
            progress=loaded.progress if loaded else Progress(),
        )  # fmt: skip
        session.run()
        disk.close()
    assert session.identifier.to_bytes() == learned().to_bytes()
    assert saving.load(path).identifier.to_bytes() == learned().to_bytes()
    frame = pandas.read_parquet(tmp_path / "record" / "samples")
    assert list(frame) == ["n", "t", "Q1", "Q2", "T1"]
    np.testing.assert_array_equal(frame[["Q1", "Q2"]], U)
    assert list(pandas.read_parquet(tmp_path / "record" / "estimates"))[3:8] == list(NAMES)


@every(
    ("asked", "words"),
    [
        (lambda: fresh(poles=(1, 1)).request, "the checkpoint was made with structures"),
        (
            lambda: fresh(input_names=("Q1", "Q3")).request,
            "the checkpoint was made with input_names Q1; Q2, and Q1; Q3 is",
        ),
        (lambda: rp.Identifier(poles=1, dt=DT).request, "the checkpoint is of several inputs, not of one input"),
    ],
)
def test_a_checkpoint_of_another_identification_is_refused(asked: Any, words: str, tmp_path: Path) -> None:
    learned().save(tmp_path / "rig")
    with pytest.raises(InvalidArgumentError, match=words):
        resume(tmp_path / "rig", asked())


def test_a_checkpoint_of_one_input_is_refused(tmp_path: Path) -> None:
    rp.Identifier(poles=1, dt=DT).save(tmp_path / "rig")
    with pytest.raises(InvalidArgumentError, match="the checkpoint is of one input, not of several inputs"):
        resume(tmp_path / "rig", fresh().request)


# --- what is seen of it


def test_a_view_has_the_model_and_the_samples_of_each_input() -> None:
    found = seen()
    assert (found.verdict, found.output_label) == ("trusted", "T1")
    assert [each.input_label for each in found.inputs] == ["Q1", "Q2"]
    for each, g, true in zip(found.inputs, learned().transfer_functions, (FAST, SLOW), strict=True):
        assert each.num.tolist() == g.num.tolist()
        assert each.dc_gain == pytest.approx(true.dc_gain, abs=4.0 * each.dc_gain_std)
        assert each.step.y[-1] == pytest.approx(each.dc_gain, rel=0.02)
        assert each.bode.omega.size == each.bode.magnitude_low.size > 0
    for u, column in zip((found.window.u, found.more_inputs[0].u), U.T, strict=True):
        assert u.shape == found.window.t.shape
        assert set(u) == set(column)
    assert (np.abs(found.parameters - TRUE) < 4.0 * found.std).all()
    assert found.simulated == pytest.approx(learned().model.simulated_fit)
    assert json.loads(json.dumps(found.to_json(), allow_nan=False))["more_inputs"][0]["delay"] == 0.3


def test_nothing_is_simulated_of_what_answers_to_inputs_before_the_window() -> None:
    """Within the dead time, the output depends on unknown earlier inputs."""
    assert np.nanmax(np.abs(seen().window.residual)) < 6.0 * seen().residual_std


def test_before_the_first_model_there_is_none_of_any_input() -> None:
    identifier = fresh()
    identifier.update_many(U[:100], Y[:100])
    found = make_view(identifier, SessionInfo(), EstimateHistory(5))
    assert (found.status, found.verdict, found.model) == ("starting", "converging", {})
    assert [each.den.size for each in found.inputs] == [0, 0]
    assert np.isnan(found.parameters).all()
    json.dumps(found.to_json(), allow_nan=False)


def test_the_model_is_kept_with_its_names_and_as_a_program(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(seen().model))
    model = rp.load_model(path)
    assert (model.input_names, model.output_name) == (("Q1", "Q2"), "T1")
    space: dict[str, Any] = {}
    exec(python_of(dict(seen().model)), space)
    assert [g.den.tolist() for g in space["G"].values()] == [g.den.tolist() for g in model.transfer_functions]


@pytest.mark.parametrize("width", [80, 120])
def test_the_screen_has_each_model_and_keeps_within_its_width(width: int) -> None:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(render(seen()))
    text = console.export_text()
    assert "From Q1 to T1" in text
    assert "From Q2 to T1" in text
    assert "exp(-0.3 s)" in text
    assert max(map(len, text.splitlines())) <= width


def test_the_report_has_each_model() -> None:
    page = report_of(learned(), seen()).decode()
    assert "Q1 → T1" in page
    assert "Q2 → T1" in page
    with pytest.raises(rp.ReplantError, match="no model to report on yet"):
        report_of(fresh(), seen())


# --- the command


def csv_of(*columns: Any, header: str = "") -> bytes:
    text = io.StringIO()
    text.write(header)
    csv.writer(text, lineterminator="\n").writerows(zip(*columns, strict=True))
    return text.getvalue().encode()


def objects() -> bytes:
    rows = zip(range(len(Y)), *U.T.tolist(), Y.tolist(), strict=True)
    return b"".join(json.dumps(dict(zip(("n", "Q1", "Q2", "T1"), row, strict=True))).encode() + b"\n" for row in rows)


@pytest.mark.slow
def test_a_pipe_ends_with_the_bits_of_run_on_what_was_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = csv_of(Y.tolist(), *U.T.tolist(), header="T1,Q1,Q2\n")
    kept = ("--record", tmp_path / "record", "--checkpoint", tmp_path / "rig")
    with live("-", "--to", "-", *kept, model=OPTIONS) as process:
        code, out, err = finished(process, data)
    assert (code, "Traceback" in err) == (0, False)
    last = estimates(out)[-1]
    whole = fresh()
    whole.update_many(U, Y)
    assert [last[name] for name in NAMES] == whole.parameters.tolist()
    assert (last["samples"], last["status"], last["verdict"]) == (len(U), "ended", "trusted")
    assert "From Q2 to T1" in err
    assert saving.load(tmp_path / "rig").identifier.to_bytes() == whole.to_bytes()
    code, out, _ = call(capsys, "run", tmp_path / "record", *OPTIONS, "--startup", 500, "--json")
    again = json.loads(out)["parameters"]
    assert [again[name]["value"] for name in NAMES] == whole.parameters.tolist()


@pytest.mark.slow
def test_objects_are_read_and_a_checkpoint_is_gone_on_with(tmp_path: Path) -> None:
    lines, outs = objects().splitlines(keepends=True), []
    for part in (lines[:1500], lines):  # the second time the first half is known
        with live("-", "--to", "-", "--checkpoint", tmp_path / "rig", model=OPTIONS) as process:
            code, out, err = finished(process, b"".join(part))
        assert (code, "Traceback" in err) == (0, False)
        outs.append(estimates(out)[-1])
    assert [each["samples"] for each in outs] == [1500, len(U)]
    assert [outs[-1][name] for name in NAMES] == pytest.approx(learned().parameters, rel=1e-6)


@pytest.mark.slow
def test_one_input_may_have_a_name_too(tmp_path: Path) -> None:
    model = ("-i", "Q1", "-o", "T1", "-p", "1", "--dt", str(DT))
    with live("-", "--to", "-", "--record", tmp_path, model=model) as process:
        code, out, _ = finished(process, objects())
    assert (code, estimates(out)[-1]["samples"]) == (0, len(U))
    assert {"a0", "b0"} <= estimates(out)[-1].keys()
    assert list(pandas.read_parquet(tmp_path / "samples")) == ["n", "t", "Q1", "T1"]


TWO = ("-i", "Q1", "-i", "Q2", "-o", "T1")


@every(
    ("options", "words"),
    [
        ((*TWO, "-p", "1,1,1"), "--poles must have a number for each of 2 inputs (Q1, Q2), as in 1,1: got 3 numbers"),
        ((*TWO, "-p", "2"), "--poles must have a number for each of 2 inputs (Q1, Q2), as in 1,1: got one number"),
        ((*TWO, "-p", "1,1", "--delay", "1,2,3"), "--delay must have a number for each of 2 inputs"),
        (TWO, "--poles is missing; give it, as in --poles 1,1"),
        ((*TWO, "-i", "Q1", "-p", "1,1,1"), "-i Q1 is given twice"),
        (("-i", "Q1", "-i", "Q1", "-p", "1,1"), "-i Q1 is given twice: name each column once"),
        (("-p", "1,1"), "--poles has 2 numbers, and there is one input: name the others, each with -i"),
        (("-i", "Q1", "-i", "T1", "-o", "T1", "-p", "1,1"), "'T1' is an input and the output: name each signal once"),
        (("-i", "Q1", "-i", "t", "-p", "1,1"), "'t' is the number, time or reference of a sample"),
        ((*TWO, "-o", "T2", "-p", "1,1"), "-o T1 -o T2: only replant fit, run and validate take several outputs"),
        ((*TWO, "-p", "1,1", "--background"), "several inputs take no --background yet"),
        ((*TWO, "-p", "1,1", "--bias"), "several inputs take no --bias yet"),
        ((*TWO, "-p", "6,6"), "poles must be at most 10 in all, got 12"),
        ((*TWO, "-p", "1,x"), "'1,x' must be a whole number for each input"),
        ((*TWO, "-p", "1:2,1"), "a range is searched by replant fit: give a number for each input here"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(
    options: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = call(capsys, "live", "-", *options, "--dt", DT)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err


def test_the_demo_has_one_input(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = call(capsys, "live", "demo", *TWO)
    assert code == 2
    assert "demo: the rig has one input and one output: leave -i and -o out" in err
