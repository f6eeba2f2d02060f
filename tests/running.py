"""Running one stage without a workflow, a plan or a store."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pipeline.artifact import Artifact, ArtifactWriter, publish
from pipeline.stage import Context, InputValue, Item, Parameters, Services, Stage, bind_inputs, output_is_private


def run_stage(
    declared: Stage,
    parameters: Parameters,
    inputs: Mapping[str, Artifact | tuple[Artifact, ...]],
    directory: Path,
    *,
    services: Services | None = None,
    workflow_name: str = "test",
    private: bool = False,
    items: Mapping[str, tuple[Item, ...]] | None = None,
) -> dict[str, Artifact]:
    """Runs a stage without the engine and returns its outputs, each in `directory/<output>`.

    `items` are those of the labelled inputs; by default, their artifacts are labelled by number. Raises what the stage
    raises, and TypeError if the inputs are not those that it declares.
    """
    values = bind_inputs(declared, inputs)
    artifacts = {name: _listed(value) for name, value in values.items()}
    from_input = any(artifact.private for listed in artifacts.values() for artifact in listed)
    writers = {
        name: ArtifactWriter(directory / f".{name}", output.kind, output_is_private(output, from_input, private))
        for name, output in declared.outputs.items()
    }
    scratch = directory / ".scratch"
    scratch.mkdir(parents=True, exist_ok=True)
    numbered = {
        name: tuple(Item(str(number), {}, name, artifact) for number, artifact in enumerate(listed))
        for name, listed in artifacts.items()
        if declared.inputs[name].labelled
    }
    context = Context(values, writers, scratch, workflow_name, services or Services(), {**numbered, **(items or {})})
    declared(context, parameters)
    return {name: publish(writer.finish(), directory / name) for name, writer in writers.items()}


def _listed(value: InputValue) -> tuple[Artifact, ...]:
    if value is None:
        return ()
    return value if isinstance(value, tuple) else (value,)
