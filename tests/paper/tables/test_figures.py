"""Figures 1-4: the data behind the axes are the tables' own runs."""

import numpy as np
import pytest

from replant.paper.figures import FIGURES, compute, draw
from replant.paper.tables import TABLES
from replant.plotting.numbers import symbol
from support.axes import assert_drawn, lines, points


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=pytest.mark.slow if number else ()) for number, name in enumerate(FIGURES)],
)
def drawn(request):
    """Return a figure of the article, its curves and the matplotlib figure."""
    figure = FIGURES[request.param]
    curves = compute(figure)
    return figure, curves, draw(figure, curves)


@pytest.mark.slow
def test_every_curve_holds_the_numbers_of_its_tables_run(drawn, results):
    figure, _, canvas = drawn
    for line in figure.lines:
        row = figure.table.row(line.row)
        trace = row.experiment.identifier(seed=0).update_many(*row.experiment.plant.record())
        indices = row.experiment.indices(trace)
        for cell in results[figure.table.name][line.row].cells:
            if row.experiment.replay is None:
                assert indices[cell.index] == cell.ours
            else:  # one of the seeds behind the row's mean
                assert abs(indices[cell.index] - cell.ours) < 5 * cell.std
        for axis, name in zip(canvas.axes, row.experiment.plant.true, strict=True):
            estimate = trace.before()[:, trace.names.index(name)]
            assert_drawn(lines(axis)[line.label], estimate, row.experiment.plant.dt)


def test_one_panel_a_parameter_with_true_value_and_unit(drawn):
    figure, _, canvas = drawn
    true = figure.table.rows[0].experiment.plant.true
    assert len(canvas.axes) == len(true)
    for axis, (name, value) in zip(canvas.axes, true.items(), strict=True):
        assert axis.get_ylabel() == f"{symbol(name)} [{figure.units[name]}]"
        dashed = lines(axis)["true value"]
        assert set(points(dashed)[1]) == {value}
        assert dashed.is_dashed()
        assert axis.get_ylim()[0] < value < axis.get_ylim()[1]
    assert canvas.axes[-1].get_xlabel() == "time [s]"


def test_the_legend_names_every_curve_and_styles_differ(drawn):
    figure, _, canvas = drawn
    named = [text.get_text() for text in canvas.legends[0].get_texts()]
    assert [name for name in named if name] == [*(line.label for line in figure.lines), "true value"]
    assert len({(line.style["color"], line.style["ls"]) for line in figure.lines}) == len(figure.lines)


def test_limits_show_where_the_curves_end(drawn):
    figure, curves, canvas = drawn
    for axis, name in zip(canvas.axes, figure.table.rows[0].experiment.plant.true, strict=True):
        low, high = axis.get_ylim()
        ends = np.array([by_name[name].values[-1] for by_name in curves.values()])
        assert ((low < ends) & (ends < high)).all()


def test_the_figures_are_the_articles():
    assert {name: figure.table for name, figure in FIGURES.items()} == {
        "fig1": TABLES["table1"],
        "fig2": TABLES["table2"],
        "fig3": TABLES["table3"],
        "fig4": TABLES["table4"],
    }
    assert [len(figure.lines) for figure in FIGURES.values()] == [4, 6, 2, 2]
