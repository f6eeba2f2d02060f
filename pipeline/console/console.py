"""What all commands share: their options, and how errors are reported."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.console.completion import (
    complete_artifact,
    complete_setting,
    complete_stage,
    complete_vars,
    complete_workflow,
)
from pipeline.console.output import named_output, write_no_more
from pipeline.disk import words_of
from pipeline.errors import PipelineError, UserError
from pipeline.plain_text import without_controls
from pipeline.store.external import from_home

if TYPE_CHECKING:
    from pipeline.store.store import Store

WorkflowFile = Annotated[
    Path,
    typer.Argument(metavar="WORKFLOW", help="The workflow file.", show_default=False, autocompletion=complete_workflow),
]
StageName = Annotated[
    str,
    typer.Argument(
        metavar="STAGE", help="A stage, or one item of it.", show_default=False, autocompletion=complete_stage
    ),
]
StageToAccept = Annotated[
    str | None,
    typer.Argument(
        metavar="STAGE",
        help="Only this stage, or one item of it.",
        show_default=False,
        autocompletion=complete_stage,
    ),
]
StageNames = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="STAGE", help="Only these and what they need.", show_default=False, autocompletion=complete_stage
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Sets a var, or a parameter as STAGE.PARAMETER. Repeatable.",
        autocompletion=complete_setting,
    ),
]
VarsFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--vars",
        metavar="FILE",
        help="Sets vars from a YAML file; later files override earlier ones, --set overrides all. Repeatable.",
        autocompletion=complete_vars,
    ),
]
StoreAddress = Annotated[
    str,
    typer.Option(
        "--store",
        metavar="DIR",
        envvar="GS_HIDER_STORE",
        help="Where results are kept: a folder or s3://BUCKET/PREFIX.",
    ),
]
Package = Annotated[str, typer.Option("--stages", metavar="PACKAGE", help="The package whose modules are the stages.")]
Json = Annotated[bool, typer.Option("--json", help="Prints one JSON object per line.")]
ArtifactName = Annotated[
    str,
    typer.Argument(
        metavar="ARTIFACT",
        help="WORKFLOW/STAGE.OUTPUT as in the store's folder `latest` (or STAGE.OUTPUT, or STAGE, where that is "
        "unambiguous), at least 6 characters of a digest, or the path of an artifact.",
        show_default=False,
        autocompletion=complete_artifact,
    ),
]
Reveal = Annotated[
    bool,
    typer.Option("--reveal", help="Shows private contents, and allows writing them to public places."),
]


@contextmanager
def reported(store: Path | str) -> Iterator[None]:
    """Reports errors as messages, and exits: with 2 for bad input, 1 for other errors, 130 after Ctrl-C.

    Exceptions that are neither ours nor the system's are defects of the engine, and keep their traceback.
    """
    try:
        with named_output():
            yield
    except PipelineError as error:
        say(without_controls(str(error), allowed="\n"))  # it may quote names from a stranger's files
        raise typer.Exit(2 if isinstance(error, UserError) else 1) from None
    except BrokenPipeError:
        write_no_more(sys.stdout)
        raise typer.Exit(1) from None
    except OSError as error:
        say(without_controls(words_of(error, store if "://" in str(store) else from_home(store))))
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        say(f"Interrupted immediately; finished stages are kept. To continue: {command_line()}")
        raise typer.Exit(130) from None


def write_the_rest() -> None:
    """Flushes standard output, about which Python itself would complain at exit; exits with 1 if it cannot be written.

    If only its reader is gone, the exit status stays.
    """
    try:
        with named_output():
            pass
    except BrokenPipeError:
        write_no_more(sys.stdout)
    except PipelineError as error:
        say(str(error))
        raise SystemExit(1) from None


def say(text: str) -> None:
    """Prints a message to standard error."""
    print(text, file=sys.stderr, flush=True)


def near(path: Path) -> Path:
    """The path as one would type it here: relative if it is below the current folder."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def where_it_is(store: Store) -> str:
    """A sentence that says where a store is, and whether it exists."""
    from pipeline.store.absent_store import AbsentStore

    where = store.address if "://" in store.address else near(store.root)
    return f"The store is {where}{', which does not exist yet' if isinstance(store, AbsentStore) else ''}"


def command_line() -> str:
    """The command that is being executed, with the interpreter as it was named."""
    return _typed(sys.argv[1:])


def command_line_with(context: typer.Context, **others: str | None) -> str:
    """The command that is being executed, with `others` in place of the values that were given for these parameters.

    A parameter whose other value is None is left out.
    """
    words = [str(context.info_name)]
    for parameter in context.command.params:
        name = str(parameter.name)
        source = context.get_parameter_source(name)
        if source is None or source.name != "COMMANDLINE":
            continue
        value = others.get(name, context.params[name])
        if value is None:
            continue
        option = [parameter.opts[0]] if parameter.param_type_name == "option" else []
        for each in value if isinstance(value, list | tuple) else [value]:
            words += option if each is True else [*option, str(each)]
    return _typed(words)


def _typed(words: Sequence[str]) -> str:
    """The words of a command as one would type it in a shell."""
    return shlex.join([sys.orig_argv[0], "-m", "pipeline", *words])
