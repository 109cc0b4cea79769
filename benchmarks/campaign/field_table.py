"""The table of the field records: where `fit` is behind the anchor, online behind `fit`, and who is trusted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rich.table import Table

from campaign import reasons
from campaign.field_outcome import Estimate, FieldOutcome
from campaign.outcome import GOOD
from campaign.table import BEHIND, Line

WAYS: dict[str, Callable[[FieldOutcome], Estimate]] = {
    "`fit`": lambda one: one.offline,
    "online with finish": lambda one: one.finished,
    "online without": lambda one: one.running,
}
#: What is counted as a loss: its words, and whether a record is one.
LOSSES: dict[str, Callable[[FieldOutcome], bool]] = {
    "`fit` behind the anchor": lambda one: one.anchor - one.offline.fit > BEHIND,
    "online with finish behind `fit`": lambda one: one.offline.fit - one.finished.fit > BEHIND,
    "online without behind `fit`": lambda one: one.offline.fit - one.running.fit > BEHIND,
}
BETWEEN = ", dead time between two samples"


@dataclass(frozen=True)
class FieldTable:
    """All that came out.

    Attributes
    ----------
    outcomes : sequence of FieldOutcome
    """

    outcomes: Sequence[FieldOutcome]

    def lines(self) -> Iterator[Line]:
        """Yield the lines of the table."""
        whole, half = ([one for one in self.outcomes if one.half is which] for which in (False, True))
        for loss, is_one in LOSSES.items():
            for group, name in ((whole, ""), (half, BETWEEN)):
                yield Line(f"{loss} by more than {BEHIND:.0f} points{name}", share(sum(map(is_one, group)), len(group)))
        for name, of in WAYS.items():
            for group, where in ((whole, ""), (half, BETWEEN)):
                yield from verdicts([of(one) for one in group], name, where)
        yield Line("anchor: good, of all", share(sum(one.anchor >= GOOD for one in self.outcomes), len(self.outcomes)))
        for name, of in WAYS.items():
            found = [of(one) for one in self.outcomes]
            times = f"{sum(one.seconds for one in found):.0f} s, verdicts {sum(one.judging for one in found):.0f} s"
            yield Line(f"{name}: processor time", times)
        yield Line(
            "anchor: processor time, of those not kept from before",
            f"{sum(one.anchor_seconds for one in self.outcomes):.0f} s",
        )

    def by_feature(self) -> Table:
        """Return the losses, and the wrong verdicts of `fit`, by what the records have."""
        table = Table(title="losses by feature, dead time a whole number of samples")
        for column in ("", "records", *LOSSES, "`fit`: bad, trusted", "`fit`: good, not trusted"):
            table.add_column(column, justify="left" if not column else "right")
        whole = [one for one in self.outcomes if not one.half]
        for feature in sorted({feature for one in whole for feature in one.features}):
            having = [one for one in whole if feature in one.features]
            counts = [sum(map(is_one, having)) for is_one in LOSSES.values()]
            counts.append(sum(one.offline.is_trusted and not one.offline.is_good for one in having))
            counts.append(sum(one.offline.is_good and not one.offline.is_trusted for one in having))
            table.add_row(feature, str(len(having)), *(share(count, len(having)) for count in counts))
        return table

    def by_reason(self) -> Table:
        """Return how often each reason was the first one for no trust in a good model, and in a bad one."""
        found = {name: map(of, self.outcomes) for name, of in WAYS.items()}
        return reasons.table(
            {name: [(one.reason, one.is_good) for one in way if not one.is_trusted] for name, way in found.items()}
        )

    def losing(self) -> Iterator[str]:
        """Yield every record that is lost, in words, the worst of each kind first."""
        for loss, is_one in LOSSES.items():
            lost = [one for one in self.outcomes if is_one(one)]
            yield f"{loss}:"
            for one in sorted(lost, key=lambda one: min(one.offline.fit, one.finished.fit, one.running.fit)):
                fits = ", ".join(f"{of(one).fit:.1f} {of(one).status}" for of in WAYS.values())
                yield f"  {one.number}: anchor {one.anchor:.1f}, {fits} ({one.what})"
        for name, of in WAYS.items():
            fooled = [one for one in self.outcomes if of(one).is_trusted and not of(one).is_good]
            yield f"{name}, bad and trusted: " + ", ".join(f"{one.number} ({of(one).fit:.1f} %)" for one in fooled)


def verdicts(found: Sequence[Estimate], name: str, where: str) -> Iterator[Line]:
    """Yield how many estimates of one way are good, and what is said of the good ones and of the bad ones."""
    good, bad = [one for one in found if one.is_good], [one for one in found if not one.is_good]
    trusted, fooled = sum(one.is_trusted for one in good), sum(one.is_trusted for one in bad)
    right = [one.is_trusted for one in good if one.is_right]
    refused = sum(one.status == "inconsistent" for one in good)
    yield Line(f"{name}: good, of all{where}", share(len(good), len(found)))
    yield Line(f"{name}: trusted, of the good{where}", share(trusted, len(good)))
    yield Line(f"{name}: bad and trusted, of all{where}", share(fooled, len(found)))
    yield Line(f"{name}: right and refused (inconsistent), of the good{where}", share(refused, len(good)))
    also = "those that explain the response to the input, too"
    yield Line(f"{name}: trusted, of {also}{where}", share(sum(right), len(right)))


def share(count: int, of: int) -> str:
    """Return a count in words."""
    return f"{count} of {of} ({100.0 * count / max(of, 1):.1f} %)" if of else "-"
