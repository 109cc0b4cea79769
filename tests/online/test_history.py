"""Raw samples kept: there is room for as many as there are, and the room is part of the state."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.engine.dimensions import FIRST_ROOM, STORED, room_for

DT = 0.1


def record(samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 10 + 1), 10)[:samples]
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, DT)
    return u, y + 0.05 * rng.standard_normal(samples)


def test_there_is_room_for_the_samples_and_at_most_as_many_again() -> None:
    u, y = record(STORED + 5000)
    ident = rp.Identifier(poles=1, dt=DT)
    for end in (400, 600, FIRST_ROOM - 1, FIRST_ROOM, FIRST_ROOM + 1, 5000, STORED - 1, STORED, u.size):
        begin = ident.samples
        ident.update_many(u[begin:end], y[begin:end])
        rows = len(ident._state.recent)
        assert rows == room_for(end - 1, STORED) or rows == room_for(end, STORED)
        assert min(end, STORED) <= rows <= max(2 * end, FIRST_ROOM)
    np.testing.assert_allclose(ident.recent[:, 0], u[-len(ident.recent) :], atol=1e-12)


def test_the_room_does_not_depend_on_how_the_samples_come() -> None:
    u, y = record(FIRST_ROOM + 10)
    chunk, single = rp.Identifier(poles=1, dt=DT), rp.Identifier(poles=1, dt=DT)
    chunk.update_many(u, y)
    for sample in zip(u.tolist(), y.tolist(), strict=True):
        single.update(*sample)
    assert chunk.to_bytes() == single.to_bytes()


def test_a_long_start_up_has_room_as_well() -> None:
    u, y = record(3000)
    ident = rp.Identifier(poles=1, dt=DT, startup=2500)
    ident.update_many(u[:2400], y[:2400])
    assert (ident.status, len(ident._state.recent)) == ("starting", 4096)
    again = rp.Identifier.from_bytes(ident.to_bytes())
    for one in (ident, again):
        one.update_many(u[2400:], y[2400:])
    assert ident.status == "running"
    assert again.to_bytes() == ident.to_bytes()
