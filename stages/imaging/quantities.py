"""The quantities that evaluations measure. Trainings do not import this: a new one must not repeat them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Quantity:
    """A measured quantity: its unit, and whether "higher" or "lower" is better ("" if neither).

    Labels and explanations belong to the report.
    """

    unit: str
    better: Literal["higher", "lower", ""]


QUANTITIES: dict[str, Quantity] = {
    "psnr": Quantity("dB", "higher"),
    "ssim": Quantity("", "higher"),
    "lpips_vgg": Quantity("", "lower"),
    "lpips_alex": Quantity("", "lower"),
    "psnr_covered": Quantity("dB", "higher"),
    "ssim_covered": Quantity("", "higher"),
    "psnr_constant": Quantity("dB", ""),
    "coverage": Quantity("", "higher"),
    "legal": Quantity("", ""),
    "hides_image": Quantity("", ""),
    "container_bytes": Quantity("bytes", "lower"),
    "total_bytes": Quantity("bytes", "lower"),
    "gaussians": Quantity("", "lower"),
    "seconds_per_frame": Quantity("s", "lower"),
    "seconds_per_feature_map": Quantity("s", "lower"),
    "residual_correlation": Quantity("", ""),
    "residual_correlation_others": Quantity("", ""),
    "loss": Quantity("", "lower"),
}
