"""flora-bus: the XSUB/XPUB proxy that every service talks through."""
