"""The links in `latest`, for people: what the last run of each workflow made, by the names of its stages.

A stage that failed in that run, or lacked what it needs, has none; one that the run did not get to keeps those it had.

A store may come from a stranger. So folders that are links are not entered, and links that are not ours are left alone.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from pipeline.disk import close_to_others, entries_of, leads_elsewhere, make_folder

OURS = re.compile(r"\.\./\.\./objects/([0-9a-f]{64})")


class Latest:
    """The links of the store at `root`; `aside` returns new temporary paths."""

    def __init__(self, root: Path, aside: Callable[[], Path]) -> None:
        self._root = root
        self._aside = aside

    def path(self, workflow: str, name: str, output: str) -> Path:
        """Where the link of an output is, or would be."""
        return self._root / "latest" / workflow / f"{name}.{output}"

    def link(self, workflow: str, name: str, outputs: Mapping[str, str]) -> None:
        """Points `latest/<workflow>/<stage>.<output>` to the objects of a result. Raises OSError if it cannot.

        Each link is replaced atomically.
        """
        folder = self._root / "latest" / workflow
        if leads_elsewhere(self._root, "latest", workflow):
            raise OSError(errno.ELOOP, "a link; expected a folder", str(folder))
        make_folder(self._root, "latest", workflow)
        close_to_others(folder)
        for output, digest in outputs.items():
            link, target = self.path(workflow, name, output), f"../../objects/{digest}"
            if link.is_symlink() and os.readlink(link) == target:  # noqa: PTH115 — Path.readlink would normalise it
                continue
            aside = self._aside()
            aside.symlink_to(target)
            aside.replace(link)

    def digests(self) -> dict[str, str]:
        """The digest that each link `<workflow>/<stage>.<output>` leads to, whether or not it is still in the store."""
        return dict(sorted(self._found()))

    def _found(self) -> Iterator[tuple[str, str]]:
        for workflow in entries_of(self._root, "latest"):
            for entry in entries_of(self._root, "latest", workflow.name, links=True):
                digest = _digest_of(Path(entry.path))
                if digest:
                    yield f"{workflow.name}/{entry.name}", digest

    def unlink(self, name: str) -> None:
        """Removes a link, by its name in `digests`; does nothing if there is none."""
        workflow, _, last = name.partition("/")
        path = self._root / "latest" / workflow / last
        if not leads_elsewhere(self._root, "latest", workflow) and path.name == last and _digest_of(path):
            path.unlink(missing_ok=True)


def _digest_of(link: Path) -> str | None:
    """The digest that one of our links leads to; None for anything else."""
    try:
        match = OURS.fullmatch(os.readlink(link))  # noqa: PTH115 — Path.readlink would normalise it
    except OSError:
        return None
    return match[1] if match else None
