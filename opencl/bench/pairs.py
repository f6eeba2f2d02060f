"""Which Gaussians draw which pixels, in vectorised torch: what a picture's cost is counted in, whoever draws it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Footprints:
    """Gaussians on the screen: the rectangles that hold their pixels, and how they fall off in them."""

    means2d: Float[Tensor, "N 2"]
    """The rectangles' centres, in pixels."""
    conics: Float[Tensor, "N 3"]
    """The inverse covariance's entries xx, xy, yy."""
    opacities: Float[Tensor, " N"]
    half_sizes: Float[Tensor, "N 2"]
    """Of the rectangles: right and down of the centre, in pixels."""
    depths: Float[Tensor, " N"]
    visible: Bool[Tensor, " N"]


@dataclass(frozen=True)
class Thresholds:
    """Where a rasterizer stops drawing."""

    alpha_minimum: float = 1 / 255
    alpha_maximum: float = 0.99
    transmittance_minimum: float = 1e-4


def half_sizes_of(conics: Float[Tensor, "N 3"], opacities: Float[Tensor, " N"], alpha_minimum: float) -> Tensor:
    """[N, 2] pixels: how far right and down of its centre a Gaussian's alpha is at least `alpha_minimum`."""
    xx, xy, yy = conics.unbind(-1)
    reach = 2 * (opacities / alpha_minimum).log().clamp_min(0)
    variances = torch.stack([yy, xx], dim=-1) / (xx * yy - xy * xy).unsqueeze(-1)
    return (reach[:, None] * variances).sqrt()


def repeat_each(counts: Int[Tensor, " K"]) -> tuple[Int[Tensor, " T"], Int[Tensor, " T"]]:
    """Each index k `counts[k]` times, and the number of each repetition: (0, 0, 2), (0, 1, 0) for (2, 0, 1)."""
    owners = torch.repeat_interleave(counts)
    starts = counts.cumsum(0) - counts
    return owners, torch.arange(len(owners)) - starts.index_select(0, owners)


def tile_entries(
    footprints: Footprints, width: int, height: int, tile: int
) -> tuple[Int[Tensor, " E"], Int[Tensor, " E"]]:
    """(tiles, Gaussians): every tile that a Gaussian's rectangle touches, by tile, each tile's nearest first."""
    columns, rows = -(-width // tile), -(-height // tile)
    order = footprints.visible.nonzero().squeeze(-1)
    order = order[torch.sort(footprints.depths[order], stable=True).indices]
    limits = torch.tensor([columns, rows])
    centres, half_sizes = footprints.means2d[order], footprints.half_sizes[order]
    first = ((centres - half_sizes) / tile).floor().long().clamp_min(0).minimum(limits)
    last = ((centres + half_sizes) / tile).ceil().long().clamp_min(0).minimum(limits)
    spans = (last - first).clamp_min(0)
    owners, numbers = repeat_each(spans.prod(dim=1))
    across = spans[owners, 0]
    tiles = (first[owners, 1] + numbers // across) * columns + first[owners, 0] + numbers % across
    tiles, by_tile = torch.sort(tiles, stable=True)
    return tiles, order[owners[by_tile]]


def contributing_pairs(
    footprints: Footprints,
    tiles: Int[Tensor, " E"],
    gaussians: Int[Tensor, " E"],
    width: int,
    height: int,
    tile: int,
    transmittances: Float[Tensor, " pixels"],
    thresholds: Thresholds,
) -> tuple[Int[Tensor, " P"], Int[Tensor, " P"]]:
    """(Gaussians, pixels): pairs that are drawn, by pixel (row by row), each pixel's nearest first.

    Args:
        tiles, gaussians: the tiles' lists, as `tile_entries` gives them; only pixels of a listed tile are drawn.
        transmittances: what is left of each pixel before the first of them.
    """
    pixels, entries, alphas = _candidates(footprints, tiles, gaussians, width, height, tile, thresholds)
    pixels, by_pixel = torch.sort(pixels, stable=True)
    owners, alphas = gaussians[entries[by_pixel]], alphas[by_pixel]
    left = torch.log1p(-alphas.clamp_max(thresholds.alpha_maximum).double()).cumsum(0)
    before_pixel = _value_before_segment(left, pixels)
    left = (left - before_pixel).exp() * transmittances[pixels]
    drawn = left > thresholds.transmittance_minimum
    return owners[drawn], pixels[drawn]


def _candidates(
    footprints: Footprints,
    tiles: Int[Tensor, " E"],
    gaussians: Int[Tensor, " E"],
    width: int,
    height: int,
    tile: int,
    thresholds: Thresholds,
) -> tuple[Int[Tensor, " C"], Int[Tensor, " C"], Float[Tensor, " C"]]:
    """(pixels, entries, alphas): pixels of the entry's tile at which its Gaussian's alpha is not too small."""
    columns = -(-width // tile)
    corner = torch.stack([tiles % columns, tiles // columns], dim=1) * tile
    far_corner = (corner + tile).minimum(torch.tensor([width, height]))
    centres = footprints.means2d[gaussians]
    reaches = half_sizes_of(footprints.conics, footprints.opacities, thresholds.alpha_minimum)[gaussians] + 1
    first = (centres - reaches - 0.5).ceil().long().maximum(corner)
    end = ((centres + reaches - 0.5).floor().long() + 1).minimum(far_corner)
    spans = (end - first).clamp_min(0)
    entries, numbers = repeat_each(spans.prod(dim=1))
    across = spans[:, 0].index_select(0, entries)
    rows_in = torch.div(numbers, across, rounding_mode="floor")
    columns_in = numbers - rows_in * across
    dx, dy = (
        (first[:, axis] + 0.5 - centres[:, axis]).index_select(0, entries) + steps
        for axis, steps in ((0, columns_in), (1, rows_in))
    )
    xx, xy, yy = (column.index_select(0, entries) for column in footprints.conics[gaussians].unbind(-1))
    powers = -0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy
    alphas = powers.exp() * footprints.opacities[gaussians].index_select(0, entries)
    pixels = (first[:, 1] * width + first[:, 0]).index_select(0, entries) + rows_in * width + columns_in
    kept = (alphas >= thresholds.alpha_minimum).nonzero().squeeze(-1)
    return pixels[kept], entries[kept], alphas[kept]


def _value_before_segment(running: Float[Tensor, " P"], segments: Int[Tensor, " P"]) -> Float[Tensor, " P"]:
    """For a running sum over runs of equal `segments`: its value before each element's run."""
    _, lengths = torch.unique_consecutive(segments, return_counts=True)
    starts = lengths.cumsum(0) - lengths
    padded = torch.cat([running.new_zeros(1), running])
    return torch.repeat_interleave(padded[starts], lengths)
