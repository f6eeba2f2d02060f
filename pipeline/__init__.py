"""The engine: workflow file → graph of stages → dask → artifacts in the store."""
