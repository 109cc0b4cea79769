"""Settings as plain JSON, and the two files of a checkpoint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from replant.errors import MissingCheckpointError
from replant.estimation.optimizers.optimizer import Replay
from replant.model.structure import Structure
from replant.online.checkpoint.files import previous, read, write
from replant.online.checkpoint.settings_json import from_plain, to_plain


def test_settings_in_plain_words() -> None:
    assert to_plain("replay", Replay(seed=3)) == {
        "Replay": {"capacity": 20000, "batch_size": 20, "warmup": 20, "seed": 3}
    }
    assert to_plain("limits", (0.5, np.inf)) == {"tuple": [0.5, {"float": "inf"}]}
    plain = {"Structure": {"poles": 2, "zeros": 1, "delay": 0.0, "bias": False, "feedthrough": False}}
    assert from_plain(plain) == Structure(2, 1)


def test_the_checkpoint_before_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "rig.replant"
    with pytest.raises(MissingCheckpointError, match="no such file"):
        read(file)
    write(file, b"first")
    write(file, b"second")
    assert (read(file), read(previous(file))) == (b"second", b"first")
    assert previous(file).name == "rig.replant.previous"
