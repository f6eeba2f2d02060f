"""A share of a capture's photos, taken by a companion of `synthesize`.

Run as `python -m stages.tracing.photograph_process JOB`.

Ray tracing in NumPy holds the interpreter between its many short steps: two threads traced 48 photos of the workshop
in 25.0 s, two processes in 16.7 s. Each process prepares the scene for itself, both at the same time.
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from pipeline.companion import end_with_stage, say
from stages.tracing.photograph import Studio
from stages.tracing.rig import orbit

SCENES = "stages.tracing.scenes"


@dataclass(frozen=True)
class Job:
    """Which of the `views` of a walk to photograph, and how; see the parameters of `synthesize`.

    The pictures go to the job's folder, for `read_picture_file`.
    """

    scene: str
    chosen: tuple[int, ...]
    views: int
    width: int
    height: int
    samples: int
    gloss: float
    seed: int

    def write(self, path: Path) -> None:
        path.write_text(json.dumps(asdict(self)))


def read_job(path: Path) -> Job:
    """Read what `Job.write` wrote."""
    content = json.loads(path.read_text())
    return Job(**content | {"chosen": tuple(content["chosen"])})


def _picture_file(folder: Path, view: int) -> Path:
    return folder / f"{view:03d}.npy"


def take(job: Job, folder: Path) -> None:
    """Photograph the chosen views. Every view has random numbers of its own, whoever takes it."""
    world = importlib.import_module(f"{SCENES}.{job.scene}").build(job.seed)
    studio = Studio(world, job.gloss)
    poses, intrinsics = orbit(job.views, job.width, job.height, job.seed)
    for view in job.chosen:
        generator = np.random.default_rng([job.seed, view])
        picture = studio.photograph(poses[view], intrinsics[view], job.width, job.height, job.samples, generator)
        np.save(_picture_file(folder, view), picture)
        say(view=view)


def read_picture_file(folder: Path, view: int) -> UInt8[np.ndarray, "height width 3"]:
    """The picture of a view that `take` has said to be there; its file is removed."""
    path = _picture_file(folder, view)
    picture = np.load(path, allow_pickle=False)
    path.unlink()
    return picture


def main() -> None:
    end_with_stage()
    path = Path(sys.argv[1])
    take(read_job(path), path.parent)


if __name__ == "__main__":
    main()
