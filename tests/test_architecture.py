"""Files are arranged in floors: each imports only from the floors below its own, so there are no circles.

A file that is on no floor here is reported as well: a new file must be given its place.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# A name with a slash is a folder. Its files may import one another, though not in a circle.
ENGINE = [
    "canonical collection data_folder disk drawing events orphans package_modules plain_text provenance",
    "errors module_names",
    "companion manifest resources",
    "arrays",
    "artifact",
    "stage",
    "store/",
    "checkpoint code/",
    "workflow/",
    "plan/ results/",
    "run/",
    "console/",
    "cli",
    "__main__",
]
STAGE_FACING = {
    f"pipeline.{name}"
    for name in (
        *("stage", "artifact", "errors", "plain_text", "drawing", "companion", "checkpoint", "data_folder"),
        "module_names",
    )
}
LIBRARY_FLOORS = ["timing", "imaging", "scene", "tracing", "hiding", "training", "analysis"]
RASTERIZER_FACING = {
    f"opencl.{name}"
    for name in (
        *("rasterizer", "device", "harmonics", "routes", "ssim", "convolution", "pixel_decoder"),
        "separation",
    )
}


def sources(package: str) -> Iterator[tuple[str, Path]]:
    for path in sorted((ROOT / package).rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        yield name.removesuffix(".__init__"), path


def imports(name: str, path: Path) -> set[str]:
    """First-party modules that a file imports anywhere; for `from a import b`, a.b if it is a module, otherwise a."""
    found: set[str] = set()
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            deeper = {f"{base}.{alias.name}" for alias in node.names}
            found |= {module for module in deeper if exists(module)} or {base}
    return {module for module in found if module.split(".")[0] in ("pipeline", "stages", "opencl")}


def exists(module: str) -> bool:
    path = ROOT.joinpath(*module.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def floors(table: list[str]) -> dict[str, int]:
    return {name: number for number, names in enumerate(table) for name in names.split()}


def place(module: str) -> str:
    """Where an engine's module stands in `ENGINE`: its name, or its folder's."""
    first = module.split(".")[1]
    return f"{first}/" if (ROOT / "pipeline" / first).is_dir() else first


def test_the_engine_stands_on_its_own_floors() -> None:
    floor = floors(ENGINE)
    for name, path in sources("pipeline"):
        if path.name == "__init__.py":
            continue
        own = place(name)
        assert own in floor, f"{path} is on no floor"
        for module in imports(name, path):
            assert module.startswith("pipeline."), f"{path} imports {module}"
            beside = place(module) == own and own.endswith("/")
            assert beside or floor[place(module)] < floor[own], f"{path} imports {module} from above or beside"


def test_the_rasterizer_knows_of_nothing_else() -> None:
    for name, path in sources("opencl"):
        for module in imports(name, path):
            assert module.split(".")[0] == "opencl", f"{path} imports {module}"


def test_stages_stand_on_the_library() -> None:
    floor = floors(LIBRARY_FLOORS)
    top = len(LIBRARY_FLOORS)
    for name, path in sources("stages"):
        if name == "stages":
            continue
        parts = name.split(".")
        if len(parts) > 2 or path.name == "__init__.py":
            assert parts[1] in floor, f"{path} is on no floor"
        own = floor.get(parts[1], top)
        for module in imports(name, path):
            package, _, rest = module.partition(".")
            folder = rest.split(".")[0]
            if package == "pipeline":
                assert module in STAGE_FACING, f"{path} imports {module}"
            elif package == "opencl":
                assert module in RASTERIZER_FACING, f"{path} imports {module}"
            elif folder != parts[1]:
                assert floor.get(folder, top) < own, f"{path} imports {module} from above or beside"


@pytest.mark.parametrize("package", ["pipeline", "opencl", "stages"])
def test_there_are_no_circles(package: str) -> None:
    waiting = {name: imports(name, path) - {name} for name, path in sources(package)}
    while waiting:
        free = {name for name, needs in waiting.items() if not needs & waiting.keys()}
        assert free, f"a circle among {sorted(waiting)}"
        waiting = {name: needs for name, needs in waiting.items() if name not in free}


@pytest.mark.parametrize("package", ["pipeline", "opencl", "stages"])
def test_packages_are_thin(package: str) -> None:
    """Code in a package's `__init__.py` would be part of the fingerprint of everything in the package."""
    for name, path in sources(package):
        if path.name == "__init__.py":
            body = ast.parse(path.read_text()).body
            assert all(isinstance(node, ast.Expr) for node in body), f"{name} is more than a docstring"


@pytest.mark.parametrize("package", ["pipeline", "opencl", "stages"])
def test_files_are_short(package: str) -> None:
    for _, path in sources(package):
        assert len(path.read_text().splitlines()) <= 420, f"{path} is long; one idea a file"
