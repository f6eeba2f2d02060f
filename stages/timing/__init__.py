"""Where time goes: a stopwatch for the parts of a training's iteration."""
