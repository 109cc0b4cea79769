"""The names that can be reproduced, and the announced number of runs."""

import pytest

from replant.paper import actuator
from replant.paper.figures import NAMES, is_figure, run, steps
from support.cases import every


def test_the_names_are_the_articles_and_one_more():
    articles = [*(f"table{i}" for i in (1, 2, 3, 4)), *(f"fig{i}" for i in (1, 2, 3, 4, 6, 7, 8))]
    assert list(NAMES) == [*articles, "actuator"]
    assert [name for name in NAMES if is_figure(name)] == [name for name in NAMES if name.startswith("fig")]


@pytest.mark.slow
@every(
    "names",
    [("table2",), ("fig1",), ("fig6", "fig7", "fig8", "actuator"), ("table4", "fig4")],
)
def test_every_step_announced_is_taken(monkeypatch, names):
    whole = actuator.measure_rig
    monkeypatch.setattr(actuator, "measure_rig", lambda samples=0, seed=0: whole(2000, seed))
    taken = []
    run(names, taken.append)
    assert len(taken) == steps(names) > 0
    assert set(taken) <= set(NAMES)
