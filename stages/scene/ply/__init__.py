"""PLY files as tables of numbers: what an element's properties are called and hold, whatever they mean."""
