"""The output of the tables for people and programs."""

import io
import json

import pytest

from replant.paper.figures import Outcome
from replant.paper.rendering import as_json, as_markdown, for_terminal, notes, summary
from replant.paper.tables import TABLES


def test_json_has_every_figure_beside_the_published_one(results):
    tables = json.loads(json.dumps(as_json(Outcome(results))))
    assert list(tables) == list(TABLES)
    for name, table in TABLES.items():
        assert list(tables[name]) == [row.label for row in table.rows]
        for row in table.rows:
            cells = tables[name][row.label]
            assert list(cells) == list(table.indices)
            assert [cell["published"] for cell in cells.values()] == list(row.published)
            expected = {"ours", "published", "agrees"} | (set() if row.experiment.replay is None else {"std", "seeds"})
            assert all(set(cell) == expected for cell in cells.values())


@pytest.mark.parametrize("width", [80, 120])
def test_the_terminal_table_fits_and_hides_nothing(results, width):
    from rich.console import Console

    for result, (_, table, *_) in zip(results.values(), for_terminal(Outcome(results)), strict=True):
        console = Console(file=io.StringIO(), width=width, color_system=None)
        console.print(table)
        text = console.file.getvalue()
        assert "…" not in text
        assert max(map(len, text.splitlines())) <= width
        for row in result.rows:
            assert all(f"{cell.ours:.2e}" in text and cell.verdict in text for cell in row.cells)


def test_markdown_has_a_line_for_every_figure(results):
    page = as_markdown(Outcome(results))
    figures = [line for line in page.splitlines() if line.startswith("| ") and "J_" in line]
    assert len(figures) == sum(len(row.cells) for result in results.values() for row in result.rows)
    for block in page.split("\n\n"):
        if block.startswith("| "):
            assert len({line.count("|") for line in block.splitlines()}) == 1
    for result in results.values():
        assert all(note in page for note in notes(result))


def test_notes_say_where_the_article_disagrees_with_itself(results):
    assert any("57.68 %" in note and "82.4 %" in note for note in notes(results["table3"]))
    assert any("batch of 20" in note and "10 updates" in note for note in notes(results["table1"]))
    assert any("20 seeds" in note for note in notes(results["table1"]))
    assert not any("seeds" in note for note in notes(results["table2"]))


def test_the_summary_counts_what_agrees(results):
    assert summary(list(results.values())) == [
        "Without buffer: 28 of 28 figures and 12 of 12 sums equal in all printed digits.",
        "With buffer, batch 10: 4 of 4 figures and 2 of 2 sums within 3 standard deviations.",
        "With buffer, batch 20 as the article prints it: 0 of 4 figures and 0 of 2 sums within 3 standard deviations.",
    ]
