"""What a secret calls the view that hides an image: known without any method."""

from __future__ import annotations

IMAGE_VIEW = "image_view"
