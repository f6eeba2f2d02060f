"""The command line: `python -m pipeline run | status | explain | accept | graph | stages | show | export | verify | …`.

Each command imports what it needs only when it is called. So help and shell completion, for which a person waits, load
neither the engine nor any numeric library.
"""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from pathlib import Path

import typer

from pipeline.console.bash_words import whole_words
from pipeline.console.commands_plan import accept, explain, graph, status
from pipeline.console.commands_results import export, show
from pipeline.console.commands_run import run
from pipeline.console.commands_stages import stages
from pipeline.console.commands_store import gc, pin, pins, unpin, verify
from pipeline.console.console import write_the_rest
from pipeline.console.output import open_closed_streams, spell_what_cannot_be_printed
from pipeline.run.process import set_thread_policy

COMMAND = "gs-hider"  # another name of the same program, which a shell can complete

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="""Runs workflows of stages, keeps every result, and repeats only what changed.

    \b
    python -m pipeline run workflows/hide_multi.yaml                  run it, or the part that is missing
    python -m pipeline status workflows/hide_multi.yaml               what is done, and what would run
    python -m pipeline explain workflows/hide_multi.yaml hide         why a stage would run
    python -m pipeline stages hide_scenes                             what a stage takes and makes; its parameters
    python -m pipeline show hide_multi/sealed.container               what came out, and how it was made
    python -m pipeline show hide_multi/cover.scene --pictures seen    its pictures as PNG files
    python -m pipeline gc --dry-run                                   what is no longer needed

    `COMMAND --help` shows more. The program is also called gs-hider: `gs-hider --install-completion` teaches your shell
    to complete workflows, stages, settings and results.
    """,
    context_settings={"max_content_width": 120},
)

for command in (run, status, explain, accept, graph, stages, show, export, verify, gc, pin, unpin, pins):
    app.command()(command)


def main() -> None:
    """Runs the command line, or answers a shell that asks for completions."""
    open_closed_streams()
    spell_what_cannot_be_printed()
    set_thread_policy()
    by_name = Path(sys.argv[0]).name == COMMAND or any(word.endswith("-completion") for word in sys.argv[1:2])
    asked_by_bash = os.environ.get(f"_{COMMAND.replace('-', '_').upper()}_COMPLETE") == "complete_bash"
    with whole_words(os.environ) if asked_by_bash else nullcontext():
        try:
            app(prog_name=COMMAND if by_name else "python -m pipeline")
        finally:
            write_the_rest()
