"""Companion process of `synthesize` that renders some of a capture's photos.

Run as `python -m stages.tracing.photograph_process JOB`.

Ray tracing in NumPy takes many short steps and holds the interpreter lock between them: two threads rendered 48 photos
of the workshop in 25.0 s, two processes in 16.7 s, although each process prepares the scene for itself.
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
    """The views to render (`chosen`, out of `views` on the orbit) and the parameters of `synthesize`.

    The pictures go to the folder of the job file, where `read_picture_file` finds them.
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
    """Read a job file written by `Job.write`."""
    content = json.loads(path.read_text())
    return Job(**content | {"chosen": tuple(content["chosen"])})


def _picture_file(folder: Path, view: int) -> Path:
    return folder / f"{view:03d}.npy"


def take(job: Job, folder: Path) -> None:
    """Render the chosen views into `folder`. Each view has its own seed, so any process renders it the same."""
    world = importlib.import_module(f"{SCENES}.{job.scene}").build(job.seed)
    studio = Studio(world, job.gloss)
    poses, intrinsics = orbit(job.views, job.width, job.height, job.seed)
    for view in job.chosen:
        generator = np.random.default_rng([job.seed, view])
        picture = studio.photograph(poses[view], intrinsics[view], job.width, job.height, job.samples, generator)
        np.save(_picture_file(folder, view), picture)
        say(view=view)


def read_picture_file(folder: Path, view: int) -> UInt8[np.ndarray, "height width 3"]:
    """Read and delete the picture of a view that `take` has reported as finished."""
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
