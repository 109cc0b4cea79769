"""Interrupts: KeyboardInterrupt raised where the interpreter looks for signals, at an instant that can be repeated."""

from __future__ import annotations

import dis
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

#: After these the interpreter looks whether a signal came.
LOOKS = {code for name, code in dis.opmap.items() if name.startswith("CALL") or name in ("RESUME", "JUMP_BACKWARD")}


def interrupt(work: Callable[[], Any], after: int) -> bool:
    """Do some work, and raise KeyboardInterrupt at the ``after``-th instant; return whether it came so far."""
    seen = 0
    newest: dict[FrameType, int] = {}

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal seen
        if event == "call":
            if "/replant/" not in frame.f_code.co_filename.replace("\\", "/"):
                return None
            frame.f_trace_lines, frame.f_trace_opcodes = False, True
        elif event == "opcode":
            seen += newest.get(frame) in LOOKS
            newest[frame] = frame.f_code.co_code[frame.f_lasti]
            if seen == after:
                seen += 1
                newest.clear()
                raise KeyboardInterrupt
        elif event == "return":
            newest.pop(frame, None)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False
