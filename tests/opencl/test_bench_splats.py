"""Trained scenes from files: small ones written here, and real ones where available."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from opencl.bench.ring import ring_of_views
from opencl.bench.splats import read_splats
from opencl.rasterizer import rasterize

REAL = Path(__file__).parents[3] / "shared" / "data" / "splats"
CHUNK = ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"]
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]


def write_splat(path: Path, count: int = 3) -> bytes:
    record = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("quat", "u1", 4)])
    rows = np.zeros(count, record)
    rows["mean"] = np.arange(3 * count).reshape(count, 3)
    rows["scale"] = [0.5, 0.25, 0.125]
    rows["color"] = [255, 0, 51, 102]
    rows["quat"] = [192, 128, 64, 0]
    path.write_bytes(rows.tobytes())
    return rows.tobytes()


def test_splat(tmp_path):
    path = tmp_path / "small.splat"
    write_splat(path)
    splats = read_splats(path)
    assert splats.means.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert splats.scales[1].tolist() == [0.5, 0.25, 0.125]
    assert splats.quats[1].tolist() == [0.5, 0.0, -0.5, -1.0]
    torch.testing.assert_close(splats.opacities, torch.full((3,), 0.4))
    torch.testing.assert_close(splats.colors[2], torch.tensor([1.0, 0.0, 0.2]))
    assert splats.means.dtype == splats.opacities.dtype == torch.float32


def test_splat_of_nothing(tmp_path):
    path = tmp_path / "empty.splat"
    path.write_bytes(b"")
    assert read_splats(path).quats.shape == (0, 4)


def test_a_truncated_splat(tmp_path):
    path = tmp_path / "cut.splat"
    path.write_bytes(write_splat(path)[:-5])
    with pytest.raises(ValueError, match=r"cut\.splat: found 91 bytes, expected a multiple of 32.*truncated"):
        read_splats(path)


def pack(values: list[int], bits: tuple[int, ...]) -> int:
    packed = 0
    for value, width in zip(values, bits, strict=True):
        assert value < 2**width
        packed = packed << width | value
    return packed


def compressed_ply(vertices: list[list[int]], chunks: list[list[float]], colors_have_range: bool = True) -> bytes:
    """`vertices` have the columns PACKED; `chunks` have minima, then maxima, each with the columns CHUNK."""
    names = CHUNK if colors_have_range else CHUNK[:6]
    header = [
        *("ply", "format binary_little_endian 1.0", "comment by a test", f"element chunk {len(chunks)}"),
        *(f"property float {end}_{name}" for end in ("min", "max") for name in names),
        f"element vertex {len(vertices)}",
        *(f"property uint {name}" for name in PACKED),
        "end_header\n",
    ]
    return "\n".join(header).encode() + np.array(chunks, "<f4").tobytes() + np.array(vertices, "<u4").tobytes()


LOW = [-1.0, 0.0, 2.0, math.log(0.1), math.log(0.2), math.log(0.3), 0.0, 0.5, -0.2]
HIGH = [1.0, 4.0, 3.0, math.log(0.4), math.log(0.2), math.log(3.0), 1.0, 0.75, 1.2]
LEAST = [0, pack([0, 0, 512, 512], (2, 10, 10, 10)), 0, 0]
LARGEST = [pack([2047, 1023, 2047], (11, 10, 11))] * 3 + [pack([255] * 4, (8, 8, 8, 8))]


def test_compressed_ply(tmp_path):
    path = tmp_path / "small.ply"
    middle = [0, 0, pack([1024, 0, 0], (11, 10, 11)), pack([0, 51, 0, 102], (8, 8, 8, 8))]
    path.write_bytes(compressed_ply([LEAST, LARGEST, middle], [LOW + HIGH]))
    splats = read_splats(path)
    torch.testing.assert_close(splats.means[:2], torch.tensor([LOW[:3], HIGH[:3]]))
    torch.testing.assert_close(splats.scales[:2], torch.tensor([LOW[3:6], HIGH[3:6]]).exp())
    torch.testing.assert_close(splats.colors[:2], torch.tensor([LOW[6:], HIGH[6:]]))
    assert splats.opacities[:2].tolist() == [0.0, 1.0]
    torch.testing.assert_close(splats.opacities[2], torch.tensor(0.4))
    torch.testing.assert_close(splats.colors[2, 1], torch.tensor(0.5 + 0.2 * 0.25))
    torch.testing.assert_close(splats.scales[2, 0], torch.tensor(0.2), rtol=1e-3, atol=0)


@pytest.mark.parametrize("index", range(4))
def test_rotations_of_a_compressed_ply(tmp_path, index):
    quat = torch.tensor([0.1, -0.3, 0.2, 0.35])
    quat[index] = 0.0
    quat[index] = (1 - quat.square().sum()).sqrt()
    others = [round((float(value) / math.sqrt(2) + 0.5) * 1023) for at, value in enumerate(quat) if at != index]
    path = tmp_path / "turned.ply"
    path.write_bytes(compressed_ply([[0, pack([index, *others], (2, 10, 10, 10)), 0, 0]], [LOW + HIGH]))
    torch.testing.assert_close(read_splats(path).quats[0], quat, rtol=0, atol=1e-3)


def test_each_chunk_has_its_own_range(tmp_path):
    path = tmp_path / "two.ply"
    path.write_bytes(compressed_ply([LEAST] * 300, [LOW + HIGH, [7.0] * 18]))
    means = read_splats(path).means
    assert means[255].tolist() == LOW[:3]
    assert means[256].tolist() == [7.0, 7.0, 7.0]


def test_colours_of_the_first_version_have_no_range(tmp_path):
    path = tmp_path / "old.ply"
    path.write_bytes(compressed_ply([LARGEST], [LOW[:6] + HIGH[:6]], colors_have_range=False))
    assert read_splats(path).colors.tolist() == [[1.0, 1.0, 1.0]]


WHOLE = compressed_ply([LEAST, LARGEST], [LOW + HIGH])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (WHOLE[:-1], r"truncated: found \d+ bytes, expected \d+ or more, up to the last row of vertex"),
        (WHOLE[: WHOLE.index(b"end_header")], "no PLY header"),
        (b"solid cube", "no PLY header"),
        (WHOLE.replace(b"binary_little_endian", b"ascii"), "expected a PLY of format binary_little_endian"),
        (
            WHOLE.replace(b"element chunk", b"element chonk"),
            "found the elements chonk, vertex, expected chunk and vertex",
        ),
        (WHOLE.replace(b"packed_scale", b"packed_skill"), "no property packed_scale of element vertex"),
        (WHOLE.replace(b"float max_scale_y", b"float max_scule_y"), "no property max_scale_y of element chunk"),
        (
            WHOLE.replace(b"property uint packed_color", b"property list uchar uint c"),
            r"line \d+: found 'property list",
        ),
        (compressed_ply([LEAST] * 300, [LOW + HIGH]), "found 1 chunks for 300 Gaussians"),
    ],
)
def test_what_is_no_compressed_ply(tmp_path, content, message):
    path = tmp_path / "wrong.ply"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"wrong\.ply.*{message}"):
        read_splats(path)


def test_other_files_are_not_read(tmp_path):
    with pytest.raises(ValueError, match=r"found the suffix '\.spz', expected \.splat or \.ply"):
        read_splats(tmp_path / "scene.spz")


def test_the_ring_looks_at_the_middle():
    means = torch.randn(500, 3, generator=torch.Generator().manual_seed(0)) + torch.tensor([3.0, -1.0, 7.0])
    views = ring_of_views(means, 5, 64, 48)
    middle = means.median(dim=0).values
    centres = []
    for view in views:
        rotation, translation = view.world_to_camera[:3, :3], view.world_to_camera[:3, 3]
        torch.testing.assert_close(rotation @ rotation.T, torch.eye(3), rtol=0, atol=1e-5)
        assert torch.linalg.det(rotation) > 0.99
        x, y, depth = (rotation @ middle + translation).tolist()
        assert abs(x) < 1e-4
        assert abs(y) < 1e-4
        assert depth > 0
        assert rotation[1] @ torch.tensor([0.0, -1.0, 0.0]) < 0, "up in the world is up in the picture"
        centres.append(-rotation.T @ translation)
    distances = torch.stack([(centre - middle).norm() for centre in centres])
    torch.testing.assert_close(distances, distances[:1].expand(5))
    assert torch.pdist(torch.stack(centres)).min() > 0.5


# The pictures were inspected: a truck and a biker, upright and sharp. These figures ensure that they stay so.
@pytest.mark.skipif(not REAL.is_dir(), reason="the real scenes are not at hand")
@pytest.mark.parametrize(
    ("name", "count", "covered", "color"),
    [
        ("truck.splat", 116_544, 0.6069, (0.3071, 0.3491, 0.4062)),
        ("biker.compressed.ply", 152_746, 0.2546, (0.0661, 0.0664, 0.0664)),
    ],
)
def test_real_scenes(name, count, covered, color):
    splats = read_splats(REAL / name)
    assert len(splats.means) == count
    assert ((splats.quats.norm(dim=1) - 1).abs() < 0.02).all()
    view = ring_of_views(splats.means, 4, 152, 100)[1]
    gaussians = (splats.means, splats.quats, splats.scales, splats.opacities, splats.colors)
    picture = rasterize(*gaussians, *view.arguments)
    assert float(picture.alphas.mean()) == pytest.approx(covered, rel=2e-3)
    torch.testing.assert_close(picture.features.mean(dim=(0, 1)), torch.tensor(color), rtol=5e-3, atol=0)
