"""One file a method: how its Gaussians become pictures. `method: NAME` in a workflow means `NAME.py` here.

A method of your own is one file more: workflows/README.md says what stands in it.
"""
