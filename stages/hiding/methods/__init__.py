"""One file a method: how its Gaussians become pictures."""
