"""Names in messages: as many as fit on a readable line, and the number of the others."""

from __future__ import annotations

from replant.logs.table import LIST_SHOWN, NAMES_SHOWN, listed


def test_few_names_are_all_shown() -> None:
    assert listed(["u [V]", "y"]) == "u [V], y"
    assert listed([]) == ""


def test_of_many_names_the_first_are_shown_and_the_rest_is_counted() -> None:
    names = [f"c{number}" for number in range(NAMES_SHOWN + 3)]
    assert listed(names[:NAMES_SHOWN]) == ", ".join(names[:NAMES_SHOWN])
    assert listed(names) == ", ".join(names[:NAMES_SHOWN]) + ", ... (3 more)"


def test_a_line_ends_with_the_name_by_which_it_is_full() -> None:
    """Names that fill it exactly leave room for one more."""
    quarter = LIST_SHOWN // 4
    exact = [letter * quarter for letter in "abcdef"]
    assert listed(exact) == ", ".join(exact[:5]) + ", ... (1 more)"
    longer = [exact[0] + "!", *exact[1:]]
    assert listed(longer) == ", ".join(longer[:4]) + ", ... (2 more)"


def test_a_long_name_is_cut_and_blanks_are_one() -> None:
    shown = listed(["a\n \tb", "x" * 500])
    assert shown.startswith("a b, xxx")
    assert shown.endswith("x...")
    assert len(shown) < 200
