"""Certificates of impact: the worst over ranges of speeds, masses and poses, with errors, beside limits."""
