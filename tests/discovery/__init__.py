"""Hidden effects: worlds that hide one, and the judging of who finds it."""
