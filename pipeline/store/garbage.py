"""What nobody needs any more in a store, and its deletion.

Everything is kept that a rerun of the kept runs would look up, so that it finds all of it:

- for each workflow, the results of its last N whole runs, and of all runs since the oldest of these; runs of only some
  stages, and interrupted ones, are kept but do not count;
- the last result of each stage of these runs, with everything that it was made from, however old;
- pinned results, and those younger than a given age;
- results that no run can make again, such as keys;
- damaged data that was set aside, as long as a kept run needs it and it was not made again, and the sound artifacts of
  a record that was set aside: they may be all that is left of a result that no run can make again.

Checkpoints are kept as long as a kept run may resume from them, and otherwise for `CHECKPOINT_DAYS`; an empty folder of
an action is not a checkpoint. The names of external files that results were made from are kept with these only, since
they may reveal a message. What can be computed again is kept for `CACHE_DAYS` after its last use.

The order of deletion leaves a valid store wherever it breaks off: links first, then records, then the artifacts that no
record names any more. What an interrupted deletion leaves behind goes the next time.

No lock shows which runs elsewhere use a bucket. So everything put there within a day stays, whether or not anything
refers to it.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property, partial
from pathlib import Path

from pipeline.disk import entries_of, size_of
from pipeline.errors import UserError
from pipeline.store.damaged import ACTIONS, FOREIGN, OBJECTS, name_in_damaged
from pipeline.store.listable import refuse_unlisted
from pipeline.store.record import Record, newest_makers
from pipeline.store.store import Store
from pipeline.store.temporary import left_behind

CHECKPOINT_DAYS = 14.0
CACHE_DAYS = 30.0
JOURNALS_KEPT = 20  # for each workflow, at least: `explain` and `status` use them
DAY = 86400.0  # seconds


@dataclass(frozen=True)
class Rules:
    """What to keep: at least the last `keep_last` runs of each workflow, and results younger than `older_than` days.

    Runs of the workflows `forgotten` no longer count, and nothing about their files is remembered.
    """

    keep_last: int = 3
    older_than: float = 0.0
    forgotten: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Waste:
    """Things to be deleted: `what` they are in words, their workflow and stage if known, and their size in bytes."""

    what: str
    number: int
    size: int
    workflow: str = ""
    stage: str = ""


@dataclass(frozen=True)
class Collection:
    """What a collection would delete, how many results it keeps, and remarks on what stays and why."""

    waste: tuple[Waste, ...]
    results_kept: int
    remarks: tuple[str, ...]
    _steps: tuple[Callable[[], None], ...] = field(repr=False, default=())

    @property
    def size(self) -> int:
        """Bytes to be freed."""
        return sum(waste.size for waste in self.waste)

    def delete(self) -> None:
        """Deletes the waste. The store must have been held alone (`in_use`) since before the collection was made."""
        for step in self._steps:
            step()


def collect(store: Store, rules: Rules) -> Collection:
    """Finds what can be deleted, and deletes nothing. Runs may use the store meanwhile, unless `delete` follows.

    Raises UserError for a pin or a record that cannot be read: nobody knows what it was to keep.
    """
    return _Collector(store, rules).collection()


class _Collector:
    def __init__(self, store: Store, rules: Rules) -> None:
        self.store = store
        self.rules = rules
        self.now = time.time()
        self.actions = store.actions
        self.objects = store.objects
        self.young = store.young  # listed last, so that it covers all that is listed above
        self.records = {record.key: record for record in store.records()}
        self.makers = newest_makers(self.records.values())
        self.links = store.latest_digests()
        self.workflows = [name for name in store.history.workflows() if name not in rules.forgotten]
        self.wanted: frozenset[str] = frozenset()
        self.gone: set[str] = set()
        self.begun: set[str] = set()
        self.named: dict[str, set[str]] = {}
        self.old_journals: dict[str, int] = {}
        self.waste: list[Waste] = []
        self.remarks: list[str] = []
        self.steps: list[Callable[[], None]] = []

    def collection(self) -> Collection:
        kept = self.kept_keys()
        digests = {digest for key in kept for digest in self.records[key].outputs.values()} | self.of_damaged_records()
        self.drop_links(digests)
        self.drop_records(kept)
        self.drop_objects(digests)
        self.drop_checkpoints()
        self.drop_the_rest(kept)
        self.remarks += self.store.remarks
        return Collection(tuple(self.waste), len(kept), tuple(self.remarks), tuple(self.steps))

    def kept_keys(self) -> set[str]:
        refuse_unlisted(self.store.root, ("runs", "latest", "pins"))
        unreadable = self.actions - self.records.keys()
        if unreadable:
            raise UserError(
                f"{len(unreadable)} records cannot be read, such as {min(unreadable)[:12]}",
                where=self.store.address,
                remedy="Nothing was deleted. Run `verify` first, which sets damaged records aside.",
            )
        wanted: set[str] = set()
        for workflow in self.workflows:
            wanted |= self.of_workflow(workflow)
        for name in self.store.pins.names:
            pin = self.store.pins.read(name)
            self.remarks.append(f"pin {name}: {len(pin.keys)} results of {pin.workflow}")
            wanted |= set(pin.keys.values())
        wanted |= {key for key, record in self.records.items() if self.age(record) < self.rules.older_than * DAY}
        wanted |= self.young.actions
        self.wanted = frozenset(wanted)
        if self.young.actions or self.young.objects:
            self.remarks.append("what was stored within the last day: a run on another machine may be about to use it")
        return self.with_what_made(self.linked(), wanted & self.records.keys()) | self.irreplaceable()

    def irreplaceable(self) -> set[str]:
        """Results that no run can make again, such as keys.

        Neither what they were made from nor what was made with them is included: that can be made again.
        """
        found = {
            key
            for key, record in self.records.items()
            if record.unrepeatable and record.workflow not in self.rules.forgotten
        }
        if found:
            self.remarks.append(f"{len(found)} that cannot be made again, such as keys; what was made with them can be")
        return found

    def of_workflow(self, workflow: str) -> set[str]:
        """Keys that the last runs of a workflow used, and those of the last results of their stages."""
        counted = 0
        newest_is_whole = False
        keys: set[str] = set()
        stages: set[str] = set()
        found: set[str] = set()
        sizes = self.store.entries(f"runs/{workflow}")
        for number, journal in enumerate(self.store.history.journals(workflow)):
            run = self.store.history.read(journal)
            made = {name: str(result.key) for name, result in run.results.items() if result.outputs}
            for result in run.results.values():
                self.named.setdefault(str(result.key), set()).update(result.outputs.values())
            if counted < self.rules.keep_last:
                counted += run.whole
                newest_is_whole |= number == 0 and run.whole
                stages |= run.results.keys()
                self.begun |= run.began
                keys |= {*made.values(), *run.began}  # a worker may finish what a run that was killed began
            else:
                last = {key for name, key in made.items() if name in stages - found}
                keys |= last
                if number >= JOURNALS_KEPT and not last:
                    name = f"runs/{workflow}/{journal.name}"
                    self.old_journals[name] = sizes.get(name, 0)
            found |= made.keys()
        if newest_is_whole:
            linked = {name for name in self.links if name.startswith(f"{workflow}/")}
            self.gone |= {name for name in linked if name.partition("/")[2].rpartition(".")[0] not in stages}
        runs = f"the last {counted} full runs" if counted > 1 else "the last full run" if counted else "all runs"
        self.remarks.append(f"{workflow}: {runs}, everything since, and the last result of each stage")
        return keys

    def linked(self) -> set[str]:
        """The artifacts that `latest` leads to, whatever the journals say: lines of these can be lost.

        Leaves out those of stages that the workflow no longer has, if its newest run was a whole one.
        """
        return {
            digest
            for name, digest in self.links.items()
            if name not in self.gone and name.partition("/")[0] not in self.rules.forgotten
        }

    def with_what_made(self, digests: set[str], wanted: set[str]) -> set[str]:
        """`wanted`, and the actions that made `digests` and everything that these actions took.

        If several made the same artifact, it is one of `wanted`, or else the newest.
        """
        kept = set(wanted)
        made = {digest for key in kept for digest in self.records[key].outputs.values()}
        queue = [*digests, *(digest for key in kept for digest in self.records[key].taken)]
        while queue:
            digest = queue.pop()
            maker = self.makers.get(digest)
            if maker and digest not in made:
                kept.add(maker.key)
                made.update(maker.outputs.values())
                queue += maker.taken
        return kept

    def of_damaged_records(self) -> set[str]:
        """The artifacts of records that were set aside and stay, which no other record may name.

        Of a record that cannot be read, those that journals name; if none does, all that no record names.
        """
        found: set[str] = set()
        for name, record in self.damaged_records.items():
            if not self.is_done_with(name):
                named = self.named.get(name_in_damaged(name))
                found |= {*record.outputs.values()} if record else named or self.objects - self.makers.keys()
        return found

    @cached_property
    def damaged_records(self) -> dict[str, Record | None]:
        """The records that were set aside, by their names in the store; None if one cannot be read."""
        return {name: self.store.damaged.record(name) for name in self.store.entries(f"damaged/{ACTIONS}")}

    def drop_links(self, digests: set[str]) -> None:
        for name, digest in self.links.items():
            if digest not in digests or name.partition("/")[0] in self.rules.forgotten:
                self.steps.append(partial(self.store.unlink_latest, name))

    def drop_records(self, kept: set[str]) -> None:
        dropped = sorted(self.actions - kept)
        if dropped:
            size = sum(self.store.sizes_of_records(dropped).values())
            self.waste.append(Waste("records of how they were made", len(dropped), size))
            self.steps += [partial(self.store.delete_record, key) for key in dropped]

    def drop_objects(self, digests: set[str]) -> None:
        numbers: Counter[tuple[str, str]] = Counter()
        sizes: Counter[tuple[str, str]] = Counter()
        dropped = sorted(self.objects - digests - self.young.objects)
        bytes_of = self.store.sizes_of_objects(dropped)
        for digest in dropped:
            self.steps.append(partial(self.store.delete_object, digest))
            maker = self.makers.get(digest)
            group = (maker.workflow, maker.name) if maker else ("", "")
            numbers[group] += 1
            sizes[group] += bytes_of[digest]
        for workflow, stage in sorted(numbers):
            what = "artifacts" if stage else "artifacts that no record names"
            group = (workflow, stage)
            self.waste.append(Waste(what, numbers[group], sizes[group], workflow, stage))

    def drop_checkpoints(self) -> None:
        dropped: dict[str, int] = {}
        empty: dict[str, int] = {}
        for folder in [Path(entry.path) for entry in entries_of(self.store.root, "scratch")]:
            if _is_empty(folder):
                empty[f"scratch/{folder.name}"] = 0
                continue
            done = self.store.find(folder.name) is not None  # a record alone does not count: its artifacts may be gone
            days = (self.now - _newest(folder)) / DAY
            if not done and folder.name in self.begun:
                self.remarks.append(f"checkpoint {folder.name[:8]}: a kept run began it and may resume from it")
            elif not done and days < CHECKPOINT_DAYS:
                goes = f"deleted after {CHECKPOINT_DAYS:.0f} days"
                self.remarks.append(f"checkpoint {folder.name[:8]}: unfinished work, {days:.0f} days old; {goes}")
            else:
                dropped[f"scratch/{folder.name}"] = size_of(folder)
        self.drop("checkpoints that nothing resumes from", dropped)
        self.drop("empty folders of work that left no checkpoint", empty)

    def drop_the_rest(self, kept: set[str]) -> None:
        known = {*self.workflows, *(name.partition("/")[0] for name in self.links)}
        codes = {str(self.records[key].parts.get("code")) for key in kept}
        self.drop_leftovers()
        self.drop("damaged, and made again or no longer needed", self.damaged(kept))
        self.drop("journals of old runs", self.old_journals)
        self.drop("workflows' histories", self.entries("runs", lambda name: name in self.rules.forgotten))
        self.drop("workflows' logs", self.entries("logs", lambda name: name not in known - self.rules.forgotten))
        self.drop("lists of code", self.entries("code", lambda name: name.removesuffix(".json") not in codes))
        self.drop("lists of files outside the store, by name", self.listings(kept))
        self.drop("cached data that was not used recently", self.cached())
        self.drop("incomplete uploads and copies of what is deleted", self.store.abandoned())

    def listings(self, kept: set[str]) -> dict[str, int]:
        """Lists of files that no kept result was made from; the next plan writes those that it reads again."""
        named = {digest for key in kept for group in self.records[key].external.values() for digest in group}
        return self.here("external", lambda path: path.stem not in named)

    def cached(self) -> dict[str, int]:
        """What to delete from the cache. It does not say whose files it names: forgetting one workflow deletes all
        names.
        """

        def is_old(path: Path) -> bool:
            status = path.lstat()
            return self.now - max(status.st_atime, status.st_mtime) > CACHE_DAYS * DAY

        def is_old_or_names_files(path: Path) -> bool:
            return bool(self.rules.forgotten) or is_old(path)

        files = self.here("cache/external", is_old_or_names_files)
        return files | self.here("cache/declarations", is_old_or_names_files) | self.here("cache/sources", is_old)

    def here(self, folder: str, goes: Callable[[Path], bool]) -> dict[str, int]:
        """Like `entries`, for a folder that is never in a bucket."""
        found = [Path(entry.path) for entry in entries_of(self.store.root, *folder.split("/"))]
        return {f"{folder}/{path.name}": size_of(path) for path in found if goes(path)}

    def damaged(self, kept: set[str]) -> dict[str, int]:
        """What to delete of the damaged data. Needed data stays: a copy may turn up, or part of it may be readable."""
        sizes = self.store.entries(f"damaged/{ACTIONS}")
        records = {name: sizes[name] for name in self.damaged_records if self.is_done_with(name)}
        left = self.damaged_records.keys() - records.keys()
        told = [self.damaged_records[name] for name in left]
        needed = {digest for record in told if record for digest in record.outputs.values()}
        needed |= {digest for key in kept for digest in self.records[key].outputs.values()}

        def goes(name: str) -> bool:
            digest = name_in_damaged(name)
            return digest in self.objects or (digest not in needed and None not in told)

        objects = self.entries(f"damaged/{OBJECTS}", goes)
        stays = len(left) + len(self.store.entries(f"damaged/{OBJECTS}")) - len(objects)
        if stays:
            self.remarks.append(f"{stays} damaged in {self.store.damaged.folder}: needed, and not made again yet")
        return records | objects | self.store.entries(f"damaged/{FOREIGN}")

    def is_done_with(self, name: str) -> bool:
        """Whether a damaged record can go: its action was done again, or nothing needs it and it can be done again.

        One that cannot be read may be of a result that no run can make again.
        """
        key, record = name_in_damaged(name), self.damaged_records[name]
        return key in self.actions or (record is not None and key not in self.wanted and not record.unrepeatable)

    def entries(self, folder: str, goes: Callable[[str], bool]) -> dict[str, int]:
        """What to delete from a folder of the store: names, and sizes in bytes."""
        found = self.store.entries(folder)
        return {name: size for name, size in found.items() if goes(name.removeprefix(f"{folder}/"))}

    def drop_leftovers(self) -> None:
        """Schedules the removal of what ended processes left in `temporary`; every run removes it, too."""
        left = left_behind(self.store.root / "temporary")
        if left:
            self.waste.append(Waste("leftovers of interrupted work", len(left), sum(map(size_of, left))))
            self.steps.append(self.store.sweep)

    def drop(self, what: str, entries: Mapping[str, int]) -> None:
        """Schedules the deletion of entries of the store, given as names and sizes in bytes."""
        if entries:
            self.waste.append(Waste(what, len(entries), sum(entries.values())))
            self.steps += [partial(self.store.delete_entry, name) for name in entries]

    def age(self, record: Record) -> float:
        """Seconds since an action began; infinite if its record does not say."""
        try:
            return self.now - datetime.fromisoformat(str(record.provenance["started"])).timestamp()
        except (KeyError, ValueError):
            return float("inf")


def _is_empty(folder: Path) -> bool:
    """Whether the folder of an action is empty; False if it cannot be read."""
    try:
        return not any(folder.iterdir())
    except OSError:
        return False


def _newest(folder: Path) -> float:
    """When anything in a folder was last written, in seconds since 1970."""
    paths = [folder, *(Path(place, name) for place, names, files in os.walk(folder) for name in (*names, *files))]
    return max(map(_written, paths))


def _written(path: Path) -> float:
    """When something was last written; now if a run has just replaced it."""
    try:
        return path.lstat().st_mtime
    except FileNotFoundError:
        return time.time()
