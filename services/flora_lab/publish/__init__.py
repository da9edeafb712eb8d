"""From the lab to a rig: keys, signed controller files, and their way over the bus."""
