"""What rig and lab share: messages, bus, time, configuration, files, geometry, vision."""
