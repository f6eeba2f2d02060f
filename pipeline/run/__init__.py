"""The execution of a plan: by this process, by workers of its own, or by dask's on other machines."""
