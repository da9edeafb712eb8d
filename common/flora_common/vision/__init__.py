"""From a photograph to a ten-point stem: decoding, the empty setup, the path method and the published one, overlays.

Needs numpy and OpenCV only; it runs on the Pi and in the lab alike.
"""
