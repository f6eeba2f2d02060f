"""Reads files of trained Gaussians, whose format is recognised by content, not by name."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import UserError
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import degree_of
from stages.scene.ply.reading import begins_as_ply, read_ply
from stages.scene.spherical_harmonics import SH_REST
from stages.scene.splat_files.compressed_ply import is_compressed, values_of_compressed_ply
from stages.scene.splat_files.gaussian_ply import values_of_gaussian_ply
from stages.scene.splat_files.records import values_of_records
from stages.scene.splat_files.values import SplatValues, gaussians_of


def read_splats(path: Path) -> tuple[Gaussians, int]:
    """The Gaussians of a file, as the method `plain` stores them, and the degree of their spherical harmonics.

    Formats: 3DGS's and Mip-Splatting's PLY (ASCII, or binary of either byte order), PlayCanvas's compressed PLY, and
    `.splat`. Positions are in the file's world. Raises `UserError` for other, broken or implausible files. Takes time
    and memory proportional to the file.
    """
    if not path.is_file():
        raise UserError(
            "no such file of splats",
            where=path,
            found="a folder" if path.is_dir() else "nothing",
            remedy="Name a .ply or .splat file.",
        )
    try:
        gaussians = gaussians_of(path, _values(path))
    except OSError as error:
        raise UserError("cannot be read", where=path, found=error.strerror or error) from error
    return gaussians, degree_of(gaussians[SH_REST])


def _values(path: Path) -> SplatValues:
    if not begins_as_ply(path):
        return values_of_records(path)
    ply = read_ply(path)
    if is_compressed(ply.elements):
        return values_of_compressed_ply(path, ply.elements)
    return values_of_gaussian_ply(path, ply.rows("vertex"))
