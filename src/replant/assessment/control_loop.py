"""The loop: what the samples tell of a controller that moves the input, and of the reference that moves it."""

from __future__ import annotations

from dataclasses import dataclass

from replant.assessment.evidence import Evidence, Runs
from replant.assessment.feedback_test import Answer, answer, colour_left
from replant.assessment.reference_test import REMEDY, Reference
from replant.assessment.verdict import Finding

CLOSED = "the loop is closed: the input answers the residual, which the noise model whitens"
AT_ONCE = (
    "the input answers the residual of the same sample: the loop is closed, or the plant has a direct path (then ask "
    "for as many zeros as poles)"
)
COLOURED = (
    "the loop is closed, and either its disturbances have more colour than the noise model, or the model is wrong; to "
    f"learn which, {REMEDY}"
)


@dataclass(frozen=True, eq=False)
class Loop:
    """What the samples tell of a controller that closes a loop.

    Attributes
    ----------
    feedback : Answer
        How the input answers the residual.
    reference : Reference or None
        What a reference explains; None where there is none, or it is of no use.
    findings : list of Finding
    """

    feedback: Answer
    reference: Reference | None
    findings: list[Finding]

    @property
    def is_closed(self) -> bool:
        """Whether a controller moves the input: it answers the residual, or a reference explains it."""
        return self.feedback.found or self.reference is not None

    @classmethod
    def of(cls, evidence: Evidence, runs: Runs, reference: Reference | None, doubts: list[Finding]) -> Loop:
        """Test for feedback, and whether the reference is one; ``doubts`` are the findings on it so far."""
        feedback = answer(runs.now, evidence.known, evidence.record.u, first=int(runs.now.is_direct))
        findings = list(doubts)
        r = evidence.record.r
        if reference is not None and r is not None and reference.follows(r, runs.now, evidence.known):
            findings.append(Finding("inconsistent", f"the reference follows the disturbances: {REMEDY}"))
            reference = None
        elif reference is None and r is not None and answer(runs.now, evidence.known, r).found:  # a copy of the input
            findings = [Finding("inconsistent", f"{doubt.reason}: {REMEDY}") for doubt in findings]
        pole = evidence.unstable_pole
        if pole > 0.0 and reference is None:
            run = f"simulated from the input alone, the model diverges (a pole at {pole:+.3g} rad/s)"
            reason = f"{run}, and only a reference can show that an unstable model is right: {REMEDY}"
            findings.append(Finding("inconsistent", reason))
        elif feedback.found and reference is None and colour_left(runs.now.error[evidence.known]) > 1.0:
            findings.append(Finding("inconsistent", COLOURED))
        elif feedback.found:
            findings.append(Finding("trusted", AT_ONCE if feedback.at_once else CLOSED))
        return cls(feedback, reference, findings)
