"""`show`, `export`, `verify`, `gc` and pins as a user meets them; a few in processes of their own, most in this one."""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from pipeline.artifact import create, load
from pipeline.cli import app
from pipeline.console.store_words import collection_words
from pipeline.disk import size_of
from pipeline.results import exporting, pictures
from pipeline.store import garbage
from pipeline.store.garbage import Collection, Rules, Waste, collect
from pipeline.store.store import Store
from tests.pipeline.helpers import CHAIN, TOYS, Workspace

ROOT = Path(__file__).parents[3]
PRIVATE = """
    name: hide
    stages:
      photos: {uses: numbers, private: true, with: {first: 8128}}
      open:   {uses: numbers}
    """


@pytest.fixture
def chain(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    monkeypatch.setenv("GS_HIDER_STORE", str(workspace.folder / "store"))
    workspace.write(CHAIN).run()
    return workspace


@pytest.fixture
def public_folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        Path(name).chmod(0o755)
        yield Path(name)


def call(*arguments: str | Path) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def process(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pipeline", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_show(chain: Workspace) -> None:
    done = process("show", "twice")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0] == "numbers  chain/twice.numbers"
    content = json.loads(call("show", "chain/twice.numbers", "--json").stdout)
    assert (content["event"], content["kind"], content["origin"]["made_by"]) == ("artifact", "numbers", "chain/twice")
    assert content["arrays"][0]["range"] == {"least": 0.0, "mean": 2.0, "greatest": 4.0, "nan": 0, "infinite": 0}
    wrong = call("show", "twise")
    assert (wrong.exit_code, wrong.stdout) == (2, "")
    assert "did you mean 'twice'" in wrong.stderr
    assert call("show", "sum").exit_code == 2


def test_show_of_damage_is_one_line(chain: Workspace) -> None:
    path = (chain.folder / "store/latest/chain/twice.numbers").resolve()
    next(path.glob("arrays.zarr/values/c/*")).unlink()
    done = call("show", "twice")
    assert (done.exit_code, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert "missing" in done.stderr


@pytest.mark.parametrize("command", [("show",), ("export", "copy")])
@pytest.mark.parametrize("damage", ["its file is missing", "its manifest is of another format"])
def test_damage_of_what_a_stranger_named_is_told_without_what_a_terminal_would_obey(
    tmp_path: Path, command: tuple[str, ...], damage: str
) -> None:
    with create(tmp_path / "artifact", "things") as writer:
        writer.write_file("x\x1b]0;owned\x07\x1b[31m.txt", "text")
    if damage == "its file is missing":
        next((tmp_path / "artifact").glob("x*.txt")).unlink()
    else:
        (tmp_path / "artifact/manifest.json").write_text(json.dumps({"format": "\x1b]0;owned\x07"}))
    done = call(command[0], tmp_path / "artifact", *(tmp_path / name for name in command[1:]))
    assert (done.exit_code, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert "?]0;owned?" in done.stderr
    assert done.stderr.removesuffix("\n").isprintable()


def test_show_into_a_closed_pipe(chain: Workspace) -> None:
    reader, writer = os.pipe()
    os.close(reader)  # closed before anything is written
    command = [sys.executable, "-m", "pipeline", "show", "twice"]
    done = subprocess.run(command, cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert done.stderr == ""


def test_pictures(chain: Workspace, tmp_path: Path, public_folder: Path) -> None:
    for name, private in (("seen", False), ("hidden", True)):
        with create(tmp_path / name, "views", private) as writer:
            writer.write("pictures", np.zeros((20, 16, 16, 3), np.uint8))
    done = call("show", tmp_path / "seen", "--pictures", public_folder / "out")
    assert (done.exit_code, len(list((public_folder / "out").iterdir()))) == (0, 16)
    assert f"16 of 20 pictures, in {public_folder / 'out'}; --all or --limit N writes more" in done.stderr
    refused = call("show", tmp_path / "hidden", "--pictures", public_folder / "hidden")
    assert (refused.exit_code, refused.stdout) == (2, "")
    assert "private" in refused.stderr
    assert not (public_folder / "hidden").exists()
    assert call("show", tmp_path / "hidden", "--pictures", tmp_path / "out", "--all").exit_code == 0
    assert len(list((tmp_path / "out").iterdir())) == 20
    assert call("show", tmp_path / "hidden", "--pictures", public_folder / "hidden", "--reveal").exit_code == 0
    modes = {stat.S_IMODE(path.stat().st_mode) for path in (public_folder / "hidden").iterdir()}
    assert (modes, stat.S_IMODE((public_folder / "hidden").stat().st_mode)) == ({0o600}, 0o700)
    assert "It contains no pictures." in call("show", "twice", "--pictures", tmp_path / "none").stderr


def test_private_results_leave_only_when_told(chain: Workspace, tmp_path: Path, public_folder: Path) -> None:
    chain.write(PRIVATE).run()
    shown = call("show", "hide/photos.numbers")
    assert "8128" not in shown.stdout
    assert "8128" in call("show", "hide/photos.numbers", "--reveal").stdout
    refused = call("export", "hide/photos", public_folder / "copy")
    assert (refused.exit_code, list(public_folder.iterdir())) == (2, [])
    (tmp_path / ".git").mkdir()
    assert "git work tree" in call("export", "hide/photos", tmp_path / "copy").stderr
    (tmp_path / ".git").rmdir()
    assert call("export", "hide/photos", tmp_path / "copy").exit_code == 0
    assert call("export", "hide/photos", public_folder / "copy", "--reveal").exit_code == 0
    assert load(public_folder / "copy").private
    assert stat.S_IMODE((public_folder / "copy").stat().st_mode) == 0o700
    assert call("export", "hide/open", public_folder / "open").exit_code == 0


def test_export(chain: Workspace, tmp_path: Path) -> None:
    done = process("export", "chain/twice", tmp_path / "copy")
    assert (done.returncode, done.stdout) == (0, "")
    np.testing.assert_array_equal(load(tmp_path / "copy").read("values"), [0, 2, 4])
    assert call("export", "twice", tmp_path / "copy").exit_code == 2
    assert call("export", "twice", tmp_path / "copy.zip").exit_code == 0
    assert call("export", "twice", tmp_path / "packed", "--zip").exit_code == 0
    assert (tmp_path / "packed").read_bytes() == (tmp_path / "copy.zip").read_bytes()
    assert call("show", tmp_path / "copy").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "module", "function"),
    [
        (("export", "chain/twice"), exporting, "new_file"),
        (("show", "chain/sum.page", "--pictures"), pictures, "make_folder"),
    ],
)
def test_a_full_stick_is_not_the_disk_of_the_store(
    chain: Workspace,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    module: ModuleType,
    function: str,
) -> None:
    """If writing to a file that is open fails, the system does not say which file it was."""

    def full(*anything: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module, function, full)
    monkeypatch.setattr(pictures, "pictures_of", lambda artifact: [pictures.Picture("report.html", None)])
    done = call(*arguments, tmp_path / "stick")
    assert (done.exit_code, f"no space left on the disk that holds {tmp_path}/stick: " in done.stderr) == (1, True)


def test_verify(chain: Workspace) -> None:
    done = process("verify")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("Everything is sound: 6 artifacts, 4 records, 6 links;")
    path = (chain.folder / "store/latest/chain/twice.numbers").resolve()
    next(path.glob("arrays.zarr/values/c/*")).write_bytes(b"")
    dry = call("verify", "--dry-run")
    assert (dry.exit_code, path.is_dir()) == (1, True)
    assert f"artifact {path.name[:12]} (chain/twice.numbers): arrays.zarr/values/c/0: 0 bytes; expected" in dry.stdout
    lines = [json.loads(line) for line in call("verify", "--json").stdout.splitlines()]
    assert [line["event"] for line in lines] == ["damaged", "damaged", "damaged", "summary"]
    assert (lines[0]["name"], lines[0]["stages"], lines[-1]["damaged"]) == (path.name, ["chain/twice.numbers"], 3)
    assert not path.is_dir()
    assert call("verify").exit_code == 0
    assert chain.run().states["twice"] == "ran"
    assert call("verify").exit_code == 0


def test_gc_and_pins(chain: Workspace) -> None:
    store = Store(chain.folder / "store")
    pinned = call("pin", chain.file, "twice", "--stages", TOYS, "--name", "paper")
    assert (pinned.exit_code, pinned.stderr) == (0, "2 results are pinned as paper; `unpin paper` releases them\n")
    assert call("pin", chain.file, "--stages", TOYS, "--name", "paper").exit_code == 2
    lacking = call("pin", chain.file, "--stages", TOYS, "--set", "factor=9")
    assert (lacking.exit_code, "some of these results are not in the store: twice, sum" in lacking.stderr) == (2, True)
    for factor in (3, 4):
        chain.run(f"factor={factor}")
    before = len(store.actions)
    dry = call("gc", "--dry-run", "--keep-last", "1")
    assert (dry.exit_code, len(store.actions)) == (0, before)
    assert "Would delete:" in dry.stdout
    assert "chain" in dry.stdout
    assert "pin paper: 2 results of chain" in dry.stdout
    done = process("gc", "--keep-last", "1", "--json")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert (done.returncode, lines[-1]["event"], lines[-1]["results_kept"]) == (0, "summary", 5)
    assert chain.plan("factor=2.0")["twice"].state == "cached"
    assert chain.plan("factor=3")["twice"].state == "run"
    assert [json.loads(line)["name"] for line in call("pins", "--json").stdout.splitlines()] == ["paper"]
    assert call("pins").stdout.startswith("paper  chain")
    assert call("unpin", "papre").exit_code == 2
    assert call("unpin", "paper").exit_code == 0
    assert call("pins").stdout == "Nothing is pinned.\n"
    call("gc", "--keep-last", "1")
    assert chain.plan("factor=2.0")["twice"].state == "run"
    assert call("gc", "--forget", "chian").exit_code == 2
    assert call("gc", "--forget", "chain").exit_code == 0
    assert not store.actions
    assert not store.objects


@pytest.mark.parametrize(
    "content",
    [
        "[" * 100_000,
        json.dumps({"workflow": 3, "made": "now", "keys": {}}),
        json.dumps({"workflow": "chain", "made": 4, "keys": {}}),
        f'{{"workflow": "chain", "made": "now", "keys": {{"base": {"[" * 500}{"]" * 500}}}}}',
    ],
    ids=["nested", "workflow", "made", "nested key"],
)
@pytest.mark.parametrize("command", ["pins", "gc"])
def test_a_pin_of_a_stranger_that_is_not_in_our_format_is_told_in_a_line(
    chain: Workspace, command: str, content: str
) -> None:
    folder = chain.folder / "store/pins"
    folder.mkdir()
    (folder / "a.json").write_text(content)
    done = call(command)
    assert (done.exit_code, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert f"{folder / 'a.json'}: the pin cannot be read" in done.stderr


def test_a_pipe_in_the_place_of_a_pin_holds_up_nobody(chain: Workspace) -> None:
    folder = chain.folder / "store/pins"
    folder.mkdir()
    os.mkfifo(folder / "a.json")
    done = call("gc")
    assert (done.exit_code, len(done.stderr.splitlines())) == (2, 1)
    assert f"{folder / 'a.json'}: the pin cannot be read" in done.stderr


def test_what_is_deleted_is_named_without_what_a_terminal_would_obey() -> None:
    evil = "\x1b[31m"
    [_, line, _] = collection_words(Collection((Waste("artifacts", 1, 10, evil, evil),), 0, ()), dry_run=True)
    assert "\x1b" not in line


def test_pins_of_a_stranger_are_listed_without_what_a_terminal_would_obey(chain: Workspace) -> None:
    folder, evil = chain.folder / "store/pins", "\x1b]0;owned\x07\x1b[31m"
    folder.mkdir()
    (folder / f"{evil}.json").write_text(json.dumps({"workflow": evil, "made": evil, "keys": {}}))
    done = call("pins")
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout == f"{'  '.join(['?]0;owned??[31m'] * 3)}  0 results\n"


def test_gc_waits_for_nobody(chain: Workspace) -> None:
    with Store(chain.folder / "store").in_use():
        done = call("gc")
        looked = call("gc", "--dry-run")
    assert (done.exit_code, "runs are using the store" in done.stderr) == (2, True)
    assert (looked.exit_code, looked.stdout.splitlines()[-1]) == (0, "There is nothing to delete; 4 results are kept.")


def test_who_looks_what_could_be_deleted_holds_up_no_run(chain: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    states = []

    def collect_meanwhile(store: Store, rules: Rules) -> Collection:
        states.append(chain.run("factor=9").states["twice"])
        return collect(store, rules)

    monkeypatch.setattr(garbage, "collect", collect_meanwhile)
    assert call("gc", "--dry-run").exit_code == 0
    assert states == ["ran"]


def test_what_goes_while_it_is_measured_has_no_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder/inner").mkdir(parents=True)
    (tmp_path / "folder/inner/file").write_bytes(bytes(100))
    (tmp_path / "folder/link").symlink_to("inner")
    assert size_of(tmp_path / "folder") == 100 + len("inner")
    lstat = Path.lstat

    def gone(path: Path) -> os.stat_result:
        if path.name == "file":
            raise FileNotFoundError
        return lstat(path)

    monkeypatch.setattr(Path, "lstat", gone)
    assert size_of(tmp_path / "folder") == len("inner")


@pytest.mark.parametrize(
    "arguments", [["show", "chain/twice"], ["verify"], ["gc"], ["pins"], ["unpin", "x"], ["export", "x", "y"]]
)
def test_a_store_that_is_not_there_is_not_made(tmp_path: Path, arguments: list[str]) -> None:
    done = call(*arguments, "--store", tmp_path / "nowhere")
    assert (done.exit_code, "no store there" in done.stderr) == (2, True)
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("command", [("gc",), ("verify",), ("run",), ("status",)])
@pytest.mark.parametrize("address", ["", "mine"])
def test_a_folder_of_something_else_is_left_alone(
    workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str], address: str
) -> None:
    """An unset shell variable leaves an empty address."""
    files = [tmp_path / "mine" / folder / "file" for folder in ("code", "logs", "objects", "temporary", "cache")]
    for file in files:
        file.parent.mkdir(parents=True)
        file.write_text("mine")
    workspace.write(CHAIN)
    monkeypatch.chdir(tmp_path / "mine" if not address else tmp_path)
    workflow = [workspace.file, "--stages", TOYS] if command[0] in ("run", "status") else []
    result = call(*command, *workflow, "--store", address)
    assert result.exit_code == 2, result.output
    assert sorted(path for path in (tmp_path / "mine").rglob("*") if path.is_file()) == sorted(files)


def test_a_run_of_stages_on_the_command_line_does_not_count(chain: Workspace) -> None:
    """The journal records that only some stages were run."""
    shutil.rmtree(chain.folder / "store")
    for arguments in ([], ["twice"], ["base", "other"]):
        done = call("run", chain.file, *arguments, "--stages", TOYS, "--serial")
        assert done.exit_code == 0
    history = Store(chain.folder / "store").history
    assert [history.read(journal).whole for journal in history.journals("chain")] == [False, False, True]


def test_every_help_teaches_by_example() -> None:
    names = [command.name or command.callback.__name__ for command in app.registered_commands if command.callback]
    assert {"run", "status", "explain", "graph", "show", "export", "verify", "gc", "pin", "unpin", "pins"} <= set(names)
    for name in names:
        text = call(name, "--help").stdout
        assert f"python -m pipeline {name}" in text, f"{name} shows no example"
    whole = process("--help")
    assert "python -m pipeline run workflows/hide_multi.yaml" in whole.stdout
    assert os.environ["HOME"] not in whole.stdout
