"""Which worker may take which stage: what fits together, and what no worker can ever take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.resources import Resources, resources_words


@dataclass(frozen=True)
class Worker:
    """A process that does one piece of work at a time.

    A worker of a cluster has the `resources` that it was started with, and no others. The workers that a run starts
    itself share those of this machine (`shared`); where a run was not told of a resource, such stages may run there,
    but one at a time: who has one GPU, or none where a stage can do without, need not say so. `counted` are the names
    that dask counts, too, so that two runs on one cluster respect each other.
    """

    address: str
    resources: Resources
    shared: bool = False
    counted: frozenset[str] = frozenset()

    def has_room(self, needs: Resources, beside: Sequence[Resources] = ()) -> bool:
        """Whether it can take a piece while others run `beside`: on this worker and those that share with it."""
        for name, wanted in needs.items():
            used = sum(other.get(name, 0.0) for other in beside)
            if used + wanted > self._amount(name, wanted):
                return False
        return True

    def _amount(self, name: str, wanted: float) -> float:
        return self.resources.get(name, wanted if self.shared else 0.0)


def place(needs: Resources, workers: Iterable[Worker], taken: Mapping[str, Resources]) -> Worker | None:
    """The worker that takes a piece now; `taken` says what each worker does, by address. None where it has to wait."""
    beside = list(taken.values())
    for worker in workers:
        if worker.address not in taken and worker.has_room(needs, beside if worker.shared else ()):
            return worker
    return None


def lacking(needs: Resources, workers: Sequence[Worker]) -> str | None:
    """Why no worker could ever take a piece, and what each has; None where one could, once it is free."""
    if any(worker.has_room(needs) for worker in workers):
        return None
    wanted = resources_words(needs) or "a worker"
    if not workers:
        return f"needs {wanted}, and there is no worker"
    if workers[0].shared:
        return f"needs {wanted}, and this machine has {resources_words(workers[0].resources)}"
    has = "; ".join(f"{worker.address} has {resources_words(worker.resources) or 'none'}" for worker in workers)
    return f"needs {wanted}, which no worker has ({has})"
