"""The linear models of a ROM as files and code for other programs; see README.md."""
