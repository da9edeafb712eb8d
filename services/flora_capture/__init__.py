"""flora-capture: one photograph per tick, whole and announced."""
