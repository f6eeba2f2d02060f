"""A package of toy stages, as small as stages can be."""
