"""Measures the engine's cost for 1,000 pairs of `workflows/batch_pairs.yaml`, 14,001 stages, without running any.

    python -m tests.benchmarks.engine [PAIRS]

Every pair has its own cover and message, so nothing is shared. Whole commands are measured, as started from a shell:
a plan with nothing done yet; then, with made-up results in the store (a few small files each), `status`, a run that
finds everything done, and `explain` of a thousand stages. `cpu` is the processor time of the process itself, which
other programs on the machine do not affect.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from pipeline.console.project import open_project
from pipeline.manifest import FileRecord, Manifest
from pipeline.plan.keys import key_of, key_parts
from pipeline.provenance import machine
from pipeline.stage import output_is_private
from pipeline.store.checksummed import with_checksum
from pipeline.store.history import StageResult
from pipeline.store.opening import open_store
from pipeline.store.record import RECORD, Record
from pipeline.store.store import Store
from pipeline.workflow.graph import Node, Source

WORKFLOW = Path(__file__).parents[2] / "workflows" / "batch_pairs.yaml"
FILES = {f"part{number}": b"what a stage made" for number in range(3)}
RECORDS = {name: FileRecord(len(data), hashlib.sha256(data).hexdigest()) for name, data in FILES.items()}


@dataclass(frozen=True)
class Cost:
    """Cost of one command: wall-clock seconds, CPU seconds, and peak memory in MB."""

    seconds: float
    cpu: float
    memory: float


def main() -> None:
    pairs = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory(prefix="gs-hider-benchmark-") as name:
        folder = Path(name)
        table = write_pairs(folder, pairs)
        small = write_pairs(folder / "one", 1)
        open_store(folder / "store")  # a plan creates no store, and caches nothing without one
        for pairs_file in (small, table):  # the first imports the stages, and torch with them, and caches that
            cost("run", folder / "store", pairs_file, "--dry-run")
        nothing = cost("run", folder / "store", small, "--dry-run")
        plan = cost("run", folder / "store", table, "--dry-run")
        stages = fill(folder / "store", table)
        print(f"{pairs} pairs, {stages} stages")
        told("plan, nothing done", plan, stages, nothing)
        told("status, all cached", cost("status", folder / "store", table), stages, nothing)
        told("run, all cached", cost("run", folder / "store", table), stages, nothing)
        told("explain every hide", cost("explain", folder / "store", table, "hide"), stages, nothing)


def write_pairs(folder: Path, pairs: int) -> Path:
    """Write a CSV of pairs, and a folder with one file for each cover and each message. Returns the CSV's path."""
    rows = ["cover,message"]
    for number in range(pairs):
        names = [f"photos/cover{number:04d}", f"photos/message{number:04d}"]
        rows.append(",".join(names))
        for name in names:
            (folder / name).mkdir(parents=True)
            (folder / name / "photo.jpg").write_text(name)
    table = folder / "pairs.csv"
    table.write_text("\n".join([*rows, ""]))
    return table


def cost(command: str, store: Path, table: Path, *arguments: str) -> Cost:
    """Run a command, discard its output and return its cost. Raises RuntimeError if it fails."""
    words = [sys.executable, "-m", "pipeline", command, str(WORKFLOW), "--store", str(store), "--set", f"pairs={table}"]
    started = time.monotonic()
    process = subprocess.Popen([*words, *arguments], stdout=subprocess.DEVNULL, cwd=WORKFLOW.parents[1])
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"{command} ended with status {os.waitstatus_to_exitcode(status)}")
    return Cost(time.monotonic() - started, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def told(what: str, cost: Cost, stages: int, nothing: Cost) -> None:
    each = 1000 * (cost.cpu - nothing.cpu) / stages
    ratio = cost.cpu / nothing.cpu
    print(
        f"{what:20} {cost.seconds:6.2f} s, cpu {cost.cpu:6.2f} s, {cost.memory:4.0f} MB; "
        f"{each:.3f} ms a stage, {ratio:.1f} times a plan of one pair"
    )


def fill(folder: Path, table: Path) -> int:
    """Make up a result for every stage. Returns the number of stages."""
    project = open_project(WORKFLOW, folder, [f"pairs={table}"])
    store, digests = project.store, dict[Source, str | None]()
    journal = store.history.begin(project.graph.workflow)
    for number, node in enumerate(project.graph.nodes.values()):
        parts = key_parts(node, digests)
        outputs = {
            name: make_up(store, output.kind, output_is_private(output, False, node.private), f"{number} {name}")
            for name, output in node.declaration.outputs.items()
        }
        digests |= {Source(node.name, name): digest for name, digest in outputs.items()}
        record = Record(key_of(parts), parts, outputs, provenance(node))
        write_record(store, record)
        journal.add(StageResult(node.name, "ran", record.key, outputs, 1.0))
    journal.close()
    return len(project.graph.nodes)


def provenance(node: Node) -> dict[str, object]:
    return {
        "name": node.name,
        "workflow": "batch_pairs",
        "upstream": list(node.upstream),
        "started": "2026-01-01T00:00:00+00:00",
        "seconds": 1.0,
        "versions": dict.fromkeys(node.code.libraries, "1.0"),
        "machine": machine(),
        "facts": {},
        "commit": None,
        "private": node.private,
    }


def make_up(store: Store, kind: str, private: bool, text: str) -> str:
    """Write a unique artifact, not safe against power cuts. Returns its digest."""
    manifest = Manifest(kind, private, {"made_up": text}, {}, RECORDS)
    path = store.folder("objects") / manifest.digest
    path.mkdir()
    for name, data in FILES.items():
        (path / name).write_bytes(data)
    manifest.write(path)
    return manifest.digest


def write_record(store: Store, record: Record) -> None:
    folder = store.folder("actions", record.key)
    content = {"key": record.key, "parts": record.parts, "outputs": record.outputs, "provenance": record.provenance}
    (folder / RECORD).write_text(with_checksum(content))


if __name__ == "__main__":
    main()
