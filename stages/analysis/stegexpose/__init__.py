"""StegExpose 0.1 (Boehm 2014): four detectors of LSB steganography (messages in the lowest bits), and their fusion."""
