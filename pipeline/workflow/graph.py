"""The graph of a workflow: every stage checked against its declaration, every reference resolved to an output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from pipeline.canonical import Json
from pipeline.code.declaration import Catalogue, Completed, Declaration
from pipeline.code.fingerprint import Code
from pipeline.code.hidden_imports import hidden_imports
from pipeline.errors import CommandError, Place, UserError, nearest
from pipeline.plain_text import listed
from pipeline.resources import amount
from pipeline.stage import Input
from pipeline.workflow.located import Problems
from pipeline.workflow.outside_files import MakesCache, Outside, OutsideFiles
from pipeline.workflow.outside_paths import absolute, as_typed, check_there
from pipeline.workflow.workflow import Entry, Instance, Reference, Workflow
from pipeline.workflow.wrong_values import WrongValue, report, wanting_text


@dataclass(frozen=True)
class Source:
    """One output of one node."""

    node: str
    output: str


@dataclass(frozen=True)
class Label:
    """What an artifact of an input is about: the name of its row, or of its stage without one, and the row's values."""

    text: str
    values: Mapping[str, Json]


@dataclass(frozen=True)
class Node:
    """A stage, ready to be given its inputs.

    `sources` says, for each input, where its artifacts come from; it is empty for an optional input that is not given.
    `labels` says what each is about, for inputs declared as labelled. `without_failed` names the inputs that go on
    without artifacts that failed.

    `arguments` are the parameters as the workflow gives them, with absolute external paths. `parameters` are all that
    are not external, with their defaults. `external` holds the digests of external files and folders by parameter,
    `outside_paths` the paths to them, given or by default. `resources` is what the stage needs while it runs.
    `unrepeatable`: no run can make again what it makes.
    """

    name: str
    declaration: Declaration
    sources: Mapping[str, tuple[Source, ...]]
    labels: Mapping[str, tuple[Label, ...]]
    without_failed: frozenset[str]
    arguments: Mapping[str, Json]
    parameters: Mapping[str, Json]
    external: Mapping[str, tuple[str, ...]]
    outside_paths: tuple[str, ...]
    code: Code
    private: bool
    resources: Mapping[str, float]
    unrepeatable: bool

    @property
    def uses(self) -> str:
        """The name of the stage in its package."""
        return self.declaration.uses

    @property
    def entry(self) -> str:
        """Its name in the file, without the row of a foreach."""
        return self.name.partition("[")[0]

    @cached_property
    def upstream(self) -> tuple[str, ...]:
        """Names of the nodes that it takes artifacts from, each once, in the order of its inputs."""
        return tuple(dict.fromkeys(source.node for sources in self.sources.values() for source in sources))

    @cached_property
    def required(self) -> tuple[str, ...]:
        """Those of `upstream` that it cannot be done without."""
        named = ((name, source) for name, sources in self.sources.items() for source in sources)
        return tuple(dict.fromkeys(source.node for name, source in named if name not in self.without_failed))


