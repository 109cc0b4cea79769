"""One command line with hostile numbers: a result, or exit code 2 and one line on standard error.

``python -m fuzz --what commands --tries 500`` takes many; ``python -m fuzz.commands NUMBER`` shows one.
"""

from __future__ import annotations

import contextlib
import io
import random
import shlex
import sys
from typing import Any

from fuzz.calls import MOST_MEMORY, limited, place, watched
from fuzz.public import folder
from fuzz.trial import FindingError
from replant.cli import main
from replant.errors import LONGEST

NUMBERS = [
    "1e308", "1e309", "-1e308", "1e-320", "1e-300", "5e-324", "0", "-0", "-1", "1", "2", "0.1", "0.05", "nan", "inf",
    "-inf", "1e9", "1e16", "999999999", "999999999999999999999", 400 * "9", 10_000 * "9", "1e30", "1e-30", "0x10",
    "1_0", "\u0663", "\u00bd", "", " ", "x", "1,5", "--", "1e", "1:4", "1:2:1", "0:0.2:0.1", "1:999999999", "0:1e308",
    "0:1e308:1e-300", "0:1:0", "0:1:1e-9", "4:1", "::", "nan:nan", "0:inf:1", 5000 * "1:", "10ms", "1e9d", "a\nb",
]  # fmt: skip
STRUCTURE = ["-p", "--zeros", "--delay"]
CLOCK = ["--dt", "--from", "--to"]
CONDITION = ["--decimate", "--resample"]
#: Of each command the words that come first, and the options that take a number.
COMMANDS: dict[str, tuple[list[str], list[str]]] = {
    "run": (["log.csv", "-i", "u", "-o", "y", "-p", "1"], [*STRUCTURE, *CLOCK, *CONDITION, "--startup", "--optimizer"]),
    "fit": (["log.csv", "-i", "u", "-o", "y", "-p", "1"], [*STRUCTURE, *CLOCK, *CONDITION]),
    "compare": (["log.csv", "-i", "u", "-o", "y", "-p", "1"], [*STRUCTURE, *CLOCK, *CONDITION, "--optimizer"]),
    "fleet": (
        ["rigs", "--by", "file", "-i", "u", "-o", "y", "-p", "1", "--method", "fit", "--out", "fleet"],
        [*STRUCTURE, *CLOCK, "--optimizer", "--on"],
    ),
    "validate": (["model.json", "log.csv", "-i", "u", "-o", "y"], ["--dt", "-i", "--time"]),
    "look": (["log.csv"], ["-i", "-o", "--time"]),
    "show": (["model.json"], []),
    "live": (
        ["-", "-p", "-1", "--dt", "0.1", "--dashboard", "off"],  # refused: a session takes seconds
        [*STRUCTURE[1:], "--dt", "--startup", "--samples", "--for", "--every", "--ttl", "--optimizer", "--dashboard"],
    ),
}
FORMS = {"--optimizer": "amsgrad:step_size=", "--on": "threads:", "--dashboard": "127.0.0.1:"}


def trial(number: int) -> str:
    """Run one command line, the ``number``-th; return "result" or "refused".

    Raises
    ------
    FindingError
        With what happened.
    """
    words, said = drawn(random.Random(number)), io.StringIO()
    code: Any = 0
    try:
        with contextlib.chdir(folder()), watched(), limited(MOST_MEMORY), contextlib.redirect_stderr(said):
            main(words)
    except SystemExit as end:
        code = end.code
    except Exception as error:
        raise FindingError(f"{words[0]}: {type(error).__name__} from {place(error)}") from error
    lines = said.getvalue().splitlines()
    if any(not line.startswith("replant: ") for line in lines):
        raise FindingError(f"{words[0]}: exit code {code}, not its own words: {lines!r:.150}")
    told = [line for line in lines if not line.startswith("replant: note: ")]
    if code not in (0, 2) or (code == 2 and len(told) != 1):
        raise FindingError(f"{words[0]}: exit code {code} with {len(told)} lines: {told!r:.150}")
    if code == 2 and len(told[0]) > LONGEST + len("replant: "):
        raise FindingError(f"{words[0]}: {len(told[0])} characters: {told[0]:.100}")
    return "refused" if code else "result"


def drawn(chance: random.Random) -> list[str]:
    """Draw a command line."""
    command = chance.choice(list(COMMANDS))
    words, options = COMMANDS[command]
    words = [command, *words]
    for option in chance.sample(options, min(len(options), chance.choice([1, 1, 2]))):
        if option in words and option not in ("-i", "-o"):  # in the place of what stands there
            place = words.index(option)
            words = words[:place] + words[place + 2 :]
        value = FORMS.get(option, "") * (chance.random() < 0.8) + number_in_words(chance)
        words += [f"{option}={value}"] if option.startswith("--") and chance.random() < 0.5 else [option, value]
    return words


def number_in_words(chance: random.Random) -> str:
    """A number as one may type it."""
    if chance.random() < 0.7:
        return chance.choice(NUMBERS)
    value = chance.choice([-1.0, 1.0, 1.0, 1.0]) * 10.0 ** chance.uniform(-20.0, 20.0)
    return repr(value) if chance.random() < 0.5 else str(round(value))


if __name__ == "__main__":
    for each in map(int, sys.argv[1:]):
        print(each, shlex.join(drawn(random.Random(each)))[:300])
        try:
            print("   ", trial(each))
        except FindingError as error:
            print("   ", f"{error}"[:400])
