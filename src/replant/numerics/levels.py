"""Levels of tests: the false-alarm probability and the effect that matters; other bounds are derived from these."""

ALPHA = 1e-4
"""Probability of a false alarm of a test [probability].
Level: 0.01 %, as the verdict is computed many times in a run.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

MATTERS = 0.01
"""Least power of an effect that matters: a tenth of the output's amplitude [part of the output's power].
Origin: a choice of what a user may rely on.
Sensitivity: not measured.
"""
# the square of some million times the precision of float64
ROUNDING = 1e-18  # power of the residual below which it is rounding alone [part of the output's power]

LARGEST_PART = (1.0 / 16.0) ** 2
"""Largest power that an alternative model could still explain, its uncertainty included, of a model trusted with a
caveat: a sixteenth of the output's amplitude [part of the output's power].
Origin: real plants are never exactly linear or of finite order; an unknown dead time of half a time constant, which
moves the coefficients of three poles by a half, leaves .67 % unexplained.
Sensitivity: at 1 %, three more of 417 verdicts on right models of field records are "trusted", and so is the model with
the unknown dead time.
"""

NEGLIGIBLE = 0.01 * MATTERS  # power still unexplained that is not worth mentioning [part of the output's power]
