"""``flora-lab track``: photographs of a plant in, ``track.csv`` out."""
