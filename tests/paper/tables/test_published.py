"""The article's tables: the published figures are reproduced."""

import dataclasses
import math

import pytest

from replant import Scaling
from replant.paper.tables import SEEDS, TABLES, run_seeds, three_digits
from support.cases import every

ROWS = [(table.name, row.label) for table in TABLES.values() for row in table.rows]
PLAIN = [(name, label) for name, label in ROWS if TABLES[name].row(label).experiment.replay is None]
BUFFERED = [(name, label) for name, label in ROWS if (name, label) not in PLAIN]


def rounding(value):
    """Return how far a figure printed with three digits may lie from the true one."""
    return 0.5 * 10.0 ** (math.floor(math.log10(value)) - 2)


@every(("name", "label"), PLAIN)
def test_rows_without_buffer_equal_the_printed_digits(results, name, label):
    cells = results[name][label].cells
    ours = {cell.index: three_digits(cell.ours) for cell in cells}
    assert ours == {cell.index: three_digits(cell.published) for cell in cells}


def test_that_is_28_figures(results):
    cells = [cell for name, label in PLAIN for cell in results[name][label].cells]
    assert sum(cell.index != "J_sum" for cell in cells) == 28
    assert all(cell.verdict == "equal" for cell in cells)


@pytest.mark.parametrize("optimizer", ["AMSGrad", "Gradient"])
def test_rows_with_buffer_lie_within_three_standard_deviations(results, optimizer):
    row = results["table1"][f"{optimizer}, with buffer (batch 10)"]
    assert row.seeds == SEEDS == 20
    for cell in row.cells:
        assert abs(cell.ours - cell.published) <= 3 * cell.std, cell
        assert cell.verdict == "within 3 std"


@pytest.mark.parametrize("optimizer", ["AMSGrad", "Gradient"])
def test_the_printed_batch_gives_lower_figures(results, optimizer):
    for cell in results["table1"][f"{optimizer}, with buffer (batch 20, as printed)"].cells:
        assert cell.ours < cell.published - 3 * cell.std, cell
        assert not cell.agrees


def test_every_row_with_buffer_is_in_both_batches():
    batches = [TABLES[name].row(label).experiment.replay.batch_size for name, label in BUFFERED]
    assert sorted(batches) == [10, 10, 20, 20]


@every(("name", "label"), ROWS)
def test_published_sums_are_the_sums_of_the_published_figures(name, label):
    *parameters, total = TABLES[name].row(label).published
    assert TABLES[name].indices[-1] == "J_sum"
    slack = sum(rounding(value) for value in [*parameters, total])
    assert total == pytest.approx(sum(parameters), abs=slack)


def test_the_claimed_improvement_does_not_follow_from_the_table(results):
    printed, ours = results["table3"].improvement
    assert printed == pytest.approx(82.4, abs=0.05)
    assert ours == pytest.approx(82.4, abs=0.05)
    assert TABLES["table3"].improvement.published == 57.68


def test_other_readings_of_the_settings_miss_the_figures():
    """By the notes one reading reproduces the figures; the other reading of the text does not."""
    adjusted, bias = TABLES["table3"].row("adjusted"), TABLES["table4"].row("with")
    for row, scaling in [
        (adjusted, Scaling(0.25, (2e-3, 4e-4, 6e-4, 1e-4))),  # the printed list in Appendix A's order
        (bias, Scaling(0.25, (0.05, 0.15, 1.0))),  # the constant 1 of (24)
    ]:
        other = dataclasses.replace(row.experiment, scaling=scaling)
        (indices,) = run_seeds(other, [0])
        assert abs(indices["J_sum"] / row.published[-1] - 1) > 0.5


def test_an_unknown_row_is_a_key_error():
    with pytest.raises(KeyError):
        TABLES["table1"].row("Newton")
