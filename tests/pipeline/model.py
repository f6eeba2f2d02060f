"""A small world of stages, files and parameters, and a model that says what each stage must make and when it must run.

The world is written to disk as a package of stages, folders and a workflow. The model computes every result by itself
and remembers the recipe of everything ever made: a stage must run exactly if its recipe is new.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

MODULUS = 1_000_003
COARSE = 250_000

Recipe = tuple[object, ...]
Value = tuple[int, bool]
"""What a stage makes, and whether it is private."""

HEAD = '''"""{text}"""
from pydantic import Field
from pipeline.stage import Context, ExternalPath, Input, Output, Parameters, stage
import numpy as np
'''
DECLARED = "outputs={{'numbers': Output('numbers')}}, version={version}"

TEMPLATES = {
    "__init__": '"""{text}"""\n',
    "lib.__init__": "",
    "methods.__init__": "",
    "lib.c": '"""{text}"""\n\nC = {constant}  # {text}\n',
    "lib.b": "from . import c\nB = {constant}\n\ndef b(x):\n    '''{text}'''\n    return x * c.C + B\n",
    "lib.a": "A = {constant}  # {text}\n\ndef a(x):\n    from {package}.lib.b import b\n    return b(x) + A\n",
    "lib.kernels": (
        "from pathlib import Path\nRESOURCES = ('*.cl',)\nK = {constant}\n# {text}\n"
        "def kernel():\n    return K + sum((Path(__file__).parent / 'blend.cl').read_bytes())\n"
    ),
    "methods.m0": "# {text}\nM = {constant}\n\ndef apply(x):\n    return x + M\n",
    "methods.m1": "from ..lib import c\nM = {constant}\n\ndef apply(x):\n    '''{text}'''\n    return x * M + c.C\n",
    "source": HEAD
    + """from {package}.lib.a import a

class SourceParameters(Parameters):
    base: int = Field(1, description="Base.")
    seed: int = Field(0, description="Seed.")
    folder: ExternalPath | None = Field(None, description="Folder.")

@stage(inputs={{}}, """
    + DECLARED
    + """)
def source(context, parameters: SourceParameters) -> None:
    total = parameters.base + int(np.random.default_rng(parameters.seed).integers(1000)) * {constant}
    for file in sorted(parameters.folder.rglob('*') if parameters.folder else ()):
        total += (sum(file.read_bytes()) + 1) * sum(file.name.encode())
    context.output('numbers').write('values', np.array([a(total) % """
    + str(MODULUS)
    + """]))
""",
    "transform": HEAD
    + """import importlib
from .lib.kernels import kernel

class TransformParameters(Parameters):
    method: str = Field("m0", description="Method.")
    factor: int = Field(2, description="Factor.")

@stage(inputs={{'numbers': Input('numbers')}}, modules=lambda p: [f'{package}.methods.{{p.method}}'], """
    + DECLARED
    + """)
def transform(context, parameters: TransformParameters) -> None:
    method = importlib.import_module('{package}.methods.' + parameters.method)
    x = int(context.input('numbers').read('values')[0]) * parameters.factor + {constant} + kernel()
    context.output('numbers').write('values', np.array([method.apply(x) % """
    + str(MODULUS)
    + """]))
""",
    "merge": HEAD
    + """from {package}.lib import b as helper

class MergeParameters(Parameters):
    shift: int = Field(0, description="Shift.")

@stage(inputs={{'numbers': Input('numbers', many=True)}}, """
    + DECLARED
    + """)
def merge(context, parameters: MergeParameters) -> None:
    values = [int(a.read('values')[0]) for a in context.input_many('numbers')]
    x = sum((i + 1) * v for i, v in enumerate(values)) + parameters.shift + {constant}
    context.output('numbers').write('values', np.array([helper.b(x) % """
    + str(MODULUS)
    + """]))
""",
    "coarse": HEAD
    + """
class CoarseParameters(Parameters):
    unit: int = Field("""
    + str(COARSE)
    + """, description="Unit.")

@stage(inputs={{'numbers': Input('numbers')}}, """
    + DECLARED
    + """)
