"""``flora-lab rhythm``: whether the tip of a plant swings, how long its cycles are, what a tip alone cannot tell."""
