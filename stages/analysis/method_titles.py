"""The methods of the tables, and their titles on pages."""

from __future__ import annotations

from stages.hiding.method_names import PLAIN

SECOND_HARMONICS, DECODER, GS_HIDER = "sh", "decoder", "gs_hider"
OURS = "homogeneous"

METHOD_TITLES = {  # the paper's, in its order, and ours
    PLAIN: "3DGS",
    SECOND_HARMONICS: "3DGS+SH",
    DECODER: "3DGS+Decoder",
    GS_HIDER: "GS-Hider",
    OURS: "Homogeneous GS-Hider",
}
