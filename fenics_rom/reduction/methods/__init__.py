"""The reduction methods, each a function of a reduction problem."""