@dataclass(frozen=True)
class Graph:
    """The nodes of a workflow, each after those that it takes artifacts from; all of them if it is `whole`.

    `command` runs the workflow in the same way again, for display in pages; `given` holds its options as they were
    typed. Both are empty if unknown.
    """

    workflow: str
    nodes: Mapping[str, Node]
    whole: bool = True
    command: str = ""
    given: tuple[str, ...] = ()

    def needed_for(self, stages: Iterable[str]) -> Graph:
        """The part of the graph that makes `stages`, named as in the file, or with the item of a foreach.

        Raises CommandError for a name that is not in the workflow in either form.
        """
        wanted: set[str] = set()
        for stage in stages:
            found = [name for name, node in self.nodes.items() if stage in (name, node.entry)]
            if not found:
                raise CommandError(self._unknown(stage))
            wanted.update(found)
        for name in reversed(list(self.nodes)):
            if name in wanted:
                wanted.update(self.nodes[name].upstream)
        chosen = {name: node for name, node in self.nodes.items() if name in wanted}
        return replace(self, nodes=chosen, whole=self.whole and len(chosen) == len(self.nodes))

    def _unknown(self, stage: str) -> str:
        """What to say of a name that is not there: stages as the file names them, or items of the stage that is."""
        entry, item, _ = stage.partition("[")
        entries = list(dict.fromkeys(node.entry for node in self.nodes.values()))
        if item and entry in entries:
            items = [name for name, node in self.nodes.items() if node.entry == entry]
            return f"no {stage!r} in {self.workflow}; there are {listed(items)}"
        return f"no stage {stage!r} in {self.workflow}; there are {', '.join(entries)}{nearest(entry, entries)}"

    @property
    def dependents(self) -> dict[str, list[str]]:
        """For each node, the names of the nodes that take from it, in order."""
        taking: dict[str, list[str]] = {name: [] for name in self.nodes}
        for name, node in self.nodes.items():
            for upstream in node.upstream:
                taking[upstream].append(name)
        return taking

    @property
    def final(self) -> tuple[str, ...]:
        """Names of the nodes that no other node takes from."""
        taken = {name for node in self.nodes.values() for name in node.upstream}
        return tuple(name for name in self.nodes if name not in taken)


def build_graph(
    workflow: Workflow, catalogue: Catalogue, external: MakesCache, problems: Problems, stages: Sequence[str] = ()
) -> Graph:
    """Checks a workflow and resolves it.

    External files, which may be many gigabytes, are read only if all else is right, with the cache that `external`
    makes. Raises WorkflowError with all `problems`, including those found before, and CommandError if one of `stages`
    is not a stage of the workflow.
    """
    try:
        builder = _Builder(workflow, catalogue, problems)
        graph = builder.build()
        if not problems:
            graph.needed_for(stages)
            files = OutsideFiles(external(), problems)
            read = {name: files.digests(outside) for name, outside in builder.outside.items()}
            nodes = {name: replace(node, external=read[name]) for name, node in graph.nodes.items()}
            graph = replace(graph, nodes=nodes)
    finally:
        catalogue.remember()
    problems.raise_if_any()
    return graph


