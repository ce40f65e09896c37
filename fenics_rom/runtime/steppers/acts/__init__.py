"""What acts on the shape of a body in a step."""
