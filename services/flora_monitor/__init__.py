"""flora-monitor: tail, rates, topics, record, replay and health of the bus."""
