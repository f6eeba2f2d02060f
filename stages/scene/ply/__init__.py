"""PLY files as tables of numbers: the names and values of an element's properties, whatever they mean."""
