"""``flora-lab report``: a run folder as one page that a person looks at."""
