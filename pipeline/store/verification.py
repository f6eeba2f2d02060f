"""Whether a store still holds what was written: every byte of every artifact, every record, pin and link.

Damaged data is moved to `damaged`, so that the next run makes it again: an artifact with the records that name it, or a
record alone. A file that something else put into a sound artifact is moved there, too, and nothing has to be made again
for it. In a bucket, a sound copy on this machine takes the place of what was moved. Other processes may run meanwhile;
what they add may or may not be checked.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from pipeline.canonical import digest_of
from pipeline.errors import ArtifactError, UserError
from pipeline.store.record import Record
from pipeline.store.store import Store

MENDED = "replaced by the sound copy on this machine"
IRREPLACEABLE = "it cannot be made again; the next run that needs it says what to do"
THREADS = min(4, os.cpu_count() or 1)  # hashing releases the GIL; more threads do not read a disk faster


@dataclass(frozen=True)
class Checked:
    """One thing that was checked: `damage` says what is wrong with it, None if it is sound; `size` is in bytes.

    `stages` are the names `<workflow>/<stage>.<output>` under which an artifact was made, as far as records tell, or
    the `<workflow>/<stage>` of a record. `irreplaceable`: what is damaged cannot be made again.
    """

    what: Literal["artifact", "foreign file", "record", "pin", "link"]
    name: str
    size: int = 0
    damage: str | None = None
    stages: tuple[str, ...] = ()
    irreplaceable: bool = False


def verify_store(store: Store, dry_run: bool = False) -> Iterator[Checked]:
    """Checks everything, artifacts first, while the result is iterated; sets damage aside unless `dry_run`."""
    names = _names(store.records())
    irreplaceable = {digest for record in store.records() if record.unrepeatable for digest in record.outputs.values()}
    lost: set[str] = set()
    with ThreadPoolExecutor(THREADS) as pool:
        for checked in pool.map(partial(_artifact, store), sorted(store.objects)):
            if checked.damage and dry_run:
                lost.add(checked.name)
            elif checked.damage:
                store.set_aside(checked.name)
                mended = f"; {MENDED}" if store.holds(checked.name) else ""
                lost_for_good = not mended and checked.name in irreplaceable
                mended = mended or (f"; {IRREPLACEABLE}" if lost_for_good else "")
                checked = replace(checked, damage=f"{checked.damage}{mended}", irreplaceable=lost_for_good)
            stages = names.get(checked.name, ())
            yield replace(checked, stages=stages)
            if not checked.damage:
                yield from _foreign(store, checked.name, stages, dry_run)
    keys = sorted(store.actions)  # listed before the artifacts: those of a new record are there before it
    present = store.objects - lost
    with ThreadPoolExecutor(THREADS) as pool:
        records = list(pool.map(store.kept_record, keys))
    for key, record in zip(keys, records, strict=True):
        damage = _damage_of_record(key, record, present)
        if damage and not dry_run:  # a run may have made it again meanwhile
            damage = _damage_of_record(key, store.kept_record(key), store.objects)
        if damage and not dry_run:
            store.set_record_aside(key)
            damage += f"; {MENDED}" if store.kept_record(key) else ""
        stages = (f"{record.workflow}/{record.name}",) if record else ()
        yield Checked("record", key, damage=damage, stages=stages)
    if not dry_run:
        for key in store.put_back():
            yield Checked("record", key, damage=f"it was set aside; {MENDED}")
    yield from _pins(store)
    for name, digest in store.latest_digests().items():
        gone = digest not in present and (digest in lost or not store.holds(digest))
        if gone and not dry_run:
            store.unlink_latest(name)
        yield Checked("link", name, damage=f"leads to {digest[:8]}, which is not in the store" if gone else None)


def _artifact(store: Store, digest: str) -> Checked:
    place = store.place(digest)
    try:
        size = store.check_object(digest)
    except (ArtifactError, OSError) as error:
        if not store.holds(digest):  # another process set it aside meanwhile
            return Checked("artifact", digest)
        return Checked("artifact", digest, damage=str(error).replace(f"{place}/", "").replace(f"{place}: ", ""))
    return Checked("artifact", digest, size)


def _foreign(store: Store, digest: str, stages: tuple[str, ...], dry_run: bool) -> Iterator[Checked]:
    for name in store.foreign(digest):
        if not dry_run:
            store.set_foreign_aside(digest, name)
        damage = "not part of the artifact, which is sound; something else put it there"
        yield Checked("foreign file", f"{digest}/{name}", damage=damage, stages=stages)


def _damage_of_record(key: str, record: Record | None, present: Collection[str]) -> str | None:
    if record is None:
        return "altered since it was written"
    if digest_of(dict(record.parts)) != key:
        return "its parts do not match its key"
    for output, digest in record.outputs.items():
        if digest not in present:
            return f"its output {output} ({digest[:8]}) is damaged or gone"
    return None


def _pins(store: Store) -> Iterator[Checked]:
    for name in store.pins.names:
        try:
            store.pins.read(name)
        except UserError as error:
            yield Checked("pin", name, damage=str(error))
        else:
            yield Checked("pin", name)


def _names(records: Iterable[Record]) -> dict[str, tuple[str, ...]]:
    """The names under which each artifact was made, by digest."""
    names: dict[str, tuple[str, ...]] = {}
    for record in records:
        for output, digest in record.outputs.items():
            names[digest] = (*names.get(digest, ()), f"{record.workflow}/{record.name}.{output}")
    return names
