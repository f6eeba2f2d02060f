"""The nodes that a workflow can name, one file a stage, and the library folders that they call."""
