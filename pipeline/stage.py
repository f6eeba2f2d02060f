"""What a stage is: a function with declared inputs, outputs and parameters, and the context that it runs in.

    class BlurParameters(Parameters):
        radius: float = Field(2.0, gt=0, description="Radius of the blur, in pixels.")

    @stage(inputs={"picture": Input("image")}, outputs={"blurred": Output("image")}, version=1)
    def blur(context: Context, parameters: BlurParameters) -> None:
        picture = context.input("picture").read("pixels")
        context.output("blurred").write("pixels", gaussian(picture, parameters.radius))

If `stages/blur.py` defines this, a workflow can use it with `uses: blur`.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.canonical import Json, plain
from pipeline.errors import ArtifactError, Interrupted, UserError
from pipeline.resources import amounts

Privacy = Literal["inherit", "private", "public"]
InputValue = Artifact | tuple[Artifact, ...] | None


class Parameters(BaseModel):
    """Base of a stage's parameters: frozen, no unknown names, no conversions but int to float, only finite numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, validate_default=True, protected_namespaces=()
    )


class ExternalMarker:
    """Marks a parameter's type as the path of something outside the store."""


ExternalPath = Annotated[Path, ExternalMarker()]
"""A file or folder outside the store. Its names and bytes are part of the action's key, its path is not."""


@dataclass(frozen=True)
class Input:
    """An artifact that a stage takes, or with `many`, a tuple of any number of them, in order.

    `kind` names one kind or several: "container or splats". An input that is `labelled`, which requires `many`, also
    says what each artifact is about, and which are missing because they failed: see `Context.items`. Both are then part
    of the action's key.
    """

    kind: str
    many: bool = False
    optional: bool = False
    labelled: bool = False

    def takes(self, kind: str) -> bool:
        """Whether the input accepts artifacts of this kind."""
        return kind in self.kind.split(" or ")


@dataclass(frozen=True)
class Output:
    """An artifact that a stage makes.

    Its privacy is `private`; `inherit`: private if an input is; or `public`: declared safe to publish by the stage's
    author, whatever the inputs are. If the workflow says `private: true` for the stage, all its outputs are private.
    """

    kind: str
    privacy: Privacy = "inherit"


@dataclass(frozen=True)
class Item:
    """What one artifact of a labelled input is about: a row of a `foreach`, or a stage without one.

    `label` is the row's short name, `values` the row itself, empty without a `foreach`. `stage` is the stage's name in
    the workflow, as in `Context.lineage`. If the stage failed, `artifact` is None and `cause` says why, on one line and
    in the same words every time for the same failure.
    """

    label: str
    values: Mapping[str, Json]
    stage: str
    artifact: Artifact | None
    cause: str | None = None


@dataclass(frozen=True)
class LineageRecord:
    """One action that something was made from, as a report shows it.

    `name` is the stage's name in the workflow, `uses` its kind, `inputs` the names of the stages that it took artifacts
    from, `seconds` how long it ran. `facts` describe the machine, and what the stage recorded; `versions` are those of
    Python and the libraries, `parameters` all except external paths. `private`: any of the `outputs` (digests) is.
    """

    name: str
    uses: str
    seconds: float
    inputs: tuple[str, ...]
    facts: Mapping[str, Json]
    versions: Mapping[str, str]
    parameters: Mapping[str, Json]
    private: bool
    outputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finished:
    """A stage that has just ended: what it took, what it made, and the facts that it recorded."""

    inputs: Mapping[str, InputValue]
    outputs: Mapping[str, Artifact]
    facts: Mapping[str, Json]

    def input(self, name: str) -> Artifact:
        """The artifact of an input that takes one. Raises TypeError if it was given none, or takes many."""
        return _one(name, self.inputs[name])


@dataclass(frozen=True)
class Remark:
    """What a person should know about a result although nothing failed: shown at once, and again when the run ends.

    `details` go only to the stage's log: they may be long, or private. A remark that is `as_wished` is not repeated: at
    the end of many stages, it would bury the others.
    """

    text: str
    details: str = ""
    as_wished: bool = False


@dataclass(frozen=True)
class Services:
    """What the engine does for a running stage, as described in `Context`; the defaults do nothing."""

    progress: Callable[[float, float, Mapping[str, float]], None] = lambda done, total, figures: None
    log: Callable[[str], None] = lambda text: None
    stop_requested: Callable[[], bool] = lambda: False
    lineage: Callable[[], tuple[LineageRecord, ...]] = tuple
    command: str = ""
    saved: Callable[[str | None], None] = lambda problem: None


