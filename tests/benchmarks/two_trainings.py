"""Times two independent trainings, side by side and one after the other, in interleaved repeats.

    python -m tests.benchmarks.two_trainings                 # plain 3DGS, one thread of torch each
    python -m tests.benchmarks.two_trainings --stage hide    # hiding a scene, two threads of torch each

Both are real trainings, on ray-traced pictures with given cameras and triangulated points. What both ways have in
common is made first and not counted; the trainings are counted until their results are in the store.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORKFLOW = """
name: two_trainings
vars: {seed: 0, plain_iterations: 1000, hide_iterations: 400}
stages:
  photos:
    foreach: &scenes {scene: [courtyard, reef]}
    uses: synthesize
    with: {scene: "${item.scene}", views: 24, width: 256, height: 192}
  scene:
    foreach: *scenes
    uses: sfm
    in: {capture: photos}
    with: {width: 192, poses: given}
  plain:
    foreach: *scenes
    uses: train_scene
    in: {scene: scene}
    with: {iterations: "${plain_iterations}", maximum_gaussians: 15000, seed: "${seed}"}

  cover_photos: {uses: synthesize, with: {scene: courtyard, views: 24, width: 256, height: 192}}
  cover: {uses: sfm, in: {capture: cover_photos}, with: {width: 192, poses: given}}
  message_photos: {uses: synthesize, with: {scene: reef, views: 24, width: 256, height: 192}}
  message: {uses: sfm, in: {capture: message_photos}, with: {width: 192, poses: given}}
  splats: {uses: train_scene, in: {scene: message}, with: {iterations: 300, maximum_gaussians: 15000}}
  views: {uses: render_hidden, in: {splats: splats.splats, message: message, cover: cover}, with: {name: reef}}
  key: {uses: draw_key, with: {seed: 0}}
  hide:
    foreach: {weight: [0.25, 0.5]}
    uses: hide_scenes
    in: {cover: cover, messages: views, key: key}
    with:
      method: homogeneous
      decoder_width: 32
      iterations: "${hide_iterations}"
      maximum_gaussians: 20000
      message_points: 4000
      lambda_message: "${item.weight}"
      threads: 2
      seed: "${seed}"
"""
NEEDED = {"plain": ["scene"], "hide": ["views", "key"]}


def run(workflow: Path, store: Path, stages: list[str], *options: str) -> list[dict[str, object]]:
    """The events that a run prints."""
    command = [sys.executable, "-m", "pipeline", "run", str(workflow), *stages, "--store", str(store), "--json"]
    done = subprocess.run([*command, *options], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def seconds(workflow: Path, prepared: Path, stage: str, seed: int, workers: int) -> float:
    """Seconds that a run of the two trainings takes on so many workers."""
    store = prepared.with_name(f"workers-{workers}")
    shutil.copytree(prepared, store, symlinks=True)
    told = run(workflow, store, [stage], "--workers", str(workers), "--set", f"seed={seed}")
    shutil.rmtree(store)
    assert told[-1]["ran"] == 2
    return float(str(told[-1]["seconds"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stage", choices=sorted(NEEDED), default="plain")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        workflow, prepared = Path(folder) / "two_trainings.yaml", Path(folder) / "prepared"
        workflow.write_text(WORKFLOW)
        run(workflow, prepared, NEEDED[arguments.stage])
        ratios = []
        for seed in range(1, arguments.repeats + 1):
            apart, together = (seconds(workflow, prepared, arguments.stage, seed, workers) for workers in (1, 2))
            ratios.append(together / apart)
            load = os.getloadavg()[0]
            print(f"apart {apart:.1f} s, together {together:.1f} s: {ratios[-1]:.2f} (load {load:.1f})", flush=True)
    print(f"{arguments.stage} on {os.cpu_count()} cores: together {statistics.median(ratios):.2f} of apart (median)")


if __name__ == "__main__":
    main()
