"""An evolution to look at: figures, a film of its best controller, and one page that holds them all."""
