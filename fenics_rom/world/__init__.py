"""Several bodies, rigid and soft, that touch one another."""
