"""COLMAP models written by pycolmap, in a process of its own: `python -m tests.stages.scene.write_colmap_models FILE`.

The file holds a JSON list of models: their folder, `text` or `binary`, and for each photo its name, its world-to-camera
matrix, and its camera: model, width, height, parameters.
"""

from __future__ import annotations

import json
import sys
import zlib  # noqa: F401 - loaded before pycolmap, whose own zlib breaks other libraries
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap


def write_model(folder: Path, form: str, photos: list[dict[str, Any]]) -> None:
    """Photos with equal cameras share one; the first two see a point, so that there are observations to skip."""
    model, numbers = pycolmap.Reconstruction(), {}
    for number, photo in enumerate(photos, start=1):
        spelt = json.dumps(photo["camera"])
        if spelt not in numbers:
            numbers[spelt] = len(numbers) + 1
            name, width, height, parameters = photo["camera"]
            camera = pycolmap.Camera(
                model=name, width=width, height=height, params=parameters, camera_id=numbers[spelt]
            )
            model.add_camera_with_trivial_rig(camera)
        observed = [pycolmap.Point2D([1.0, 2.0]), pycolmap.Point2D([3.0, 4.0])]
        image = pycolmap.Image(name=photo["name"], camera_id=numbers[spelt], image_id=number, points2D=observed)
        pose = pycolmap.Rigid3d(np.array(photo["world_to_camera"])[:3])
        model.add_image_with_trivial_frame(image, pose)
    if len(photos) > 1:
        track = pycolmap.Track()
        track.add_element(1, 0)
        track.add_element(2, 1)
        model.add_point3D([0.0, 0.0, 0.0], track)
    folder.mkdir(parents=True, exist_ok=True)
    write = model.write_text if form == "text" else model.write_binary
    write(str(folder))


if __name__ == "__main__":
    for one in json.loads(Path(sys.argv[1]).read_text()):
        write_model(Path(one["folder"]), one["form"], one["photos"])
