"""The attribute under which a secret names the view that hides an image; usable without importing any method."""

from __future__ import annotations

IMAGE_VIEW = "image_view"
