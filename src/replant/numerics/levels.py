"""Levels: the chance of a false alarm, and what matters; other bounds of tests are derived from the two."""

ALPHA = 1e-4
"""Chance that a test finds something where there is nothing [probability].
Level: 0.01 %: the verdict is asked for many times in a run.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

MATTERS = 0.01
"""What matters: a tenth of the output's amplitude [part of the output's power].
Origin: a choice of what a user may rely on.
Sensitivity: not measured.
"""
# the square of some million times float64's precision
ROUNDING = 1e-18  # power of the residual below which only rounding is left [part of the output's power]

LARGEST_PART = (1.0 / 16.0) ** 2
"""What an alternative could still explain, up to which a model is trusted with a caveat: a sixteenth of the output's
amplitude. With its doubt added it must stay below it [part of the output's power].
Origin: real plants are never quite linear, nor of finite order; an unknown dead time of half a time constant, which
moves the coefficients of three poles by a half, leaves .67 %.
Sensitivity: at 1 %, of 417 verdicts on right models of field records three more are "trusted", and that one.
"""

NEGLIGIBLE = 0.01 * MATTERS  # what could still be explained that is not worth a word [part of the output's power]
