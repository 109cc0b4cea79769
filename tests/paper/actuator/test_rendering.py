"""The output of the actuator experiment for people and programs."""

import io
import json
import re

import pytest

from replant.paper.actuator import DEFAULT
from replant.paper.figures import ACTUATOR, Outcome
from replant.paper.rendering import actuator_summary, as_json, as_markdown, for_terminal

NAMES = ("a2", "a1", "a0", "b1", "b0")


def test_json_has_every_measure(actuator):
    table = json.loads(json.dumps(as_json(Outcome(actuator=actuator)), allow_nan=False))[ACTUATOR]
    assert list(table) == [row.label for row in actuator.rows]
    for row in actuator.rows:
        cells = table[row.label]
        parts = ["error", "J", "settled", "roughness"] if row.totals else ["error"]
        expected = {f"{part}_{name}" for part in parts for name in NAMES} | {"free_run"}
        assert set(cells) == expected | ({"J_sum", "settled", "roughness"} if row.totals else set())
        assert all(set(cell) == {"ours", "published"} and cell["published"] is None for cell in cells.values())
        assert cells["error_a1"]["ours"] == row.errors["a1"]
        if row.totals:
            assert cells["J_sum"]["ours"] == pytest.approx(sum(cells[f"J_{name}"]["ours"] for name in NAMES))


@pytest.mark.parametrize("width", [80, 120])
def test_the_terminal_table_fits_and_hides_nothing(actuator, width):
    from rich.console import Console

    console = Console(file=io.StringIO(), width=width, color_system=None)
    ((_, table, *_),) = for_terminal(Outcome(actuator=actuator))
    console.print(table)
    text = console.file.getvalue()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    lines = [line.split() for line in text.splitlines()]
    assert sum("gbt" in words for words in lines) == sum("exact" in words for words in lines) == 14
    assert sum("own" in words for words in lines) == 1


def test_markdown_has_a_line_for_every_run_and_square_tables(actuator):
    page = as_markdown(Outcome(actuator=actuator))
    for row in actuator.rows:
        assert page.count(f"| {row.label} |") == (4 if row.totals else 1)
    for block in page.split("\n\n"):
        if block.startswith("| "):
            assert len({line.count("|") for line in block.splitlines()}) == 1


def test_the_summary_sets_the_default_beside_the_best_of_the_twelve(actuator):
    filters, best, default, elsewhere = actuator_summary(actuator)
    assert "article's filters" in filters

    def figure(line, name):
        return float(re.search(rf"{name} (\S+) %", line)[1])

    for name in NAMES:
        smallest = min(abs(row.errors[name]) for row in actuator.online_rows())
        assert figure(best, name) == pytest.approx(smallest, rel=0.05)
        smallest = min(abs(row.errors[name]) for row in actuator.online_rows("exact"))
        assert figure(best.partition(";")[2], name) == pytest.approx(smallest, rel=0.05)
        own = abs(actuator.row(DEFAULT, "default", "own").errors[name])
        assert figure(default, name) == pytest.approx(own, rel=0.05)
        worst = max(abs(row.errors[name]) for row in actuator.elsewhere)
        assert figure(elsewhere, name) == pytest.approx(worst, rel=0.05)
    assert "On 5 other records" in elsewhere
