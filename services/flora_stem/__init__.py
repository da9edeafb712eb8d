"""flora-stem: photograph to ten-point stem."""
