"""StegExpose's detectors literally as defined, pixel by pixel: slow, but unambiguous."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from scipy.stats import chi2


def divided(above: float, below: float) -> float:
    return above / below if below != 0 else math.nan


def roots(a: float, b: float, c: float) -> list[float]:
    discriminant = b**2 - 4 * a * c
    if discriminant < 0:
        return []
    return [divided(-b + sign * math.sqrt(discriminant), 2 * a) for sign in (1, -1)]


def sorted_pairs(pairs: Iterator[tuple[int, int]], within: Callable[[int, int], bool]) -> tuple[float, float, float]:
    p = x = y = z = w = 0
    for u, v in pairs:
        p += 1
        if u == v:
            z += 1
        elif (v % 2 == 0 and u < v) or (v % 2 == 1 and u > v):
            x += 1
        elif (v % 2 == 0 and u > v) or (v % 2 == 1 and u < v):
            y += 1
            w += within(u, v)
        if u != v and u // 2 == v // 2:
            assert (v % 2 == 0 and u > v) or (v % 2 == 1 and u < v)  # so W is a subset of Y
    return (w + z) / 2, 2 * x - p, y - x


def primary_sets(picture: np.ndarray) -> float:
    height, width, _ = picture.shape
    red = picture[..., 0].astype(int)
    pairs = ((red[y, x], red[y, x + 1]) for y in range(height) for x in range(0, width - 1, 2))
    found = roots(*sorted_pairs(pairs, lambda u, v: (u % 2 == 0 and v % 2 == 1) or u % 2 == 1))
    return min(found) if found else math.nan


def sample_pairs(picture: np.ndarray) -> float:
    height, width, _ = picture.shape
    if height % 2 or width % 2:
        return math.nan
    shares = []
    for channel in range(3):
        values = picture[..., channel].astype(int)
        pairs = [(values[y, x], values[y, x + 1]) for y in range(height) for x in range(0, width, 2)]
        pairs += [(values[y, x], values[y + 1, x]) for y in range(0, height, 2) for x in range(width)]
        a, b, c = sorted_pairs(iter(pairs), lambda u, v: u // 2 == v // 2)
        found = roots(a, b, c)
        share = min(found, key=abs) if found else 0.0
        shares.append(divided(c, b) if share == 0 else share)
    return sum(shares) / 3


def chi_square(picture: np.ndarray) -> float:
    values = [int(value) for row in picture for pixel in row for value in pixel]
    blocks = len(values) // 1024 - 1
    histogram = [1] * 256
    p_values = []
    for block in range(blocks):
        for value in values[1024 * block : 1024 * (block + 1)]:
            histogram[value] += 1
        observed = [histogram[2 * k] for k in range(128)]
        expected: list[float] = [(histogram[2 * k] + histogram[2 * k + 1]) // 2 for k in range(128)]
        if abs(sum(observed) - sum(expected)) > 1e-5:
            scale = sum(observed) / sum(expected)
            expected = [scale * value for value in expected]
        p_values.append(chi2.sf(sum((o - e) ** 2 / e for o, e in zip(observed, expected, strict=True)), 127))
    return sum(p_values) / blocks if blocks > 0 else math.nan


def f_plus(value: int) -> int:
    return value + 1 if value % 2 == 0 else value - 1


def f_minus(value: int) -> int:
    return value - 1 if value % 2 == 0 else value + 1


def variation(p: list[int]) -> int:
    return abs(p[0] - p[1]) + abs(p[3] - p[2]) + abs(p[1] - p[3]) + abs(p[2] - p[0])


def counted(values: np.ndarray, step: int, all_flipped: bool) -> dict[str, int]:
    height, width = values.shape
    counts = dict.fromkeys(("R", "S", "R-", "S-"), 0)
    for y in range(0, height - 1, step):
        for x in range(0, width - 1, step):
            group = [int(value) for value in (values[y, x], values[y, x + 1], values[y + 1, x], values[y + 1, x + 1])]
            if all_flipped:
                group = [f_plus(value) for value in group]
            for mask in ((1, 0, 0, 1), (0, 1, 1, 0)):
                for flipped, sign in ((f_plus, ""), (f_minus, "-")):
                    changed = [flipped(v) if marked else v for v, marked in zip(group, mask, strict=True)]
                    counts["R" + sign] += variation(changed) > variation(group)
                    counts["S" + sign] += variation(changed) < variation(group)
    return counts


def rs_analysis(picture: np.ndarray) -> float:
    if min(picture.shape[:2]) < 2:
        return math.nan
    by_step = []
    for step in (1, 2):
        lengths = []
        for channel in range(3):
            one, two = (counted(picture[..., channel], step, flipped) for flipped in (False, True))
            d0, d_0 = one["R"] - one["S"], one["R-"] - one["S-"]
            d1, d_1 = two["R"] - two["S"], two["R-"] - two["S-"]
            found = roots(2 * (d1 + d0), d_0 - d_1 - d1 - 3 * d0, d0 - d_0)
            if found:
                x = min(found, key=abs)
            else:
                regular = divided(one["R-"] - one["R"], two["R"] - one["R"] + one["R-"] - two["R-"])
                singular = divided(one["S-"] - one["S"], two["S"] - one["S"] + one["S-"] - two["S-"])
                x = (regular + singular) / 2
            lengths.append(abs(divided(x, x - 0.5)))
        by_step.append(sum(lengths) / 3)
    return sum(by_step) / 2
