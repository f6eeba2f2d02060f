"""Finds which Gaussians draw which tiles and pixels, in vectorised torch, independently of any rasterizer."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Footprints:
    """Projected Gaussians: their bounding rectangles on the screen and their falloff."""

    means2d: Float[Tensor, "N 2"]
    """Centres of the Gaussians and their rectangles, in pixels."""
    conics: Float[Tensor, "N 3"]
    """Entries xx, xy, yy of the inverse covariance."""
    opacities: Float[Tensor, " N"]
    half_sizes: Float[Tensor, "N 2"]
    """Half widths and half heights of the rectangles, in pixels."""
    depths: Float[Tensor, " N"]
    visible: Bool[Tensor, " N"]


@dataclass(frozen=True)
class Thresholds:
    """Limits of alpha and transmittance at which a rasterizer stops drawing."""

    alpha_minimum: float = 1 / 255
    alpha_maximum: float = 0.99
    transmittance_minimum: float = 1e-4


def half_sizes_of(conics: Float[Tensor, "N 3"], opacities: Float[Tensor, " N"], alpha_minimum: float) -> Tensor:
    """Half width and height, [N,2] in pixels, of the box in which a Gaussian's alpha reaches `alpha_minimum`."""
    xx, xy, yy = conics.unbind(-1)
    reach = 2 * (opacities / alpha_minimum).log().clamp_min(0)
    variances = torch.stack([yy, xx], dim=-1) / (xx * yy - xy * xy).unsqueeze(-1)
    return (reach[:, None] * variances).sqrt()


def repeat_each(counts: Int[Tensor, " K"]) -> tuple[Int[Tensor, " T"], Int[Tensor, " T"]]:
    """Repeat each index k `counts[k]` times, and number the repetitions: (2, 0, 1) gives (0, 0, 2), (0, 1, 0)."""
    owners = torch.repeat_interleave(counts)
    starts = counts.cumsum(0) - counts
    return owners, torch.arange(len(owners)) - starts.index_select(0, owners)


def tile_entries(
    footprints: Footprints, width: int, height: int, tile: int
) -> tuple[Int[Tensor, " E"], Int[Tensor, " E"]]:
    """All pairs (tiles, Gaussians) of a tile and a Gaussian whose rectangle touches it, sorted by tile, then depth."""
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
    """All pairs (Gaussians, pixels) that are drawn, sorted by pixel (row by row), then depth.

    Args:
        tiles, gaussians: tile lists from `tile_entries`. A Gaussian is drawn only in pixels of its listed tiles.
        transmittances: transmittance of each pixel in front of the listed Gaussians.
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
    """(pixels, entries, alphas): pixels of an entry's tile at which the alpha of its Gaussian reaches the minimum."""
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
    """For each element of a running sum, the sum before its segment, a run of equal values in `segments`."""
    _, lengths = torch.unique_consecutive(segments, return_counts=True)
    starts = lengths.cumsum(0) - lengths
    padded = torch.cat([running.new_zeros(1), running])
    return torch.repeat_interleave(padded[starts], lengths)
