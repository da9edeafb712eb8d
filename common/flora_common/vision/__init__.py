"""From a photograph to a ten-point stem: decoding, setup matrices, the published method, overlays.

Needs numpy and OpenCV only; it runs on the Pi and in the lab alike.
"""
