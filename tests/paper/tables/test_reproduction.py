"""Comparison of one figure, and the runs behind a table."""

import math

from replant.paper.tables import TABLES, Cell, reproduce
from support.cases import every


@every(("ours", "verdict"), [(5185.1, "equal"), (5194.9, "equal"), (5184.9, "differs"), (51900.0, "differs")])
def test_without_buffer_three_digits_are_compared(ours, verdict):
    cell = Cell("J_a0", ours, 5.19e3)
    assert cell.verdict == verdict
    assert cell.agrees == (verdict == "equal")
    assert cell.distance is None


@every(
    ("ours", "verdict"),
    [(100.0, "within 3 std"), (130.0, "within 3 std"), (131.0, "3.1 std away"), (400.0, "30 std away")],
)
def test_with_buffer_standard_deviations_are_counted(ours, verdict):
    assert Cell("J_a0", ours, 100.0, std=10.0).verdict == verdict


def test_no_spread_leaves_no_room():
    assert Cell("J_a0", 100.0, 100.0, std=0.0).agrees
    assert Cell("J_a0", 101.0, 100.0, std=0.0).distance == math.inf


def test_progress_is_told_of_every_row():
    calls = []
    result = reproduce(TABLES["table1"], seeds=2, on_row=lambda: calls.append(1))
    assert len(calls) == 6
    assert [row.seeds for row in result.rows] == [2, 2, 1, 2, 2, 1]
