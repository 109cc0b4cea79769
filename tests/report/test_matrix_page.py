"""The report of several inputs and outputs: a row an output, a column an input."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.report.outputs import Output, save_figures
from replant.report.result_page import write_outputs

DT = 0.1
FIRST, SECOND = rp.TransferFunction([2.0], [1.0, 1.0]), rp.TransferFunction([0.5], [1.0, 0.2], delay=0.3)


def output_of(name: str, gain: float) -> Output:
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], (60, 2)).repeat(10, axis=0)
    y = gain * (FIRST.simulate(u[:, 0].copy(), DT) + SECOND.simulate(u[:, 1].copy(), DT))
    y += 20.0 + 0.05 * rng.standard_normal(600)
    y[200] += 40.0
    log = rp.Log(
        u[:, 0], y, DT, input_name="Q1 [%]", output_name=name, path=Path("heaters.csv"), others={"Q2 [%]": u[:, 1]},
        more_inputs=("Q2 [%]",),
    )  # fmt: skip
    return Output(rp.fit(log, poles=(1, 1), delay=(0.0, 0.3)), log)


@pytest.fixture(scope="module")
def outputs() -> list[Output]:
    return [output_of("T1 [degC]", 1.0), output_of("T2 [degC]", -0.5)]


def charts(page: str) -> list[dict[str, object]]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return [chart for section in json.loads(found[1]).values() for chart in section]


@pytest.mark.usefixtures("unrendered")
def test_a_page_of_one_output_has_each_input(outputs: list[Output], tmp_path: Path) -> None:
    page = write_outputs(tmp_path / "report.html", outputs[:1], command="replant fit", python="fit()").read_text()
    for words in ("Q1 [%] → T1 [degC]", "Q2 [%] → T1 [degC]", "Trusted", "1 outlier", "replant fit", "heaters.csv"):
        assert words in page.replace("\N{NO-BREAK SPACE}", " "), words
    names = [chart["name"] for chart in charts(page)]
    assert names == ["output", "part", "residual", "input1", "input2"]
    parts = charts(page)[1]["curves"]
    assert isinstance(parts, list)
    assert [curve["label"] for curve in parts] == ["Q1 [%]", "Q2 [%]"]
    assert page.count("<math") == 2


@pytest.mark.slow
def test_a_page_of_two_outputs_is_a_matrix(outputs: list[Output], tmp_path: Path) -> None:
    page = write_outputs(tmp_path / "report.html", outputs).read_text()
    names = [chart["name"] for chart in charts(page)]
    assert names == ["output", "part", "residual", "output2", "part2", "residual2", "input1", "input2"]
    assert "T1 [degC]: Trusted" in page
    assert "T2 [degC]: Trusted" in page
    assert page.count("<math") == 4
    for place in ("step0-0", "step1-1", "bode0-1", "poles1-0", "left1-2"):
        assert f'id="{place}-' in page, place


def test_what_is_left_out_is_shaded_and_the_parts_add_up(outputs: list[Output]) -> None:
    one = outputs[0]
    assert np.isnan(one.residual[200])
    before, outlier = one.result.left_out_over_time(
        DT
    ).tolist()  # the first three samples answer to inputs from before the record
    assert before == pytest.approx([0.0, 0.3])
    assert outlier[0] <= 20.0 <= outlier[1]
    assert np.flatnonzero(np.isnan(one.residual)).tolist() == [0, 1, 2, 200]
    known = one.fitted.model.output_level + one.parts.sum(axis=1)
    assert known == pytest.approx(one.fitted.model.simulate(one.log.inputs))
    assert one.fitted.output[400:] == pytest.approx(known[400:], abs=0.05)  # what was before the record is forgotten


@pytest.mark.usefixtures("unrendered")
def test_what_a_column_is_called_is_text(tmp_path: Path) -> None:
    page = write_outputs(tmp_path / "report.html", [output_of("T1 [<b>]", 1.0)]).read_text()
    assert "<b>" not in page
    assert "[&lt;b&gt;/%/s]" in page


@pytest.mark.slow
def test_the_pictures_of_each_output_are_written(outputs: list[Output], tmp_path: Path) -> None:
    assert [path.name for path in save_figures(tmp_path, outputs)] == [
        "fit-1.png", "responses-1.png", "fit-2.png", "responses-2.png",
    ]  # fmt: skip
    assert all(path.stat().st_size > 10_000 for path in tmp_path.iterdir())