class _Builder:
    """Builds a graph without the digests of external files; `outside` says for each node what to read for them."""

    def __init__(self, workflow: Workflow, catalogue: Catalogue, problems: Problems) -> None:
        self.workflow = workflow
        self.catalogue = catalogue
        self.problems = problems
        self.outside: dict[str, dict[str, Outside]] = {}
        self.declarations: dict[str, Declaration | None] = {}
        self.wrong: list[WrongValue] = []

    def build(self) -> Graph:
        nodes: dict[str, Node] = {}
        for name in self.order():
            entry = self.workflow.entries[name]
            rows = {number: row for row, number in reversed(list(enumerate(entry.chosen)))}
            for number, instance in enumerate(entry.instances):
                node = self.node(entry, instance, rows[number])
                if node:
                    nodes[node.name] = node
        report(self.wrong, self.problems)
        return Graph(self.workflow.name, nodes)

    def order(self) -> list[str]:
        """Entries in the order of the file, but each after those that it refers to; a cycle is reported once."""
        entries = self.workflow.entries
        done: dict[str, None] = {}
        for first in entries:
            path = {} if first in done else {first: _references(entries[first])}  # with the references left to follow
            while path:
                name, references = next(reversed(path.items()))
                reference = next(references, None)
                if reference is None:
                    path.popitem()
                    done[name] = None
                elif reference.stage in path:
                    names = list(path)
                    circle = " → ".join([*names[names.index(reference.stage) :], reference.stage])
                    self.problems.add(reference.place, f"stages depend on each other in a circle: {circle}")
                elif reference.stage in entries and reference.stage not in done:
                    path[reference.stage] = _references(entries[reference.stage])
        return list(done)

    def node(self, entry: Entry, instance: Instance, index: int) -> Node | None:
        declaration = self.declared(instance)
        if declaration is None:
            for references in instance.inputs.values():
                for reference in references:
                    self.resolve(entry, reference, index)
            return None
        sources = self.sources(entry, instance, index, declaration)
        paths = {name: as_typed(path) for name, path in instance.parameters.items() if name in declaration.external}
        instance = replace(instance, parameters={**instance.parameters, **paths})
        arguments = self.arguments(instance, declaration)
        for name, path in paths.items():
            check_there(name, path, self.problems)  # even if something else is wrong
        completed = self.completed(entry, instance, arguments)
        if completed is None:
            return None
        code = self.code(instance, declaration, completed)
        if code is None:
            return None
        self.outside[instance.name] = self.paths(entry, instance, completed)
        return Node(
            name=instance.name,
            declaration=declaration,
            sources=sources,
            labels={
                name: tuple(self.labels(entry, instance.inputs.get(name, ()), index))
                for name, port in declaration.inputs.items()
                if port.labelled
            },
            without_failed=instance.without_failed,
            arguments=arguments,
            parameters=completed.parameters,
            external={},
            outside_paths=tuple(path for paths in completed.external.values() for path in paths),
            code=code,
            private=instance.private,
            resources={**declaration.resources, **self.resources(instance)},
            unrepeatable=completed.unrepeatable,
        )

    def declared(self, instance: Instance) -> Declaration | None:
        uses = instance.uses.value
        if not isinstance(uses, str):
            return None
        if uses not in self.declarations:
            self.declarations[uses] = self.tried(instance.uses.place, uses)
        elif self.declarations[uses] is None:
            self.tried(instance.uses.place, uses)
        return self.declarations[uses]

    def tried(self, place: Place, uses: str) -> Declaration | None:
        try:
            return self.catalogue.declaration(uses)
        except UserError as error:
            self.problems.add(place, str(error))
            return None

    def sources(
        self, entry: Entry, instance: Instance, index: int, declaration: Declaration
    ) -> dict[str, tuple[Source, ...]]:
        for name in instance.inputs:
            if name not in declaration.inputs:
                place = entry.input_places.get(name, entry.inputs_place)
                allowed = ", ".join(declaration.inputs) or "none"
                hint = nearest(name, declaration.inputs)
                self.problems.add(place, f"{declaration.uses} has no input {name!r}; it has {allowed}{hint}")
                for reference in instance.inputs[name]:
                    self.resolve(entry, reference, index)
        sources: dict[str, tuple[Source, ...]] = {}
        for name, port in declaration.inputs.items():
            references = instance.inputs.get(name)
            sources[name] = ()
            if references is None:
                if not port.optional and name not in entry.input_places:
                    self.problems.add(
                        entry.inputs_place, f"input {name!r} of {entry.name!r} (kind {port.kind}) is missing"
                    )
                continue
            place = entry.input_places.get(name, entry.inputs_place)
            if not port.many and name in instance.listed:
                self.problems.add(place, f"input {name!r} takes one artifact; found a list")
            found = [self.resolve(entry, reference, index, port) for reference in references]
            sources[name] = tuple(source for group in found for source in group)
            if name in instance.without_failed and not port.many:
                self.problems.add(place, f"input {name!r} takes one artifact; 'without_failed' is only for lists")
            if not port.many and any(len(group) > 1 for group in found):
                message = f"input {name!r} takes one artifact; found all {len(sources[name])} items of a foreach"
                self.problems.add(references[0].place, f"{message} (only stages with the same foreach are paired)")
        return sources

    def resolve(self, entry: Entry, reference: Reference, index: int, port: Input | None = None) -> list[Source]:
        """The outputs that a reference stands for: one for each row of a foreach, or only that of the same row."""
        target = self.workflow.entries.get(reference.stage)
        if target is None:
            known = ", ".join(self.workflow.entries)
            hint = nearest(reference.stage, self.workflow.entries)
            self.problems.add(reference.place, f"no stage {reference.stage!r}; there are {known}{hint}")
            return []
        chosen = target.chosen[index : index + 1] if entry.goes_with(target) else target.chosen
        return [source for number in chosen for source in self.output(target.instances[number], reference, port)]

    def labels(self, entry: Entry, references: Iterable[Reference], index: int) -> Iterator[Label]:
        """What each output that `references` stand for is about."""
        for reference in references:
            target = self.workflow.entries.get(reference.stage)
            if target is None or target.rows is None:
                yield Label(reference.stage, {})
                continue
            texts = target.rows.labels(target.rows.columns)
            for number in (index,) if entry.goes_with(target) else range(len(texts)):
                yield Label(texts[number], target.rows.plain[number])

    def output(self, instance: Instance, reference: Reference, port: Input | None) -> list[Source]:
        declaration = self.declared(instance)
        if declaration is None:
            return []
        outputs, name = declaration.outputs, reference.output
        listed = ", ".join(f"{reference.stage}.{output}" for output in outputs) or "none"
        if name is None and len(outputs) != 1:
            self.problems.add(reference.place, f"{reference.stage!r} has several outputs; choose one of {listed}")
            return []
        name = name if name is not None else next(iter(outputs))
        if name not in outputs:
            message = f"{reference.stage!r} has no output {name!r}; there are {listed}{nearest(name, outputs)}"
            self.problems.add(reference.place, message)
            return []
        if port is not None and not port.takes(outputs[name].kind):
            self.problems.add(
                reference.place,
                f"{reference.stage}.{name} is of kind {outputs[name].kind}; this input takes kind {port.kind}",
            )
        return [Source(instance.name, name)]

    def arguments(self, instance: Instance, declaration: Declaration) -> dict[str, Json]:
        return {
            name: absolute(value) if name in declaration.external else value.plain
            for name, value in instance.parameters.items()
        }

    def completed(self, entry: Entry, instance: Instance, arguments: Mapping[str, Json]) -> Completed | None:
        uses = str(instance.uses.value)
        try:
            completed = self.catalogue.complete(uses, arguments)
        except (UserError, ValueError, TypeError) as error:
            self.problems.add(instance.uses.place, str(error))
            return None
        if isinstance(completed, Completed):
            return None if instance.broken else completed
        for refusal in completed:
            first = str(refusal.path[0]) if refusal.path else ""
            if first in instance.broken:
                continue
            place, message = entry.parameters_place, refusal.message
            if first in instance.parameters:
                value = instance.parameters[first].at(refusal.path[1:])
                known = len(refusal.path) > 1 or not message.startswith("unknown")
                place = value.place if known else entry.parameter_places.get(first, value.place)
                message = wanting_text(refusal.name, message, value) if refusal.text_wanted else message
            if refusal.path and not refusal.missing:
                self.wrong.append(WrongValue(place, entry.name, refusal.name, message))
            else:
                self.problems.add(place, f"{message} [{entry.name}]" if refusal.missing else message)
        return None

    def paths(self, entry: Entry, instance: Instance, completed: Completed) -> dict[str, Outside]:
        """The external paths that each parameter holds, given by the workflow or by default."""
        given = instance.parameters
        return {
            name: Outside(paths, given[name].place if name in given else entry.parameters_place)
            for name, paths in completed.external.items()
        }

    def code(self, instance: Instance, declaration: Declaration, completed: Completed) -> Code | None:
        try:
            code = self.catalogue.code(declaration.uses, completed.modules)
        except UserError as error:
            self.problems.add(instance.uses.place, str(error))
            return None
        for found in hidden_imports(code, declaration, self.catalogue.package):
            self.problems.add(instance.uses.place, f"the code of {declaration.uses} {found}")
        return code

    def resources(self, instance: Instance) -> dict[str, float]:
        """What the stage needs according to the workflow, which overrides its declaration."""
        needed: dict[str, float] = {}
        for name, value in instance.resources.items():
            try:
                needed[name] = amount(name, value.plain)
            except UserError as error:
                self.problems.add(value.place, str(error))
        return needed


def _references(entry: Entry) -> Iterator[Reference]:
    """Everything that an entry refers to, in all its rows."""
    return (reference for each in entry.instances for group in each.inputs.values() for reference in group)
