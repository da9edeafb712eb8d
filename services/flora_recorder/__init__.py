"""flora-recorder: every bus message to MCAP files."""
