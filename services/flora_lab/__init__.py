"""flora-lab: the offline lab: tracks, models, controllers, discoveries."""
