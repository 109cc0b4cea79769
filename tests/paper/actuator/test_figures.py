"""Figures 6-8: the data behind the axes are the record's and the table's own runs."""

import pytest

from replant.paper.actuator import FILTERS, GAINS
from replant.paper.figures import COLUMNS, TOLD_APART, UNITS, WINDOWS, draw_record, draw_transients
from replant.plotting.numbers import symbol
from support.axes import assert_drawn, lines, points
from support.cases import every
from support.trace_by_hand import DT, TRUE, trace_by_hand


def test_figure_6_shows_the_record_and_its_offline_estimates(actuator):
    record = actuator.record
    top, *panels = draw_record(record, actuator.offline).axes
    assert_drawn(top.get_lines()[0], record.u, DT)
    for axis, window in zip(panels, [(0.0, 1.0), *WINDOWS.values()], strict=True):
        begin = round(window[0] * record.u.size)
        drawn = lines(axis)
        assert_drawn(drawn["measured"], record.y, DT, begin)
        assert len(drawn) == 3
        for filters, words in (("gbt", "the article's filters"), ("exact", "exact filters")):
            simulation = actuator.offline[filters].simulation
            assert_drawn(drawn[f"{words}: simulated fit {simulation.fit:.1f} %"], simulation.output, DT, begin)
        assert axis.get_xlim() == pytest.approx((window[0] * DT * record.u.size, window[1] * DT * record.u.size))
        assert axis.get_ylabel() == "displacement [mm]"
    assert top.get_ylabel() == "input [kV]"
    assert panels[-1].get_xlabel() == "time [s]"


@every("filters", FILTERS, quick=1)
@every("name", COLUMNS)
def test_figures_7_and_8_hold_the_tables_runs(actuator, name, filters):
    canvas = draw_transients(name, actuator, filters)
    assert len(canvas.axes) == 10
    for j, method in enumerate(COLUMNS[name]):
        column = canvas.axes[j::2]
        assert column[0].get_title(loc="left") == method
        for variant in GAINS:
            _, trace = trace_by_hand(actuator.record, method, variant, filters)
            label = variant if variant == "no buffer" else f"buffer, {variant}"
            for i, axis in enumerate(column):
                t, values = points(lines(axis)[label])
                assert values == pytest.approx(trace.before()[(t / DT).round().astype(int), i], rel=1e-6, abs=1e-6)
                curve = actuator.row(method, variant, filters).curves[list(TRUE)[i]]
                assert values.tolist() == curve.values.tolist()


def test_figures_7_and_8_show_truth_goal_and_units(actuator):
    for name in COLUMNS:
        canvas = draw_transients(name, actuator)
        named = [text.get_text() for text in canvas.legends[0].get_texts() if text.get_text()]
        assert named == [
            "no buffer",
            "buffer, small gain",
            "buffer, very small gain",
            "true value",
            "least squares, normalised",
        ]
        for i, axis in enumerate(canvas.axes):
            coefficient = list(TRUE)[i // 2]
            assert set(points(lines(axis)["true value"])[1]) == {TRUE[coefficient]}
            goal = actuator.goals["gbt"][i // 2]
            dotted = lines(axis).get("least squares, normalised")
            assert (dotted is not None) == (abs(goal / TRUE[coefficient] - 1) > TOLD_APART)
            assert dotted is None or set(points(dotted)[1]) == {goal}
            low, high = axis.get_ylim()
            assert low < 0.0 < TRUE[coefficient] < high < 2.5 * TRUE[coefficient]
            if i % 2 == 0:
                assert axis.get_ylabel() == f"{symbol(coefficient)} [{UNITS[coefficient]}]"
