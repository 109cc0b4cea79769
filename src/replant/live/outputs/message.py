"""Message: an estimate as it is sent to controllers and plots, one flat JSON object each."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

from replant.arguments import FloatArray

VERSION = 1
"""Version of the layout, `schema/message-1.json`; raised where an entry changes its meaning or goes away [count]."""
UNKNOWN = "unknown"  # the verdict while none is known
LEAST_TTL = 5.0
"""Least time for which "trusted" may stand without an accepted sample: a network takes time to send again [s]."""
INTERVALS = 10  # the same in sampling times: a slow plant's samples may come ten in a message [sampling times]
#: `Estimate.status` while no sample is accepted, and when the session is over.
WAITING, ENDED = "waiting", "ended"


def time_to_live(dt: float) -> float:
    """Return the default time to live: how long "trusted" may stand without an accepted sample, in s.

    Examples
    --------
    >>> time_to_live(0.001), time_to_live(2.0)
    (5.0, 20.0)
    """
    return max(LEAST_TTL, INTERVALS * dt)


@dataclass(frozen=True, eq=False)
class EstimateMessage:
    """The estimate after a sample, with the newest verdict and the newest standard deviations.

    Attributes
    ----------
    timestamp : float
        Rig time of the sample in s.
    sequence : int or None
        Number of the sample, where the device gives one.
    samples : int
        Accepted samples so far.
    names : tuple of str
        Names of the P parameters.
    parameters : (P,) array
        NaN until there is a first model.
    std : (P,) array
        Standard deviations.  They and the verdict may be tenths of a second older than the sample; NaN and "unknown"
        where the estimate has moved since by more than they allow.
    status : {"starting", "running", "diverged", "waiting", "ended"}
        "waiting" while no sample is accepted, "ended" when the session is over.
    verdict : str
    excited : bool
        See `Assessment`; False while the verdict is not known.
    ttl : float
        Seconds from the receipt of the message for which a controller may use the model; 0: it may not.
    sent : float or None
        Unix time in s at which the message was sent; None before that.

    Examples
    --------
    >>> import numpy as np
    >>> known = np.array([2.128]), np.array([0.056])
    >>> EstimateMessage(0.5, None, 25, ("a0",), *known, "running", "trusted", True, ttl=5.0).as_json()
    b'{"schema_version":1,"timestamp":0.5,"samples":25,"a0":2.128,"std_a0":0.056,"trusted":1,"excited":1,"ttl":5.0,...'
    """

    timestamp: float
    sequence: int | None
    samples: int
    names: tuple[str, ...]
    parameters: FloatArray
    std: FloatArray
    status: str
    verdict: str
    excited: bool = False
    ttl: float = 0.0
    sent: float | None = None

    @property
    def trusted(self) -> bool:
        """Whether a controller may use the model, for `ttl` seconds."""
        return self.verdict == "trusted" and self.ttl > 0.0

    def as_json(self) -> bytes:
        """Return one line of JSON, without the line end: a flat object, in which unknown numbers are null."""
        fields: dict[str, float | int | str | None] = {"schema_version": VERSION, "timestamp": self.timestamp}
        if self.sequence is not None:
            fields["sequence"] = self.sequence
        fields["samples"] = self.samples
        for prefix, values in (("", self.parameters), ("std_", self.std)):
            for name, value in zip(self.names, values.tolist(), strict=True):
                fields[prefix + name] = value if math.isfinite(value) else None
        fields["trusted"] = int(self.trusted)
        fields["excited"] = int(self.excited)
        fields["ttl"] = self.ttl
        fields["status"] = self.status
        fields["verdict"] = self.verdict
        fields["sent"] = self.sent
        return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()
