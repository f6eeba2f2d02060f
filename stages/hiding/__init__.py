"""How Gaussians become pictures: containers, decoders, and one file per method."""
