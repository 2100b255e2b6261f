"""Frame times, clock steps and the clock's state."""
