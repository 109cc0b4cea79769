"""`fit` and `run` on public logs beside an output-error fit of the same structure that shares no code with them.

    python benchmarks/public_logs --mirror DIR [--only NAME ...] [--cache FILE]

DIR holds a git directory for each repository, named owner+name; what is missing is said, and how to clone it.  All
figures are simulated fits in percent, offset and initial state estimated.  "!" marks a model with a pole that grows
more than e-fold within the record: the anchor has none, and it does not count as good as the anchor.  In feedback the
output error is no measure of a model: those logs are listed, and left out of the totals.  Exit code 2 says that
repositories are missing.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

import replant as rp
from public_logs import anchor
from public_logs.anchor import FloatArray, OutputError
from public_logs.records import Data, how_to_clone, read
from public_logs.table import LOGS, Log
from replant.errors import ReplantError
from replant.estimation.settings import Request
from replant.estimation.simulation.model_run import runs_away
from replant.estimation.solver.srivc import refine
from replant.fitting.fit import RawRecord
from replant.online.runs.run import run_online
from replant.verdict import simulate

CLOSE, FAR = 1.0, 5.0  # points below the anchor: as good as it; far too low to be trusted
CACHE = Path("out/public_logs.json")
HEADER = (
    "log                 samples structure loop    anchor      fit  behind verdict           run  behind verdict\n"
    "                            poles/zeros            %        %                              %"
)
MEANS = rp.Preprocess("identity", "mean", "mean")


@dataclass(frozen=True)
class Row:
    """What the anchor, `fit` and `run` reach on a log: fits in percent, verdicts, and whether a model runs away."""

    log: Log
    samples: int
    best: float
    fits: tuple[float, float]
    verdicts: tuple[str, str]
    away: tuple[bool, bool] = (False, False)

    @property
    def behind(self) -> tuple[float, float]:
        """Points of `fit` and `run` below the anchor."""
        fit, run = (self.best - one for one in self.fits)
        return fit, run

    def __str__(self) -> str:
        log, structure = (
            self.log,
            f"{self.log.poles}/{self.log.zeros}" + (f" {self.log.delay:g}s" if self.log.delay else ""),
        )
        each = "  ".join(
            f"{fit:7.2f}{'!' if away else ' '}{behind:7.2f} {verdict:12}"
            for fit, behind, verdict, away in zip(self.fits, self.behind, self.verdicts, self.away, strict=True)
        )
        return f"{log.name:20} {self.samples:6} {structure:9} {log.loop:6} {self.best:7.2f}  {each}".rstrip()


def measured(log: Log, data: Data, cache: dict[str, list[float]]) -> Row:
    """Return the row of a log."""
    structure = rp.Structure(log.poles, log.zeros, delay=log.delay)
    models: list[rp.TransferFunction | None] = []
    verdicts = []
    try:
        fitted = rp.fit(data.u, data.y, log.dt, structure, preprocess=MEANS, reference=data.r)
        models.append(fitted.transfer_function)
        verdicts.append(fitted.verdict.status)
    except ReplantError:
        models.append(None)
        verdicts.append("no model")
    result = run_online(Request(structure, log.dt, preprocess=MEANS), data.u, data.y, reference=data.r)
    models.append(result.transfer_function)
    verdicts.append(result.verdict.status)
    (fit, fit_away), (run, run_away) = (_simulated(model, log, data) for model in models)
    given = [np.asarray(model.den[1:]) for model in [*models, _plain(structure, data, log.dt)] if model is not None]
    best = _anchor(log, data, given, cache)
    return Row(log, data.u.size, best, (fit, run), (verdicts[0], verdicts[1]), (fit_away, run_away))


def _simulated(model: rp.TransferFunction | None, log: Log, data: Data) -> tuple[float, bool]:
    """Return the simulated fit in percent, and whether the model would run away; without a model -inf."""
    if model is None:
        return -np.inf, False
    return simulate(model, data.u, data.y, log.dt).fit, runs_away(model.den, data.u.size * log.dt)


def _plain(structure: rp.Structure, data: Data, dt: float) -> rp.TransferFunction | None:
    """Return replant's estimate without a noise model, where it finds one."""
    raw = RawRecord(structure, dt, MEANS.resolve(data.u, data.y), data.u, data.y, None, "zoh")
    found = refine(structure, raw.made_ready(None), filtered=False)
    return None if found is None else structure.transfer_function(found.theta[: structure.size])


def _anchor(log: Log, data: Data, given: Sequence[FloatArray], cache: dict[str, list[float]]) -> float:
    """Return the anchor's fit: from its own starts, once, and from denominators that replant comes to.

    Beside a known anchor only those of the latter count that are better already.
    """
    problem = OutputError(data.u, data.y, log.dt, log.poles, log.zeros, log.delay)
    problem_given = data.u.tobytes(), data.y.tobytes(), log.dt, log.poles, log.zeros, log.delay
    key = sha256(repr((problem_given, Path(anchor.__file__).read_text())).encode()).hexdigest()[:16]
    if key in cache:
        known = np.array(cache[key])
        given = [den for den in given if problem.fit(den) > problem.fit(known)]
    else:
        known = problem.best()
    best = problem.better(known, given)
    cache[key] = best.tolist()
    return problem.fit(best)


def totals(rows: Sequence[Row]) -> list[str]:
    """Return the lines below the table."""
    found = [row for row in rows if row.log.loop == "open"]
    lines = []
    for k, name in enumerate(("fit", "run")):
        near = sum(row.behind[k] <= CLOSE and not row.away[k] for row in found)
        wrong = [row.log.name for row in found if row.behind[k] > FAR and row.verdicts[k] == "trusted"]
        lines.append(
            f"{name}: within {CLOSE:g} point of the anchor on {near} of {len(found)} logs in open loop; "
            f"trusted although {FAR:g} points below: {len(wrong)}" + (f" ({', '.join(wrong)})" if wrong else "")
        )
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--mirror", type=Path, required=True, metavar="DIR", help="folder of git directories owner+name"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help=f"of {', '.join(log.name for log in LOGS)}")
    parser.add_argument(
        "--cache", type=Path, default=CACHE, metavar="FILE", help=f"denominators of the anchor; {CACHE}"
    )
    arguments = parser.parse_args()
    logs = [log for log in LOGS if not arguments.only or log.name in arguments.only]
    unknown = set(arguments.only or ()) - {log.name for log in logs}
    if unknown:
        parser.error(f"no such log: {', '.join(sorted(unknown))}")
    missing = how_to_clone(arguments.mirror, logs)
    if missing:
        print("repositories are missing:", *missing, sep="\n  ", file=sys.stderr)
        return 2
    cache = json.loads(arguments.cache.read_text()) if arguments.cache.exists() else {}
    arguments.cache.parent.mkdir(parents=True, exist_ok=True)
    print(
        "log                  samples poles/zeros loop   anchor      fit  behind verdict           run  behind verdict"
    )
    rows = []
    for log in logs:
        rows.append(measured(log, read(arguments.mirror, log), cache))
        print(rows[-1], flush=True)
        arguments.cache.write_text(json.dumps(cache))
    print(*totals(rows), sep="\n")
    return 0
