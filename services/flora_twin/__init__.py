"""flora-twin: the virtual grow box, and the virtual rig around it."""
