"""What a run is about to do that a person may not expect, said before it spends hours.

After an update of this program, a run repeats everything that differs only in its code. That gives other bits, and
other keys to everything made from them; the earlier results can only be kept before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pipeline.plain_text import listed
from pipeline.plan.accept import is_acceptable
from pipeline.plan.loss import NOT_READ, is_read
from pipeline.plan.plan import Step
from pipeline.workflow.graph import Graph

SHOWN = 4  # names of stages


def foretold(graph: Graph, steps: Mapping[str, Step]) -> Iterator[str]:
    """What a run would repeat only because code changed, and what unrepeatable results it may make anew."""
    code = [name for name, step in steps.items() if is_acceptable(step) and step.state != "refused"]
    if code:
        kept = "to keep the earlier results, stop this run and `accept` the workflow, with the same settings"
        yield f"running again although only code changed: {listed(code, SHOWN)}; {kept}"
    unrepeatable = [name for name, node in graph.nodes.items() if node.unrepeatable and is_read(name, graph)]
    waiting = [name for name in unrepeatable if steps[name].state == "depends"]
    if waiting:
        yield f"{listed(waiting, SHOWN)}: made anew if the inputs turn out different; {NOT_READ}"
