"""The workflow file: read, checked for its shape, `--set` applied, `foreach` unrolled and every `${…}` replaced.

    name: hide_scene
    vars: {width: 192, cover: null}          # null: must be given with --set
    stages:
      photos: {uses: photos, with: {folder: "${cover}"}}
      scene:  {uses: sfm, in: {capture: photos}, with: {width: "${width}"}}

Nothing here knows what stages exist: `graph` checks what is said against what they declare.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.canonical import Json
from pipeline.errors import CommandError, Place, nearest
from pipeline.located import Located, Problems, read_yaml
from pipeline.matrix import Item, Scope, items, substitute

WORKFLOW_KEYS = ("name", "vars", "stages")
STAGE_KEYS = ("uses", "in", "with", "foreach", "private", "resources")
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


@dataclass(frozen=True)
class Reference:
    """`stage` or `stage.output` in an `in:`."""

    stage: str
    output: str | None
    place: Place


@dataclass(frozen=True)
class Instance:
    """One node of the graph to be: an entry of the file, for one item of its `foreach`.

    `broken` names parameters whose value is missing, which has been reported already.
    """

    name: str
    uses: Located
    inputs: Mapping[str, tuple[Reference, ...]]
    listed: frozenset[str]
    parameters: Mapping[str, Located]
    broken: frozenset[str]
    private: bool
    resources: Mapping[str, Located]


@dataclass(frozen=True)
class Entry:
    """A stage of the file. `foreach` is its plain lists, equal for stages that go item by item; None without one."""

    name: str
    place: Place
    inputs_place: Place
    parameters_place: Place
    input_places: Mapping[str, Place]
    parameter_places: Mapping[str, Place]
    foreach: Json
    instances: tuple[Instance, ...]


@dataclass(frozen=True)
class Workflow:
    name: str
    file: str
    entries: Mapping[str, Entry]


def read_workflow(path: Path, settings: Sequence[str], problems: Problems) -> Workflow:
    """The workflow in the file at `path`, with each `NAME=VALUE` of `settings` applied.

    Raises CommandError where the file cannot be read; everything else that is wrong joins `problems`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise CommandError("cannot read the workflow", where=path, found=reason, expected="a YAML file") from error
    root = read_yaml(text, str(path), path.resolve().parent, problems)
    if root is None:
        return Workflow(path.stem, str(path), {})
    return _Parser(path, problems).workflow(root, _settings(settings, problems))


def _settings(settings: Sequence[str], problems: Problems) -> dict[str, Located]:
    values: dict[str, Located] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        place = Place(f"--set {name}")
        if not equals or not name:
            problems.add(Place(f"--set {setting}"), "expected NAME=VALUE or STAGE.PARAMETER=VALUE")
            continue
        value = read_yaml(text, place.file, Path.cwd(), problems, fixed=place)
        if value is not None:
            values[name] = value
    return values


