"""A container renders the same after a round trip through the store, and reveals nothing of the message."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.artifact import create, load
from pipeline.errors import UserError
from stages.hiding.method import build_method
from stages.hiding.storage import (
    bytes_of,
    check_method,
    read_gaussians,
    read_method,
    write_container,
    write_secret,
)
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians, gaussians_at

SETTINGS = {"feature_dim": 5, "layers": 3, "decoder_width": 8, "precision": "float32"}
MESSAGE = "a-name-that-must-not-be-published"


@pytest.fixture
def camera() -> Camera:
    intrinsics = torch.tensor([[20.0, 0, 8], [0, 20.0, 6], [0, 0, 1]])
    return Camera(torch.eye(4), intrinsics, torch.zeros(3), 16, 12)


def hidden(folder: Path, seed: int = 0):
    torch.manual_seed(seed)
    method = build_method("gs_hider", SETTINGS | {"messages": [MESSAGE]})
    points = np.random.default_rng(seed).uniform(-1, 1, (6, 3)) + np.array([0, 0, 4])
    gaussians = gaussians_at(points, {"raw_features": torch.randn(6, 5)})
    with create(folder / "container", "container") as writer:
        write_container(writer, gaussians, method)
    with create(folder / "secret", "secret", private=True) as writer:
        write_secret(writer, method, [MESSAGE])
    return gaussians, method, load(folder / "container"), load(folder / "secret")


def test_cover_and_message_come_back_bit_for_bit(tmp_path: Path, camera: Camera) -> None:
    gaussians, method, container, secret = hidden(tmp_path)
    before = method.render(gaussians, camera)
    state = torch.get_rng_state()
    read = read_method(container, secret)
    assert torch.equal(torch.get_rng_state(), state), "nothing is drawn"
    assert not any(weight.requires_grad for network in read.networks.values() for weight in network.parameters())
    after = read.render(read_gaussians(container), camera)
    assert set(after.pictures) == {"cover", MESSAGE}
    for name, picture in before.pictures.items():
        assert torch.equal(picture, after.pictures[name])


def test_messages_keep_their_order(tmp_path: Path) -> None:
    """It is that of the message decoder's channels."""
    _, _, container, _ = hidden(tmp_path)
    method = build_method("gs_hider", SETTINGS | {"messages": ["b", "c", "a"]})
    with create(tmp_path / "several", "secret", private=True) as writer:
        write_secret(writer, method, method.messages)
    assert tuple(read_method(container, load(tmp_path / "several")).messages) == ("b", "c", "a")


@pytest.mark.parametrize("alike", [[], [0, 1], [0, 2], [1, 2]])
def test_the_order_of_rows_tells_nothing(tmp_path: Path, alike: list[int]) -> None:
    """Even where Gaussians share some coordinates, as those on a grid do."""
    gaussians, method, _, _ = hidden(tmp_path)
    gaussians.means[:, alike] = 4.0
    backwards = Gaussians({name: tensor.flip(0) for name, tensor in gaussians.parameters.items()})
    for name, each in (("forwards", gaussians), ("backwards", backwards)):
        with create(tmp_path / name, "container") as writer:
            write_container(writer, each, method)
    assert load(tmp_path / "backwards").digest == load(tmp_path / "forwards").digest


def test_without_the_secret_only_the_cover_is_rendered(tmp_path: Path, camera: Camera) -> None:
    _, _, container, _ = hidden(tmp_path)
    assert set(read_method(container).render(read_gaussians(container), camera).pictures) == {"cover"}


def test_the_container_names_no_message(tmp_path: Path) -> None:
    _, _, container, _ = hidden(tmp_path)
    published = b"".join(path.read_bytes() for path in container.path.rglob("*") if path.is_file())
    assert MESSAGE.encode() not in published
    assert b"message" not in published


def test_a_secret_of_another_method_is_refused(tmp_path: Path) -> None:
    _, _, container, _ = hidden(tmp_path)
    torch.manual_seed(0)
    other = build_method("gs_hider", SETTINGS | {"messages": [MESSAGE], "decoder_width": 9})
    with create(tmp_path / "other", "secret", private=True) as writer:
        write_secret(writer, other, [MESSAGE])
    with pytest.raises(UserError, match="message_decoder"):
        read_method(container, load(tmp_path / "other"))


def test_a_secret_without_a_decoder_is_refused(tmp_path: Path) -> None:
    """3DGS+SH, whose messages are in the container, writes such secrets; a decoder would keep its random weights."""
    _, _, container, _ = hidden(tmp_path)
    with create(tmp_path / "other", "secret", private=True) as writer:
        write_secret(writer, build_method("sh", {"messages": [MESSAGE], "sh_degree": 1}), [MESSAGE])
    with pytest.raises(UserError, match=r"message_decoder.*made together with this container"):
        read_method(container, load(tmp_path / "other"))


def test_a_container_of_another_method_than_declared_is_refused(tmp_path: Path) -> None:
    _, _, container, _ = hidden(tmp_path)
    check_method(container, "gs_hider")
    with pytest.raises(UserError, match=r"gs_hider.*homogeneous"):
        check_method(container, "homogeneous")


def test_bytes_of_counts_values_and_weights(tmp_path: Path) -> None:
    _, _, container, _ = hidden(tmp_path)
    values = 6 * (3 + 4 + 3 + 1 + 5)
    weights = (5 * 8 * 9 + 8) + (8 * 8 * 9 + 8) + (8 * 3 * 9 + 3)
    assert bytes_of(container) == 4 * (values + weights)
