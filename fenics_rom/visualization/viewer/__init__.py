"""The body in a browser: live and pulled with the mouse, or a recorded run."""
