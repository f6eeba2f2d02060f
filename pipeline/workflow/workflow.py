"""The workflow file: read and checked, settings applied, `foreach` and `matrix` expanded, `${…}` replaced.

    name: hide_scene
    vars: {width: 192, cover: null}          # null: must be given with --set or in a file of --vars
    stages:
      photos: {uses: photos, with: {folder: "${cover}"}}
      scene:  {uses: sfm, in: {capture: photos}, with: {width: "${width}"}}

A stage with a `foreach` or `matrix` is done once for each row that makes a difference: rows that are equal in all that
the stage and those upstream use share one instance. So pairs of scenes with the same cover share one `cover[kitchen]`,
although `cover` says `foreach: pairs.csv` like all other stages.

Nothing here knows which stages exist: `graph` checks the file against their declarations.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.errors import CommandError, Place, nearest, nearest_of
from pipeline.workflow.located import Located, Problems, read_yaml
from pipeline.workflow.matrix import Rows, expand
from pipeline.workflow.substitution import Scope, references, substitute
from pipeline.workflow.wanted_columns import wanted_columns

WORKFLOW_KEYS = ("name", "vars", "stages")
STAGE_KEYS = ("uses", "in", "with", "foreach", "matrix", "private", "resources")
INPUT_KEYS = ("all", "without_failed")
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
COMMENT = re.compile(r"^[^'\"]*(?<!\S)#")  # a YAML comment, in a value without quotes


@dataclass(frozen=True)
class Reference:
    """`stage` or `stage.output` in an `in:`."""

    stage: str
    output: str | None
    place: Place


@dataclass(frozen=True)
class Instance:
    """One node of the future graph: an entry of the file, for those rows of its `foreach` that it serves.

    `listed` names inputs that are given as a list, `without_failed` inputs that go on without what failed, `broken`
    parameters whose value is missing, which is already reported.
    """

    name: str
    uses: Located
    inputs: Mapping[str, tuple[Reference, ...]]
    listed: frozenset[str]
    without_failed: frozenset[str]
    parameters: Mapping[str, Located]
    broken: frozenset[str]
    private: bool
    resources: Mapping[str, Located]


@dataclass(frozen=True)
class Entry:
    """A stage of the file.

    `rows` are those of its `foreach` or `matrix`, None without one. `chosen` holds, for each row, the index of the
    instance that serves it; without rows, it holds one index.
    """

    name: str
    place: Place
    inputs_place: Place
    parameters_place: Place
    input_places: Mapping[str, Place]
    parameter_places: Mapping[str, Place]
    rows: Rows | None
    instances: tuple[Instance, ...]
    chosen: tuple[int, ...]

    def goes_with(self, other: Entry) -> bool:
        """Whether the two are paired row by row: they have the same rows in the same order."""
        return self.rows is not None and other.rows is not None and self.rows.identity == other.rows.identity


@dataclass(frozen=True)
class Workflow:
    """What a workflow file says, by stage; `file` is its path."""

    name: str
    file: str
    entries: Mapping[str, Entry]


def read_workflow(path: Path, settings: Sequence[str], problems: Problems, vars_files: Sequence[Path] = ()) -> Workflow:
    """The workflow in the file at `path`, with the vars in `vars_files` and each `NAME=VALUE` of `settings` applied.

    Settings win over files, later files over earlier ones, and all of them over the workflow's own vars. Raises
    CommandError if a file cannot be read; everything else that is wrong is added to `problems`.
    """
    root = _read_file(path, "the workflow", problems)
    files = [_read_file(file, "the vars file", problems) for file in vars_files]
    if root is None:
        return Workflow(path.stem, str(path), {})
    readable = [file for file in files if file is not None]
    return _Parser(path, problems).workflow(root, _settings(settings, problems), readable)


def _read_file(path: Path, what: str, problems: Problems) -> Located | None:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        hint = nearest_of(path.stem, _workflows_near(path)) if isinstance(error, FileNotFoundError) else ""
        raise CommandError(f"cannot read {what}", where=path, found=reason, expected=f"a YAML file{hint}") from error
    return read_yaml(text, str(path), path.resolve().parent, problems)


def _workflows_near(path: Path) -> dict[str, Path]:
    """YAML files next to `path` and in the folder `workflows`, by name."""
    return {file.stem: file for folder in (path.parent, Path("workflows")) for file in sorted(folder.glob("*.yaml"))}


def _settings(settings: Sequence[str], problems: Problems) -> dict[str, Located]:
    values: dict[str, Located] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        place = Place(f"--set {name}")
        if not equals or not name:
            problems.add(Place(f"--set {setting}"), "expected NAME=VALUE or STAGE.PARAMETER=VALUE")
            continue
        if not text.strip():  # such as of a shell's variable that is not set; YAML would take it for null
            problems.add(place, "no value was given; null withdraws what the workflow states, '\"\"' is an empty text")
            continue
        values[name] = _setting(name, text, place, problems)
    return values


def _setting(name: str, text: str, place: Place, problems: Problems) -> Located:
    comment = COMMENT.search(text)
    if comment:
        found = f"{text[comment.end() - 1 :]!r} would be read as a comment"
        problems.add(place, f"""{found}; quote the value: --set '{name}="{text}"'""")
        return Located(None, place, Path.cwd(), broken=True)
    value = read_yaml(text, place.file, Path.cwd(), problems, fixed=place)
    if value is None:
        return Located(None, place, Path.cwd(), broken=True)
    return replace(value, typed=text.strip()) if isinstance(value.value, tuple | Mapping) else value


class _Parser:
    def __init__(self, path: Path, problems: Problems) -> None:
        self.path = path
        self.problems = problems
        self.expanded: dict[tuple[object, ...], tuple[Located, Rows | None]] = {}
        self.wanted: Mapping[str, tuple[str, ...]] = {}

    def workflow(self, root: Located, settings: dict[str, Located], files: Sequence[Located]) -> Workflow:
        top = self.mapping(root, "the workflow", WORKFLOW_KEYS)
        name = self.name(top.get("name"))
        stages = top.get("stages")
        if stages is None and isinstance(root.value, Mapping):
            self.problems.add(root.place, "the workflow has no 'stages'")
        bodies = dict(self.mapping(stages, "'stages'")) if stages is not None else {}
        self.wanted = wanted_columns(bodies, settings)
        variables = self.variables(top.get("vars"), files, settings, bodies)
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
        columns = _columns_used(entries, bodies, settings)
        return Workflow(
            name, str(self.path), {stage: _shared(entry, columns[stage]) for stage, entry in entries.items()}
        )

    def name(self, value: Located | None) -> str:
        if value is None:
            return self.path.stem
        if not isinstance(value.value, str) or not NAME.fullmatch(value.value):
            self.problems.add(value.place, f"name is {value.found}; expected letters, digits, '_' and '-'")
            return self.path.stem
        return value.value

    def variables(
        self,
        vars_: Located | None,
        files: Sequence[Located],
        settings: dict[str, Located],
        stages: Mapping[str, object],
    ) -> Scope:
        """The value of every var, in the order of the workflow: each may refer to those before it.

        Null withdraws what the workflow states. If it states nothing, a value must be given. Values of `settings` may
        refer to vars, too, if they are lists or mappings.
        """
        stated = self.mapping(vars_, "'vars'") if vars_ is not None else {}
        given = dict(stated)
        for file in files:
            given |= self.mapping(file, "the vars file", tuple(given))
        scope: dict[str, Located | None] = {}
        for name, value in given.items():
            if name in settings:
                scope[name] = self.set_value(settings[name], scope)
            elif value.value is None and stated[name].value is None and not value.broken:
                self.problems.add(value.place, f"the var {name!r} has no value; give it with --set {name}=VALUE")
                self.problems.missing.add(name)
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
                self.problems.add(value.place, f"no such var or stage; known: {', '.join(known) or 'none'}{hint}")
        return scope

    def set_value(self, given: Located, scope: Scope) -> Located | None:
        """The value that `--set` gives a var; None if it is broken.

        Rows are often copied from the workflow, with its `${…}`. A text by itself, such as a path, is as it was typed.
        """
        if isinstance(given.value, tuple | Mapping):
            return substitute(given, scope, self.problems)
        return None if given.broken else given

    def entry(self, name: str, place: Place, body: Located, variables: Scope, settings: dict[str, Located]) -> Entry:
        fields = self.mapping(body, f"stage {name!r}", STAGE_KEYS)
        uses = fields.get("uses")
        if uses is None or uses.value is None:
            if isinstance(body.value, Mapping):
                self.problems.add(place, f"stage {name!r} has no 'uses'")
            uses = Located(None, place, body.base)
        inputs = fields.get("in")
        parameters = fields.get("with")
        given = dict(self.mapping(inputs, f"'in' of stage {name!r}")) if inputs else {}
        values = dict(self.mapping(parameters, f"'with' of stage {name!r}")) if parameters else {}
        values |= settings
        private = fields.get("private", Located(False, place, body.base))
        resources = self.mapping(
            fields.get("resources", Located({}, place, body.base)), f"'resources' of stage {name!r}"
        )
        rows = self.rows(name, fields, variables)
        repeated = any(key in fields for key in ("foreach", "matrix"))
        scopes = [rows.scope(index) for index in range(len(rows.values))] if rows else [] if repeated else [{}]
        instances = [
            self.instance(name, uses, given, values, private, resources, {**variables, **scope} if scope else variables)
            for scope in scopes
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
            rows=rows,
            instances=tuple(instances),
            chosen=tuple(range(len(instances))),
        )

    def rows(self, name: str, fields: Mapping[str, Located], variables: Scope) -> Rows | None:
        """The rows of a stage's `foreach` or `matrix`; None without one, or if it is wrong, which is then reported."""
        if "foreach" in fields and "matrix" in fields:
            message = f"stage {name!r} has both 'foreach' and 'matrix'; expected only one"
            self.problems.add(fields["matrix"].place, message)
        for key in ("foreach", "matrix"):
            given = substitute(fields[key], variables, self.problems) if key in fields else None
            if given is not None:
                # Stages that share a var or a table get the same rows, which are read and checked once.
                wanted = self.wanted.get(str(fields[key].value), ())
                shared = (key, given.base, given.value, wanted) if isinstance(given.value, str) else (key, id(given))
                if shared not in self.expanded:
                    self.expanded[shared] = given, expand(key, given, self.problems, wanted)
                return self.expanded[shared][1]
        return None

    def instance(
        self,
        name: str,
        uses: Located,
        inputs: Mapping[str, Located],
        parameters: Mapping[str, Located],
        private: Located,
        resources: Mapping[str, Located],
        scope: Scope,
    ) -> Instance:
        used = substitute(uses, scope, self.problems)
        if used is not None and uses.value is not None and not isinstance(used.value, str):
            self.problems.add(uses.place, f"uses is {used.found}; expected the name of a stage")
            used = None
        uses = used or replace(uses, value=None)
        flag = substitute(private, scope, self.problems) or private
        if not isinstance(flag.value, bool):
            self.problems.add(flag.place, f"private is {flag.found}; expected true or false")
        filled = {key: substitute(value, scope, self.problems) for key, value in inputs.items()}
        taken = {key: self.taken(key, value) for key, value in filled.items() if value is not None}
        values = {key: substitute(value, scope, self.problems) for key, value in parameters.items()}
        needed = {key: substitute(value, scope, self.problems) for key, value in resources.items()}
        return Instance(
            name=name,
            uses=uses,
            inputs={key: self.references(key, value) for key, (value, _) in taken.items()},
            listed=frozenset(key for key, (value, _) in taken.items() if isinstance(value.value, tuple)),
            without_failed=frozenset(key for key, (_, without_failed) in taken.items() if without_failed),
            parameters={key: value for key, value in values.items() if value is not None},
            broken=frozenset(key for key, value in values.items() if value is None),
            private=flag.value is True,
            resources={key: value for key, value in needed.items() if value is not None},
        )

    def taken(self, name: str, value: Located) -> tuple[Located, bool]:
        """What an input takes, and whether it goes on without what failed: `{all: STAGE, without_failed: true}`."""
        if not isinstance(value.value, Mapping):
            return value, False
        fields = self.mapping(value, f"input {name!r}", INPUT_KEYS)
        if "all" not in fields:
            self.problems.add(value.place, f"input {name!r} has no 'all'; expected all: STAGE")
        flag = fields.get("without_failed", Located(False, value.place, value.base))
        if not isinstance(flag.value, bool):
            self.problems.add(flag.place, f"without_failed is {flag.found}; expected true or false")
        return fields.get("all", replace(value, value=())), flag.value is True

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
        """The entries of a mapping with `allowed` keys, by default any; others are reported and left out."""
        if not isinstance(located.value, Mapping):
            self.problems.add(located.place, f"{what} is {located.found}; expected a mapping")
            return {}
        if allowed is None:
            return located.value
        for key in located.value:
            if key not in allowed:
                message = (
                    f"unknown key {key!r} in {what}; allowed: {', '.join(allowed) or 'none'}{nearest(key, allowed)}"
                )
                self.problems.add(located.keys[key], message)
        return {key: value for key, value in located.value.items() if key in allowed}


