"""What a stage's author has to say of results that are made, though nothing failed: photos that were left out, say.

The function that says it is named by a text, and imported only when there is a result: so it is no part of the stage's
code, and better words make nobody's results run again.
"""

from __future__ import annotations

from importlib import import_module

from pipeline.stage import Finished, Remark, Stage


def remarks_on(declared: Stage, finished: Finished) -> tuple[Remark, ...]:
    """The remarks of a stage that declares some on what it has just made. Raises whatever their function raises."""
    if declared.remarks is None:
        return ()
    module, _, function = declared.remarks.partition(":")
    return tuple(getattr(import_module(module), function)(finished))
