"""flora-flash: the beat, and the flash lamp."""
