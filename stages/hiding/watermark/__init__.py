"""Watermarks in pictures: an invertible network on wavelet coefficients hides a picture in a picture; and grain."""
