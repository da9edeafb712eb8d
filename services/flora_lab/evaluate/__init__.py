"""``flora-lab evaluate``: controllers in simulators and on virtual plants, and the reality gap between the two."""
