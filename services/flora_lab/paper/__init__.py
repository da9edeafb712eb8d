"""``flora-lab paper``: every figure and number of Wahby et al. 2018 beside those of this project."""