def _columns_used(
    entries: Mapping[str, Entry], bodies: Mapping[str, Located], settings: Mapping[str, Located]
) -> dict[str, frozenset[str]]:
    """The columns of its rows that each stage uses, itself or through upstream stages paired with it row by row."""
    used: dict[str, set[str]] = {}
    upstream: dict[str, set[str]] = {}
    for name, entry in entries.items():
        mine = [value for setting, value in settings.items() if setting.startswith(f"{name}.")]
        said = {reference for value in (bodies[name], *mine) for reference in references(value)}
        used[name] = {reference.removeprefix("item.") for reference in said if reference.startswith("item.")}
        stages = {taken.stage for each in entry.instances for group in each.inputs.values() for taken in group}
        upstream[name] = {stage for stage in stages if stage in entries and entry.goes_with(entries[stage])}
    growing = True
    while growing:
        before = sum(map(len, used.values()))
        for name in entries:
            used[name].update(*(used[stage] for stage in upstream[name]))
        growing = sum(map(len, used.values())) > before
    return {name: frozenset(columns) for name, columns in used.items()}


def _shared(entry: Entry, used: frozenset[str]) -> Entry:
    """The entry with one instance for all rows that are equal in the columns `used`, named after their values."""
    if entry.rows is None:
        return entry
    columns = [column for column in entry.rows.columns if column in used]
    labels = entry.rows.labels(columns) if columns else [""] * len(entry.instances)
    instances: dict[str, Instance] = {}
    for label, instance in zip(labels, entry.instances, strict=True):
        name = f"{entry.name}[{label}]" if columns else entry.name
        instances.setdefault(label, replace(instance, name=name))
    number = {label: index for index, label in enumerate(instances)}
    return replace(entry, instances=tuple(instances.values()), chosen=tuple(number[label] for label in labels))
