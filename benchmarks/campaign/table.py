"""The table of a campaign: what was measured beside what is wanted, and the worst records with their numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from campaign.actuators import Trusted
from campaign.outcome import GOOD, SIGMAS, Outcome

BEHIND = 5.0  # points of fit by which online is behind an offline fit
SHOWN = 8  # worst records


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes
    ----------
    what, measured, wanted : str
    kept : bool or None
        Whether what is wanted is measured; None where nothing is wanted.
    """

    what: str
    measured: str
    wanted: str = ""
    kept: bool | None = None


@dataclass(frozen=True)
class Campaign:
    """All that came out.

    Attributes
    ----------
    outcomes : sequence of Outcome
    actuators, toggling, smooth : Trusted
    silent, surplus : int
        Of ``surplus`` plants with a pole too many so many have no model.
    """

    outcomes: Sequence[Outcome]
    actuators: Trusted
    toggling: Trusted
    smooth: Trusted
    silent: int
    surplus: int

    def lines(self) -> Iterator[Line]:
        """Yield the lines of the table."""
        all_of, good = self.outcomes, [one for one in self.outcomes if one.is_good]
        bad = [one for one in all_of if not one.is_good]
        offline = sum(one.offline >= GOOD for one in all_of)
        yield Line("records explained to over 90 %: offline, online", f"{offline}, {len(good)} of {len(all_of)}")
        behind = sum(one.offline - one.online > BEHIND for one in all_of)
        yield _at_most("online more than 5 points of fit below `fit`", behind, len(all_of), 0.01)
        yield _at_most('still "starting" at the end', sum(one.starting for one in all_of), len(all_of), 0.0)
        trusted = sum(one.status == "trusted" for one in good)
        share = trusted / max(len(good), 1)
        yield Line("good models that are trusted", f"{trusted} of {len(good)}", "95 %", share >= 0.95)
        yield _at_most("bad models that are trusted", sum(one.status == "trusted" for one in bad), len(bad), 0.01)
        still = sum(one.stilled for one in good)
        yield _at_most('good models "not excited" because the input has come to rest', still, len(good), 0.0)
        for noise, most in (("white", 0.03), ("AR(.9)", 0.06), ("drift", 0.12)):
            known = [one for one in all_of if one.noise == noise and not math.isnan(one.deviation)]
            far = sum(one.deviation > SIGMAS for one in known)
            yield _at_most(f"a coefficient over three standard deviations off, {noise} noise", far, len(known), most)
        noisy = [one for one in all_of if one.noise != "none"]
        unknown = sum(one.unknown for one in noisy)
        yield Line("said to have unknown coefficients, with noise", f"{unknown} of {len(noisy)}")
        known = [one.beside_bound for one in good if not math.isnan(one.beside_bound)]
        beside = f"{np.median(known):.2f}" if known else "-"
        yield Line("error over the Cramer-Rao bound, median of good models", beside)
        yield _trusted("behind actuators that are not linear", self.actuators, 3)
        yield _trusted("looks at a gain that toggles, 25 % off", self.toggling, 2)
        yield _trusted("smooth input taken as held, 10 % off, and not said", self.smooth, 0)
        yield _at_most("one pole too many, no noise: no estimate", self.silent, self.surplus, 0.0)

    def worst(self) -> Iterator[str]:
        """Yield the worst records in words."""
        behind = sorted(self.outcomes, key=lambda one: one.online - one.offline)
        for one in [one for one in behind if one.offline - one.online > BEHIND][:SHOWN]:
            yield f"{one.number}: online {one.online:.1f} %, offline {one.offline:.1f} % ({one.what}): {one.reason}"
        for one in [one for one in self.outcomes if one.status == "trusted" and not one.is_good][:SHOWN]:
            yield f"{one.number}: trusted at {one.online:.1f} % ({one.what})"
        far = sorted((one for one in self.outcomes if one.deviation > SIGMAS), key=lambda one: -one.deviation)
        for one in far[:SHOWN]:
            yield f"{one.number}: {one.deviation:.1f} standard deviations off ({one.what})"
        for which, cases in (("actuator", self.actuators), ("toggling", self.toggling), ("smooth", self.smooth)):
            if cases.cases:
                yield f"{which}: {', '.join(cases.cases[:SHOWN])}"


def _at_most(what: str, count: int, of: int, share: float) -> Line:
    wanted = f"at most {100.0 * share:.0f} %" if share else "0"
    return Line(what, f"{count} of {of}", wanted, count <= share * of)


def _trusted(what: str, trusted: Trusted, most: int) -> Line:
    return Line(f"trusted, wrong: {what}", f"{trusted.trusted} of {trusted.wrong}", str(most), trusted.trusted <= most)
