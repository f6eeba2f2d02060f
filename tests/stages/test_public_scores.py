"""What `evaluate` and `render_path` publish if the cover's photos or the splats are private."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.artifact import Artifact
from stages.analysis.comparisons import read_comparisons
from stages.analysis.videos import read_videos
from stages.evaluate import EvaluateParameters, evaluate
from stages.imaging.metric_table import read_rows
from stages.render_path import RenderPathParameters, render_path
from tests.running import run_stage
from tests.stages import small


def scored(folder: Path, cover: Artifact, **splats: Artifact) -> dict[str, Artifact]:
    parameters = EvaluateParameters(method="plain", lpips="none", threads=1)
    return run_stage(evaluate, parameters, {"cover": cover, **splats}, folder)


def test_of_a_private_cover_the_public_sees_renders_without_photos_or_names(tmp_path: Path) -> None:
    container = small.splats(tmp_path / "splats")
    cover = small.scene(tmp_path / "cover", test_views=2, private=True)
    made = scored(tmp_path / "scores", cover, container=container)
    (owner,), (public,) = read_comparisons(made["pictures"]), read_comparisons(made["public_pictures"])
    assert owner.has_truth
    assert not public.has_truth
    assert public.names == ("view 1", "view 2"), "test views alone"
    assert np.array_equal(public.rendered, owner.rendered[:2])
    assert np.array_equal(public.truth, owner.rendered[:2])
    rows, every = read_rows(made["public_scores"]), read_rows(made["scores"])
    assert not any(row.view for row in rows)
    tests = [row.value for row in every if row.quantity == "psnr" and row.split == "test"]
    assert [row.value for row in rows if row.quantity == "psnr" and row.split == "test"] == [
        pytest.approx(np.mean(tests), abs=1e-9)
    ]
    published = b"".join(path.read_bytes() for path in made["public_scores"].path.rglob("*") if path.is_file())
    assert not any(name.encode() in published for name in small.NAMES)


def test_of_private_splats_the_public_learns_nothing(tmp_path: Path) -> None:
    cover, private = small.scene(tmp_path / "cover"), small.splats(tmp_path / "private", private=True)
    alone = scored(tmp_path / "alone", cover, container=private)
    assert not read_rows(alone["public_scores"])
    assert not read_comparisons(alone["public_pictures"])
    assert read_rows(alone["scores"])
    beside = scored(tmp_path / "beside", cover, container=small.splats(tmp_path / "open"), reference=private)
    assert len(read_comparisons(beside["public_pictures"])) == 1
    assert len(read_comparisons(beside["pictures"])) == 2
    sizes = [row for row in read_rows(beside["public_scores"]) if row.quantity == "container_bytes"]
    assert len(sizes) == 1


def test_private_splats_are_filmed_for_their_owner_alone(tmp_path: Path) -> None:
    cover = small.scene(tmp_path / "cover")
    parameters = RenderPathParameters(method="plain", frames=2, seconds=1, threads=1)
    for private, films in ((False, 1), (True, 0)):
        container = small.splats(tmp_path / f"splats {private}", "container", private)
        made = run_stage(render_path, parameters, {"container": container, "cover": cover}, tmp_path / str(private))
        assert len(read_videos(made["videos"])) == 1
        assert len(read_videos(made["public_videos"])) == films
