"""Watermarks that a picture carries: an invertible network on wavelet coefficients hides a picture in a picture."""
