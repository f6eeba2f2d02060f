"""The built-in scenes: one module each, with a function `build(seed)` that returns a `World`."""
