"""The reduced model: a frozen record, its file, and its truncation."""
