"""StegExpose 0.1 (Boehm 2014): four detectors of messages in the lowest bits of a picture, and their fusion."""
