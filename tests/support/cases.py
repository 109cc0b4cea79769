"""Many cases in one test: all of them run, and its failure holds the failure of each case, by the case's name."""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

LONGEST = 60
ParameterSet = type(pytest.param())
PART, SOME, OTHERS, ALL = "part_of_cases", "some", "others", "all"
Labels = Iterable[Any] | Callable[[Any], Any] | None
Cases = Iterable[Any] | Callable[[], Iterable[Any]]


def every(
    names: str | Sequence[str], cases: Cases, ids: Labels = None, quick: int | None = None
) -> Callable[[Any], Any]:
    """Call a test once a case, as `pytest.mark.parametrize` would, but as one test.

    A case that fails does not keep the others from running.  Each finds an empty folder in ``tmp_path``, a
    ``monkeypatch`` of its own and nothing in ``capsys``; other fixtures are shared.  A case that is skipped is said
    with its reason, and by how many others it was accompanied.  Cases that take time to find are given as a function,
    which is called when the test runs.  Of cases that take long `make test` runs as many as ``quick`` says, spread over
    them, and `make slow` the others.
    """
    keys = [name.strip() for name in names.split(",")] if isinstance(names, str) else list(names)
    given = cases if callable(cases) else list(cases)  # an iterator is empty at the second time
    words = ids if callable(ids) else None
    named = None if ids is None or callable(ids) else [*map(str, ids)]

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        asked = inspect.signature(test)

        @functools.wraps(test)
        def run(**fixtures: Any) -> None:
            failed: dict[str, BaseException] = {}
            skipped: dict[str, str] = {}
            rows = [(case,) if len(keys) == 1 else case for case in (given() if callable(given) else given)]
            labels = named or [label(row, words) for row in rows]
            assert rows, "no case at all"
            assert not any(isinstance(one, ParameterSet) for row in (rows, *rows) for one in row), (
                "pytest.param is no case"
            )
            assert len(labels) == len(rows)
            numbers, part, is_nested = range(len(rows)), fixtures.pop(PART, ALL), PART in asked.parameters
            some = {round(k * (len(rows) - 1) / max(quick - 1, 1)) for k in range(quick or 0)}
            some = set(numbers) if quick is None else some
            if part == SOME or (part == OTHERS and not is_nested):
                numbers = [k for k in numbers if (k in some) is (part == SOME)]
            for number, name, row in [(k, labels[k], rows[k]) for k in numbers]:
                try:
                    with of_its_own(fixtures, number) as own:
                        if is_nested:  # beside a case that `make test` leaves out none of the inner ones has been run
                            own[PART] = ALL if part == OTHERS and number not in some else part
                        test(**own, **dict(zip(keys, row, strict=True)))
                except pytest.skip.Exception as reason:
                    skipped[name] = str(reason)
                except (Exception, pytest.fail.Exception) as error:
                    error.add_note(f"in the case {name}")
                    failed[f"{number}: {name}"] = error
            if failed:
                title = f"{len(failed)} of {len(numbers)} cases failed: {', '.join(failed)}"
                raise BaseExceptionGroup(title, list(failed.values()))
            if skipped:
                reasons = ", ".join(sorted(set(skipped.values())))
                pytest.skip(f"{len(skipped)} of {len(numbers)} cases ({', '.join(skipped)}): {reasons}")

        left = [one for name, one in asked.parameters.items() if name not in keys]
        own = quick is not None and PART not in asked.parameters
        left += [inspect.Parameter(PART, inspect.Parameter.KEYWORD_ONLY)] * own
        run.__signature__ = asked.replace(parameters=left)  # type: ignore[attr-defined]  # what pytest looks at
        return pytest.mark.parametrize(PART, [SOME, pytest.param(OTHERS, marks=pytest.mark.slow)])(run) if own else run

    return decorate


def examples(count: int, quick: int | None = None) -> int:
    """Return how many examples of a property are tried: ``quick`` or a quarter in `make test`, all in `make slow`."""
    return count if settings.get_current_profile_name() == "whole" else quick or -(-count // 4)


@contextlib.contextmanager
def of_its_own(fixtures: dict[str, Any], number: int) -> Iterator[dict[str, Any]]:
    """The fixtures of one case: those that a case would leave something in are new."""
    own = dict(fixtures)
    with contextlib.ExitStack() as stack:
        if isinstance(folder := fixtures.get("tmp_path"), Path):
            own["tmp_path"] = folder / str(number)
            own["tmp_path"].mkdir()
        if "monkeypatch" in fixtures:
            own["monkeypatch"] = stack.enter_context(pytest.MonkeyPatch.context())
        for name in {"capsys", "capfd"} & set(fixtures):
            fixtures[name].readouterr()
        yield own


def label(row: tuple[Any, ...], ids: Callable[[Any], Any] | None) -> str:
    """What a case is called: its values in short."""
    words = [None if ids is None else ids(value) for value in row]
    words = [word_for(value) if word is None else str(word) for value, word in zip(row, words, strict=True)]
    return "-".join(words)


def word_for(value: Any) -> str:
    word = getattr(value, "__name__", None) or repr(value)
    return word if len(word) <= LONGEST else f"{word[:LONGEST]}..."
