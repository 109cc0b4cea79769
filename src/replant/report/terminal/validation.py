"""Validations as JSON and on the terminal."""

from __future__ import annotations

import math
from typing import Any

from replant.assessment.verdict import percent as share
from replant.identified.model_json import finite, verdict_object
from replant.identified.validation import Validation
from replant.report.number_format import percent
from replant.report.terminal.summary import print_verdict


def as_json(validation: Validation, source: str) -> dict[str, Any]:
    """Return the JSON object of a validation; figures that are not known become null."""
    auto, cross = validation.outside
    by_frequency = validation.by_frequency
    return {
        "source": source,
        "fit": {"one_step": finite(validation.one_step), "simulated": finite(validation.fit)},
        "offset": finite(validation.offset),
        "samples": validation.samples,
        "residual": {"outside_auto": finite(auto), "outside_cross": finite(cross)},
        "worst_error": None if by_frequency is None else finite(by_frequency.worst),
        "verdict": verdict_object(validation.verdict),
    }


def print_validation(console: Any, validation: Validation, source: str) -> None:
    """Print a validation: fits, offset, tests of the residual, and the verdict in words."""
    console.print(f"\nOn {source}", highlight=False, markup=False, style="bold")
    simulated, one_step = (percent(fit, ascii_only=True) for fit in (validation.fit, validation.one_step))
    console.print(f"Fit      {simulated} {validation.how}, {one_step} one step ahead", highlight=False)
    if math.isfinite(validation.offset):
        console.print(f"Offset   {validation.offset:+.4g} beside the model's working point", highlight=False)
    auto, cross = validation.outside
    if math.isfinite(auto):
        outside = f"{100 * auto:.0f} % with itself, {100 * cross:.0f} % with the input"
        console.print(f"Residual correlated beyond the 95 % limit: {outside} (of a right model 5 %)", highlight=False)
    if validation.by_frequency is not None:
        worst = validation.by_frequency.worst
        error = f"up to {share(worst)} of |G|" if worst else "none beyond chance"
        console.print(f"Error    {error}, by frequency", highlight=False)
    console.print(f"Samples  {validation.samples:,}", highlight=False)
    print_verdict(console, validation.verdict)
