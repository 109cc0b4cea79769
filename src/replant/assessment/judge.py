"""For now: the provisional verdict."""

import math

from replant.assessment.verdict import Verdict

#: Condition number of the scaled regressors beyond which the data do not tell the parameters apart.
WORST_CONDITION = 1e8
#: Simulated fit in percent below which the model does not explain the data.
POOREST_FIT = 50.0
#: Movement of the estimate over the last tenth, as a part of its size, beyond which it still converges.
MOST_DRIFT = 0.05


def judge(*, refused: bool, condition: float, simulated: float, drift: float) -> Verdict:
    """Return the verdict on an estimate from its figures, the gravest finding first.

    Parameters
    ----------
    refused : bool
        Whether an update had to be undone because it left float64.
    condition : float
        Condition number of the scaled regressors.
    simulated : float
        Simulated fit in percent.
    drift : float
        Largest movement of a parameter over the last tenth of the record, as a part of its size.

    Examples
    --------
    >>> judge(refused=False, condition=20.0, simulated=30.0, drift=0.0).status
    'inconsistent'
    """
    if refused:
        return Verdict("diverged", ("updates left the range of float64 and were undone: lower the gain or step size",))
    if not condition < WORST_CONDITION:
        figure = "infinite" if math.isinf(condition) else f"{condition:.1e}"
        return Verdict(
            "not excited",
            (f"the input does not excite every parameter (condition number {figure}): move it more, or ask for less",),
        )
    if not simulated >= POOREST_FIT:
        return Verdict(
            "inconsistent", (f"the model run from the input alone explains the output poorly (fit {simulated:.1f} %)",)
        )
    if drift > MOST_DRIFT:
        return Verdict("converging", (f"a parameter still moved by {100 * drift:.0f} % over the last tenth",))
    return Verdict("trusted", (f"simulated fit {simulated:.1f} %, condition number {condition:.0f}",))