class Context:
    """What a stage is given besides its parameters. `scratch` is a private folder that outlives an interruption."""

    def __init__(
        self,
        inputs: Mapping[str, InputValue],
        outputs: Mapping[str, ArtifactWriter],
        scratch: Path,
        workflow_name: str,
        services: Services,
        items: Mapping[str, tuple[Item, ...]] | None = None,
    ) -> None:
        self.inputs = inputs
        self._items = items or {}
        self.scratch = scratch
        self.workflow_name = workflow_name
        self.facts: dict[str, Json] = {}
        self.seconds_before = 0.0
        self._outputs = outputs
        self._services = services

    def input(self, name: str) -> Artifact:
        """The artifact of an input that takes one. Raises TypeError if it was given none, or takes many."""
        return _one(name, self.inputs[name])

    def input_many(self, name: str) -> tuple[Artifact, ...]:
        """The artifacts of a `many` input, in order; empty if it is optional and not given.

        Raises TypeError for an input without `many`.
        """
        value = self.inputs[name]
        if not isinstance(value, tuple):
            raise TypeError(f"input {name!r} is not declared with many=True")
        return value

    def items(self, name: str) -> tuple[Item, ...]:
        """What the artifacts of a labelled input are about, in order, including failed ones; empty if not given.

        Raises TypeError for an input that is not labelled.
        """
        if name not in self._items:
            raise TypeError(f"input {name!r} is not declared with labelled=True")
        return self._items[name]

    def input_optional(self, name: str) -> Artifact | None:
        """The artifact of an optional input; None if the workflow gives none. Raises TypeError for a `many` input."""
        value = self.inputs[name]
        if isinstance(value, tuple):
            raise TypeError(f"input {name!r} is declared with many=True; use input_many")
        return value

    def output(self, name: str) -> ArtifactWriter:
        """The writer of an output. Raises KeyError if no output of that name is declared."""
        if name not in self._outputs:
            raise KeyError(f"no output {name!r} is declared; declared: {', '.join(self._outputs)}")
        return self._outputs[name]

    def check_outputs(self) -> None:
        """Raises ArtifactError if nothing was written to a declared output."""
        for name, writer in self._outputs.items():
            if writer.untouched:
                raise ArtifactError(f"the stage wrote nothing to its output {name!r}")

    def progress(self, done: float, total: float, **figures: float) -> None:
        """Reports how far the stage is, with current figures such as `psnr=22.1`; cheap enough for every iteration."""
        self._services.progress(done, total, figures)

    def log(self, text: str) -> None:
        """Writes a line to the stage's log."""
        self._services.log(text)

    def stop_requested(self) -> bool:
        """Whether a long loop should save a checkpoint in `scratch` and raise `pipeline.errors.Interrupted`."""
        return self._services.stop_requested()

    def stop_if_requested(self) -> None:
        """Raises Interrupted if the stage should stop: for loops that have nothing to save."""
        if self.stop_requested():
            raise Interrupted("stopped; it will start over next time")

    def progress_or_stop(self, done: float, total: float, **figures: float) -> None:
        """Reports how far the stage is, as `progress` does. Raises Interrupted as `stop_if_requested` does."""
        self.progress(done, total, **figures)
        self.stop_if_requested()

    def saved(self, problem: str | None) -> None:
        """Reports why a checkpoint could not be saved, or None if it was: a person is told while the stage goes on."""
        self._services.saved(problem)

    def worked_before(self, seconds: float) -> None:
        """Reports how long the work in a checkpoint took, in seconds: they are added to the stage's own."""
        self.seconds_before = seconds

    def record(self, **facts: Json) -> None:
        """Records facts with the result, not in it, such as the device's name or timings.

        Raises TypeError or ValueError for values that JSON cannot represent.
        """
        self.facts |= {name: plain(value, f"fact {name!r}") for name, value in facts.items()}

    def lineage(self) -> tuple[LineageRecord, ...]:
        """The actions that the inputs come from, each after those that it took artifacts from."""
        return self._services.lineage()

    @property
    def command(self) -> str:
        """The command that runs the workflow as it is being run, without this machine's paths; empty if unknown.

        It is not part of any key: a cached result may show the command of an earlier run.
        """
        return self._services.command


def _one(name: str, value: InputValue) -> Artifact:
    if not isinstance(value, Artifact):
        raise TypeError(f"input {name!r} is not one artifact; use input_many or input_optional")
    return value


StageFunction = Callable[[Context, Any], None]


@dataclass(frozen=True)
class Stage:
    """A declared stage. Calling it runs the function alone, without the engine."""

    function: StageFunction
    parameters: type[Parameters]
    inputs: Mapping[str, Input]
    outputs: Mapping[str, Output]
    version: int
    modules: Callable[[Any], list[str]] | None = None
    alone: bool = False
    resources: Mapping[str, float] = field(default_factory=dict)
    unrepeatable: Callable[[Any], bool] | None = None
    remarks: str | None = None
    unread: Mapping[str, Mapping[str, Json]] = field(default_factory=dict)
    name: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.function.__name__)

    def __call__(self, context: Context, parameters: Parameters) -> None:
        """Runs the function. Raises what it raises, and ArtifactError if it leaves an output unwritten."""
        self.function(context, parameters)
        context.check_outputs()


