"""One file per method: how its Gaussians become pictures. `method: NAME` in a workflow means `NAME.py` here.

To add a method of your own, add a file; workflows/README.md describes its contents.
"""
