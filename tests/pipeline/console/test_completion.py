"""Shell completion: by the functions in this process, and by the program as bash calls it."""

from __future__ import annotations

import os
import pty
import select
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.code.declared_parameters import declared_parameters
from tests.pipeline.helpers import CHAIN, TOYS, Workspace

ROOT = Path(__file__).parents[3]
PROGRAM = "import sys; sys.argv = ['gs-hider']; from pipeline.cli import main; main()"

METHODS = ("decoder", "gs_hider", "homogeneous", "plain", "sh")
CHOICE = """
    vars: {count: 3, way: user, cover: null}
    stages:
      base: {uses: numbers, with: {count: "${count}", file: "${cover}"}}
      bad:  {uses: fail, in: {numbers: base}, with: {how: "${way}"}}
    """


@pytest.fixture
def here(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    """A current folder with a workflow that ran, and a folder `workflows`."""
    workspace.write(CHAIN).run()
    (workspace.folder / "workflows").mkdir()
    (workspace.folder / "workflows" / "hide.yaml").write_text("stages: {}\n")
    monkeypatch.chdir(workspace.folder)
    monkeypatch.delenv("GS_HIDER_STORE", raising=False)
    return workspace


def offered(line: str) -> list[str]:
    """What is offered for the last word of a line, in this process."""
    words = ["gs-hider", *line.split(" ")]
    environment = {
        "COMP_WORDS": " ".join(words),
        "COMP_CWORD": str(len(words) - 1),
        "_GS_HIDER_COMPLETE": "complete_bash",
    }
    result = CliRunner().invoke(app, prog_name="gs-hider", env=environment)
    assert (result.exit_code, result.stderr) == (0, "")
    return result.stdout.split()


def test_commands() -> None:
    assert offered("s") == ["status", "stages", "show"]
    assert "--keep-last" in offered("gc --")


def test_workflow_files(here: Workspace) -> None:
    assert offered("run w") == ["workflow.yaml", "workflows/", "workflows/hide.yaml"]
    assert "store/" in offered("run ")
    assert offered("status workflows/h") == ["workflows/hide.yaml"]
    assert offered("graph nowhere/h") == []


def test_stages(here: Workspace) -> None:
    assert offered("run workflow.yaml ") == ["base", "twice", "other", "sum"]
    assert offered("explain workflow.yaml t") == ["twice"]
    assert offered("pin workflow.yaml su") == ["sum"]


def test_stages_that_a_workflow_can_use() -> None:
    assert offered("stages hide_") == ["hide_image", "hide_scenes"]
    assert offered(f"stages --stages {TOYS} sc") == ["scale"]
    assert offered("stages --stages no.such sc") == []


def test_settings(here: Workspace) -> None:
    assert offered("run workflow.yaml --set ") == ["count=3", "factor=2.0", "base.", "twice.", "other.", "sum."]
    assert offered("run workflow.yaml --set co") == ["count=3"]
    assert offered(f"run workflow.yaml --stages {TOYS} --set twice.") == ["twice.factor="]
    assert offered(f"status --stages {TOYS} workflow.yaml --set base.f") == ["base.first=", "base.file="]
    assert offered("run workflow.yaml --set nosuch.") == []


def test_files_of_vars(here: Workspace) -> None:
    (here.folder / "workflows/profiles").mkdir()
    (here.folder / "workflows/profiles/cpu.yaml").write_text("count: 5\n")
    assert offered("run workflow.yaml --vars w") == ["workflow.yaml", "workflows/", "workflows/profiles/cpu.yaml"]
    assert offered("run workflow.yaml --vars workflows/profiles/") == ["workflows/profiles/cpu.yaml"]
    assert offered("run workflow.yaml --vars workflows/profiles/cpu.yaml --set co") == ["count=3"]
    assert offered("run --vars workflows/profiles/cpu.yaml workflow.yaml --set co") == ["count=3"]


def test_parameters_of_a_base_class_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    found = offered("run workflows/hide_multi.yaml --set hide.")
    assert {"hide.lambda_message=", "hide.iterations=", "hide.threads="} <= set(found)
    assert {"hide.model_config=", "hide.hides_scenes="}.isdisjoint(found)


@pytest.mark.parametrize(
    ("annotation", "choices"),
    [
        ("bool", ["true", "false"]),
        ("Literal[1, 4] | None", ["1", "4"]),
        ("Depth", ["shallow", "deep"]),
        ("Depth | bool", ["shallow", "deep", "true", "false"]),
        ('Annotated[str, ModuleIn("mine.layers")]', ["clay", "sand"]),
        ("float", []),
        ("dict[str, Literal['a', 'b']]", []),
        ("Nowhere", []),
    ],
)
def test_values_of_an_annotation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, annotation: str, choices: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine/layers").mkdir(parents=True)
    for name in ("sand", "clay", "__init__"):
        (tmp_path / f"mine/layers/{name}.py").touch()
    (tmp_path / "mine/names.py").write_text("Depth = Literal['shallow', 'deep']\n")
    (tmp_path / "mine/dig.py").write_text(
        f"from mine.names import Depth\nclass P(Parameters):\n    depth: {annotation}\ndef dig(context, p: P): ...\n"
    )
    assert declared_parameters("mine", "dig")["depth"].choices == choices


def test_values_where_there_are_a_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of real stages, whose types list the choices in place or have a name."""
    monkeypatch.chdir(ROOT)
    run = "run workflows/hide_photos.yaml --set"
    assert offered(f"{run} hide.method=") == [f"hide.method={name}" for name in METHODS]
    assert offered(f"{run} hide.method=s") == ["hide.method=sh"]
    assert offered(f"{run} method=") == [f"method={name}" for name in METHODS]
    assert offered(f"{run} scores.lpips=") == [f"scores.lpips={name}" for name in ("vgg", "alex", "both", "none")]
    assert offered(f"{run} hide.iterations=") == []
    assert offered(f"{run} cover=.") == []


def test_artifacts_pins_and_workflows_that_ran(here: Workspace) -> None:
    assert offered("show chain/su") == ["chain/sum.key", "chain/sum.page", "chain/sum.total"]
    assert offered("export sum.k") == ["sum.key"]
    (here.folder / "store/pins").mkdir()
    (here.folder / "store/pins/paper.json").write_text("{}")
    assert offered("unpin p") == ["paper"]
    assert offered("gc --forget c") == ["chain"]
    assert offered("gc --store nowhere --forget c") == []


@pytest.mark.parametrize("text", ["", "{", "stages: 3", "vars: [1]\nstages: {a: }", "\x00"])
def test_a_broken_workflow_offers_nothing_and_says_nothing(here: Workspace, text: str) -> None:
    here.file.write_text(text)
    for line in ("run workflow.yaml x", "run workflow.yaml --set x", "run workflow.yaml --set a.x", "run nosuch.yaml "):
        assert offered(line) == []


def test_as_bash_calls_it(here: Workspace) -> None:
    """In a process that loads neither the engine nor any numerical library."""
    heavy = ("torch", "zarr", "numpy", "dask", "distributed", "rich", "pipeline.workflow.graph", "stages")
    script = (
        f"import atexit, sys; atexit.register(lambda: print([m for m in {heavy!r} if m in sys.modules]))\n{PROGRAM}"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": str(ROOT), "COMP_WORDS": "gs-hider\nrun\nworkflow.yaml\ntw", "COMP_CWORD": "3"}
        | {"_GS_HIDER_COMPLETE": "complete_bash"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ("twice\n[]\n", "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_a_shell(shell: str) -> None:
    """Even if the program is called as a module: the shell completes the command `gs-hider`."""
    done = subprocess.run(
        [sys.executable, "-m", "pipeline", "--show-completion", shell],
        cwd=ROOT,
        env={**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "gs-hider" in done.stdout
    assert "_GS_HIDER_COMPLETE" in done.stdout
    assert "python -m" not in done.stdout


@pytest.fixture
def program(here: Workspace, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A command `gs-hider` on the PATH, which completes, and otherwise only prints what it was called with."""
    program = here.folder / "bin" / "gs-hider"
    program.parent.mkdir()
    program.write_text(
        '#!/bin/sh\nif [ -z "$_GS_HIDER_COMPLETE" ]; then echo "called: $*"; exit; fi\n'
        f"exec {shlex.quote(sys.executable)} -c {shlex.quote(PROGRAM)}\n"
    )
    program.chmod(0o755)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    return program


def in_bash(*words: str) -> list[str]:
    """What bash offers for the last of the words into which it splits a line."""
    script = (
        'eval "$(_GS_HIDER_COMPLETE=source_bash gs-hider)"\n'
        'COMP_WORDS=(gs-hider "$@"); COMP_CWORD=$#\n'
        "$(complete -p gs-hider | sed 's/.*-F \\([^ ]*\\).*/\\1/') gs-hider\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(["bash", "--norc", "-c", script, "bash", *words], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split()


def test_in_a_real_bash(program: Path) -> None:
    """The script as bash runs it: the words of a line go in, completions come out."""
    assert in_bash("explain", "workflow.yaml", "tw") == ["twice"]


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["--set", "bad.how", "="], ["user", "defect", "death", "silence", "stranger"]),
        (["--set", "bad.how", "=", "de"], ["defect", "death"]),
        (["--set", "=", "bad.how", "=", "us"], ["user"]),
        (
            ["--set", "bad.ho"],
            ["bad.how=user", "bad.how=defect", "bad.how=death", "bad.how=silence", "bad.how=stranger"],
        ),
        (["--set", "bad.how=us"], ["bad.how=user"]),  # if = is not among COMP_WORDBREAKS
        (["--set", "way", "="], ["user", "defect", "death", "silence", "stranger"]),
        (["--set", "count", "="], ["3"]),
        (["--set", "cover", "="], []),
        (["--set", "bad.how", "=", "user", ""], ["base", "bad"]),
        (["--set", "count", "=", "3", "--set", "bad.how", "=", "us"], ["user"]),
        (["--store", "=", "s3", ":", "//bucket/a", "--set", "bad.how", "=", "us"], ["user"]),
        (["--set", "nosuch.how", "="], []),
    ],
)
def test_bash_parts_words_at_some_signs(here: Workspace, program: Path, words: list[str], offered: list[str]) -> None:
    """And replaces only the last part."""
    here.write(CHOICE)
    assert in_bash("run", "workflow.yaml", "--stages", TOYS, *words) == offered


def test_at_a_terminal(here: Workspace, program: Path) -> None:
    """What a person types, with Tab, and what the program is then called with."""
    here.write(CHOICE)
    typed = f"gs-hider run workflow.yaml --stages {TOYS} --set bad.ho\tus\t --set count=\t\n"
    screen = typed_into_bash('eval "$(_GS_HIDER_COMPLETE=source_bash gs-hider)"\n' + typed, until="called: ")
    assert f"called: run workflow.yaml --stages {TOYS} --set bad.how=user --set count=3" in screen


def typed_into_bash(text: str, until: str) -> str:
    """What is on the screen of a terminal with bash, once a whole line on it begins with `until`."""
    process, terminal = pty.fork()
    if process == 0:
        os.environ["TERM"] = "dumb"
        os.execvp("bash", ["bash", "--norc", "--noprofile"])
    try:
        os.write(terminal, text.encode())
        screen = ""
        while "\n" not in screen.partition(f"\n{until}")[2]:
            assert select.select([terminal], [], [], 60)[0], screen
            screen += os.read(terminal, 4096).decode().replace("\r", "")
        return screen
    finally:
        os.close(terminal)
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
