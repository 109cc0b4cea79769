"""The verdict in words, and the findings that a report begins with."""

from __future__ import annotations

import re
from dataclasses import dataclass

from replant.report.number_format import complex_number, number
from replant.runs.result import Result

GOOD, WARN, BAD = "good", "warn", "bad"
#: The colour of each gravity at a terminal.
COLOURS = {GOOD: "green", WARN: "yellow", BAD: "red"}


@dataclass(frozen=True)
class VerdictWords:
    """A verdict for readers."""

    gravity: str  # {"good", "warn", "bad"}
    headline: str  # in a word or two
    meaning: str  # in a sentence.  It says no more than the status does: how far a model is off stands in the reasons
    shape: str = "?"  # a character that identifies it at a terminal without its colour
    usable: bool = True  # False where the model must not be used for anything


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


FEW_SAMPLES = 10  # samples for each parameter below which a record is called short [samples]
MANY_REJECTED = 0.01  # share of rejected samples that is mentioned as many [share of samples]


@dataclass(frozen=True)
class Finding:
    """One finding about a result."""

    gravity: str  # {"good", "warn", "bad"}
    headline: str  # in a word or two
    text: str  # in whole sentences
    usable: bool = True  # False where the model must not be used for anything
    more: tuple[str, ...] = ()  # further sentences, that are read after the others


def without_reasons(status: str, *, excited: bool) -> str:
    """Return a verdict for a place that does not show its reasons: a trusted model says there that the input rests.

    Examples
    --------
    >>> without_reasons("trusted", excited=False), without_reasons("trusted", excited=True)
    ('trusted, not excited', 'trusted')
    """
    return f"{status}, not excited" if status == "trusted" and not excited else status


def findings(result: Result, total: int) -> list[Finding]:
    """Return the findings about ``result`` from a record of ``total`` samples, the gravest first."""
    found = [*_of_verdict(result), *_of_samples(result, total), *_of_model(result)]
    return sorted(found, key=lambda finding: (BAD, WARN, GOOD).index(finding.gravity))


def _of_verdict(result: Result) -> list[Finding]:
    status, reasons = result.verdict.status, result.verdict.reasons
    words = words_of(status)
    if result.samples == 0:
        why = "Every sample was rejected" if any(result.rejected.values()) else "The record is empty"
        return [Finding(BAD, "No sample used", f"{why}: there is nothing to identify a model from.", usable=False)]
    if status != "diverged" and result.samples < FEW_SAMPLES * result.structure.size:
        return []  # of so few samples the verdict is meaningless: `_of_samples` says that they are few
    said = [*map(_sentence, reasons)]
    text = " ".join([words.meaning, *said[:1]]).strip()
    return [Finding(words.gravity, words.headline, text, words.usable, tuple(said[1:]))]


def _of_samples(result: Result, total: int) -> list[Finding]:
    found = []
    size, rejected = result.structure.size, sum(result.rejected.values())
    if 0 < result.samples < FEW_SAMPLES * size:
        count = f"{result.samples} sample{'s' if result.samples > 1 else ''}"
        text = f"{count} cannot determine {size} parameters: record at least {FEW_SAMPLES * size}."
        found.append(Finding(BAD, "Too short", text, usable=False))
    if rejected > MANY_REJECTED * max(total, 1):
        reasons = ", ".join(f"{count:,} {reason}" for reason, count in result.rejected.items() if count)
        share = number(100.0 * rejected / total, 3)
        found.append(Finding(WARN, "Rejected samples", f"{share} % of the record could not be used: {reasons}."))
    return found


def _of_model(result: Result) -> list[Finding]:
    unstable = [pole for pole in result.transfer_function.poles.tolist() if pole.real > 0 and pole.imag >= 0]
    if not unstable or result.samples == 0:
        return []
    poles = ", ".join(complex_number(pole) for pole in unstable)
    text = f"The model has {'a pole' if len(unstable) == 1 else 'poles'} in the right half-plane: {poles} rad/s."
    return [Finding(WARN, "Unstable", text)]


def _sentence(reason: str) -> str:
    """Return a verdict's reason as a sentence, with long numbers as the report writes them.

    Examples
    --------
    >>> _sentence("a coefficient has moved over the last 2.45e+03 s")
    'A coefficient has moved over the last 2450 s.'
    """
    reason = re.sub(r"-?\d{7,}(\.\d+)?|-?\d(\.\d+)?e[+-]\d+|-?\binf\b", lambda found: number(float(found[0])), reason)
    return reason[:1].upper() + reason[1:].rstrip(".") + "."
