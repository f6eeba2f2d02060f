"""Toy stages that are slow enough to be killed, crash, log a lot, or write down what others may read."""
