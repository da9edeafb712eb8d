"""``flora-lab dataset``: tracks in, the paper's training set out."""
