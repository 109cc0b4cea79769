"""The columns of a log beside input, output, reference and time, and which of them a first model leaves to explain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from replant.arguments import FloatArray
from replant.assessment.assess_offline import MOST_SAMPLES
from replant.assessment.other_columns import OtherColumn
from replant.data.inspection.columns import read_contents
from replant.data.logs.recording import Recording
from replant.errors import ReplantError
from replant.log import Log


def with_others(recording: Recording) -> Recording:
    r"""Return a recording whose log, if it is held in memory, has the other columns of numbers that change.

    Those of another length are left out: their rows are of other times.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from replant.data.logs import open_recording
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.csv")
    ...     _ = file.write_text("t,u,y,pump,note\n0,1,0,3,a\n1,1,1,4,b\n2,0,2,4,c\n")
    ...     recording = with_others(open_recording(file, input="u", output="y"))
    >>> recording.held.others["pump"]
    array([3., 4., 4.])
    """
    log = recording.held
    return recording if log is None else replace(recording, held=_with_others(recording, log))


def _with_others(recording: Recording, log: Log) -> Log:
    roles = {log.input_name, log.output_name, log.reference_name}
    names = recording.table.names
    if not set(names) - roles:
        return log
    contents = read_contents(recording.table)
    others = {
        column.name: contents.values[column.number]
        for column in contents.columns
        if column.is_signal and column.rows == log.input.size and column.name not in roles
        and names.count(column.name) == 1
    }  # fmt: skip
    return replace(log, others=others)


def beside_first_model(
    u: FloatArray, y: FloatArray, dt: float, delay: float, others: Mapping[str, FloatArray]
) -> tuple[OtherColumn, ...]:
    """Return the columns that explain a part of what a model of one pole leaves; none if there is no model."""
    from replant.offline.fit import fit

    if not others:
        return ()
    rows = slice(0, MOST_SAMPLES)
    shown = {name: signal[rows] for name, signal in others.items()}
    try:
        log = Log(u[rows], y[rows], dt, None, "u", "y", Path("log"), others=shown)
        return fit(log, poles=1, delay=delay, method="srivc").other_columns
    except ReplantError:
        return ()
