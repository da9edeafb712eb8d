"""flora-controller: stem to light, by an evolved network or a built-in rule."""
