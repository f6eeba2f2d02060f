"""What the secret shows of a recovered container is compared with what it shows of the published one, in private."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import Artifact, create, load
from pipeline.errors import Interrupted, UserError
from pipeline.stage import Services
from stages.analysis.attacks.features import channel_permutation
from stages.analysis.comparisons import read_comparisons
from stages.hiding.rendering import COVER
from stages.hiding.storage import write_container, write_secret
from stages.imaging.metric_table import read_rows
from stages.reveal import RevealParameters, reveal
from tests.running import run_stage
from tests.stages import small
from tests.stages.analysis.attacks.containers import MESSAGE, METHODS, target_and_owner
from tests.stages.test_stopping import Asking


def inputs_of(folder: Path, method: str, messages: tuple[str, ...] = (MESSAGE,)) -> dict[str, Artifact]:
    """The recovered container is the published one, with permuted channels if it has features."""
    target, owner = target_and_owner(method)
    harmed = channel_permutation(target, 16, torch.Generator().manual_seed(1)) if target.has_features else target
    for name, each in (("published", target), ("container", harmed)):
        with create(folder / name, "container") as writer:
            write_container(writer, each.gaussians, each.method)
    with create(folder / "secret", "secret", private=True) as writer:
        write_secret(writer, owner, messages)
    small.scene(folder / "cover")
    return {name: load(folder / name) for name in ("container", "published", "secret", "cover")}


def revealed(folder: Path, method: str, inputs: dict[str, Artifact]) -> dict[str, Artifact]:
    return run_stage(reveal, RevealParameters(method=method, threads=1), inputs, folder)


@pytest.mark.parametrize("method", METHODS)
def test_each_message_is_held_against_what_the_published_container_shows(tmp_path: Path, method: str) -> None:
    inputs = inputs_of(tmp_path, method)
    for name in ("published", "container"):
        outputs = revealed(tmp_path / name / "outputs", method, {**inputs, "container": inputs[name]})
        assert all(artifact.private for artifact in outputs.values())
        rows = [row for row in read_rows(outputs["scores"]) if row.quantity == "psnr"]
        of_message = [row.value for row in rows if row.message == MESSAGE]
        assert len(of_message) == len([row for row in rows if row.message is None]) == small.VIEWS
        same = name == "published" or not any(each == "raw_features" for each in inputs[name].names)
        assert min(of_message) > 50 if same else max(of_message) < 40
    by_title = {each.title: each for each in read_comparisons(outputs["pictures"])}
    assert {COVER, MESSAGE} <= by_title.keys()
    np.testing.assert_array_equal(by_title[COVER].truth[0], small.pictures(0)[0])
    assert np.asarray(by_title[MESSAGE].truth).std() > 1


def test_an_image_is_looked_at_where_it_is_hidden(tmp_path: Path) -> None:
    inputs = inputs_of(tmp_path, "homogeneous")
    view = inputs["cover"].attributes["names"][3]
    with create(tmp_path / "secret of an image", "secret", private=True) as writer:
        write_secret(writer, target_and_owner("homogeneous")[1], (MESSAGE,), view)
    inputs["secret"], looks = load(tmp_path / "secret of an image"), list[float]()
    services = Services(progress=lambda done, total, figures: looks.append(total))
    parameters = RevealParameters(method="homogeneous", threads=1)
    outputs = run_stage(reveal, parameters, inputs, tmp_path / "outputs", services=services)
    assert looks == [1 + small.VIEWS] * (1 + small.VIEWS), "of what was published one view is rendered"
    [found] = [row for row in read_rows(outputs["scores"]) if row.message == MESSAGE and row.quantity == "psnr"]
    assert found.view == view
    [shown] = [each for each in read_comparisons(outputs["pictures"]) if each.title == MESSAGE]
    assert shown.names == (view,)
    assert np.asarray(shown.truth).std() > 1


def test_a_secret_of_no_message_is_told(tmp_path: Path) -> None:
    inputs = inputs_of(tmp_path, "homogeneous", messages=())
    with pytest.raises(UserError, match=r"there is no message to reveal.*a secret without messages"):
        revealed(tmp_path / "outputs", "homogeneous", inputs)


def test_a_published_container_of_another_method_is_refused(tmp_path: Path) -> None:
    inputs, others = (inputs_of(tmp_path / method, method) for method in ("homogeneous", "gs_hider"))
    with pytest.raises(UserError, match="by another method"):
        revealed(tmp_path / "outputs", "homogeneous", inputs | {"published": others["published"]})


def test_it_stops_when_it_is_asked_to(tmp_path: Path) -> None:
    inputs, asking = inputs_of(tmp_path, "homogeneous"), Asking(stop_at=2)
    with pytest.raises(Interrupted):
        run_stage(reveal, RevealParameters(method="homogeneous"), inputs, tmp_path / "out", services=asking.services())
    assert len(asking.figures) == asking.looks == 2
