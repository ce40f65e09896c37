"""What people look at: plots, exports and the live view."""
