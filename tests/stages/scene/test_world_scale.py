"""Splats are only drawn from cameras of their own world; a container is in that of the scene it was made with."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.artifact import Artifact, create, load
from pipeline.errors import UserError
from stages.scene.world_scale import refuse_other_world, stated


def made(folder: Path, kind: str, scale: float = 1.0) -> Artifact:
    with create(folder, kind) as writer:
        writer.attributes.update(stated(scale))
    return load(folder)


def test_a_container_does_not_state_its_world_and_is_not_refused(tmp_path: Path) -> None:
    scene = made(tmp_path / "scene", "scene", 8.0)
    refuse_other_world(made(tmp_path / "container", "container"), scene)
    refuse_other_world(made(tmp_path / "own", "splats", 8.0), scene)
    with pytest.raises(UserError, match=r"a world 1 times as large .* expected one 8 times as large"):
        refuse_other_world(made(tmp_path / "other", "splats"), scene)
