"""A live session with a reference: learned, recorded, resumed, seen and shown, and refused in one line."""

from __future__ import annotations

import functools
import io
from pathlib import Path

import numpy as np
import pandas
import pytest
from rich.console import Console

import replant as rp
from replant.errors import InvalidArgumentError
from replant.live.make_view import POINTS, EstimateHistory, make_view
from replant.live.outputs.message import DiskWriter, Notices, ParquetRecorder
from replant.live.progress import Progress, resume
from replant.live.terminal_status import render, report_of
from replant.live.view import SessionInfo, View
from support.live_fakes import DT, REQUEST, FakeSource, make, record

pytestmark = pytest.mark.usefixtures("unrendered")

U, Y = record()
R = 50.0 + np.arange(U.size)


@functools.cache
def _learned(referenced: bool) -> rp.Identifier:
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(U, Y, DT * np.arange(U.size), R if referenced else None)
    return identifier


def learned(*, referenced: bool = True) -> rp.Identifier:
    return _learned(referenced).clone()


def seen(identifier: rp.Identifier) -> View:
    return make_view(identifier, SessionInfo(at=U.size * DT, source="fake://"), EstimateHistory(2))


def test_it_is_learned_and_recorded_to_the_bit(tmp_path: Path) -> None:
    disk = DiskWriter(Notices(print))
    session, _ = make(FakeSource(U, Y, r=R), recorder=ParquetRecorder(tmp_path, disk))
    session.run()
    disk.close()
    assert session.identifier.to_bytes() == learned().to_bytes()
    frame = pandas.read_parquet(tmp_path / "samples")
    assert list(frame) == ["n", "t", "u", "y", "r"]
    log = rp.read_log(tmp_path, input="u", output="y", reference="r")
    np.testing.assert_array_equal(log.reference, R)
    np.testing.assert_array_equal(log.output, Y)


def test_a_session_that_is_resumed_goes_on_with_it(tmp_path: Path) -> None:
    """Its record is continued, without what it holds already."""
    path = tmp_path / "rig"
    for part in (slice(0, 1234), slice(0, None)):
        loaded = resume(path, REQUEST)
        go_on = loaded is not None
        disk = DiskWriter(Notices(print))
        recorder = ParquetRecorder(tmp_path / "record", disk, go_on=go_on)
        identifier = loaded.identifier if loaded else None
        progress = loaded.progress if loaded else Progress()
        source = FakeSource(U[part], Y[part], r=R[part])
        session, _ = make(source, path=path, identifier=identifier, progress=progress, recorder=recorder)
        session.run()
        disk.close()
    assert session.identifier.to_bytes() == learned().to_bytes()
    np.testing.assert_array_equal(pandas.read_parquet(tmp_path / "record" / "samples")["r"], R)


@pytest.mark.parametrize("first", [False, True])
def test_a_source_that_has_one_no_more_or_has_one_now_is_refused(tmp_path: Path, first: bool) -> None:
    path = tmp_path / "rig"
    make(FakeSource(U[:1000], Y[:1000], r=R[:1000] if first else None), path=path)[0].run()
    before = path.read_bytes()
    loaded = resume(path, REQUEST)
    assert loaded is not None
    source = FakeSource(U, Y, r=None if first else R)
    session, _ = make(source, path=path, identifier=loaded.identifier, progress=loaded.progress)
    with pytest.raises(InvalidArgumentError, match="give it with every sample, or with none"):
        session.run()
    assert path.read_bytes() == before


def test_after_a_reset_it_is_chosen_anew() -> None:
    identifier = learned()
    identifier.reset()
    identifier.update_many(U, Y)
    assert not identifier.reference


def test_a_view_has_the_reference_of_each_sample() -> None:
    short = rp.Identifier(**vars(REQUEST))
    short.update_many(U[:900], Y[:900], r=R[:900])
    np.testing.assert_array_equal(seen(short).window.r, R[:900])
    window = seen(learned()).window
    assert window.r.shape == window.t.shape == window.u.shape
    assert window.r.size <= POINTS
    assert (window.r.min(), window.r.max()) == (R.min(), R.max())
    assert seen(learned(referenced=False)).window.r.size == 0
    assert seen(rp.Identifier(**vars(REQUEST))).to_json()["window"]["r"] == []


def shown(view: View) -> str:
    console = Console(width=100, file=io.StringIO())
    with console.capture() as captured:
        console.print(render(view))
    return captured.get()


def test_the_terminal_shows_the_newest_beside_the_output() -> None:
    text = shown(seen(learned()))
    assert f"reference {R[-1]:,.1f}" in text
    assert f"output {Y[-1]:,.1f}" in text
    assert "reference" not in shown(seen(learned(referenced=False)))


def test_the_report_names_it() -> None:
    identifier = learned()
    page = report_of(identifier, seen(identifier)).decode()
    assert "reference=" in page
    identifier = learned(referenced=False)
    assert "reference=" not in report_of(identifier, seen(identifier)).decode()
