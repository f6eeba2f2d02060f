"""From the exported folders alone: a page with the cover for anyone, and one with the message for a friend."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.artifact import create, load
from stages.export_container import ExportContainerParameters, export_container
from stages.hiding.storage import write_container, write_secret
from tests.running import run_stage
from tests.stages import small
from tests.stages.analysis.attacks.containers import target_and_owner
from tests.workflows.test_published import REPOSITORY, run

WORKFLOW = REPOSITORY / "workflows" / "view_container.yaml"
MESSAGE = "statue"


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copies of the public and of the secret folder, and nothing else from the publisher."""
    folder = tmp_path_factory.mktemp("given")
    target, owner = target_and_owner("homogeneous")
    with create(folder / "container", "container") as writer:
        write_container(writer, target.gaussians, target.method)
    with create(folder / "secret", "secret", private=True) as writer:
        write_secret(writer, owner, [MESSAGE])
    inputs = {name: load(folder / name) for name in ("container", "secret")}
    inputs["cover"] = small.scene(folder / "cover")
    made = run_stage(export_container, ExportContainerParameters(frames=6), inputs, folder / "made")
    for name, artifact in made.items():
        shutil.copytree(artifact.path, folder / "copies" / name)
    return folder / "copies"


def page(made: dict[str, dict[str, Path]], name: str) -> str:
    return (made["report"][name] / "report.html").read_text()


def test_the_public_folder_shows_the_cover(store: Path, given: Path) -> None:
    made = run(WORKFLOW, store, f"--set=bundle={given / 'bundle'}")
    for name in ("owner", "public"):
        assert page(made, name).count("<video") == 1
        assert page(made, name).count("<img") == 6
    assert "as anyone with its files sees it" in page(made, "owner")
    assert "photos" not in page(made, "public")


def test_a_friend_sees_the_message_beside_it(store: Path, given: Path) -> None:
    folders = [f"--set=bundle={given / 'bundle'}", f"--set=container.secret={given / 'secret_bundle'}"]
    made = run(WORKFLOW, store, *folders)
    owner, public = page(made, "owner"), page(made, "public")
    assert f"what your secret reveals in it: {MESSAGE}." in owner
    assert owner.count("<img") == 12
    assert MESSAGE not in public
    assert public.count("<img") == 6
    for word in ("secret", "message", "hidden"):
        assert word not in public.lower()
    for stage, output in (("seen", "videos"), ("seen", "pictures"), ("report", "owner"), ("container", "image_camera")):
        assert made[stage][output].stat().st_mode & 0o077 == 0


def test_a_folder_without_cameras_says_what_to_ask_for(tmp_path: Path, store: Path, given: Path) -> None:
    shutil.copytree(given / "bundle", tmp_path / "bundle", ignore=shutil.ignore_patterns("cameras.json"))
    command = [sys.executable, "-m", "pipeline", "run", str(WORKFLOW), "--store", str(store), "--serial"]
    finished = subprocess.run(
        [*command, f"--set=bundle={tmp_path / 'bundle'}"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 1
    assert "seen: failed" in finished.stderr
    assert "Ask whoever published it for cameras.json" in finished.stderr
