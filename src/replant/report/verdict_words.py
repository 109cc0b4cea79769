"""What each verdict means, in the words and with the gravity of report, terminal and dashboard alike."""

from __future__ import annotations

from dataclasses import dataclass

GOOD, WARN, BAD = "good", "warn", "bad"
#: The colour of each gravity at a terminal.
COLOURS = {GOOD: "green", WARN: "yellow", BAD: "red"}


@dataclass(frozen=True)
class VerdictWords:
    """A verdict for readers.

    Attributes
    ----------
    gravity : {"good", "warn", "bad"}
    headline : str
        In a word or two.
    meaning : str
        In a sentence.  It says no more than the status does: how far a model is off stands in the reasons.
    shape : str
        A character that identifies it at a terminal without its colour.
    usable : bool
        False where the model must not be used for anything.
    """

    gravity: str
    headline: str
    meaning: str
    shape: str = "?"
    usable: bool = True


#: By status.
VERDICTS = {
    "trusted": VerdictWords(GOOD, "Trusted", "No test speaks against the model.", "●"),
    "converging": VerdictWords(
        WARN, "Still converging", "The samples do not determine the model well enough yet.", "◐"
    ),
    "not excited": VerdictWords(
        BAD, "Not excited", "The input does not determine every parameter: do not use this model.", "○", usable=False
    ),
    # of a model with nearly the fit of a trusted one, too: by how much it is off, the reasons say
    "inconsistent": VerdictWords(
        BAD, "Inconsistent", "The samples contradict the model: the reasons say by how much.", "▲"
    ),
    "diverged": VerdictWords(BAD, "Diverged", "This is the last finite estimate: do not use it.", "✕", usable=False),
    "unknown": VerdictWords(WARN, "Unknown", "The model cannot be judged at present."),
}


def words_of(status: str) -> VerdictWords:
    """Return the words of a verdict; of a status that is not known, itself as a warning.

    Examples
    --------
    >>> words_of("trusted").headline, words_of("biased")
    ('Trusted', VerdictWords(gravity='warn', headline='Biased', meaning='', shape='?', usable=True))
    """
    return VERDICTS.get(status, VerdictWords(WARN, status.capitalize(), ""))


def colour_of(status: str) -> str:
    """Return the colour of a verdict at a terminal.

    Examples
    --------
    >>> colour_of("trusted"), colour_of("not excited")
    ('green', 'red')
    """
    return COLOURS[words_of(status).gravity]
