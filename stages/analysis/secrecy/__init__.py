"""Who can read the message without the secret: wrong decoders, trained ones, and what lies open in the features."""
