"""Work that a lab is asked to do over the bus: what may be asked, what has become of it, and asking."""
