"""Pages of texture come back as painted, blurred as asked, and repeat without a seam."""

from __future__ import annotations

import numpy as np
import pytest

from stages.tracing.texture import TexturePyramid

SIZE = 32


def linear(page: np.ndarray) -> np.ndarray:
    return page.astype(np.float64) ** 2.2


def pages() -> list[np.ndarray]:
    return list(np.random.default_rng(1).random((3, SIZE, SIZE, 3), dtype=np.float32))


def look(pyramid: TexturePyramid, page: int, u: np.ndarray, v: np.ndarray, texels: float) -> np.ndarray:
    count = len(u)
    return pyramid.lookup(
        np.full(count, page, np.int32), u.astype(np.float32), v.astype(np.float32), np.full(count, texels, np.float32)
    )


def test_a_texel_comes_back_as_painted() -> None:
    pyramid = TexturePyramid(pages())
    row, column = np.array([0, 5, 31, 17]), np.array([0, 30, 2, 9])
    found = look(pyramid, 1, (column + 0.5) / SIZE, -(row + 0.5) / SIZE, 1.0)
    assert np.allclose(found.T, linear(pages()[1][row, column]), atol=0.005)


def test_pages_repeat() -> None:
    pyramid = TexturePyramid(pages())
    u, v = np.random.default_rng(0).random((2, 50))
    for texels in (1.0, 3.0):
        assert np.allclose(look(pyramid, 2, u, v, texels), look(pyramid, 2, u + 3, v - 2, texels), atol=2e-3)


def test_a_wide_spot_is_the_mean_of_what_it_covers() -> None:
    pyramid = TexturePyramid(pages())
    quarter = linear(pages()[0])[:8, :8].mean(axis=(0, 1))
    found = look(pyramid, 0, np.array([4 / SIZE]), np.array([-4 / SIZE]), 8.0)
    assert np.allclose(found[:, 0], quarter, atol=0.01)


def test_blur_grows_steadily() -> None:
    pyramid = TexturePyramid(pages())
    u, v = np.random.default_rng(0).random((2, 500))
    spreads = [look(pyramid, 0, u, v, texels).std() for texels in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)]
    assert spreads == sorted(spreads, reverse=True)


def test_between_two_levels_of_blur_lies_a_blend_of_both() -> None:
    pyramid = TexturePyramid(pages())
    u, v = np.random.default_rng(0).random((2, 50))
    sharp, between, blurred = (np.sqrt(look(pyramid, 0, u, v, texels)) for texels in (2.0, 2.0**1.5, 4.0))
    assert np.allclose(between, (sharp + blurred) / 2, atol=1e-4)


@pytest.mark.parametrize("shape", [(24, 24, 3), (32, 16, 3), (32, 32)])
def test_other_pages_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="power of two"):
        TexturePyramid([np.zeros(shape, np.float32)])
