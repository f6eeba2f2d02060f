"""Readings of the message without the secret: wrong decoders, surrogates, and what the features reveal openly."""
