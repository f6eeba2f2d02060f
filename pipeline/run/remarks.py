"""What a stage has to say about a result although nothing failed, for example that photos were left out.

The function that says it is declared by its name, and imported only when there is a result. So it is not part of the
stage's code, and better wording makes no result outdated.
"""

from __future__ import annotations

from importlib import import_module

from pipeline.stage import Finished, Remark, Stage


def remarks_on(declared: Stage, finished: Finished) -> tuple[Remark, ...]:
    """The remarks of a stage on what it has just made; empty if it declares none. Raises what their function raises."""
    if declared.remarks is None:
        return ()
    module, _, function = declared.remarks.partition(":")
    return tuple(getattr(import_module(module), function)(finished))
