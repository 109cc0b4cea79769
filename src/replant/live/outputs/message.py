"""Estimate: what goes out to controllers and plots, one flat JSON object a message."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

from replant.arguments import FloatArray


@dataclass(frozen=True, eq=False)
class Estimate:
    """The estimate after a sample, with the newest verdict and standard deviations known.

    Attributes
    ----------
    timestamp : float
        Rig time of the sample in s.
    sequence : int or None
        Its number, where the device gives one.
    samples : int
        Accepted samples so far.
    names : tuple of str
    parameters : (P,) array
        NaN until the first model is there.
    std : (P,) array
        Standard deviations; they and the verdict are as of a moment (tenths of a second) before the sample.
    status : {"starting", "running", "diverged"}
    verdict : str

    Examples
    --------
    >>> import numpy as np
    >>> known = np.array([2.128]), np.array([0.056])
    >>> Estimate(0.5, None, 25, ("a0",), *known, "running", "trusted").as_json()
    b'{"timestamp":0.5,"samples":25,"a0":2.128,"std_a0":0.056,"trusted":1,"status":"running","verdict":"trusted"}'
    """

    timestamp: float
    sequence: int | None
    samples: int
    names: tuple[str, ...]
    parameters: FloatArray
    std: FloatArray
    status: str
    verdict: str

    def as_json(self) -> bytes:
        """Return one line of JSON without its end: numbers under names of one level, unknown ones null."""
        fields: dict[str, float | int | str | None] = {"timestamp": self.timestamp}
        if self.sequence is not None:
            fields["sequence"] = self.sequence
        fields["samples"] = self.samples
        for prefix, values in (("", self.parameters), ("std_", self.std)):
            for name, value in zip(self.names, values.tolist(), strict=True):
                fields[prefix + name] = value if math.isfinite(value) else None
        fields["trusted"] = int(self.verdict == "trusted")
        fields["status"] = self.status
        fields["verdict"] = self.verdict
        return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()