class _Parser:
    def __init__(self, path: Path, problems: Problems) -> None:
        self.path = path
        self.problems = problems

    def workflow(self, root: Located, settings: dict[str, Located]) -> Workflow:
        top = self.mapping(root, "the workflow", WORKFLOW_KEYS)
        name = self.name(top.get("name"))
        stages = top.get("stages")
        if stages is None and isinstance(root.value, Mapping):
            self.problems.add(root.place, "the workflow has no 'stages'")
        bodies = dict(self.mapping(stages, "'stages'")) if stages is not None else {}
        variables = self.variables(top.get("vars"), settings, bodies)
        entries = {}
        for stage, body in bodies.items():
            place = stages.keys.get(stage, body.place) if stages is not None else body.place
            if not NAME.fullmatch(stage):
                self.problems.add(place, f"{stage!r} cannot name a stage; expected letters, digits, '_' and '-'")
            mine = {
                setting.removeprefix(f"{stage}."): value
                for setting, value in settings.items()
                if setting.startswith(f"{stage}.")
            }
            entries[stage] = self.entry(stage, place, body, variables, mine)
        return Workflow(name, str(self.path), entries)

    def name(self, value: Located | None) -> str:
        if value is None:
            return self.path.stem
        if not isinstance(value.value, str) or not NAME.fullmatch(value.value):
            self.problems.add(value.place, f"name is {value.found}; expected letters, digits, '_' and '-'")
            return self.path.stem
        return value.value

    def variables(self, vars_: Located | None, settings: dict[str, Located], stages: Mapping[str, object]) -> Scope:
        """The value of every var, in the order of the file: one may refer to those before it."""
        given = self.mapping(vars_, "'vars'") if vars_ is not None else {}
        scope: dict[str, Located | None] = {}
        for name, value in given.items():
            if name in settings:
                scope[name] = settings[name]
            elif value.value is None:
                self.problems.add(value.place, f"the var {name!r} has no value; give it with --set {name}=VALUE")
                scope[name] = None
            else:
                scope[name] = substitute(value, scope, self.problems)
        for setting, value in settings.items():
            stage, dot, _ = setting.partition(".")
            if setting not in given and not (dot and stage in stages):
                known = [*given, *(f"{stage}.PARAMETER" for stage in stages)]
                hint = nearest(stage, [*given, *stages])
                if setting in stages:
                    hint = f"; {setting!r} is a stage: set one of its parameters with --set {setting}.PARAMETER=VALUE"
                self.problems.add(value.place, f"no such var or stage; known are {', '.join(known) or 'none'}{hint}")
        return scope

    def entry(self, name: str, place: Place, body: Located, variables: Scope, settings: dict[str, Located]) -> Entry:
        fields = self.mapping(body, f"stage {name!r}", STAGE_KEYS)
        uses = fields.get("uses")
        if uses is None:
            if isinstance(body.value, Mapping):
                self.problems.add(place, f"stage {name!r} does not say what it uses")
            uses = Located(None, place, body.base)
        inputs = fields.get("in")
        parameters = fields.get("with")
        given = dict(self.mapping(inputs, f"'in' of stage {name!r}")) if inputs else {}
        values = dict(self.mapping(parameters, f"'with' of stage {name!r}")) if parameters else {}
        values |= settings
        foreach = substitute(fields["foreach"], variables, self.problems) if "foreach" in fields else None
        passes = items(foreach, self.problems) if foreach is not None else None
        private = fields.get("private", Located(False, place, body.base))
        resources = self.mapping(
            fields.get("resources", Located({}, place, body.base)), f"'resources' of stage {name!r}"
        )
        instances = [
            self.instance(name, item, uses, given, values, private, resources, variables)
            for item in (passes or (() if "foreach" in fields else (None,)))
        ]
        return Entry(
            name=name,
            place=place,
            inputs_place=inputs.place if inputs else place,
            parameters_place=parameters.place if parameters else place,
            input_places=inputs.keys if inputs else {},
            parameter_places={
                **(parameters.keys if parameters else {}),
                **{key: v.place for key, v in settings.items()},
            },
            foreach=foreach.plain if foreach is not None else None,
            instances=tuple(instances),
        )

    def instance(
        self,
        name: str,
        item: Item | None,
        uses: Located,
        inputs: Mapping[str, Located],
        parameters: Mapping[str, Located],
        private: Located,
        resources: Mapping[str, Located],
        variables: Scope,
    ) -> Instance:
        scope = {**variables, **item.scope} if item else variables
        uses = substitute(uses, scope, self.problems) or replace(uses, value=None)
        if not isinstance(uses.value, str) and uses.value is not None:
            self.problems.add(uses.place, f"uses is {uses.found}; expected the name of a stage")
            uses = replace(uses, value=None)
        flag = substitute(private, scope, self.problems) or private
        if not isinstance(flag.value, bool):
            self.problems.add(flag.place, f"private is {flag.found}; expected true or false")
        filled = {key: substitute(value, scope, self.problems) for key, value in inputs.items()}
        values = {key: substitute(value, scope, self.problems) for key, value in parameters.items()}
        needed = {key: substitute(value, scope, self.problems) for key, value in resources.items()}
        return Instance(
            name=f"{name}[{item.label}]" if item else name,
            uses=uses,
            inputs={key: self.references(key, value) for key, value in filled.items() if value is not None},
            listed=frozenset(key for key, value in filled.items() if value and isinstance(value.value, tuple)),
            parameters={key: value for key, value in values.items() if value is not None},
            broken=frozenset(key for key, value in values.items() if value is None),
            private=flag.value is True,
            resources={key: value for key, value in needed.items() if value is not None},
        )

    def references(self, name: str, value: Located) -> tuple[Reference, ...]:
        references = []
        for item in value.value if isinstance(value.value, tuple) else (value,):
            if not isinstance(item.value, str) or not item.value:
                self.problems.add(item.place, f"input {name!r} is {item.found}; expected STAGE or STAGE.OUTPUT")
                continue
            stage, _, output = item.value.partition(".")
            references.append(Reference(stage, output or None, item.place))
        return tuple(references)

    def mapping(self, located: Located, what: str, allowed: Sequence[str] | None = None) -> Mapping[str, Located]:
        """The entries of a mapping with `allowed` keys; what is not so is reported and left out."""
        if not isinstance(located.value, Mapping):
            self.problems.add(located.place, f"{what} is {located.found}; expected a mapping")
            return {}
        if allowed is None:
            return located.value
        for key in located.value:
            if key not in allowed:
                message = f"unknown key {key!r} in {what}; allowed are {', '.join(allowed)}{nearest(key, allowed)}"
                self.problems.add(located.keys[key], message)
        return {key: value for key, value in located.value.items() if key in allowed}
