"""Imports of a stage's code whose changes its fingerprint would miss: a stale result would pass for a new one."""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util
import json
import sys
import sysconfig
from collections.abc import Iterator
from importlib.metadata import Distribution
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

from pipeline.code.declaration import Declaration
from pipeline.code.fingerprint import Code
from pipeline.provenance import providers

INSTALLED = {"site-packages", "dist-packages"}  # of this Python, of the system's, of a user, or of a cluster's modules


def hidden_imports(code: Code, declaration: Declaration, package: str) -> Iterator[str]:
    """What is wrong with each import in the code of a stage of `package`, in words that follow "the code"."""
    if code.dynamic and not declaration.selects_modules:
        found = ", ".join(code.dynamic)
        yield f"imports modules by computed names ({found}); name them with @stage(modules=…), or use plain imports"
    for library in code.libraries:
        if path := place_if_not_installed(library):
            found = f"imports {library} ({path}), whose changes no key would notice"
            yield f"{found}; move it into the package {package}, or install it as a library"


@functools.cache
def place_if_not_installed(library: str) -> Path | None:
    """Where a module lies that is neither Python's nor part of an installed distribution, such as a file in the
    working folder; None if there is none of that name. Nothing is imported for that.

    An editable install counts as installed. `library` is a name without dots.
    """
    if library in sys.stdlib_module_names:
        return None
    try:
        specification = importlib.util.find_spec(library)
    except ValueError:  # a module put into sys.modules by hand
        return None
    if specification is None:
        return None
    if specification.has_location:
        places = [Path(str(specification.origin))]
    else:  # built in, or a folder without __init__.py, which has no say if it only has the name of what is missing
        folders = map(Path, specification.submodule_search_locations or ())
        places = [folder for folder in folders if any(folder.rglob("*.py"))]
    return next((place for place in places if not _is_installed(library, place)), None)


def _is_installed(library: str, place: Path) -> bool:
    if not INSTALLED.isdisjoint(place.parts) or place.is_relative_to(sysconfig.get_path("stdlib")):
        return True
    return any(_holds(distribution, library, place) for distribution in importlib.metadata.distributions())


def _holds(distribution: Distribution, library: str, place: Path) -> bool:
    """Whether a module is part of a distribution outside the usual folders, or of an editable install.

    The sources of an editable install may lie among files that are not part of it: then it says what is. If it does
    not say, all of them count.
    """
    sources = _editable_sources(distribution)
    if distribution.name in providers().get(library, ()):
        home = Path(str(distribution.locate_file("")))
        return any(place.is_relative_to(folder) for folder in (home, sources) if folder)
    return bool(sources and place.is_relative_to(sources) and not distribution.read_text("top_level.txt"))


def _editable_sources(distribution: Distribution) -> Path | None:
    """The folder that an editable install was made from; None for any other distribution."""
    origin = json.loads(distribution.read_text("direct_url.json") or "{}")
    if not origin.get("dir_info", {}).get("editable"):
        return None
    return Path(url2pathname(urlsplit(origin["url"]).path))