def stage(
    *,
    inputs: Mapping[str, Input],
    outputs: Mapping[str, Output],
    version: int,
    modules: Callable[[Any], list[str]] | None = None,
    alone: bool = False,
    resources: Mapping[str, float | str] | None = None,
    unrepeatable: Callable[[Any], bool] | None = None,
    remarks: str | None = None,
    unread: Mapping[str, Mapping[str, Json]] | None = None,
) -> Callable[[StageFunction], Stage]:
    """Declares a function `(context, parameters)` as a stage; its annotation gives the type of the parameters.

    Raise `version` when results change for a reason that no source file shows. `modules` returns the names of the
    first-party modules that the stage imports dynamically, as its parameters select: they join its code fingerprint. No
    other stage of a run runs beside one that is `alone` because it measures time. `resources` is what the stage cannot
    do without while it runs, such as `{"memory": "8 GiB"}`, or `{"gpu": 1}` if there is no other way; a workflow may
    override it. Neither of these two is in the key. Raises TypeError if the declaration itself is wrong.

    Nor are the others: `unrepeatable` says whether, with given parameters, the stage draws something that cannot be
    drawn again, such as a key, which no run replaces unless a person has given it up. `unread` names inputs that the
    stage does not read if parameters have the given values: `{"key": {"level": 0}}`. `remarks`, such as
    "stages.scene.remarks:photos_left_out", names the function that turns a `Finished` into a tuple of `Remark`.
    """

    def declare(function: StageFunction) -> Stage:
        for name in (*inputs, *outputs):
            if not name.isidentifier():
                raise TypeError(f"stage {function.__name__}: {name!r} cannot name an input or output")
        try:
            needed = amounts(resources or {})
        except UserError as error:
            raise TypeError(f"stage {function.__name__}: {error}") from error
        model = _parameters_of(function)
        for name, port in inputs.items():
            if port.labelled and not port.many:
                raise TypeError(f"stage {function.__name__}: the labelled input {name!r} is not declared many=True")
        ports = dict(inputs), dict(outputs)
        return Stage(function, model, *ports, version, modules, alone, needed, unrepeatable, remarks, unread or {})

    return declare


def _parameters_of(function: StageFunction) -> type[Parameters]:
    arguments = list(inspect.signature(function).parameters)
    if len(arguments) != 2:
        raise TypeError(f"stage {function.__name__} takes {arguments}; expected (context, parameters)")
    model = typing.get_type_hints(function).get(arguments[1])
    if not (isinstance(model, type) and issubclass(model, Parameters)):
        raise TypeError(f"stage {function.__name__}: annotate {arguments[1]!r} with a subclass of Parameters")
    for name, information in model.model_fields.items():
        if not information.description:
            raise TypeError(f"{model.__name__}.{name} has no description; give it Field(description=…)")
    return model


def output_is_private(output: Output, from_input: bool, said: bool) -> bool:
    """Whether an output is private, given whether an input is (`from_input`) or the workflow says so (`said`)."""
    return said or output.privacy == "private" or (output.privacy == "inherit" and from_input)


def bind_inputs(declared: Stage, given: Mapping[str, InputValue]) -> dict[str, InputValue]:
    """A value for every declared input; None, or () for `many`, if an optional one is not given.

    Raises TypeError for an input that is unknown, missing, or of the wrong shape or kind.
    """
    for name in given:
        if name not in declared.inputs:
            raise TypeError(f"stage {declared.name} has no input {name!r}; it has {', '.join(declared.inputs)}")
    values: dict[str, InputValue] = {}
    for name, port in declared.inputs.items():
        value = given.get(name)
        if value is None and port.many and port.optional:
            value = ()
        if value is None and not port.optional:
            raise TypeError(f"stage {declared.name}: input {name!r} is missing")
        if value is not None and isinstance(value, tuple) != port.many:
            raise TypeError(f"stage {declared.name}: input {name!r} takes {'a tuple' if port.many else 'one artifact'}")
        for artifact in _artifacts({name: value}):
            if not port.takes(artifact.kind):
                raise TypeError(f"stage {declared.name}: input {name!r} takes a {port.kind}, not a {artifact.kind}")
        values[name] = value
    return values


def _artifacts(values: Mapping[str, InputValue]) -> list[Artifact]:
    listed = [value if isinstance(value, tuple) else (value,) for value in values.values()]
    return [artifact for group in listed for artifact in group if artifact is not None]
