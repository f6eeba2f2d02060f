"""Where in a scene of Gaussians a picture was taken from: first by known landmarks, then by every pixel."""
