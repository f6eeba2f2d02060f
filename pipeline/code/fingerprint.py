"""The code that a stage's result depends on, as a digest for each first-party module.

The scope is whole modules: the stage's own, and all first-party modules that it imports, directly or indirectly.
Hashing single functions, as most tools do, misses an edited helper, and a silently stale result is the worst that a
cache can do. Hashing the whole tree is safe, but then a changed line in the report repeats hours of training. Modules
are safe, since Python cannot run code of a module that nobody imports, and as precise as the files are small. So:

- a module counts by its syntax tree, without comments, docstrings, layout, and the arguments `unrepeatable=`,
  `unread=`, `remarks=`, `alone=` and `resources=` of `@stage`, which change no bit;
- imports count wherever they are, including inside functions and under `TYPE_CHECKING`, and so do the packages that
  they pass through: keep `__init__.py` thin;
- `RESOURCES = ("kernels/*.cl",)` at the top of a module adds the bytes of files beside it. The module has to read them
  when it is loaded: what it reads later may have been edited since then, and nothing could tell;
- an import with a computed name hides what it imports. It is an error unless the stage declares `modules=`, which names
  the modules that its parameters select; `import_module("its.name")` counts like any other import;
- the engine itself never counts, nor do third-party libraries: their versions are in the provenance;
- a module that is neither first-party nor installed, such as a file beside the package, is an error: nothing would tell
  that it changed.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

from pipeline.canonical import digest_of
from pipeline.errors import UserError
from pipeline.package_modules import folders_of

ENGINE = "pipeline"
DYNAMIC = ("import_module", "__import__", "run_module", "run_path", "spec_from_file_location")
IMPORTS = "its imports"
STATEMENTS = "its other statements"
NOTES = ("unrepeatable", "unread", "remarks", "alone", "resources")
"""Arguments of `@stage` that say where a stage runs, or how to treat its result, not what that is."""


@dataclass(frozen=True)
class Module:
    """What one source file contributes; `dynamic` holds the lines of imports whose name is computed.

    `definitions` holds a digest for each name defined at the top level, for the imports, for the other statements, and
    for each resource. They only serve to say what changed: keys depend on `digest` alone. `resources` holds the
    patterns that name the resources.
    """

    path: Path
    digest: str
    definitions: Mapping[str, str]
    imports: tuple[str, ...]
    dynamic: tuple[int, ...]
    resources: tuple[str, ...]


@dataclass(frozen=True)
class Code:
    """The code behind one stage: a digest for each first-party module, and the third-party names that they import."""

    modules: Mapping[str, str]
    libraries: tuple[str, ...]
    dynamic: tuple[str, ...]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the modules' names and digests."""
        return digest_of(dict(self.modules), "the code")


class SourceTree:
    """The sources of the first-party packages. Each file is read once, by `read`; nothing is imported for that."""

    def __init__(self, packages: Iterable[str], read: Callable[[str, Path], Module] | None = None) -> None:
        self._folders = {package: folders_of(package) for package in packages if package != ENGINE}
        self._read = read or read_module
        self._modules: dict[str, Module | None] = {}

    def code(self, roots: Iterable[str]) -> Code:
        """The code that importing the modules `roots` brings in.

        Raises UserError if a root does not exist or a source file is not Python.
        """
        roots = tuple(roots)
        for root in roots:
            if self.module(root) is None:
                raise UserError("no such module", found=root, expected=f"a module of {', '.join(self._folders)}")
        reached: dict[str, Module] = {}
        libraries: set[str] = set()
        waiting = list(roots)
        while waiting:
            name = waiting.pop()
            module = self.module(name)
            if module is None or name in reached:
                continue
            reached[name] = module
            parent = name.rpartition(".")[0]
            waiting += [*module.imports, *([parent] if parent else [])]
            libraries |= {imported.partition(".")[0] for imported in module.imports}
        return Code(
            modules={name: reached[name].digest for name in sorted(reached)},
            libraries=tuple(sorted(libraries - self._folders.keys() - {ENGINE})),
            dynamic=tuple(f"{module.path}:{line}" for module in reached.values() for line in module.dynamic),
        )

    def definitions(self, code: Code) -> dict[str, Mapping[str, str]]:
        """The digests of the definitions of each module of `code`."""
        modules = {name: self.module(name) for name in code.modules}
        return {name: module.definitions for name, module in modules.items() if module}

    def module(self, name: str) -> Module | None:
        """The first-party module of that name; None if there is none. Raises UserError if it is not Python."""
        if name not in self._modules:
            path = self._path(name)
            self._modules[name] = self._read(name, path) if path else None
        return self._modules[name]

    def _path(self, name: str) -> Path | None:
        package, *rest = name.split(".")
        for folder in self._folders.get(package, ()):
            stem = folder.joinpath(*rest)
            for path in (stem / "__init__.py", *([stem.with_name(stem.name + ".py")] if rest else [])):
                if path.is_file():
                    return path
        return None


