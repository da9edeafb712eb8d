"""flora-dashboard: the rig in a browser, to look at."""
