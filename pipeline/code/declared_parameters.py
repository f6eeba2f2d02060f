"""What the source of a stage says about its parameters: importing it, with all that it imports, would take seconds."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pipeline.package_modules import modules_in


@dataclass(frozen=True)
class Declared:
    """A parameter: its annotation, and the module that defines the names in it."""

    annotation: ast.expr
    module: str

    @property
    def choices(self) -> list[str]:
        """The values that it can have, as one would type them, if these are a few words; otherwise empty."""
        return list(dict.fromkeys(_choices(self.annotation, self.module)))


def declared_parameters(package: str, uses: str) -> dict[str, Declared]:
    """The parameters of a stage by name, those of base classes first. Raises OSError if there is no such stage."""
    module = f"{package}.{uses}"
    functions = [node for node in _parsed(module).body if isinstance(node, ast.FunctionDef) and node.name == uses]
    annotation = functions[0].args.args[1].annotation
    return dict(_fields(module, annotation.id)) if isinstance(annotation, ast.Name) else {}


def _fields(module: str, name: str) -> Iterator[tuple[str, Declared]]:
    """The annotated names in a class, those of its bases first, wherever these are defined."""
    for where, node in _definitions(module, name):
        if isinstance(node, ast.ClassDef):
            for base in node.bases:
                if isinstance(base, ast.Name):
                    yield from _fields(where, base.id)
            for field in node.body:
                match field:
                    case ast.AnnAssign(annotation=ast.Subscript(value=ast.Name(id="ClassVar"))):
                        continue  # a class variable, not a parameter
                    case ast.AnnAssign(target=ast.Name(id=parameter), annotation=annotation):
                        yield parameter, Declared(annotation, where)


def _choices(annotation: ast.expr, module: str) -> Iterator[str]:
    match annotation:
        case ast.Subscript(value=ast.Name(id="Literal"), slice=values):
            for value in values.elts if isinstance(values, ast.Tuple) else [values]:
                yield str(ast.literal_eval(value))
        case ast.Subscript(
            value=ast.Name(id="Annotated"),
            slice=ast.Tuple(
                elts=[_, ast.Call(func=ast.Name(id="ModuleIn"), args=[ast.Constant(value=str() as package)])]
            ),
        ):
            yield from next((names for folder in _places(package) if (names := modules_in(folder))), [])
        case ast.BinOp(left=left, right=right):
            yield from [*_choices(left, module), *_choices(right, module)]
        case ast.Name(id="bool"):
            yield from ("true", "false")
        case ast.Name(id=alias):
            for where, node in _definitions(module, alias):
                if isinstance(node, ast.Assign):
                    yield from _choices(node.value, where)


def _definitions(module: str, name: str) -> Iterator[tuple[str, ast.stmt]]:
    """The statements that define a first-party name, followed through imports, each with its module."""
    for node in _parsed(module).body:
        match node:
            case ast.ClassDef(name=found) | ast.Assign(targets=[ast.Name(id=found)]) if found == name:
                yield module, node
            case ast.ImportFrom(module=str(source), names=names) if _path(source) and source != "pipeline.stage":
                for alias in names:
                    if (alias.asname or alias.name) == name:
                        yield from _definitions(source, alias.name)


def _parsed(module: str) -> ast.Module:
    path = _path(module)
    if path is None:
        raise FileNotFoundError(module)
    return ast.parse(path.read_bytes())


def _path(module: str) -> Path | None:
    """The source file of a first-party module; None for any other."""
    paths = [place.with_suffix(".py") for place in _places(module)]
    return next((path for path in paths if path.is_file()), None)


def _places(name: str) -> list[Path]:
    """Possible places of a first-party package, or of a module without its suffix: in the current folder, and here."""
    return [root.joinpath(*name.split(".")) for root in (Path.cwd(), Path(__file__).resolve().parents[2])]
