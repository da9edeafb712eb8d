"""Evolution: tasks, controllers and their fitness."""
