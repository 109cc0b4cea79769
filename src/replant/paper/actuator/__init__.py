"""The actuator experiment of section 4."""
