"""flora-lab as a service: watches plants while they grow, and diagnoses each run when it has ended."""
