"""A store in a bucket of S3's kind, with a mirror of it on this machine."""
