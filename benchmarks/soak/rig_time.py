"""Hours of rig time with random faults on random plants: no model that is wrong is to be called trusted.

Rigs of random plants at 64 Hz are identified with default settings; a fault comes about every 40 minutes.  At looks
that follow each fault closely, and seldom in between, the verdict stands beside the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from replant import Identifier
from soak.faults import FAULTS, Fault, deck
from soak.rig import DT, Rig

WRONG = 0.1  # part by which abs G may be off
#: Samples after something has happened, at which the verdict is looked at.
LOOKS = (8, 16, 32, 64, 128, 256, 400, 640, 1000, 1600, 2500, 4000, 5000, 6400, 10_000, 16_000)
STRIDE = 64_000  # samples between two looks later on
BETWEEN = (600.0, 3600.0)  # s between two faults
HOURS_A_RIG = 25.0
#: For so long, in s, "trusted" may be said of a model that has become wrong, see docs/live.md: 640 samples; where the
#: input rests, which shows no change, until every sample that the verdict holds out is of the rest: 5,000.
LIMIT, AT_REST = 640 * DT, 5000 * DT


@dataclass
class Episode:
    """A fault and what came of it, in s of rig time.

    Attributes
    ----------
    noticed : float or None
        From the beginning of the fault to the first look that does not say "trusted".
    wrong : float
        The longest from when "trusted" was wrong at the earliest, to the first look at which it was not.
    worst : float
        The largest error of abs G while "trusted" was said and the plant was excited.
    again : float or None
        From the end of the fault until "trusted" is said of a model that is right.
    """

    fault: str
    rig: int
    at: float
    lasted: float
    noticed: float | None = None
    wrong: float = 0.0
    worst: float = 0.0
    again: float | None = None


@dataclass
class Watch:
    """A rig, its identifier, and the verdict beside the truth."""

    rig: Rig
    number: int
    clock: float = 0.0
    episodes: list[Episode] = field(default_factory=list)
    looks: int = 0

    def __post_init__(self) -> None:
        self._fault: Fault = lambda samples: samples
        self.identifier = Identifier(self.rig.structure, self.rig.dt)
        self._since: float | None = None  # when "trusted" of a wrong model may have begun
        self._looked = 0.0
        self._trusts = False

    def go_on(self, samples: int) -> None:
        """Take samples, and look."""
        self.identifier.update_many(*self._fault(self.rig.take(samples)))
        self.clock += samples * self.rig.dt
        self._look()

    def happens(self, name: str) -> float:
        """Begin a fault; return how long it lasts, in s."""
        lasts, self._fault = FAULTS[name](self.rig)
        self.episodes.append(Episode(name, self.number, self.clock, lasts))
        if name == "restart":
            self.identifier = Identifier.from_bytes(self.identifier.to_bytes())
        self._looked = self.clock  # what was right until now is wrong from here at the earliest
        return lasts

    def ends(self) -> None:
        """End the fault."""
        self.rig.held = None
        self._fault = lambda samples: samples
        self._looked = self.clock

    def _look(self) -> None:
        verdict = self.identifier.assess()
        self._trusts, off = verdict.status == "trusted", 0.0
        self.looks += 1
        if self._trusts:
            off = self.rig.error(self.identifier.transfer_function)
        # while nothing excites the plant no change can show, and the verdict says both
        is_wrong = self._trusts and verdict.excited and not off <= WRONG
        if is_wrong and self._since is None:
            self._since = self._looked
        if self.episodes:
            self._note(self.episodes[-1], off)
        if not is_wrong:
            self._since = None
        self._looked = self.clock

    def _note(self, episode: Episode, off: float) -> None:
        gone = self.clock - episode.at
        if not self._trusts and episode.noticed is None:
            episode.noticed = gone
        if self._since is not None:
            episode.worst = max(episode.worst, off)
        if self._since is not None:
            episode.wrong = max(episode.wrong, self.clock - self._since)
        elif self._trusts and gone > episode.lasted and episode.again is None and episode.noticed is not None:
            episode.again = gone - episode.lasted


def watched(number: int, seed: int, hours: float, names: Iterator[str] | None = None) -> Watch:
    """Run one rig for so many hours of its time."""
    rng = np.random.default_rng([seed, number])
    watch = Watch(Rig(rng), number)
    names = deck(rng) if names is None else names
    _pass(watch, 600.0)
    while watch.clock < 3600.0 * hours:
        _pass(watch, watch.happens(next(names)))
        watch.ends()
        _pass(watch, float(rng.uniform(*BETWEEN)))
    return watch


def _pass(watch: Watch, seconds: float) -> None:
    """Let time pass, looking closely at first."""
    samples, done = round(seconds / watch.rig.dt), 0
    for look in LOOKS:
        if look < samples:
            watch.go_on(look - done)
            done = look
    while done < samples:
        some = min(STRIDE, samples - done)
        watch.go_on(some)
        done += some


def run(hours: float, seed: int, report: Callable[[Watch], None], hours_a_rig: float = HOURS_A_RIG) -> list[Episode]:
    """Run rigs until so many hours have gone; return every episode."""
    episodes, done, number = [], 0.0, 0
    while done < hours:
        watch = watched(number, seed, min(hours_a_rig, hours - done))
        report(watch)
        episodes += watch.episodes
        done += watch.clock / 3600.0
        number += 1
    return episodes


def broken(episodes: list[Episode]) -> list[str]:
    """Return the episodes in which a model that was wrong was called trusted for longer than is documented."""
    return [
        f"{episode.fault} at {episode.at:.0f} s of rig {episode.rig}: {episode.wrong:.1f} s trusted with abs G up to "
        f"{100.0 * episode.worst:.0f} % off"
        for episode in episodes
        if episode.wrong > (AT_REST if episode.fault == "changed_at_rest" else LIMIT)
    ]


def table(episodes: list[Episode]) -> str:
    """Return the episodes by fault: how many, how soon noticed, how long wrong and trusted, s of rig time."""
    head = ("fault", "episodes", "noticed", "median", "95 %", "worst", "trusted, >10 % off: episodes", "95 %", "worst")
    rows = [head, tuple("---" if i == 0 else "---:" for i in range(len(head)))]
    for name in FAULTS:
        mine = [episode for episode in episodes if episode.fault == name]
        if not mine:
            continue
        noticed = [episode.noticed for episode in mine if episode.noticed is not None]
        wrong = [episode.wrong for episode in mine if episode.wrong > 0.0]
        counts = str(len(mine)), str(len(noticed)), str(len(wrong))
        rows.append((name.replace("_", " "), *counts[:2], *_quantiles(noticed), counts[2], *_quantiles(wrong)[1:]))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _quantiles(values: list[float]) -> tuple[str, str, str]:
    if not values:
        return "-", "-", "-"
    return f"{np.median(values):.1f} s", f"{np.quantile(values, 0.95):.1f} s", f"{max(values):.1f} s"
