"""What is simulated: a scene file, checked and typed."""