def read_module(name: str, path: Path, read: Callable[[Path], bytes] = Path.read_bytes) -> Module:
    """The module `name` in the file at `path`. Raises UserError if it is not Python or a resource is missing."""
    try:
        tree = ast.parse(read(path), str(path))
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None) or 1
        raise UserError(f"not Python: {getattr(error, 'msg', error)}", where=f"{path}:{line}") from error
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    patterns = _resources(tree, path)
    files = {file.relative_to(path.parent).as_posix(): file for file in resource_files(patterns, path)}
    resources = {name: sha256(read(file)).hexdigest() for name, file in files.items()}
    return Module(
        path=path,
        digest=digest_of([spell(tree), resources]),
        definitions={**_definitions(tree), **resources},
        imports=tuple(dict.fromkeys(_imports(tree, package))),
        dynamic=tuple(_dynamic(tree)),
        resources=patterns,
    )


def _definitions(tree: ast.Module) -> dict[str, str]:
    """A digest of everything that the top level says about each name; a name may be defined several times."""
    spellings: dict[str, list[str]] = {}
    for statement in tree.body:
        if not _is_bare_text(statement):
            for name in _names(statement):
                spellings.setdefault(name, []).append(spell(statement))
    return {name: digest_of(texts) for name, texts in spellings.items()}


def _names(statement: ast.stmt) -> list[str]:
    """The names that a statement at the top level defines."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [statement.name]
    if isinstance(statement, ast.Import | ast.ImportFrom):
        return [IMPORTS]
    targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
    names = [node.id for target in targets if target for node in ast.walk(target) if isinstance(node, ast.Name)]
    return names if names and isinstance(statement, ast.Assign | ast.AnnAssign | ast.AugAssign) else [STATEMENTS]


def spell(node: object) -> str:
    """A canonical spelling of a syntax tree: no positions, no docstrings or other bare strings, no empty fields.

    >>> spell(ast.parse("x = 1  # one")) == spell(ast.parse("'''Said.'''\\n\\nx  =  1"))
    True
    """
    if isinstance(node, ast.FunctionDef):
        node.decorator_list = [_without_notes(decorator) for decorator in node.decorator_list]
    if isinstance(node, ast.AST):
        fields = [(name, spell(value)) for name, value in ast.iter_fields(node) if name not in ("ctx", "type_comment")]
        return f"{type(node).__name__}({','.join(f'{name}={text}' for name, text in fields if text)})"
    if isinstance(node, list):
        return "".join(f"[{spell(item)}]" for item in node if not _is_bare_text(item))
    return "" if node is None else f"{type(node).__name__} {node!r}"


def _without_notes(decorator: ast.expr) -> ast.expr:
    if not (isinstance(decorator, ast.Call) and _called(decorator) == "stage"):
        return decorator
    return ast.Call(decorator.func, decorator.args, [said for said in decorator.keywords if said.arg not in NOTES])


def _is_bare_text(node: object) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _imports(tree: ast.Module, package: str) -> Iterator[str]:
    """Full names of everything that a module may import: for `from a import b`, both `a` and `a.b`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and _called(node) in DYNAMIC and (name := _literal_name(node)):
            yield name


def _dynamic(tree: ast.Module) -> Iterator[int]:
    """Lines of imports with a computed name, and of other uses of the functions that make such imports possible."""
    plain = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call) and _literal_name(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (node.lineno for alias in node.names if alias.name in DYNAMIC and alias.asname)
        elif isinstance(node, ast.Name | ast.Attribute) and _named(node) in DYNAMIC and id(node) not in plain:
            yield node.lineno


def _called(call: ast.Call) -> str:
    return _named(call.func)


def _named(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _literal_name(call: ast.Call) -> str | None:
    """The module's name in `import_module("its.name")`; None for anything less plain."""
    if _called(call) != "import_module" or len(call.args) != 1 or call.keywords:
        return None
    name = call.args[0]
    if isinstance(name, ast.Constant) and isinstance(name.value, str) and not name.value.startswith("."):
        return name.value
    return None


def _resources(tree: ast.Module, path: Path) -> tuple[str, ...]:
    """The patterns in a module-level `RESOURCES`. Raises UserError if it is not a literal tuple of strings."""
    found: tuple[str, ...] = ()
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if isinstance(node, ast.Assign | ast.AnnAssign) and any(getattr(t, "id", "") == "RESOURCES" for t in targets):
            try:
                patterns = ast.literal_eval(node.value) if node.value else ()
            except ValueError:
                patterns = None
            if not isinstance(patterns, tuple) or not all(isinstance(pattern, str) for pattern in patterns):
                raise UserError("RESOURCES is not a literal tuple of patterns", where=f"{path}:{node.lineno}")
            found = patterns
    return found


def resource_files(patterns: Iterable[str], path: Path) -> list[Path]:
    """The files that `patterns` match, relative to the folder of the module at `path`.

    Raises UserError for a pattern that matches none.
    """
    files: list[Path] = []
    for pattern in patterns:
        found = sorted(file for file in path.parent.glob(pattern) if file.is_file())
        if not found:
            raise UserError(f"RESOURCES names {pattern!r}, which matches no file", where=path)
        files += found
    return files
