"""Words typed nearly right: the nearest known word; "-" counts as "_"."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

import click

NEAR = 0.6  # likeness from which on a word is taken for a misspelling [ratio of difflib]


def did_you_mean(word: str, words: Sequence[str]) -> str:
    """Return a question for the nearest of ``words``; empty if none is near.

    Examples
    --------
    >>> did_you_mean("amsgrd", ["adam", "amsgrad"]), did_you_mean("magic", ["adam", "amsgrad"])
    ("did you mean 'amsgrad'?", '')
    """
    near = get_close_matches(_plain(word), words, n=1, cutoff=NEAR)
    return f"did you mean {near[0]!r}?" if near else ""


def _plain(word: str) -> str:
    return word.lower().replace("-", "_")


class Choice(click.Choice[str]):
    """The type of options that are one of several words, in any case, with - or _; a near one is proposed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the word as the option knows it.

        >>> Choice(["srivc", "least_squares"]).convert("least-squares", None, None)
        'least_squares'
        """
        found = next((choice for choice in self.choices if _plain(choice) == _plain(str(value))), None)
        if found is None:
            listed = ", ".join(map(repr, self.choices))
            question = did_you_mean(str(value), self.choices)
            near = f" ({question})" if question else ""
            self.fail(f"{value!r} is not one of {listed}{near}.", param, ctx)
        return found
