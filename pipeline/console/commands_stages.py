"""`stages`: what a workflow can use, and what each stage takes, makes and can be told."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from pipeline.console.completion import complete_uses
from pipeline.console.console import Json, Package, reported


def stages(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", help="A stage, as in `uses: NAME`.", show_default=False, autocompletion=complete_uses
        ),
    ] = None,
    as_json: Json = False,
    package: Package = "stages",
) -> None:
    """Lists the stages that a workflow can use; of one, shows what it takes and makes, and its parameters.

    \b
    python -m pipeline stages
    python -m pipeline stages hide_scenes
    python -m pipeline stages hide_scenes --json
    """
    with reported("store"):
        from pipeline.code.manual import manual, summaries
        from pipeline.console.stage_words import lines_of_manual, lines_of_summaries

        if name is None:
            found = summaries(package)
            if as_json:
                for each, summary in found.items():
                    print(json.dumps({"event": "stage_summary", "name": each, "summary": summary}))
            else:
                print("\n".join(lines_of_summaries(found)))
        elif as_json:
            print(json.dumps(manual(package, name).as_json()))
        else:
            print("\n".join(lines_of_manual(manual(package, name))))
