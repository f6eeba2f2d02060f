"""The built-in places: one file a scene, each with a `build(seed)` that returns a `World`."""
