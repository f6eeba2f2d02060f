"""Which worker may run which stage: what there is room for now, and what no worker can ever run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.resources import Resources, resources_words


@dataclass(frozen=True)
class Worker:
    """A process that does one piece of work at a time.

    A worker of a cluster has exactly the `resources` that it was started with. The workers that a run starts itself
    share those of this machine (`shared`). If the run was not told about a resource, stages that need it still run
    there, but one at a time: a user with one GPU, or with none where a stage can do without, need not say so. `counted`
    names the resources that dask counts, too, so that two runs on one cluster respect each other.
    """

    address: str
    resources: Resources
    shared: bool = False
    counted: frozenset[str] = frozenset()

    def has_room(self, needs: Resources, beside: Sequence[Resources] = ()) -> bool:
        """Whether it can take a piece of work while others, which need `beside`, run on workers that share with it."""
        for name, wanted in needs.items():
            used = sum(other.get(name, 0.0) for other in beside)
            if used + wanted > self._amount(name, wanted):
                return False
        return True

    def _amount(self, name: str, wanted: float) -> float:
        return self.resources.get(name, wanted if self.shared else 0.0)


def place(needs: Resources, workers: Iterable[Worker], taken: Mapping[str, Resources]) -> Worker | None:
    """The worker that takes a piece of work now; None if the piece has to wait.

    `taken` holds what the work of each busy worker needs, by address.
    """
    beside = list(taken.values())
    for worker in workers:
        if worker.address not in taken and worker.has_room(needs, beside if worker.shared else ()):
            return worker
    return None


def lacking(needs: Resources, workers: Sequence[Worker]) -> str | None:
    """Why no worker could ever take a piece of work, and what each has; None if one could, once it is free."""
    if any(worker.has_room(needs) for worker in workers):
        return None
    wanted = resources_words(needs) or "a worker"
    if not workers:
        return f"needs {wanted}, but there is no worker"
    if workers[0].shared:
        return f"needs {wanted}, but this machine has {resources_words(workers[0].resources)}"
    has = "; ".join(f"{worker.address} has {resources_words(worker.resources) or 'none'}" for worker in workers)
    return f"needs {wanted}, which no worker has ({has})"
