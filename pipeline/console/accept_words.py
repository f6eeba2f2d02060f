"""What `accept` prints: which results are kept, or would be, and which cannot be."""

from __future__ import annotations

import json
from collections.abc import Iterable

from pipeline.plan.accept import Acceptance, Refusal


def print_acceptances(found: Iterable[Acceptance], dry_run: bool, as_json: bool) -> None:
    """A line for each result that is kept, or with `dry_run` would be."""
    for each in found:
        if as_json:
            names = {"event": "accept", "name": each.name, "kept": not dry_run}
            print(json.dumps({**names, "from": each.old, "key": each.record.key, "changes": each.changes}))
        else:
            print(f"{each.name}: {'would be kept' if dry_run else 'kept'} although {'; '.join(each.changes)}")


def print_refusals(refused: Iterable[Refusal], as_json: bool) -> None:
    """A line for each result that cannot be kept, and why."""
    for refusal in refused:
        if as_json:
            print(json.dumps({"event": "accept", "name": refusal.name, "kept": False, "refused": refusal.reasons}))
        else:
            print(refusal)