def coarse(context, parameters: CoarseParameters) -> None:
    x = int(context.input('numbers').read('values')[0])
    context.output('numbers').write('values', np.array([x // parameters.unit + {constant}]))
""",
}
KINDS = ("source", "transform", "merge", "coarse")
DEFAULTS: Mapping[str, Mapping[str, int | str]] = {
    "source": {"base": 1, "seed": 0},
    "transform": {"method": "m0", "factor": 2},
    "merge": {"shift": 0},
    "coarse": {"unit": COARSE},
}
CLOSURES = {
    "source": ("source", "lib.a", "lib.b", "lib.c"),
    "transform": ("transform", "lib.kernels"),
    "merge": ("merge", "lib.b", "lib.c"),
    "coarse": ("coarse",),
    "m0": ("methods.m0",),
    "m1": ("methods.m1", "lib.c"),
}


@dataclass
class File:
    """A source file: `constant` changes results, `unused` adds definitions that change nothing, `text` is a comment."""

    constant: int = 3
    unused: int = 0
    text: str = "Said."
    version: int = 1


@dataclass
class Folder:
    path: str
    files: dict[str, bytes]


@dataclass
class StageNode:
    """A stage of the workflow; `given` are the parameters that the workflow file states."""

    name: str
    kind: str
    inputs: list[int]
    given: dict[str, int | str]
    folder: int | None = None
    private: bool = False

    @property
    def parameters(self) -> dict[str, int | str]:
        return {**DEFAULTS[self.kind], **self.given}


@dataclass
class World:
    root: Path
    package: str
    nodes: list[StageNode]
    folders: list[Folder]
    code: dict[str, File] = field(default_factory=lambda: {name: File() for name in TEMPLATES})
    kernel: bytes = b"float x;"
    order: list[int] = field(default_factory=list)
    through_vars: bool = False
    made: dict[Recipe, Value] = field(default_factory=dict)

    def write(self) -> None:
        """Writes everything to disk as it is now; files that are already right are left alone."""
        wanted = {
            self.root / f"{folder.path}/{name}": data for folder in self.folders for name, data in folder.files.items()
        }
        base = self.root / self.package
        for module, file in self.code.items():
            text = TEMPLATES[module].format(package=self.package, **vars(file))
            text += "".join(f"UNUSED_{number} = {number}\n" for number in range(file.unused))
            wanted[base / (module.replace(".", "/") + ".py")] = text.encode()
        wanted[base / "lib/blend.cl"] = self.kernel
        wanted[self.root / "workflow.yaml"] = self.workflow().encode()
        for folder in self.root.glob("photos*"):
            for path in folder.iterdir():
                if path not in wanted:
                    path.unlink()
        for path, data in wanted.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.is_file() or path.read_bytes() != data:
                path.write_bytes(data)

    def workflow(self) -> str:
        lines = []
        variables = []
        for index in self.order or range(len(self.nodes)):
            node = self.nodes[index]
            given: dict[str, object] = dict(node.given)
            if self.through_vars:
                variables += [f"  v{index}_{name}: {value}" for name, value in given.items()]
                given = {name: f'"${{v{index}_{name}}}"' for name in given}
            if node.folder is not None:
                given["folder"] = self.folders[node.folder].path
            inputs = [self.nodes[number].name for number in node.inputs]
            taken = f"[{', '.join(inputs)}]" if node.kind == "merge" else "".join(inputs)
            fields = [f"uses: {node.kind}", f"private: {str(node.private).lower()}"]
            fields += [f"in: {{numbers: {taken}}}"] if inputs else []
            fields += [f"with: {{{', '.join(f'{name}: {value}' for name, value in given.items())}}}"] if given else []
            lines.append(f"  {node.name}: {{{', '.join(reversed(fields) if self.order else fields)}}}")
        head = ["vars:", *variables] if variables else []
        return "\n".join([*head, "stages:", *lines]) + "\n"

    def expected(self) -> tuple[dict[str, Value], set[Recipe], dict[str, Recipe]]:
        """What every stage makes, the recipes that are new, and each stage's recipe."""
        values: list[Value] = []
        recipes: dict[str, Recipe] = {}
        for node in self.nodes:
            taken = tuple(values[number] for number in node.inputs)
            recipe = self.recipe(node, taken)
            value = self.result(node, [value for value, _ in taken])
            values.append((value, node.private or any(private for _, private in taken)))
            recipes[node.name] = recipe
        by_name = {node.name: value for node, value in zip(self.nodes, values, strict=True)}
        return by_name, set(recipes.values()) - self.made.keys(), recipes

    def recipe(self, node: StageNode, taken: tuple[Value, ...]) -> Recipe:
        modules = [
            *CLOSURES[node.kind],
            *(CLOSURES[str(node.parameters["method"])] if node.kind == "transform" else ()),
        ]
        code = tuple((name, self.code[name].constant, self.code[name].unused) for name in sorted(set(modules)))
        code += (("__init__", 0, self.code["__init__"].unused),)
        libraries = {name.partition(".")[0] for name in modules if "." in name}
        code += tuple((f"{name}.__init__", 0, self.code[f"{name}.__init__"].unused) for name in sorted(libraries))
        kernel = self.kernel if node.kind == "transform" else b""
        folder = tuple(sorted(self.folders[node.folder].files.items())) if node.folder is not None else None
        parameters = tuple(sorted(node.parameters.items()))
        return (node.kind, self.code[node.kind].version, code, kernel, folder, parameters, node.private, taken)

    def result(self, node: StageNode, taken: list[int]) -> int:
        own = self.code[node.kind].constant
        parameters = node.parameters
        a, b, c = (self.code[f"lib.{name}"].constant for name in "abc")
        if node.kind == "source":
            seed = int(parameters["seed"])
            total = int(parameters["base"]) + int(np.random.default_rng(seed).integers(1000)) * own
            files = self.folders[node.folder].files if node.folder is not None else {}
            total += sum((sum(data) + 1) * sum(name.encode()) for name, data in files.items())
            return (total * c + b + a) % MODULUS
        if node.kind == "transform":
            x = taken[0] * int(parameters["factor"]) + own + self.code["lib.kernels"].constant + sum(self.kernel)
            m = self.code[f"methods.{parameters['method']}"].constant
            return (x + m if parameters["method"] == "m0" else x * m + c) % MODULUS
        if node.kind == "merge":
            x = sum((number + 1) * value for number, value in enumerate(taken)) + int(parameters["shift"]) + own
            return (x * c + b) % MODULUS
        return taken[0] // int(parameters["unit"]) + own

    def rename_folder(self, index: int) -> None:
        folder = self.folders[index]
        new = f"{folder.path}x"
        shutil.move(self.root / folder.path, self.root / new)
        folder.path = new
