"""From where in a scene of Gaussians a picture was taken: known landmarks first, then every pixel."""
