"""What resists the shape of a body in a step."""
