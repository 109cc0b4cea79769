"""The bits of an estimate do not depend on how many threads BLAS may have."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from support.waiting import PATIENCE

SCRIPT = """
import hashlib, numpy as np, replant as rp

def bits(*arrays):
    return hashlib.sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)).hexdigest()[:12]

DT, N = 0.02, 14000
rng = np.random.default_rng(2)
u = np.repeat(rng.choice([-1.0, 1.0], (N // 40, 2)), 40, axis=0)
plants = [rp.TransferFunction([2.0, 6.0], [1.0, 2.0, 5.0]), rp.TransferFunction([1.0, 6.0], [1.0, 4.0, 12.0, 8.0])]
for poles, plant in zip((2, 3), plants):
    y = plant.simulate(u[:, 0], DT)
    y[N // 2 :] *= 1.3
    y += 0.1 * rng.standard_normal(N)
    ident = rp.Identifier(poles=poles, zeros=1, dt=DT)
    trace = ident.update_many(u[:, 0], y)
    print(poles, bits(trace.parameters, trace.errors), repr(ident.assess()), bits(ident.covariance))
    ident.finish()
    found = rp.fit(u[:, 0], y, DT, poles=poles, zeros=1)
    print(poles, bits(ident.parameters, ident.covariance), bits(found.parameters, found.covariance), found.verdict)
y = sum(plant.simulate(each, DT) for plant, each in zip(plants, u.T)) + 0.1 * rng.standard_normal(N)
ident = rp.Identifier(poles=(2, 3), zeros=(1, 1), dt=DT)
ident.update_many(u[:4000], y[:4000])
found = rp.fit(u[:4000], y[:4000], DT, poles=(2, 3), zeros=(1, 1))
print(bits(ident.parameters, ident.covariance), repr(ident.assess()), bits(found.parameters, found.covariance))
print(found.verdict)
"""


@pytest.mark.slow
def test_one_and_two_threads_give_the_same_bits() -> None:
    one, two = (
        subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", SCRIPT], stdout=subprocess.PIPE, text=True,
            env=os.environ | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), threads),
        )
        for threads in ("1", "2")
    )  # fmt: skip
    said = [process.communicate(timeout=PATIENCE)[0] for process in (one, two)]
    assert one.returncode == two.returncode == 0
    assert said[0].count("\n") == 6
    assert said[0] == said[1]
