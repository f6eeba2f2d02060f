"""How Gaussians become pictures: containers, decoders, and one file a method."""
