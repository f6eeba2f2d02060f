"""Trains plain 3DGS on fox from random grey points, the case for which OpenSplat's figures are known.

    python -m tests.benchmarks.fox_random_points FOLDER_OF_FOX

132x238 pixels (134x239 before undistortion), 2,000 steps, 20,000 random grey points, scored on the held-out photo
0012.jpg. OpenSplat's C++ on a CPU reaches 20.4 dB there, at 4.5 iterations a second. On a machine with a GPU, set
GS_HIDER_DEVICE=portable: else a GPU is compared with a CPU.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import torch

from opencl.routes import describe_drawing, working_device
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method
from stages.imaging.pictures import picture_to_tensor
from stages.imaging.psnr import psnr
from stages.imaging.ssim import ssim
from stages.photos import PhotosParameters, photos
from stages.scene.scene import read_scene
from stages.sfm import SfmParameters, sfm
from stages.train_scene import TrainSceneParameters, train_scene
from tests.running import run_stage

HELD_OUT = "0012.jpg"
ITERATIONS = 2_000
OPENSPLAT_DECIBELS, OPENSPLAT_ITERATIONS_A_SECOND = 20.4, 4.5


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        results = Path(name)
        capture = run_stage(photos, PhotosParameters(folder=folder), {}, results / "photos")["capture"]
        scene = run_stage(sfm, SfmParameters(width=239, matching_size=960), {"capture": capture}, results / "sfm")[
            "scene"
        ]
        parameters = TrainSceneParameters(
            iterations=ITERATIONS, sparse_points=False, random_points=20_000, maximum_gaussians=40_000, threads=2
        )
        start = time.perf_counter()
        splats = run_stage(train_scene, parameters, {"scene": scene}, results / "train")["splats"]
        seconds = time.perf_counter() - start
        views = read_scene(scene)
        held_out = views.cameras.select([HELD_OUT])
        assert HELD_OUT in views.test_names
        rendering = next(photographs(read_gaussians(splats), read_method(splats), held_out))
        truth = picture_to_tensor(views.pictures[views.rows([HELD_OUT])[0]])
        picture = rendering.pictures[COVER].clamp(0, 1)
    rate = ITERATIONS / seconds
    print(describe_drawing(working_device()), f"torch {torch.__version__}")
    print(f"{held_out.width}x{held_out.height}, {splats.attributes['gaussians']} Gaussians")
    quality = f"{psnr(picture, truth):.2f} dB, SSIM {float(ssim(picture, truth)):.3f}"
    print(f"{HELD_OUT}: {quality} (OpenSplat {OPENSPLAT_DECIBELS} dB)")
    print(f"{rate:.1f} iterations a second, {rate / OPENSPLAT_ITERATIONS_A_SECOND:.1f} times OpenSplat's")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
