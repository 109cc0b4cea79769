"""Provenance: what a model was made from, how, by which version, and when."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version

from replant.arguments import keep, text, whole


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from.

    Attributes
    ----------
    method : str
        "srivc", "least_squares", or the optimizer of an identifier.
    source : str
        Name of the log's file; empty for arrays and live samples.
    sha256 : str
        Digest of that file in hexadecimal; empty where it is not known.
    samples : int
        Samples that the model was made from.
    version : str
        Version of replant.
    date : str
        When the model was made, UTC in ISO 8601.  Two models that differ in nothing else are equal.

    Examples
    --------
    >>> Provenance("srivc", "motor.csv", samples=2000).source
    'motor.csv'
    """

    method: str
    source: str = ""
    sha256: str = ""
    samples: int = 0
    version: str = field(default_factory=lambda: version("replant"))
    date: str = field(default_factory=_now, compare=False)

    def __post_init__(self) -> None:
        for name in ("method", "source", "sha256", "version", "date"):
            keep(self, name, text)
        keep(self, "samples", whole, 0, 2**63 - 1)
