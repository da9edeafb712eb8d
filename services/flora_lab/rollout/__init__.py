"""How far simulated plants are from real ones: one step ahead, and running free for days."""
