"""Finding results by name, and what may be shown or copied of them, and where."""
