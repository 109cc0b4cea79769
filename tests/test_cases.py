"""Of the cases of one test none is left out, and none that fails is lost: all others rely on it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from support.cases import OTHERS, PART, SOME, every


def test_each_case_runs_and_each_failure_is_named() -> None:
    seen = []

    @every("number", range(6), ids=lambda number: f"case {number}")
    def odd_ones_fail(number: int) -> None:
        seen.append(number)
        if number == 5:
            pytest.fail("by the word")
        assert number % 2 == 0, f"{number} is odd"

    with pytest.raises(BaseExceptionGroup, match="3 of 6 cases failed: 1: case 1, 3: case 3, 5: case 5") as caught:
        odd_ones_fail()
    assert seen == [0, 1, 2, 3, 4, 5]
    assert [str(error).splitlines()[0] for error in caught.value.exceptions] == ["1 is odd", "3 is odd", "by the word"]
    assert [error.__notes__ for error in caught.value.exceptions] == [[f"in the case case {n}"] for n in (1, 3, 5)]


def test_cases_multiply() -> None:
    seen = set()

    @every("a", "xy")
    @every(("b", "c"), [(1, 2), (3, 4)])
    def passes(a: str, b: int, c: int) -> None:
        seen.add((a, b, c))

    passes()
    assert seen == {("x", 1, 2), ("x", 3, 4), ("y", 1, 2), ("y", 3, 4)}


@every("outer, inner", [(None, None), (None, 1), (1, None), (2, 1), (1, 2)])
def test_of_cases_that_multiply_each_runs_once_in_one_of_the_two_parts(outer: int | None, inner: int | None) -> None:
    seen = []

    @every("a", "xyz", quick=outer)
    @every("b", (1, 2, 3, 4), quick=inner)
    def passes(a: str, b: int) -> None:
        seen.append((a, b))

    for part in (SOME, OTHERS) if outer or inner else (SOME,):
        passes(**{PART: part})
        if part == SOME:
            assert len(seen) == (outer or 3) * (inner or 4)
    assert sorted(seen) == [(a, b) for a in "xyz" for b in (1, 2, 3, 4)]


def test_a_test_without_cases_fails() -> None:
    """Where they are found by a search that finds nothing any more."""
    with pytest.raises(AssertionError, match="no case"):
        every("a", [])(lambda a: None)()


def test_cases_that_only_pytest_knows_fail() -> None:
    """Their values would be taken for marks and names."""
    for names, case in (("a", pytest.param(1)), ("a, b, c", pytest.param(1, 2, 3))):
        with pytest.raises(AssertionError, match=r"pytest\.param is no case"):
            every(names, [case])(lambda **values: None)()


def test_cases_without_values_for_every_name_fail() -> None:
    with pytest.raises(BaseExceptionGroup, match="1 of 1 cases failed"):
        every("a, b", [(1,)])(lambda a, b: None)()


def test_skipped_cases_are_counted_and_the_others_run() -> None:
    seen = []

    @every("a", "xyz")
    def skips(a: str) -> None:
        if a == "x":
            pytest.skip("no x here")
        seen.append(a)

    with pytest.raises(pytest.skip.Exception, match=r"1 of 3 cases \('x'\): no x here"):
        skips()
    assert seen == ["y", "z"]


@every("word", ["first", "second"])
def test_what_a_case_leaves_is_gone_in_the_next(
    word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "LEFT" not in os.environ
    assert not list(tmp_path.iterdir())
    assert capsys.readouterr().out == ""
    monkeypatch.setenv("LEFT", word)
    (tmp_path / word).touch()
    print(word)


@pytest.mark.parametrize(("part", "expected"), [("some", [0, 4, 9]), ("others", [1, 2, 3, 5, 6, 7, 8])])
def test_of_many_cases_some_are_run_at_once_and_the_others_by_make_slow(part: str, expected: list[int]) -> None:
    seen = []

    @every("number", range(10), quick=3)
    def long(number: int) -> None:
        seen.append(number)

    long(part_of_cases=part)
    assert seen == expected
    (mark,) = long.pytestmark
    some, others = mark.args[1]
    assert some == "some"
    assert [one.name for one in others.marks] == ["slow"]
