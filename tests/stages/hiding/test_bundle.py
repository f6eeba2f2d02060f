"""What goes into the public files of a container."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.artifact import create, load
from stages.hiding.bundle import container_bundle
from stages.hiding.networks import PUBLIC_NETWORKS, SECRET_NETWORKS


def test_a_secret_network_in_a_container_stays_out_of_its_files(tmp_path: Path) -> None:
    """No stage writes one there. A method of one's own might."""
    with create(tmp_path / "container", "container") as writer:
        writer.attributes.update(method="gs_hider", settings={})
        writer.write("means", np.zeros((2, 3), np.float32))
        for network in (*PUBLIC_NETWORKS, *SECRET_NETWORKS, "another"):
            writer.write(f"{network}/0.weight", np.zeros(1, np.float32))
    bundle = container_bundle(load(tmp_path / "container"))
    assert set(bundle.networks) == set(PUBLIC_NETWORKS)
    assert set(bundle.attributes) == {"means"}
