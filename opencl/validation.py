"""Checks of the rasterizer's arguments. Each error names the argument, what was found and what was expected."""

from __future__ import annotations

import torch
from torch import Tensor

from opencl.contract import RasterSettings

_FLOATS = (torch.float32, torch.float64)
_LARGEST_SIDE = 1 << 20
_MOST_PIXELS = (1 << 31) - 1
_LAST_ROW_TOLERANCE = 1e-6
"""Allows for rounding if the matrix comes from an inversion. A transposed matrix is far off."""


def check_arguments(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    features: Tensor,
    world_to_camera: Tensor,
    intrinsics: Tensor,
    width: int,
    height: int,
    background: Tensor | None,
    settings: RasterSettings,
) -> None:
    """Raise ValueError for arguments that `rasterize` cannot draw, except non-finite backgrounds on a GPU."""
    if not isinstance(settings, RasterSettings):
        raise ValueError(f"settings: found {type(settings).__name__}, expected RasterSettings")
    for name, side in (("width", width), ("height", height)):
        if not isinstance(side, int) or isinstance(side, bool) or not 1 <= side <= _LARGEST_SIDE:
            raise ValueError(f"{name}: found {side!r}, expected an integer from 1 to {_LARGEST_SIDE}")
    if width * height > _MOST_PIXELS:
        raise ValueError(f"width and height: found {width} x {height} pixels, expected at most {_MOST_PIXELS} in all")
    tensors = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "features": features}
    tensors |= {"world_to_camera": world_to_camera, "intrinsics": intrinsics}
    if background is not None:
        tensors["background"] = background
    _check_kinds(tensors)
    _check_shapes(tensors)
    _check_camera(world_to_camera, intrinsics)
    if background is not None and background.is_cpu:  # on a GPU, the check would have to wait
        _check_finite("background", background)


def _check_kinds(tensors: dict[str, Tensor]) -> None:
    for name, tensor in tensors.items():
        if not isinstance(tensor, Tensor):
            raise ValueError(f"{name}: found {type(tensor).__name__}, expected a torch.Tensor")
        if tensor.layout != torch.strided:
            raise ValueError(f"{name}: found {tensor.layout}, expected a dense tensor; tensor.to_dense() makes one")
    means = tensors["means"]
    if means.dtype not in _FLOATS:
        raise ValueError(f"means: found {means.dtype}, expected torch.float32 or torch.float64")
    for name, tensor in tensors.items():
        if tensor.dtype != means.dtype:
            raise ValueError(f"{name}: found {tensor.dtype}, expected {means.dtype} as means has")
        if tensor.device != means.device and name not in ("world_to_camera", "intrinsics"):
            raise ValueError(f"{name}: found on {tensor.device}, expected on {means.device} as means is")
        if tensor.is_meta:
            raise ValueError(f"{name}: found on meta, expected on a device that holds its values")


def _check_shapes(tensors: dict[str, Tensor]) -> None:
    means, features = tensors["means"], tensors["features"]
    count = len(means) if means.ndim else 0
    if features.ndim != 2 or features.shape[1] < 1:
        raise ValueError(f"features: found shape {tuple(features.shape)}, expected ({count}, M) with M of at least 1")
    expected = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,)}
    pose = tensors["world_to_camera"]
    cameras = (len(pose),) if pose.ndim == 3 and len(pose) else ()
    expected |= {"features": (count, features.shape[1])}
    expected |= {"world_to_camera": (*cameras, 4, 4), "intrinsics": (*cameras, 3, 3)}
    background = tensors.get("background")
    batched = background is not None and background.ndim == 2
    expected |= {"background": (*(cameras if batched else ()), features.shape[1])}
    for name, tensor in tensors.items():
        if tuple(tensor.shape) != expected[name]:
            raise ValueError(f"{name}: found shape {tuple(tensor.shape)}, expected {expected[name]}")


def _check_camera(world_to_camera: Tensor, intrinsics: Tensor) -> None:
    for name, tensor in (("world_to_camera", world_to_camera), ("intrinsics", intrinsics)):
        if tensor.requires_grad and torch.is_grad_enabled():
            raise ValueError(f"{name}: found requires_grad, expected a camera without gradient (none is computed)")
        _check_finite(name, tensor)
    for pose in world_to_camera.reshape(-1, 4, 4).tolist():
        _check_last_row(pose[3])
    for calibration in intrinsics.reshape(-1, 3, 3).tolist():
        _check_intrinsics(calibration)


def _check_finite(name: str, tensor: Tensor) -> None:
    if not bool(tensor.isfinite().all()):
        raise ValueError(f"{name}: found a value that is not finite, expected finite numbers: {_shown(tensor)}")


def _check_last_row(row: list[float]) -> None:
    if max(abs(value - expected) for value, expected in zip(row, (0, 0, 0, 1), strict=True)) > _LAST_ROW_TOLERANCE:
        raise ValueError(f"world_to_camera: found a last row of {row}, expected [0, 0, 0, 1]; is it transposed?")


def _check_intrinsics(calibration: list[list[float]]) -> None:
    (fx, skew, _), (shear, fy, _), last = calibration
    if fx <= 0 or fy <= 0:
        raise ValueError(f"intrinsics: found focal lengths {fx} and {fy}, expected more than 0")
    if skew != 0 or shear != 0 or last != [0, 0, 1]:
        raise ValueError(f"intrinsics: found {calibration}, expected a pinhole [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")


def _shown(tensor: Tensor) -> str:
    """The values as text, at most the first 16."""
    values = tensor.flatten()[:16].tolist()
    return f"{values}" if tensor.numel() <= len(values) else f"{values} and {tensor.numel() - len(values)} more"
