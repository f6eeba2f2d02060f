"""Plans and graphs as the command line prints them: lines for people, JSON for programs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping

from pipeline.console.wording import duration
from pipeline.drawing import Box, Tone
from pipeline.plain_text import in_a_line
from pipeline.plan.plan import Step
from pipeline.workflow.graph import Node

MOST_OF_A_CAUSE = 160
"""Characters shown of the cause of a failure; `explain` shows all of it."""

STATES = {
    "cached": "cached",
    "running": "running now",
    "run": "to run",
    "depends": "depends",
    "shared": "shared",
    "lost": "lost",
    "refused": "to accept",
}


def print_plan(steps: Mapping[str, Step], as_json: bool) -> None:
    """Prints a line for each step, and unless `as_json` a summary."""
    width = max((len(name) for name in steps), default=0)
    for name, step in steps.items():
        if as_json:
            print(json.dumps(_step_as_json(step)))
        else:
            print(f"{name:{width}}  {_state_words(step)}")
    if not as_json:
        print(_summary(steps))


def _summary(steps: Mapping[str, Step]) -> str:
    """How many steps are in each state, and how long the cached results took to make; a shared one counts once."""
    counts = Counter(step.state for step in steps.values())
    words = ", ".join(f"{number} {STATES[state]}" for state, number in sorted(counts.items()))
    seconds = {step.key: step.result.seconds for step in steps.values() if step.result}
    return f"{words}; the cached results took {duration(sum(seconds.values()))}" if seconds else words


def _state_words(step: Step) -> str:
    if step.result:
        words = f"{STATES[step.state]}  {duration(step.result.seconds)}"
    else:
        words = f"{STATES[step.state]}  {'; '.join(step.reasons)}"
    return f"{words} ({in_a_line(step.failed_before, MOST_OF_A_CAUSE)})" if step.failed_before else words


def _step_as_json(step: Step) -> dict[str, object]:
    return {
        "event": "plan",
        "name": step.name,
        "state": step.state,
        "key": step.key,
        "reasons": step.reasons,
        "seconds": step.result.seconds if step.result else None,
        "failed": step.failed,
    }


def node_as_json(node: Node) -> dict[str, object]:
    """A node as `graph --json` prints it."""
    return {
        "event": "node",
        "name": node.name,
        "uses": node.uses,
        "inputs": {name: [f"{s.node}.{s.output}" for s in sources] for name, sources in node.sources.items()},
        "outputs": {name: output.kind for name, output in node.declaration.outputs.items()},
        "private": node.private,
    }


def box(node: Node, step: Step) -> Box:
    """A node in a drawing of the graph."""
    lines = (node.uses, duration(step.result.seconds)) if step.result else (node.uses,)
    private = node.private or (step.result is not None and step.result.private)
    refused = step.state in ("lost", "refused")
    tone: Tone = "private" if private else "done" if step.result else "failed" if refused else "plain"
    return Box(node.name, node.upstream, lines, tone)
