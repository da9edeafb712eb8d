"""The virtual rig: all services as processes on a private bus, round one virtual grow box."""
